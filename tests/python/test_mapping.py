from __future__ import annotations

from pathlib import Path

import numpy as np
from agent_doubles import HEIGHT, WIDTH, camera

from fuse_grounding import splat
from fuse_grounding._core import Camera
from fuse_grounding.config import MapConfig
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.mapping import GaussianMap, trainer_config
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


def test_every_training_setting_reaches_the_trainer():
    config = MapConfig(feature_rate=0.5, densify_start=7, degree=1, seed=3)
    trained = trainer_config(config)
    assert (trained.feature_rate, trained.densify_start, trained.degree, trained.seed) == (0.5, 7, 1, 3)
    assert trainer_config(MapConfig()) == splat.TrainerConfig()  # one set of defaults, not two
