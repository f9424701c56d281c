from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from agent_doubles import CONFIG, HEIGHT, WIDTH, Kit, World, camera

from fuse_grounding.agent import Agent, Session
from fuse_grounding.config import Config
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import InputError
from fuse_grounding.grounding import Grounded, decode_mask, encode_mask, locate
from fuse_grounding.planning.protocol import Decision, Situation
from fuse_grounding.record import EpisodeRecord, Stopwatch
from fuse_grounding.runfolder import RunFolder, prepare


class Walk:
    """A policy that goes one node to the right, for ever."""

    start = "here"
    planner = None

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        return Decision(8, "walk")


def walk(score: Any, config: Config = CONFIG) -> tuple[Grounded, Kit, World]:
    kit, world = Kit("explicit", score, config, policy=Walk()), World()
    return Agent(kit.config, kit.parts).run(world, "cut a rope"), kit, world


def without_timings(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            k: without_timings(v) for k, v in value.items() if k != "timings" and not k.endswith("_seconds")
        }
    return [without_timings(v) for v in value] if isinstance(value, list) else value


def test_patience_counts_from_the_best_view_and_returns_it():
    # Rises to node 3, equal at node 4 (no improvement), lower afterwards: five failures at node 8.
    scores = {0: 0.2, 1: 0.5, 2: 0.4, 3: 0.8, 4: 0.8, 5: 0.7, 6: 0.0, 7: 0.1, 8: 0.3, 9: 0.99}
    grounded, _, world = walk(lambda node, pitch: scores[node])
    assert grounded.viewpoint.node == 3
    assert grounded.score == pytest.approx(0.7 * 0.8 + 0.3 * 0.5)  # 0.75 m is half way from 0.3 to 1.2
    record = grounded.record
    assert [s.node for s in record.steps] == list(range(9))
    assert [s.improved for s in record.steps] == [True, True, False, True] + [False] * 5
    assert record.steps[-1].action is None
    assert record.result is not None
    assert record.result.stop_reason.startswith("patience")
    assert (record.result.online_actions, record.result.observations) == (8, 9)
    assert len(world.acts) == 8


def test_patience_may_begin_with_the_first_score():
    rule = {"rule": "patience_once_found"}
    found = walk(lambda node, pitch: 0.6 if node == 9 else 0.0, CONFIG.with_(stopping=rule))[0].record
    assert [s.node for s in found.steps] == list(range(15))  # five views after the ninth
    assert [s.index for s in found.steps if s.improved] == [9]
    nothing = walk(lambda node, pitch: 0.0, CONFIG.with_(stopping=rule, budget={"actions": 8}))[0].record
    assert nothing.result is not None
    assert nothing.result.stop_reason == "budget: 8 actions"


def test_the_budget_scores_one_view_more_than_it_makes_moves():
    config = CONFIG.with_(budget={"actions": 3})
    grounded, _, world = walk(lambda node, pitch: 0.1 + 0.05 * (node % 30), config)
    result = grounded.record.result
    assert result is not None
    assert (result.online_actions, result.observations, len(world.acts)) == (3, 4, 3)
    assert grounded.viewpoint.node == 3  # the last view counts
    assert result.stop_reason == "budget: 3 actions"


def test_seeds_are_registered_and_mapped_but_never_returned_nor_budgeted():
    # The best pictures of all are at the seed nodes 34, 35, 1, 2; the agent stays at 0.
    class Stay(Walk):
        def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
            return Decision(7, "stay")

    kit = Kit("explicit", lambda node, pitch: 0.3 if node == 0 else 0.9, policy=Stay())
    grounded = Agent(kit.config, kit.parts).run(World(), "cut")
    assert grounded.viewpoint.node == 0
    assert {node for node, _ in kit.seer.seen} == {0}
    result = grounded.record.result
    assert result is not None
    assert (result.seed_motions, result.online_actions, result.total_steps) == (4, 5, 9)
    assert (kit.map.seeds, kit.map.views) == (4, 6)
    assert grounded.record.initialization is not None
    assert [s.node for s in grounded.record.initialization.seeds] == [34, 35, 1, 2]


def test_the_start_view_can_be_barred_from_being_returned():
    config = CONFIG.with_(return_={"include_initial": False}, budget={"actions": 2})
    grounded, _, _ = walk(lambda node, pitch: 0.9 if node == 0 else 0.4, config)
    assert grounded.viewpoint.node == 1


def test_no_instance_ids_reach_registration_or_perception():
    _, kit, _ = walk(lambda node, pitch: 0.5)
    assert kit.registrar.observations
    assert all(o.instance is None for o in kit.registrar.observations)


def test_two_runs_differ_in_timings_alone():
    def once(method: str) -> dict[str, Any]:
        kit = Kit(method, lambda node, pitch: ((7 * node + pitch) % 11) / 11)
        return without_timings(
            Agent(kit.config, kit.parts).run(World(), "cut").record.model_dump(mode="json")
        )

    for method in ("explicit", "random", "semantic_only", "geometry_only"):
        assert once(method) == once(method)


def test_a_robot_stepping_itself_gets_the_same_episode():
    kit = Kit("explicit", lambda node, pitch: ((5 * node + 3 * pitch) % 13) / 13)
    reference = Agent(kit.config, kit.parts).run(World(), "cut").record

    kit = Kit("explicit", lambda node, pitch: ((5 * node + 3 * pitch) % 13) / 13)
    robot, session = World(), Agent(kit.config, kit.parts).start("cut", node=0)
    while session.seed_requests:
        request = session.seed_requests[0]
        seen = World((robot.node + request.ring) % 36, request.pitch_index).observe()
        session.add_seed(seen.rgb, seen.depth, seen.camera)
    while True:
        seen = robot.observe()
        turn = session.step(seen.rgb, seen.depth, seen.camera)
        if isinstance(turn, Grounded):
            break
        assert turn.action == 5 * (turn.pitch + 1) + turn.ring + 2
        robot.act(turn.action)  # the session's own account never leaves the pitches
    assert without_timings(turn.record.model_dump(mode="json")) == without_timings(
        reference.model_dump(mode="json")
    )


@pytest.mark.parametrize("node", [35, None])
def test_a_policy_is_told_which_views_were_seen(node: int | None):
    class Retrace(Walk):
        """Right, left, down, up and two to the right, and keeps what it was told."""

        def __init__(self) -> None:
            self.told: list[list[tuple[int, int]]] = []

        def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
            self.told.append(list(situation.visited))
            return Decision((8, 6, 12, 2, 9)[len(self.told) - 1], "walk")

    policy = Retrace()
    kit = Kit("random", lambda node, pitch: 0.5, CONFIG.with_(budget={"actions": 5}), policy=policy)
    session, seen = Agent(kit.config, kit.parts).start("cut", node=node), World().observe()
    while not isinstance(session.step(seen.rgb), Grounded):
        pass
    at = 0 if node is None else node
    ring = [at, (at + 1) % 36, at, at, at]
    assert policy.told[-1] == list(zip(ring, [1, 1, 1, 2, 1], strict=True))
    assert [len(told) for told in policy.told] == [1, 2, 3, 4, 5]


@pytest.mark.parametrize(("method", "node", "actions"), [("static", 0, 0), ("canonical", None, 1)])
def test_looking_once(method: str, node: int | None, actions: int):
    kit = Kit(method, lambda node, pitch: 0.9 if node == 35 else 0.4)
    grounded = Agent(kit.config, kit.parts).run(World(), "cut")
    result = grounded.record.result
    assert result is not None
    assert (grounded.viewpoint.node, result.online_actions, result.seed_motions) == (node, actions, 0)
    assert grounded.instance_score == (0.9 if method == "canonical" else 0.4)
    assert grounded.record.initialization is None


class Sure:
    """A planner double: `clear` prefers action 8 by far, otherwise all are alike."""

    name = "double"

    def __init__(self, clear: bool):
        self._clear = clear

    def values(self, situation: Any) -> np.ndarray:
        values = np.zeros(15, np.float32)
        values[8] = 1.0 if self._clear else 0.0
        values[3] = 5.0  # less far down: masked at the upper pitch, never to be chosen there
        return values


def gated(planner: Sure | None, config: Config = CONFIG) -> tuple[Grounded, Kit]:
    from fuse_grounding.planning.explicit import Explicit
    from fuse_grounding.planning.gated import Gated

    policy = Gated(planner, Explicit("explicit", config), config)
    kit = Kit("fuse", lambda node, pitch: 0.5, config, policy=policy)
    return Agent(kit.config, kit.parts).run(World(pitch_index=0), "cut"), kit


def test_the_gate_opens_for_a_sure_planner_and_leaves_the_map_alone():
    grounded, kit = gated(Sure(clear=True))
    first = grounded.record.steps[0]
    assert (first.branch, first.action) == ("amortized", 8)
    assert first.entropy is not None
    assert first.entropy <= 0.8
    assert first.action_values is not None
    assert first.action_values[3] is None
    assert kit.map.refinements == 0
    assert grounded.record.result is not None
    assert grounded.record.result.branches == {"amortized": 5}
    assert grounded.record.result.planner == "double"


def test_the_gate_stays_shut_for_an_unsure_planner():
    config = CONFIG.with_(gate={"eta": 0.8})
    grounded, kit = gated(Sure(clear=False), config)
    first = grounded.record.steps[0]
    assert first.branch == "explicit"
    assert first.entropy == pytest.approx(1.0)
    assert kit.map.refinements == 5


def test_without_a_planner_every_decision_is_explicit_and_says_so():
    kit = Kit("fuse", lambda node, pitch: 0.5, CONFIG.with_(planner={"name": "none"}))
    record = Agent(kit.config, kit.parts).run(World(), "cut").record
    decided = [s for s in record.steps if s.action is not None]
    assert decided
    assert {(s.branch, s.entropy) for s in decided} == {("explicit", None)}
    assert all("no amortised planner" in s.reason for s in decided)
    assert record.result is not None
    assert record.result.planner == "none"
    assert any("no amortised planner" in a for a in record.announcements)


def test_without_depth_the_term_is_off_and_announced():
    kit = Kit("random", lambda node, pitch: 0.6)
    grounded = Agent(kit.config, kit.parts).run(World(depth=None), "cut")
    assert grounded.score == pytest.approx(0.7 * 0.6)
    assert grounded.place is None
    assert any("no depth" in a for a in grounded.record.announcements)


def test_a_region_that_is_too_small_is_returned_only_for_want_of_a_better():
    config = CONFIG.with_(stopping={"min_region_px": 500})  # the block has 400
    grounded, _, _ = walk(lambda node, pitch: 0.9 if node == 2 else 0.3, config)
    assert grounded.score is None
    assert grounded.viewpoint.node == 2
    assert grounded.found
    assert any("no region was large enough" in a for a in grounded.record.announcements)
    assert grounded.record.result is not None
    assert grounded.record.result.observations == 5  # nothing scored counts against patience


def test_nothing_seen_is_a_result_too():
    grounded, _, _ = walk(lambda node, pitch: 0.0)
    assert not grounded.found
    assert grounded.record.result is not None
    assert grounded.record.result.status == "not_found"


def test_what_comes_in_is_checked():
    kit = Kit("explicit", lambda node, pitch: 0.5)
    session = Agent(kit.config, kit.parts).start("cut", node=0)
    seen = World().observe()
    with pytest.raises(InputError, match="needs 4 more seed views"):
        session.step(seen.rgb)
    kit = Kit("static", lambda node, pitch: 0.5)
    session = Agent(kit.config, kit.parts).start("cut", node=0)
    for rgb, found in [
        (seen.rgb[:-1], r"\(47, 64, 3\) uint8"),
        (seen.rgb.astype(np.float32), "float32"),
        (seen.rgb[..., 0], r"\(48, 64\) uint8"),
        (seen.rgb.tolist(), "list"),
    ]:
        with pytest.raises(
            InputError, match=rf"rgb must be a \({HEIGHT}, {WIDTH}, 3\) uint8 array, found .*{found}"
        ):
            session.step(rgb)
    with pytest.raises(InputError, match="depth must be"):
        session.step(seen.rgb, np.zeros((HEIGHT, WIDTH), np.uint16))
    with pytest.raises(InputError, match="pose must be"):
        session.step(seen.rgb, pose=np.eye(3))
    with pytest.raises(InputError, match="action_mask must be"):
        session.step(seen.rgb, action_mask=np.ones(14, bool))
    with pytest.raises(InputError, match="allows no action"):
        session.step(seen.rgb, action_mask=np.zeros(15, bool))
    assert isinstance(session.step(seen.rgb), Grounded)  # none of these cost the session anything
    with pytest.raises(InputError, match="this search is over"):
        session.step(seen.rgb)


def test_depth_holes_are_unknown_not_near():
    kit = Kit("static", lambda node, pitch: 0.5)
    seen = World().observe()
    depth = np.full((HEIGHT, WIDTH), np.nan, np.float32)
    depth[14:34, 5:15] = 0.75
    depth[14:34, 15:25] = np.inf
    grounded = Agent(kit.config, kit.parts).start("cut").step(seen.rgb, depth)
    assert isinstance(grounded, Grounded)
    assert grounded.score == pytest.approx(0.7 * 0.5 + 0.3 * 0.5)


def test_locating_a_card_on_the_table():
    """A card of 20x10 cm at z = 0.1, seen from 1 m height, is found where it lies."""
    view = camera(4, 2)
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    rays = np.stack([(columns + 0.5 - view.cx) / view.fx, (rows + 0.5 - view.cy) / view.fy], axis=-1)
    rays = np.dstack([rays, np.ones((HEIGHT, WIDTH))]) @ view.rotation  # world, unit depth
    depth = (0.1 - view.center[2]) / rays[..., 2]
    hit = view.center + depth[..., None] * rays
    mask = (np.abs(hit[..., 0] - 0.05) < 0.1) & (np.abs(hit[..., 1] + 0.02) < 0.05) & (depth > 0)
    place = locate(mask, depth.astype(np.float32), view)
    assert place is not None
    assert place.centroid == pytest.approx([0.05, -0.02, 0.1], abs=0.015)
    assert place.box[:, 2] == pytest.approx([0.1, 0.1], abs=1e-5)
    assert place.box[1, 0] - place.box[0, 0] == pytest.approx(0.2, abs=0.06)  # the border is shaved off
    assert place.box[1, 1] - place.box[0, 1] == pytest.approx(0.1, abs=0.06)
    assert locate(np.zeros_like(mask), depth, view) is None


def test_masks_survive_run_lengths():
    random = np.random.default_rng(0)
    for mask in (random.random((5, 7)) > 0.5, np.zeros((3, 4), bool), np.ones((3, 4), bool)):
        assert np.array_equal(decode_mask(encode_mask(mask)), mask)


def test_an_interrupted_run_stays_readable(tmp_path: Path):
    def score(node: int, pitch: int) -> float:
        if node == 3:
            raise KeyboardInterrupt
        return 0.2 + 0.1 * node

    kit = Kit("explicit", score, policy=Walk())
    with pytest.raises(KeyboardInterrupt):
        Agent(kit.config, kit.parts).run(World(), "cut", watchers=[RunFolder(tmp_path)])
    record = EpisodeRecord.load(tmp_path / "episode.json")
    assert [s.node for s in record.steps] == [0, 1, 2]
    assert record.result is None
    assert (tmp_path / "steps" / "02" / "observation.png").is_file()
    assert not list(tmp_path.rglob(".*"))


def test_a_finished_run_leaves_the_promised_files(tmp_path: Path):
    kit = Kit("explicit", lambda node, pitch: 0.5)
    grounded = Agent(kit.config, kit.parts).run(World(), "cut", watchers=[RunFolder(tmp_path)])
    for name in ("episode.json", "overview.png", "grounding.png", "scene.ply"):
        assert (tmp_path / name).is_file(), name
    for step in grounded.record.steps:
        for name in ("observation", "semantic", "geometric", "evidence"):
            assert (tmp_path / "steps" / f"{step.index:02d}" / f"{name}.png").is_file()
    assert EpisodeRecord.load(tmp_path / "episode.json") == grounded.record


def test_records_that_cannot_be_read_are_named(tmp_path: Path):
    path = tmp_path / "episode.json"
    with pytest.raises(InputError, match=r"episode\.json does not exist"):
        EpisodeRecord.load(path)
    path.write_text('{"schema_version": 1, "query": "cu')
    with pytest.raises(InputError, match=r"episode\.json is not complete JSON"):
        EpisodeRecord.load(path)
    path.write_text(json.dumps({"schema_version": 99}))
    with pytest.raises(InputError, match="schema_version 99, expected 1"):
        EpisodeRecord.load(path)


def test_output_folders_are_never_overwritten_by_accident(tmp_path: Path):
    folder = tmp_path / "out"
    prepare(folder)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="exists and is not empty"):
        prepare(folder)
    with pytest.raises(InputError, match="is not an earlier run"):
        prepare(folder, force=True)
    assert (folder / "notes.txt").read_text() == "mine"
    (folder / "episode.json").write_text("{}")
    assert not any(prepare(folder, force=True).iterdir())
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is a file"):
        prepare(tmp_path / "file")
    with pytest.raises(InputError, match="cannot be written"):
        prepare(tmp_path / "file" / "below")


def test_sessions_start_only_at_real_pitches():
    kit = Kit("static", lambda node, pitch: 0.5)
    with pytest.raises(InputError, match="pitch_index must be a whole number from 0 to 2, found 3"):
        Agent(kit.config, kit.parts).start("cut", pitch_index=3)


def test_observation_without_pose_is_grounded_but_not_located():
    kit = Kit("static", lambda node, pitch: 0.5)
    seen: Observation = World().observe()
    session: Session = Agent(kit.config, kit.parts).start("cut")
    grounded = session.step(seen.rgb, seen.depth)
    assert isinstance(grounded, Grounded)
    assert grounded.found
    assert grounded.place is None
    assert any("no pose" in a for a in session.record.announcements)


@pytest.mark.parametrize("method", ["explicit", "static", "canonical"])
def test_a_search_without_a_known_candidate_ends_with_its_reason(method: str, tmp_path: Path):
    """The labels that could light a drawer are not the segmenter's: no crash, no seed views, no success."""
    kit, world = Kit(method, lambda node, pitch: 0.9), World()
    files = RunFolder(prepare(tmp_path / "run", False), "e", "s", 0)
    grounded = Agent(kit.config, kit.parts).run(world, "light up a dark drawer", watchers=[files])
    record = grounded.record
    assert record.result is not None
    assert record.result.status == "not_found"
    assert record.result.stop_reason.startswith(
        "no candidate: the segmenter knows none of the proposed labels ("
    )
    assert (record.candidates, len(record.steps), world.acts) == ([], 1, [])
    assert "flashlight" in [c.label for c in record.candidates_unknown]
    assert any("left out, because the segmenter does not know it" in note for note in record.announcements)
    assert kit.registrar.observations == []
    assert (tmp_path / "run" / "overview.png").is_file()
