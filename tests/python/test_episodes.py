"""Sets of episodes: what ships, what is made, what is refused."""

from __future__ import annotations

import gzip
import json

import pytest

from fuse_grounding.cli.app import execute
from fuse_grounding.environment import Episode, load_episodes, make_episode, save_episodes, scene_names
from fuse_grounding.errors import InputError


def changed(path, edit) -> None:
    data = json.loads(gzip.decompress(path.read_bytes()))
    edit(data["episodes"][0])
    path.write_bytes(gzip.compress(json.dumps(data).encode()))


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "some.json.gz"
    save_episodes(path, load_episodes("dev")[:2])
    return path


def test_the_shipped_set_is_fair():
    episodes = load_episodes("dev")
    assert len(episodes) >= 10
    assert len({e.scene_id for e in episodes}) >= 2
    assert len({e.verb for e in episodes}) >= 6
    for e in episodes:
        target = e.data["statistics"][0]
        index = 3 * e.start[0] + e.start[1]
        assert 0.05 <= target["visible_px"][index] / target["unoccluded_px"][index] <= 0.6
        assert target["pixels_max"] >= 500
        assert 7 <= len(e.data["distractor_ids"]) <= 14
        assert e.categories[e.data["target"]] in e.data["candidate_sets"]["oracle"]


def test_a_seed_is_an_episode():
    one = make_episode("write", "train_study", 4)
    assert one == make_episode("write", "train_study", 4)
    assert one.data["objects"] != make_episode("write", "train_study", 5).data["objects"]
    assert (one.verb, one.scene_id, one.split) == ("write", "train_study", "train")


def test_what_does_not_exist_is_named():
    with pytest.raises(InputError, match=r"unknown scene `dev_attic`; known scenes: .*dev_kitchen"):
        make_episode("cut", "dev_attic")
    with pytest.raises(InputError, match="unknown verb `fly`; known verbs: "):
        make_episode("fly")
    with pytest.raises(InputError, match="seed must be"):
        make_episode("cut", seed=-1)
    with pytest.raises(InputError, match="no shipped set of that name"):
        load_episodes("devv")


def test_broken_files_are_refused(file, tmp_path):
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="not a complete gzip file"):
        load_episodes(file)
    for edit, message in [
        (lambda e: e.update(schema_version=7), "schema version 7, expected 1"),
        (lambda e: e.update(start_pitch=3), "pitch index 3"),
        (lambda e: e.update(target=77), "target 77 is not among the objects"),
        (lambda e: e.update(colour="red"), "colour"),
        (lambda e: e["objects"][0].update(model_id="knife_dev_7"), "unknown object `knife_dev_7`"),
    ]:
        file.write_bytes(whole)
        changed(file, edit)
        with pytest.raises(InputError, match=message):
            load_episodes(file)
    with pytest.raises(InputError, match="cannot access"):
        save_episodes(tmp_path / "nowhere" / "e.json.gz", [])


def test_commands(file, tmp_path, capsys):
    assert execute(["episodes", "validate", str(file)]) == 0
    out = tmp_path / "made.json.gz"
    made = ["episodes", "generate", "--split", "dev", "--count", "1", "--seed", "3", "--out"]
    assert execute([*made, str(out), "--json"]) == 0
    first = out.read_bytes()
    assert execute([*made, str(out)]) == 0
    assert out.read_bytes() == first
    capsys.readouterr()
    assert execute(["episodes", "show", str(out), "--json"]) == 0
    (shown,) = json.loads(capsys.readouterr().out)
    assert Episode(json.dumps(shown)).episode_id == "dev_0000"
    assert execute(["episodes", "generate", "--split", "test", "--out", str(out)]) == 2
    assert "unknown split `test`" in capsys.readouterr().err
    assert execute(["episodes", "show", str(file), "--episode", "none"]) == 2
    assert execute(["episodes", "scenes"]) == 0
    assert all(name in capsys.readouterr().out for name in scene_names()[:1])
