"""The sensor from Python: off, on, on revisit, refused; and the exact truths that it leaves alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from test_cli import run
from test_device import gpu  # noqa: F401  # a fixture

from fuse_grounding.agent import Agent
from fuse_grounding.benchmark import identity, runner
from fuse_grounding.cli.sheets import SENSORS
from fuse_grounding.config import Config, SensorConfig
from fuse_grounding.environment import Blind, Observation, TabletopEnvironment, load_episodes
from fuse_grounding.environment.gym import TabletopGym
from fuse_grounding.errors import InputError
from fuse_grounding.record import EpisodeRecord

ROOT = Path(__file__).resolve().parents[2]
EPISODES = load_episodes("dev")
EPISODE = EPISODES[0]
NOISY: dict[str, Any] = {
    "seed": 3,
    "exposure_jitter_stops": 0.1,
    "motion_px": 2.0,
    "shot_noise": 0.02,
    "read_noise": 0.005,
    "depth_noise_m": 0.001,
    "depth_noise_per_m": 0.0014,
    "depth_edge_dropout": 0.5,
}


@pytest.fixture(scope="module")
def clean() -> TabletopEnvironment:
    return TabletopEnvironment(EPISODE)


@pytest.fixture(scope="module")
def noisy() -> TabletopEnvironment:
    return TabletopEnvironment(EPISODE, sensor=NOISY)


def same(a: Observation, b: Observation) -> tuple[bool, bool]:
    """Whether colours and whether depths are the same; ids always are."""
    assert a.instance is not None
    assert b.instance is not None
    assert np.array_equal(a.instance, b.instance)
    assert a.depth is not None
    assert b.depth is not None
    return np.array_equal(a.rgb, b.rgb), np.array_equal(a.depth, b.depth)


def test_a_sensor_that_is_off_is_none(clean):
    for off in (None, {}, SensorConfig(), {"seed": 9}):
        other = TabletopEnvironment(EPISODE, sensor=off)
        assert same(clean.render_at(7, 0), other.render_at(7, 0)) == (True, True)
    assert SensorConfig() == Config().sensor


def test_a_view_that_is_seen_again_is_the_same_and_others_are_not(clean, noisy):
    here, there = noisy.render_at(7, 0), noisy.render_at(8, 0)
    assert same(here, clean.render_at(7, 0)) == (False, False)
    noisy.render_at(20, 2)
    assert same(here, noisy.render_at(7, 0)) == (True, True)
    assert same(here, TabletopEnvironment(EPISODE, sensor=SensorConfig(**NOISY)).render_at(7, 0)) == (
        True,
        True,
    )
    assert same(here, noisy.photograph(noisy.camera_at(7, 0))) == (True, True)
    assert same(noisy.canonical_observation(), noisy.canonical_observation()) == (True, True)
    other_seed = TabletopEnvironment(EPISODE, sensor={**NOISY, "seed": 4})
    assert same(here, other_seed.render_at(7, 0)) == (False, False)

    # Noise alone, where both are far from clipping: no more alike than chance between two views.
    def noise(world: TabletopEnvironment, node: int) -> np.ndarray:
        measured, exact = world.render_at(node, 0).depth, clean.render_at(node, 0).depth
        assert measured is not None
        assert exact is not None
        return np.where(measured > 0, (measured - exact) / (0.001 + 0.0014 * exact**2), 0)

    one, two = noise(noisy, 7), noise(noisy, 8)
    assert one.std() == pytest.approx(1.0, abs=0.02)
    for another in (two, noise(other_seed, 7)):
        assert abs((one * another).mean()) < 4 / np.sqrt(one.size)
    assert there.depth is not None


def test_episodes_have_their_own_noise():
    sensor = {"depth_noise_m": 0.01}
    views = []
    for episode in EPISODES[:2]:
        measured = TabletopEnvironment(episode, sensor=sensor).render_at(0, 1).depth
        exact = TabletopEnvironment(episode).render_at(0, 1).depth
        assert measured is not None
        assert exact is not None
        views.append(measured - exact)
    assert abs((views[0] * views[1]).mean()) < 4 * 0.01**2 / np.sqrt(views[0].size)


def test_truths_stay_exact_and_are_the_judges_only(clean, noisy):
    assert np.array_equal(noisy.true_instances(7, 0), clean.true_instances(7, 0))
    assert np.array_equal(noisy.normals(7, 0), clean.normals(7, 0))
    depth, ids = noisy.depth_ids(7, 0)
    assert np.array_equal(depth, clean.render_at(7, 0).depth)
    assert np.array_equal(ids, clean.true_instances(7, 0))
    blind = Blind(noisy)
    assert same_pictures(blind.observe(), noisy.observe())
    for name in ("amodal_mask", "depth_ids", "normals", "sensor"):
        assert not hasattr(blind, name)


def same_pictures(a: Observation, b: Observation) -> bool:
    return np.array_equal(a.rgb, b.rgb) and np.array_equal(a.depth, b.depth)  # type: ignore[arg-type]


def test_normals_are_those_of_the_depth(clean):
    seen, normals = clean.render_at(7, 1), clean.normals(7, 1)
    assert normals.dtype == np.float32
    assert normals.shape == (480, 640, 3)
    z, k = seen.depth.astype(np.float64), seen.camera
    columns, rows = np.meshgrid(np.arange(640) + 0.5, np.arange(480) + 0.5)
    points = np.stack([(columns - k.cx) / k.fx * z, (rows - k.cy) / k.fy * z, z], 2)
    hit = z > 0
    assert np.allclose(np.linalg.norm(normals[hit], axis=1), 1, atol=1e-6)
    assert not normals[~hit].any()
    assert (np.einsum("hwc,hwc->hw", normals, points)[hit] <= 0).all()
    # Neighbours on one flat surface: what lies between them is at right angles to the normal.
    right, down = points[:-1, 1:] - points[:-1, :-1], points[1:, :-1] - points[:-1, :-1]
    flat = hit[:-1, :-1]
    for a, b in ((normals[:-1, 1:], normals[:-1, :-1]), (normals[1:, :-1], normals[:-1, :-1])):
        flat = flat & (np.abs(a - b).max(2) < 1e-6)
    flat &= (seen.instance[:-1, :-1] == 0) & (np.linalg.norm(right, axis=2) < 0.02)
    flat &= np.linalg.norm(down, axis=2) < 0.02
    assert flat.sum() > 50_000
    lean = np.abs(np.einsum("hwc,hwc->hw", right, normals[:-1, :-1])) / np.linalg.norm(right, axis=2)
    assert np.quantile(lean[flat], 0.99) < 1e-3
    table = clean.render_at(7, 1).camera.rotation @ [0, 0, 1]
    assert (np.abs(normals - table).max(2) < 1e-5).mean() > 0.2


def test_amodal_masks_hold_what_is_seen_and_what_is_hidden(clean):
    hidden = 0
    for target in clean.true_targets():
        for node, pitch in (EPISODE.start, (5, 0), (20, 1), (33, 2)):
            mask = clean.amodal_mask(target.instance, node, pitch)
            visible = clean.true_instances(node, pitch) == target.instance
            assert mask.dtype == np.bool_
            assert mask.shape == (480, 640)
            assert not (visible & ~mask).any()
            assert mask.sum() == target.unoccluded_px[node, pitch]
            assert visible.sum() == target.visible_px[node, pitch]
            # Something nearer stands before each pixel of it that is not seen.
            occluders = clean.true_instances(node, pitch)[mask & ~visible]
            hidden += int((occluders > 0).sum())
    assert hidden > 500


def test_wrong_instances_and_places_are_named(clean):
    with pytest.raises(InputError, match=r"no instance 99 on the table of this episode; there are 1, 2"):
        clean.amodal_mask(99, 0, 0)
    with pytest.raises(InputError, match="no instance 0 on the table"):
        clean.amodal_mask(0, 0, 0)
    with pytest.raises(InputError, match="node 36"):
        clean.amodal_mask(1, 36, 0)
    with pytest.raises(InputError, match="node must be a whole number"):
        clean.normals("x", 0)


def test_the_gpus_world_goes_through_the_same_sensor(clean, noisy, gpu):  # noqa: F811
    plain = TabletopEnvironment(EPISODE, device="gpu")
    other = TabletopEnvironment(EPISODE, device="gpu", sensor=NOISY)
    expected, drawn, exact = noisy.render_at(7, 0), other.render_at(7, 0), plain.render_at(7, 0)
    assert expected.depth is not None
    assert drawn.depth is not None
    assert exact.depth is not None
    assert not np.array_equal(drawn.rgb, exact.rgb)
    assert (np.abs(expected.depth - drawn.depth) <= 2e-4 * exact.depth).mean() > 0.995
    assert (np.abs(expected.rgb.astype(int) - drawn.rgb).max(2) <= 6).mean() > 0.98
    target = EPISODE.data["target"]
    assert np.array_equal(other.amodal_mask(target, 7, 0), clean.amodal_mask(target, 7, 0))
    for _ in range(2):  # made, then kept
        assert np.array_equal(other.normals(7, 0), clean.normals(7, 0))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"shot_noise": -0.1},
            "`sensor.shot_noise`: found -0.1, expected: greater than or equal to 0",
        ),
        (
            {"depth_noise_m": float("nan")},
            "`sensor.depth_noise_m`: found nan, expected: a finite number",
        ),
        ({"shotnoise": 0.1}, "unknown key `sensor.shotnoise`; did you mean `shot_noise`?"),
        ({"defocus_px": 20}, "`sensor.defocus_px`: found 20, expected: less than or equal to 16"),
        ({"seed": -1}, "`sensor.seed`: found -1, expected: greater than or equal to 0"),
        ("noisy", "`sensor`: found 'noisy', expected: a table of settings"),
    ],
)
def test_wrong_settings_are_named(settings, message):
    for call in (
        lambda: TabletopEnvironment(EPISODE, sensor=settings),
        lambda: TabletopGym([EPISODE], sensor=settings),
    ):
        with pytest.raises(InputError) as caught:
            call()
        assert str(caught.value) == f"sensor: {message}"


def test_the_bounds_are_those_of_the_native_code():
    for name, field in SensorConfig.model_fields.items():
        if name == "seed":
            continue
        for bound in field.metadata:
            low = getattr(bound, "ge", None)
            edge = low if low is not None else bound.le
            inside = SensorConfig().model_copy(update={name: float(edge)})
            TabletopEnvironment(EPISODE, sensor=inside)
            beyond = edge - 1e-3 if low is not None else edge + 1e-3
            outside = SensorConfig().model_copy(update={name: float(beyond)})
            with pytest.raises(InputError, match=rf"sensor: {name} must be from"):
                TabletopEnvironment(EPISODE, sensor=outside)


def test_gymnasium_takes_a_sensor(noisy):
    env = gymnasium.make("fuse_grounding/Tabletop-v0", episodes=[EPISODE], sensor=NOISY)
    seen, _ = env.reset()
    noisy.reset()
    truth = noisy.observe()
    assert np.array_equal(seen["rgb"], truth.rgb)
    assert np.array_equal(seen["depth"], truth.depth)
    assert env.observation_space.contains(seen)


def test_the_sensor_is_recorded_and_part_of_a_benchmarks_identity():
    config = Config().with_(sensor=NOISY, method="static")
    agent = Agent(config)
    assert agent.start(EPISODE.query).record.config["sensor"] == config.to_dict()["sensor"]
    assert config.to_dict()["sensor"]["seed"] == 3
    parts = [identity.identity(c, [EPISODE], {"fuse": agent.provenance}) for c in (Config(), config)]
    assert identity.difference(*parts) == (
        "with other settings (`config.sensor.depth_edge_dropout` is 0.0 there and 0.5 here)"
    )


def test_runs_and_benchmarks_see_through_the_sensor(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    opened: list[TabletopEnvironment] = []

    class Watched(TabletopEnvironment):
        def __init__(self, *arguments: Any, **named: Any):
            super().__init__(*arguments, **named)
            opened.append(self)

    monkeypatch.setattr(runner, "TabletopEnvironment", Watched)
    monkeypatch.setattr("fuse_grounding.cli.run.TabletopEnvironment", Watched)
    agent = Agent(Config().with_(sensor=NOISY, method="static"))
    assert runner.run_one(agent, "static", EPISODE, 0)["status"] == "ok"
    settings = ["--set", "sensor.read_noise=0.02", "--method", "static", "--seed", "7"]
    status, _, stderr = run(capsys, "run", "cut", *settings, "--out", str(tmp_path / "r"))
    assert status == 0, stderr
    assert EpisodeRecord.load(tmp_path / "r" / "episode.json").config["sensor"]["read_noise"] == 0.02
    assert [world.sensor for world in opened] == [SensorConfig(**NOISY), SensorConfig(read_noise=0.02)]
    arguments = ["run", "cut", "--capture", str(tmp_path), "--set", "sensor.read_noise=0.02"]
    status, _, stderr = run(capsys, *arguments)
    assert status == 2
    assert "photos come from a real sensor; leave out `sensor`" in stderr
    status, _, stderr = run(capsys, "run", "cut", "--set", "sensor.read_noise=-1")
    assert status == 2
    assert "`sensor.read_noise`: found -1" in stderr


def test_the_docs_show_what_the_settings_do():
    text = (ROOT / "docs" / "sensor.md").read_text(encoding="utf-8")
    assert (ROOT / "docs" / "images" / "scenes" / "sensor.jpg").stat().st_size <= 250_000
    assert "images/scenes/sensor.jpg" in text
    for name in SensorConfig.model_fields:
        assert f"`{name}`" in text, name
    for _, settings in SENSORS:
        SensorConfig(**settings)
