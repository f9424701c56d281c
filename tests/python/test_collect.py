"""`fuse collect`: real walks with small maps, in parts."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_networks import write_encoder

from fuse_grounding import tensors
from fuse_grounding.config import Config
from fuse_grounding.environment import TabletopEnvironment, load_episodes
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.record import hold
from fuse_grounding.training import collect, rollouts, transitions

SMALL = {"initial_iterations": 12, "incremental_iterations": 3, "fine_iterations": 3}


@pytest.fixture(scope="module")
def encoder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_encoder(tmp_path_factory.mktemp("encoder"))


def request(encoder: Path, **changes: Any) -> collect.Request:
    config = Config().with_(map=SMALL).to_dict()
    wanted = {
        "split": "dev",
        "trajectories": 2,
        "seed": 0,
        "states": 0,
        "actions": 1,
        "encoder": str(encoder),
    }
    return collect.Request(**{**wanted, "config": config, **changes})


@pytest.fixture(scope="module")
def collected(encoder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two walks, made by this process."""
    out = tmp_path_factory.mktemp("collected") / "out"
    heard: list[tuple[int, int]] = []
    made = collect.collect(out, request(encoder), tell=lambda *done: heard.append(done))
    assert made.trajectories == 2
    assert heard == [(0, 2), (1, 2), (2, 2)]
    return out


def test_every_number_is_measured(collected: Path, encoder: Path):
    data, note = transitions.load(collected / collect.RESULT)
    assert [t["episode_id"] for t in note["trajectories"]] == ["dev_0000", "dev_0001"]
    episodes = load_episodes("dev")[:2]
    lengths = np.bincount(data.trajectory[data.before])
    assert lengths.tolist() == [1, 1]
    np.testing.assert_array_equal(data.after, data.before + 1)  # plain walks
    semantic, uncertainty, overlap, visible, near = data.levels.T
    for level in (semantic, overlap, visible, near):
        assert ((level >= 0) & (level <= 1)).all()
    assert ((uncertainty > 0) & (uncertainty <= 0.8)).all()
    assert len(np.unique(uncertainty)) == len(uncertainty)
    np.testing.assert_allclose(np.linalg.norm(data.feature.astype(float), axis=1), 1.0, atol=1e-3)
    for trajectory, episode in enumerate(episodes):
        target = TabletopEnvironment(episode).true_targets()[0]
        states = np.flatnonzero(data.trajectory == trajectory)
        nodes, pitches = data.viewpoint[states].T
        expected = target.visible_px[nodes, pitches] / target.most_pixels
        np.testing.assert_allclose(visible[states], expected, atol=1e-6)
        # Moves lead where the next state is.
        rows = np.flatnonzero(np.isin(data.before, states))
        ring = (data.viewpoint[data.after[rows], 0] - data.viewpoint[data.before[rows], 0] + 18) % 36 - 18
        np.testing.assert_array_equal(ring, data.action[rows] % 5 - 2)
    assert data.candidates.any(1).all()
    assert data.candidates[np.arange(len(data.context)), data.context].all()
    card = collect.card(collected)
    assert card["bytes"] == (collected / collect.RESULT).stat().st_size
    assert card["transitions"] == len(data)
    assert "segmenter" in card["weights"]
    assert card["encoder"] == json.loads(encoder.with_suffix(".json").read_text())["sha256"]
    assert str(collected) not in json.dumps(card)


def test_interrupted_and_resumed_with_other_jobs_it_ends_in_the_same_bytes(
    collected: Path, encoder: Path, tmp_path: Path
):
    import shutil

    out = tmp_path / "out"
    shutil.copytree(collected, out)
    # What a killed run leaves: some parts, and one that was being written under another name.
    for name in (collect.RESULT, collect.CARD, "parts/00001.safetensors"):
        (out / name).unlink()
    (out / "parts" / ".00001.safetensors.half").write_bytes(b"half")
    with pytest.raises(InputError, match="exists and is not empty; use --resume or another"):
        collect.collect(out, request(encoder))
    with pytest.raises(InputError, match=r"another collection \(`request\.seed` is 0 there and 1 here\)"):
        collect.collect(out, request(encoder, seed=1), resume=True)
    held = hold(out, "collection")
    with pytest.raises(InputError, match=r"another collection is writing to .*; wait for it or end it"):
        collect.collect(out, request(encoder), resume=True)
    os.close(held)
    collect.collect(out, request(encoder), jobs=2, resume=True)
    assert (out / collect.RESULT).read_bytes() == (collected / collect.RESULT).read_bytes()
    (out / "parts" / "00000.safetensors").write_bytes(b"damaged")
    with pytest.raises(InputError, match=r"00000\.safetensors is not a sound .*; take the part away"):
        collect.collect(out, request(encoder), resume=True)


def test_a_survey_measures_every_action_and_forks_change_nothing(
    encoder: Path, monkeypatch: pytest.MonkeyPatch
):
    from fuse_grounding.perception.embedded_encoder import EmbeddedEncoder

    episode = load_episodes("dev")[0]
    few = np.zeros(15, bool)
    few[[4, 7]] = True
    monkeypatch.setattr(rollouts, "action_mask", lambda node, pitch: few)
    config = Config().with_(map=SMALL)
    prober = rollouts.Prober(config, EmbeddedEncoder(encoder), collect.labels())
    walk = prober.survey(0, episode, 1, np.random.default_rng(0))
    start = walk.states[0]
    assert start.viewpoint == episode.start
    assert [action for _, action, _ in walk.moves] == np.flatnonzero(start.feasible).tolist()
    # A walk that goes one of these ways, and never forks, measures the same.
    _, _, after = walk.moves[0]
    scene = rollouts._Scene(prober, episode, episode.start)
    scene.visit(scene.spatial, episode.start, 0)
    alone = scene.visit(scene.spatial, walk.states[after].viewpoint, 1)
    for name in ("levels", "feature", "summary"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(walk.states[after], name))
    # So does a replay, which is seen one situation at a time.
    places = [start.viewpoint, walk.states[after].viewpoint]
    replayed = [rollouts.summarize(s, prober.config) for s in prober.replay(episode, places)]
    for found, state in zip(replayed, (start, walk.states[after]), strict=True):
        np.testing.assert_array_equal(found, state.summary)


def test_lengths_make_about_as_many_transitions_as_the_papers():
    chance = rollouts._CHANCE
    assert chance.sum() == pytest.approx(1.0)
    assert 416 * float(chance @ rollouts.LENGTHS) == pytest.approx(3479, rel=0.005)


def test_a_full_disk_and_a_folder_that_cannot_be_are_said(
    encoder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match=r"output directory .*below cannot be written: Not a directory"):
        collect.collect(tmp_path / "file" / "below", request(encoder))

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tensors, "write_atomically", full)
    with pytest.raises(FuseError, match=r"plan\.json cannot be written: No space left on device"):
        collect.collect(tmp_path / "out", request(encoder))


def test_the_command_line_refuses_evaluation_scenes(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    from fuse_grounding.cli.app import execute

    assert execute(["collect", "--split", "eval", "--out", str(tmp_path / "o")]) == 2
    assert "--split must be train or dev, found eval" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()
