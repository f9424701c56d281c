"""The method `vlm` against a server on this machine."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from agent_doubles import CONFIG, HEIGHT, WIDTH, Kit, World
from chat_server import ChatServer, Got, Turn, good, hang_up, huge, no_schema, raw, slow, status, wants_key
from test_llm import bare

from fuse_grounding.agent import Agent
from fuse_grounding.cli.app import execute
from fuse_grounding.config import Config
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.grounding import Grounded
from fuse_grounding.knowledge.protocol import Candidate
from fuse_grounding.planning.protocol import Situation
from fuse_grounding.planning.vlm import HORIZONTAL, PITCH, Reply, depth_picture, feasible_actions
from fuse_grounding.record import EpisodeRecord, ResultEntry


def move(horizontal: str = "move_right_10", pitch: str = "pitch_keep", **changed: Any) -> dict[str, Any]:
    seen = {"target_visible": False, "target_centered": False, "target_reachable": False}
    return {"status": "continue", "horizontal": horizontal, "pitch": pitch, **seen, **changed}


STOP = move("stay", status="stop", target_visible=True)


def config(server: ChatServer | str, folder: Path, **vlm: Any) -> Config:
    url = server if isinstance(server, str) else server.url
    given = {"base_url": url, "model": "m", "cache": str(folder), "backoff_s": 0.01, **vlm}
    return CONFIG.with_(method="vlm", vlm=given)


def search(settings: Config, world: World | None = None) -> Grounded:
    """An episode; a knife is seen everywhere, best at node 2."""
    kit = Kit("vlm", lambda node, pitch: 0.9 if node == 2 else 0.5, settings)
    return Agent(kit.config, kit.parts).run(world or World(), "cut")


def result(grounded: Grounded) -> ResultEntry:
    assert grounded.record.result is not None
    return grounded.record.result


def told(got: Got) -> dict[str, Any]:
    return json.loads(got.texts[1])


def test_the_fifteen_actions_have_names():
    seen = {"target_visible": True, "target_centered": True, "target_reachable": True}
    actions = [
        Reply.model_validate({"status": "continue", "horizontal": h, "pitch": p, **seen}).action
        for p in PITCH
        for h in HORIZONTAL
    ]
    assert actions == list(range(15))
    mask = np.zeros(15, bool)
    mask[[5, 7, 14]] = True
    assert feasible_actions(mask) == {"pitch_keep": ["move_left_20", "stay"], "pitch_down": ["move_right_20"]}


def test_depth_is_white_near_dark_far_black_unknown():
    depth = np.array([[0.1, 0.3, 1.15], [2.0, 9.0, 0.0], [np.nan, np.inf, 0.73]], np.float32)
    assert depth_picture(depth, 0.3, 2.0).tolist() == [[255, 255, 144], [32, 32, 0], [0, 0, 199]]


def test_the_model_moves_the_camera_and_stops(tmp_path: Path):
    world = World(node=35)
    turns = [
        good(move("move_right_20", "pitch_down")),
        good(move("move_right_10", "pitch_up", target_visible=True)),
        good(move("move_left_10")),
        good(STOP),
    ]
    with ChatServer(turns) as server:
        grounded = search(config(server, tmp_path), world)
    assert world.acts == [14, 3, 6]
    record, end = grounded.record, result(grounded)
    assert (end.online_actions, end.observations, end.branches) == (3, 4, {"vlm": 3})
    assert end.stop_reason.startswith("the model stopped (reply ")
    # Grounded in the last view, though an earlier one scored higher.
    assert [s.node for s in record.steps] == [35, 1, 2, 1]
    assert (end.view.node, end.score) == (1, record.steps[3].scores[0].fused)  # type: ignore[union-attr]
    assert record.steps[2].best_score > end.score  # type: ignore[operator]
    assert record.steps[1].reason.startswith("continue: target visible (reply ")
    assert record.steps[0].reason.startswith("continue: target not visible (reply ")
    assert record.config["stopping"]["rule"] == "policy"
    assert record.config["return"]["view"] == "final"
    assert record.steps[0].timings["api"] > 0
    assert EpisodeRecord.model_validate(record.model_dump()) == record

    views = World(node=35)
    assert len(server.got) == 4
    for got, acts in zip(server.got, ([], [14], [3], [6]), strict=True):
        for action in acts:
            views.act(action)
        rgb, depth = got.pictures
        np.testing.assert_array_equal(rgb, views.observe().rgb)
        assert depth.shape == (HEIGHT, WIDTH)
        assert set(np.unique(depth)) == {196}  # 0.75 m
        assert (told(got)["loop_position"], told(got)["pitch_deg"]) == (
            views.node,
            (15, 30, 45)[views.pitch_index],
        )
    first, second = told(server.got[0]), told(server.got[1])
    assert first["targets"] == [c.label for c in record.candidates]
    assert set(first["feasible_actions"]) == {"pitch_up", "pitch_keep", "pitch_down"}
    assert set(second["feasible_actions"]) == {"pitch_up", "pitch_keep"}  # it is down already
    assert first["history"] == []
    assert second["history"] == [
        {"step": 0, "loop_position": 35, "pitch_deg": 30.0, **move("move_right_20", "pitch_down")}
    ]
    schema = server.got[0].body["response_format"]["json_schema"]["schema"]
    assert schema["required"] == [
        *("status", "horizontal", "pitch"),
        *("target_visible", "target_centered", "target_reachable"),
    ]
    assert schema["properties"]["status"]["enum"] == ["stop", "continue"]


def test_it_goes_on_until_the_budget_and_remembers_six_decisions(tmp_path: Path):
    with ChatServer(good(move("stay"))) as server:
        settings = config(server, tmp_path).with_(budget={"actions": 9})
        grounded = search(settings)
        assert [len(told(got)["history"]) for got in server.got] == [0, 1, 2, 3, 4, 5, 6, 6, 6]
        assert [h["step"] for h in told(server.got[-1])["history"]] == [2, 3, 4, 5, 6, 7]
        # Patience of five ends it where that is wanted, and the best view is returned.
        patient = settings.with_(stopping={"rule": "patience"}, return_={"view": "best"})
        assert result(search(patient)).stop_reason.startswith("patience: 5")
        assert len(server.got) == 9  # the same questions
        shorter = search(config(server, tmp_path, history=0).with_(budget={"actions": 2}))
        assert len(server.got) == 9  # what is not told does not matter: all are the first question
    assert result(grounded).stop_reason == "budget: 9 actions"
    assert (result(grounded).online_actions, result(shorter).online_actions) == (9, 2)


def test_stopping_without_a_visible_target_goes_on(tmp_path: Path):
    with ChatServer(
        [good({**STOP, "target_visible": False, "horizontal": "move_left_20"}), good(STOP)]
    ) as server:
        grounded = search(config(server, tmp_path))
    assert [s.action for s in grounded.record.steps] == [5, None]
    assert grounded.record.steps[0].reason.startswith("stop without a visible target, so continue")


def test_without_depth_it_is_told_so(tmp_path: Path):
    with ChatServer(good(STOP)) as server:
        search(config(server, tmp_path), World(depth=None))
    assert len(server.got[0].pictures) == 1
    assert server.got[0].texts[-1] == "The depth is not known."


def test_the_oracles_label_is_told_only_where_asked_for(tmp_path: Path):
    with ChatServer(good(STOP)) as server:
        oracle = search(config(server, tmp_path, labels="oracle"))
        candidates = search(config(server, tmp_path))
    assert [told(got)["targets"] for got in server.got] == [
        ["ruler"],
        [c.label for c in candidates.record.candidates],
    ]
    assert "vlm: the world was asked for the episode's target" in str(oracle.record.announcements)
    assert "asked" not in str(candidates.record.announcements)
    assert oracle.label == "knife"  # masks are of the candidates
    kit = Kit("vlm", lambda node, pitch: 0.5, config(server, tmp_path, labels="oracle"))
    with pytest.raises(InputError, match="needs an episode that knows its target"):
        Agent(kit.config, kit.parts).start("cut", node=0)


INVALID: dict[str, tuple[Turn, int, str]] = {
    "words": (good("I would move left."), 1, "does not fit: Invalid JSON"),
    "empty": (good(""), 1, "does not fit: Invalid JSON"),
    "status": (good({**move(), "status": "go"}), 1, "does not fit: `status`"),
    "type": (good({**move(), "target_visible": "yes"}), 1, "does not fit: `target_visible`"),
    "more": (good({**move(), "why": "x"}), 1, "does not fit: `why`"),
    "infeasible": (good(move(pitch="pitch_up")), 1, "move_right_10 with pitch_up is not feasible"),
    "no completion": (raw(b"not a completion"), 1, "no reply: .*not a chat completion"),
    "huge": (huge, 1, "no reply: .*longer than 1000000 bytes"),
    "500": (status(500), 2, "no reply: .*the server says 500.*the last of 2 attempts"),
    "slow": (slow, 2, r"no reply: .*no reply within 0\.3 s"),
    "gone": (hang_up, 2, "no reply: .*broke off"),
}


@pytest.mark.parametrize("how", INVALID)
def test_an_invalid_reply_is_a_decision_not_to_move(tmp_path: Path, how: str):
    turn, sent, reason = INVALID[how]
    world = World(node=0, pitch_index=0)
    with ChatServer(turn) as broken:
        settings = config(broken, tmp_path, retries=1, timeout_s=0.3).with_(budget={"actions": 1})
        grounded = search(settings, world)
        assert len(broken.got) == sent
    record, end = grounded.record, result(grounded)
    assert world.acts == [7]
    assert (record.steps[0].branch, end.branches) == ("vlm_invalid", {"vlm_invalid": 1})
    assert re.search(f"{reason}.*; no motion$", record.steps[0].reason), record.steps[0].reason
    assert len(record.steps[0].reason) < 700
    assert end.status == "grounded"
    # Replayed without a server, the episode is the same, failures included.
    replayed = search(
        config(broken, tmp_path, retries=1, timeout_s=0.3, offline=True).with_(budget={"actions": 1}),
        World(node=0, pitch_index=0),
    )
    assert bare(replayed.record.model_dump()) == bare(record.model_dump())


def test_after_an_invalid_reply_the_search_goes_on(tmp_path: Path):
    world = World()
    with ChatServer([good(move()), good("?"), good(move()), good(STOP)]) as server:
        grounded = search(config(server, tmp_path), world)
    assert world.acts == [8, 7, 8]
    assert result(grounded).branches == {"vlm": 2, "vlm_invalid": 1}
    note = told(server.got[2])["history"][-1]
    assert (note["horizontal"], note["note"]) == ("stay", "your reply was invalid; the camera did not move")


def test_a_server_that_stays_silent_ends_the_episode_with_an_error(tmp_path: Path):
    with ChatServer(status(503, "overloaded")) as server:
        with pytest.raises(
            FuseError, match=r"503.*overloaded.*; the last 3 questions had no reply"
        ) as failed:
            search(config(server, tmp_path, retries=0))
        assert not isinstance(failed.value, InputError)  # a benchmark records it and goes on
        assert len(server.got) == 3
    turns = [status(503), status(503), good(move()), status(503), status(503), good(STOP)]
    with ChatServer(turns) as server:  # never three in a row
        assert result(search(config(server, tmp_path / "b", retries=0))).branches == {
            "vlm": 1,
            "vlm_invalid": 4,
        }


def test_an_endpoint_that_cannot_be_asked_ends_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("VLM_KEY", "sk-wrong-123456")
    refused = pytest.raises(InputError, match=r"vlm at http.*the key in VLM_KEY is refused")
    with ChatServer(wants_key("sk-right", good(STOP))) as server, refused:
        search(config(server, tmp_path, key_env="VLM_KEY"))
    with pytest.raises(InputError, match="nobody answers"):
        search(config("http://127.0.0.1:9/v1", tmp_path))
    with pytest.raises(InputError, match=r"`vlm.base_url` is not set"):
        search(CONFIG.with_(method="vlm"))


def test_a_server_without_schemas_is_announced_once(tmp_path: Path):
    with ChatServer(no_schema(good(move()))) as server:
        grounded = search(config(server, tmp_path).with_(budget={"actions": 3}))
    notes = [n for n in grounded.record.announcements if "takes no schema" in n]
    assert len(notes) == 1
    assert len(server.got) == 4


def test_an_episode_is_replayed_offline_bit_for_bit(tmp_path: Path):
    turns = [good(move("move_left_20")), good("?"), status(500), good(move(pitch="pitch_up")), good(STOP)]
    with ChatServer(turns) as server:
        first = search(config(server, tmp_path, retries=0))
        assert len(server.got) == 5
    again = search(config(server, tmp_path, retries=0, offline=True))
    assert bare(first.record.model_dump()) == bare(again.record.model_dump())
    assert result(again).branches == {"vlm": 2, "vlm_invalid": 2}
    np.testing.assert_array_equal(first.mask, again.mask)
    with pytest.raises(InputError, match=r"`vlm.offline`: the reply [0-9a-f]{64} is not in"):
        search(config(server, tmp_path, offline=True), World(node=5))


def test_a_robot_without_a_place_on_the_ring_is_served(tmp_path: Path):
    with ChatServer(good(STOP)) as server:
        kit = Kit("vlm", lambda node, pitch: 0.5, config(server, tmp_path))
        session = Agent(kit.config, kit.parts).start("cut")
        assert isinstance(session.step(World().observe().rgb), Grounded)
    assert told(server.got[0])["loop_position"] is None
    assert (
        Situation(0, np.zeros((1, 1, 3), np.uint8), np.ones(15, bool), [Candidate("a", 1, "")], []).node
        is None
    )


def test_the_command_line_runs_a_real_episode_with_both_models(tmp_path: Path):
    """Real pictures, a real segmenter; twice the same, the second time without a server."""
    proposals = {"candidates": [{"label": "knife", "score": 1.0, "reason": "sharp"}]}

    def both(got: Got) -> dict[str, Any]:
        schema = got.body["response_format"]["json_schema"]["name"]
        return proposals if schema == "proposals" else move("move_right_20")

    def bench(out: str, url: str, *more: str) -> list[dict[str, Any]]:
        chosen = ["budget.actions=2", "knowledge.source=llm", *more]
        for section in ("vlm", "knowledge.llm"):
            chosen += [f"{section}.base_url={url}", f"{section}.model=m", f"{section}.cache={tmp_path / 'c'}"]
        options = [part for setting in chosen for part in ("--set", setting)]
        folder = tmp_path / out
        assert execute(["bench", "--methods", "vlm", "--limit", "1", "--out", str(folder), *options]) == 0
        return [json.loads(line) for line in (folder / "results.jsonl").read_text().splitlines()]

    with ChatServer(good(both)) as server:
        (row,) = bench("online", server.url)
        assert len(server.got) == 3
    rgb, depth = server.got[1].pictures
    assert (rgb.shape, depth.shape) == ((480, 640, 3), (480, 640))
    assert len(np.unique(depth)) > 100  # a scene, not a wall
    assert (row["status"], row["branches"], row["candidates"]) == ("ok", {"vlm": 2}, ["knife"])
    assert row["stop_reason"] == "budget: 2 actions"
    assert row["timings"]["api"] > 0
    assert row["calls"].pop("api") == 3
    (again,) = bench("offline", server.url, "vlm.offline=true", "knowledge.llm.offline=true")
    assert bare(again) == bare(row)
