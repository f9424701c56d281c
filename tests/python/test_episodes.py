"""Sets of episodes: what ships, what is made, what is refused."""

from __future__ import annotations

import gzip
import json
import logging
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from fuse_grounding._core import kin_categories, object_categories, statistics_path
from fuse_grounding.cli.app import execute
from fuse_grounding.environment import (
    SETS,
    Episode,
    TabletopEnvironment,
    load_episodes,
    load_generation,
    make_episode,
    save_episodes,
    scene_names,
)
from fuse_grounding.environment.episodes import DATA, phrasings, shipped_sets, stage, valid_categories
from fuse_grounding.environment.sets import generate_set
from fuse_grounding.errors import InputError

ROOT = Path(__file__).resolve().parents[2]


def schema(name: str) -> jsonschema.Draft202012Validator:
    text = (DATA / "schema" / f"{name}.schema.json").read_text(encoding="utf-8")
    jsonschema.Draft202012Validator.check_schema(json.loads(text))
    return jsonschema.Draft202012Validator(json.loads(text))


def unpacked(path: Path) -> dict[str, Any]:
    return json.loads(gzip.decompress(path.read_bytes()))


def changed(path: Path, edit: Any) -> None:
    data = unpacked(path)
    edit(data)
    path.write_bytes(gzip.compress(json.dumps(data).encode()))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "some.json.gz"
    save_episodes(path, load_episodes("dev")[:2])
    return path


@pytest.mark.parametrize("name", shipped_sets())
def test_shipped_sets_keep_their_promises(name: str):
    episodes, generation = load_episodes(name), load_generation(name)
    plan = SETS[name]
    assert generation is not None
    assert (generation["split"], generation["seed"]) == (plan.split, plan.seed)
    assert len(episodes) == plan.count == generation["count"]
    words = phrasings(plan.split)
    verbs = [e.verb for e in episodes]
    assert set(verbs) == set(valid_categories())
    assert max(map(verbs.count, words)) - min(map(verbs.count, words)) <= 1
    for e in episodes:
        assert e.query in words[e.verb]
        assert 0.05 <= e.data["start_fraction"] <= 0.6
        assert e.data["best_px"] >= 500
        assert e.data["best_fraction"] >= 0.8
        assert 1 <= e.data["moves_to_good_view"] <= 30
        assert 7 <= len(e.data["distractor_ids"]) <= 14
        assert e.categories[e.data["target"]] in valid_categories()[e.verb]
    path = DATA / "episodes" / f"{name}.json.gz"
    schema("episodes").validate(unpacked(path))
    schema("statistics").validate(unpacked(statistics_path(path)))
    assert execute(["episodes", "validate", name]) == 0  # the statistics are this set's and agree with it


def test_dev_begins_with_five_verbs_and_evaluation_asks_in_words_of_its_own():
    assert len({e.verb for e in load_episodes("dev")[:5]}) == 5
    train, held_out = phrasings("train"), phrasings("eval")
    assert phrasings("dev") == train
    for verb in valid_categories():
        assert min(len(train[verb]), len(held_out[verb])) >= 5, verb
        assert not set(train[verb]) & set(held_out[verb]), verb


def test_a_seed_is_an_episode_with_its_statistics():
    one = make_episode("write", "train_study", 4)
    again = make_episode("write", "train_study", 4)
    assert (one, one.statistics_text) == (again, again.statistics_text)
    assert one.data["objects"] != make_episode("write", "train_study", 5).data["objects"]
    assert (one.verb, one.scene_id, one.split) == ("write", "train_study", "train")
    assert one.statistics is not None
    assert [s["instance_id"] for s in one.statistics] == one.data["valid_target_ids"]
    # Counted anew where they are not known, and that is said.
    bare = TabletopEnvironment(Episode(one.text))
    logged: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: logged.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("fuse_grounding.environment.tabletop")
    logger.addHandler(handler)
    try:
        counted = bare.true_targets()[0]
    finally:
        logger.removeHandler(handler)
    assert logged == [
        f"episode {one.episode_id} has no statistics with it: pixels are counted in 108 views, "
        "which takes a moment"
    ]
    known = TabletopEnvironment(one).true_targets()[0]
    assert (counted.visible_px == known.visible_px).all()
    assert (counted.unoccluded_px == known.unoccluded_px).all()


def test_surfaces_at_one_depth_are_counted_as_they_are_drawn():
    # In one view of it two things have a pixel at the same depth: what is seen there is the first drawn.
    one = next(e for e in load_episodes("eval") if e.episode_id == "eval_0065")
    known = TabletopEnvironment(one).true_targets()[0]
    counted = TabletopEnvironment(Episode(one.text)).true_targets()[0]
    assert (counted.visible_px == known.visible_px).all()


def test_knobs_turn():
    hidden = make_episode(
        "pound", seed=3, difficulty={"start_fraction": [0.05, 0.2], "distractors": [7, 7], "least_moves": 1}
    )
    assert hidden.data["start_fraction"] <= 0.2
    assert len(hidden.data["distractor_ids"]) == 7


def test_every_category_has_a_near_miss():
    groups = kin_categories()
    assert {c for group in groups for c in group} == {c for c, _ in object_categories()}


def test_what_does_not_exist_is_named():
    with pytest.raises(InputError, match=r"unknown scene `dev_attic`; known scenes: .*dev_kitchen"):
        make_episode("cut", "dev_attic")
    with pytest.raises(InputError, match="unknown verb `fly`; known verbs: "):
        make_episode("fly")
    with pytest.raises(InputError, match="seed must be"):
        make_episode("cut", seed=-1)
    with pytest.raises(InputError, match=r"no shipped set of that name \(there are: dev"):
        load_episodes("devv")


EDITS = [
    (lambda d: d.update(schema_version=1), "schema version 1, expected 2", True),
    (lambda d: d["episodes"][0].update(schema_version=1), "schema version 1, expected 2", True),
    (lambda d: d["episodes"][0].update(start_pitch=3), "pitch index 3", True),
    (lambda d: d["episodes"][0].update(target=77), "target 77 is not among the objects", False),
    (lambda d: d["episodes"][0].update(colour="red"), "colour", True),
    (lambda d: d["episodes"][0].pop("best_px"), "best_px", True),
    (lambda d: d["episodes"][0].update(start_fraction=0.9), "shows 0.900 of the target", True),
    (lambda d: d["episodes"][0].update(moves_to_good_view=0), "1 to 30, found 0", True),
    (lambda d: d["episodes"][0].update(query=""), "1 to 200 bytes, found 0", True),
    (lambda d: d["episodes"][0].update(split="test"), "split|variant `test`", True),
    (lambda d: d["episodes"][0]["objects"][0].update(instance_id=0), "unique and not 0", True),
    (lambda d: d["episodes"][0]["objects"][0].update(category="A spade"), "A spade", True),
    (lambda d: d["episodes"][0]["objects"][0]["rotation"].update(w="x"), "invalid type", True),
    (lambda d: d["episodes"][0]["objects"][0].update(model_id="knife_dev_7"), "object `knife_dev_7`", False),
    (lambda d: d["episodes"][0].update(distractor_ids=[1]), "distractor_ids must name", True),
    (lambda d: d["episodes"].append(d["episodes"][0]), "appears twice", False),
    (lambda d: d.update(generation={}), "missing field `set`", True),
    (lambda d: d.update(more=1), "unknown field `more`", True),
]


@pytest.mark.parametrize(("edit", "message", "structural"), EDITS)
def test_broken_files_are_refused_by_loader_and_schema(file: Path, edit: Any, message: str, structural: bool):
    """What a schema can say, it refuses too: all but what needs the catalogue or other entries."""
    assert schema("episodes").is_valid(unpacked(file))
    changed(file, edit)
    statistics_path(file).unlink()
    assert schema("episodes").is_valid(unpacked(file)) == (not structural)
    with pytest.raises(InputError, match=message):
        load_episodes(file)


def test_broken_containers_are_refused(file: Path, tmp_path: Path):
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"some\.json\.gz is not a complete gzip file"):
        load_episodes(file)
    file.write_bytes(whole)
    beside = statistics_path(file)
    packed = beside.read_bytes()
    beside.write_bytes(packed[:100])
    with pytest.raises(InputError, match=r"some\.statistics\.json\.gz is not a complete gzip file"):
        load_episodes(file)
    with pytest.raises(InputError, match="cannot access"):
        save_episodes(tmp_path / "nowhere" / "e.json.gz", [])


STATISTICS_EDITS = [
    (lambda d: d.update(schema_version=1), "schema version 1, expected 2", True),
    (lambda d: d.update(episodes_sha256="0" * 64), "belongs to another episode file", False),
    (lambda d: d["statistics"].pop(), "must follow the episodes one to one", False),
    (lambda d: d["statistics"][0]["targets"].clear(), "must follow valid_target_ids", True),
    (lambda d: d["statistics"][0]["targets"][0]["visible_px"].pop(), "must have 108 views", True),
    (lambda d: d["statistics"][0]["targets"][0].pop("pixels_max"), "pixels_max", True),
    (lambda d: d["statistics"][0]["targets"][0].update(pixels_max=1), "not those of visible_px", False),
    (lambda d: d["statistics"][0]["targets"][0].update(position_m=[0, 1]), "invalid length 2", True),
]


@pytest.mark.parametrize(("edit", "message", "structural"), STATISTICS_EDITS)
def test_statistics_that_do_not_belong_are_refused(file: Path, edit: Any, message: str, structural: bool):
    beside = statistics_path(file)
    assert schema("statistics").is_valid(unpacked(beside))
    changed(beside, edit)
    assert schema("statistics").is_valid(unpacked(beside)) == (not structural)
    with pytest.raises(InputError, match=message):
        load_episodes(file)
    assert execute(["episodes", "validate", str(file)]) == 2


def test_statistics_of_another_set_and_none(file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    other = tmp_path / "other.json.gz"
    save_episodes(other, load_episodes("dev")[2:3])
    taken = ["episodes", "validate", str(file), "--statistics"]
    assert execute([*taken, str(statistics_path(other))]) == 2
    assert "belongs to another episode file: it names SHA-256" in capsys.readouterr().err
    assert execute([*taken, str(tmp_path / "none.json.gz")]) == 2
    assert "no statistics file" in capsys.readouterr().err
    statistics_path(file).unlink()
    assert execute(["episodes", "validate", str(file)]) == 2
    assert "has no statistics some.statistics.json.gz beside it" in capsys.readouterr().err
    assert all(e.statistics is None for e in load_episodes(file))
    # Episodes without statistics leave none of an earlier file behind.
    save_episodes(other, load_episodes(file))
    assert not statistics_path(other).exists()


def test_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "made.json.gz"
    made = ["episodes", "generate", "--split", "dev", "--count", "1", "--seed", "3", "--out"]
    assert execute([*made, str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    first, statistics = out.read_bytes(), statistics_path(out).read_bytes()
    assert execute([*made, str(out), "--threads", "1"]) == 0
    assert (out.read_bytes(), statistics_path(out).read_bytes()) == (first, statistics)
    generation = load_generation(out)
    assert generation is not None
    assert (generation["rejected"], generation["count"]) == (told["rejected"], 1)
    assert not [p for p in tmp_path.iterdir() if p.name.endswith(".parts")]
    assert execute(["episodes", "validate", str(out), "--render"]) == 0
    capsys.readouterr()
    assert execute(["episodes", "show", str(out), "--json"]) == 0
    (shown,) = json.loads(capsys.readouterr().out)
    assert Episode(json.dumps(shown)).episode_id == "dev_0000"
    assert execute(["episodes", "show", str(out)]) == 0
    assert "seen well after" in capsys.readouterr().out
    assert execute(["episodes", "generate", "--split", "test", "--out", str(out)]) == 2
    assert "unknown split `test`; known: train, dev, eval, large" in capsys.readouterr().err
    assert execute(["episodes", "generate", "--split", "all", "--out", str(out)]) == 2
    assert "must be a folder that exists with --split all" in capsys.readouterr().err
    assert execute([*made, str(out), "--knob", "near_misses"]) == 2
    assert "--knob must be name=value" in capsys.readouterr().err
    assert execute(["episodes", "show", str(out), "--episode", "none"]) == 2
    assert execute(["episodes", "scenes"]) == 0
    assert all(name in capsys.readouterr().out for name in scene_names()[:1])


def test_a_changed_picture_is_found_by_rendering(file: Path, capsys: pytest.CaptureFixture[str]):
    """An object is moved by hand and everything else left: only rendering can tell."""
    statistics_path(file).unlink()
    one = unpacked(file)["episodes"][0]
    target = next(i for i, o in enumerate(one["objects"]) if o["instance_id"] == one["target"])
    changed(file, lambda d: d["episodes"][0]["objects"][target]["translation"].__setitem__(0, 0.3))
    assert execute(["episodes", "validate", str(file), "--render"]) == 2
    assert f"rendered anew: episode `{one['episode_id']}`" in capsys.readouterr().err


def test_an_interrupted_set_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    made = iter(load_episodes("dev"))
    asked: list[int] = []

    class Maker:
        plan_episodes = stage().plan_episodes

        def make_episodes(self, validity: Any, requests: list[Any], settings: str, threads: Any) -> Any:
            asked.append(len(requests))
            if len(asked) == 2:
                raise KeyboardInterrupt
            return [
                (e.text, e.statistics_text, {"no room on the table": 1})
                for _, e in zip(requests, made, strict=False)
            ]

    monkeypatch.setattr("fuse_grounding.environment.sets.stage", Maker)
    out = tmp_path / "dev.json.gz"
    with pytest.raises(KeyboardInterrupt):
        generate_set("dev", out)
    assert not out.exists()
    with pytest.raises(InputError, match=r"parts of another request \(`count` is 25 there and 24 here\)"):
        generate_set("dev", out, count=24)
    done: list[int] = []
    part = out.with_name("dev.json.gz.parts") / "000000.json"
    kept = part.read_text()
    part.write_text(json.dumps({"made": [], "part_seconds": 0}))
    with pytest.raises(InputError, match=r"000000\.json is not a part of this set: 0 episodes, expected 8"):
        generate_set("dev", out)
    part.write_text(kept)
    finished = generate_set("dev", out, tell=lambda n, total: done.append(n))
    assert asked == [8, 8, 8, 8, 1]
    assert done == [0, 8, 16, 24, 25]
    assert (finished.episodes, finished.rejected) == (25, {"no room on the table": 25})
    assert [e.text for e in load_episodes(out)] == [e.text for e in load_episodes("dev")]
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        *("dev.generation.json", "dev.json.gz", "dev.statistics.json.gz"),
    ]


def test_an_interrupt_keeps_finished_parts(tmp_path: Path):
    out = tmp_path / "dev.json.gz"
    child = subprocess.Popen(
        [
            *(sys.executable, "-m", "fuse_grounding.cli.app", "episodes", "generate"),
            "--split",
            "dev",
            "--out",
            str(out),
        ],
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    parts = tmp_path / "dev.json.gz.parts"
    deadline = time.monotonic() + 60
    while not (parts / "plan.json").exists():
        assert child.poll() is None and time.monotonic() < deadline  # noqa: PT018
        time.sleep(0.05)
    time.sleep(0.5)
    child.send_signal(signal.SIGINT)
    _, stderr = child.communicate(timeout=60)
    assert child.returncode == 130
    assert b"kept in dev.json.gz.parts; the same command goes on" in stderr
    assert not out.exists()


def test_a_card_is_written(file: Path, tmp_path: Path):
    pytest.importorskip("matplotlib")
    assert execute(["episodes", "card", str(file), "--out", str(tmp_path / "cards")]) == 0
    text = (tmp_path / "cards" / "some.md").read_text()
    assert "# The episode set `some`" in text
    assert "moves to the first good view" in text
    for part in ("contents", "start", "views"):
        assert f"(some_{part}.png)" in text
        assert (tmp_path / "cards" / f"some_{part}.png").stat().st_size > 5000


def test_world_md_shows_every_scene():
    text = (ROOT / "docs" / "world.md").read_text(encoding="utf-8")
    for name in scene_names():
        assert f"images/scenes/{name}.jpg" in text, name
        picture = ROOT / "docs" / "images" / "scenes" / f"{name}.jpg"
        assert picture.is_file(), "fuse episodes scenes --sheets docs/images/scenes"
        assert picture.stat().st_size <= 250_000
