from __future__ import annotations

from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from agent_doubles import HEIGHT, WIDTH, camera

from fuse_grounding import splat
from fuse_grounding._core import Camera
from fuse_grounding.agent import Agent
from fuse_grounding.config import Config, MapConfig
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import InputError
from fuse_grounding.mapping import GaussianMap
from fuse_grounding.record import Stopwatch
from fuse_grounding.registration.protocol import RegisteredView


class Registrar:
    """Registers what it is told to; finds two more points with each later view."""

    def __init__(self, points: int):
        self.cameras: list[Camera] = []
        self.ids = list(range(points))

    def initialize(self, seeds: object) -> list[RegisteredView]:
        raise NotImplementedError

    def register(self, observation: Observation) -> RegisteredView:
        raise NotImplementedError

    def add(self, view: Camera) -> None:
        self.cameras.append(view)
        self.ids += [max(self.ids) + 1, max(self.ids) + 2]

    def views(self) -> list[RegisteredView]:
        return [RegisteredView(c, "posed") for c in self.cameras]

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        return self.points_by_id()[1:]

    def points_by_id(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        random = np.random.default_rng(0)
        xyz = random.uniform(-0.3, 0.3, (1000, 3)) + np.array([0, 0, 0.4])
        return np.array(self.ids), xyz[self.ids], np.full((len(self.ids), 3), 128, np.uint8)


def picture() -> np.ndarray:
    return np.full((HEIGHT, WIDTH, 3), (200, 60, 40), np.uint8)


def grown(points: int, **settings: int | bool) -> tuple[GaussianMap, Registrar]:
    registrar = Registrar(points)
    config = MapConfig.model_validate({"initial_iterations": 60, "incremental_iterations": 20, **settings})
    scene = GaussianMap(registrar, config)
    for node in (34, 35, 1, 2):
        registrar.cameras.append(camera(node, 1))
        scene.add_seed(picture())
    return scene, registrar


def test_the_map_starts_late_then_takes_in_what_waited(tmp_path: Path):
    scene, registrar = grown(60)
    assert scene.render(camera(0, 1)) is None
    assert scene.entry() is None
    scene.save(tmp_path / "none.ply")
    assert not (tmp_path / "none.ply").exists()
    clock = Stopwatch()
    for node in (0, 1):  # two views wait for one refinement, as amortised steps leave them
        registrar.add(camera(node, 1))
        scene.add(picture())
    scene.refine(clock)
    assert {"initialize_map", "refine"} == set(clock.take())
    entry = scene.entry()
    assert entry is not None
    assert (entry.views, entry.refinements, entry.gaussians) == (6, 1, 64)
    registrar.add(camera(2, 1))
    scene.add(picture())
    scene.refine(clock)
    assert set(clock.take()) == {"refine"}
    entry = scene.entry()
    assert entry is not None
    assert (entry.views, entry.refinements, entry.gaussians) == (7, 2, 66)
    rendering = scene.render(camera(0, 1))
    assert rendering is not None
    assert rendering.rgb.shape == (HEIGHT, WIDTH, 3)
    assert 0 < rendering.coverage <= 1
    scene.save(tmp_path / "scene.ply")
    assert len(splat.Gaussians.from_ply(tmp_path / "scene.ply")) == 66


def test_new_points_can_be_left_out():
    scene, registrar = grown(60, add_points=False)
    registrar.add(camera(0, 1))
    scene.add(picture())
    scene.refine(Stopwatch())
    entry = scene.entry()
    assert entry is not None
    assert entry.gaussians == 62  # found before the map was started, on the first refinement


def test_refining_explains_the_pictures_better():
    scene, _ = grown(200)
    scene.refine(Stopwatch())
    before = scene.render(camera(1, 1))
    for _ in range(4):
        scene.refine(Stopwatch())
    after = scene.render(camera(1, 1))
    assert before is not None
    assert after is not None
    truth = picture() / np.float32(255)
    assert np.abs(after.rgb - truth).mean() < 0.9 * np.abs(before.rgb - truth).mean()


def test_too_few_points_leave_the_map_away_and_do_not_fail():
    scene, registrar = grown(1)
    scene.refine(Stopwatch())
    assert scene.render(camera(0, 1)) is None
    registrar.add(camera(0, 1))
    scene.add(picture())
    registrar.ids = list(range(40))
    scene.refine(Stopwatch())  # enough by now: started from all views so far
    entry = scene.entry()
    assert entry is not None
    assert entry.views == 5


def test_a_maps_settings_are_the_trainers_and_five_of_its_own():
    # One set of defaults, but for what makes the short refinements within an episode cheaper.
    fast: dict[str, Any] = {"fine_iterations": 240, "matched_low_pass": True}
    fast |= {"step_iterations": 3, "rate_gain": 3.0}
    assert asdict(MapConfig()) == asdict(splat.TrainerConfig(**fast))
    assert all(getattr(splat.TrainerConfig.official(), name) != value for name, value in fast.items())
    ours = set(MapConfig.model_fields) - {f.name for f in fields(splat.TrainerConfig)}
    assert ours == {"schedule", "device", "initial_iterations", "incremental_iterations", "add_points"}
    official = Config.load(None, ["map.schedule=official", "map.max_gaussians=9"]).map
    assert asdict(official) == asdict(replace(splat.TrainerConfig.official(), max_gaussians=9))
    config = Config.load(None, ["map.degree=1", "map.seed=3", "map.extent=0.5", "map.background=[1, 1, 1]"])
    trained = splat.Trainer(splat.Gaussians.from_points(np.eye(3), np.eye(3)), config.map).config
    assert (trained.degree, trained.seed, trained.extent, trained.background) == (1, 3, 0.5, (1, 1, 1))
    with pytest.raises(InputError, match="position_rate must be finite and positive, found inf"):
        Agent(Config.load(None, ["method=explicit", "map.position_rate=1e300"]))


@pytest.mark.parametrize("name", [f.name for f in fields(splat.TrainerConfig)])
def test_the_trainer_refuses_what_the_configuration_refuses(name: str):
    """The bounds stand in two languages: neither lets pass what the other does not."""
    points = splat.Gaussians.from_points(np.eye(3), np.eye(3))

    def refused(value: Any) -> tuple[bool, bool]:
        verdicts = []
        for attempt in (
            lambda: Config.from_dict({"map": {name: value}}),
            lambda: splat.Trainer(points, splat.TrainerConfig(**{name: value})),
        ):
            try:
                attempt()
                verdicts.append(False)
            except InputError:
                verdicts.append(True)
        return verdicts[0], verdicts[1]

    vector = name == "background"
    for number in (-1, 0, 1, 2, 4, float("nan"), float("inf")):
        value = (number, 0.5, 0.5) if vector else number
        config, trainer = refused(value)
        assert config == trainer, (value, "configuration", config, "trainer", trainer)
    assert refused("x") == (True, True)
