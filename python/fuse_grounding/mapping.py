"""The Gaussian map as the agent uses it: starts from the seed views, grows with every refinement."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from fuse_grounding import splat
from fuse_grounding._core import Camera
from fuse_grounding.config import MapConfig
from fuse_grounding.planning.protocol import Rendering
from fuse_grounding.record import MapEntry, Stopwatch
from fuse_grounding.registration.protocol import Registrar

MIN_POINTS = 8
"""With fewer sparse points there is nothing to start from, and the map stays away."""


class PointRegistrar(Registrar, Protocol):
    """A registrar whose sparse points can be told apart over time."""

    def points_by_id(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ids (N,) int64, never given twice; positions (N, 3) metres; colours (N, 3) uint8."""
        ...


class ForkingRegistrar(PointRegistrar, Protocol):
    """One of which a twin can be made."""

    def fork(self) -> ForkingRegistrar:
        """A twin that goes its own way from here. Raises InputError where that cannot be."""
        ...


def check(config: MapConfig) -> list[str]:
    """What a reader of the record must know of the device that `config` takes.

    Raises InputError for what only the native trainer refuses: its numbers are narrower than Python's.
    """
    one = splat.Gaussians.from_points(np.zeros((1, 3)), np.zeros((1, 3)))
    taken = splat.Trainer(one, config, config.device).device
    if config.device == "cpu":
        return []
    why = "no real GPU was found, " if taken.startswith("cpu") else ""
    return [f"map.device {config.device}: {why}the map is trained on {taken}"]


class GaussianMap:
    """Views wait until a refinement takes them in: amortised steps cost nothing here.

    The order of views is the registrar's: seeds first, then the online views.
    """

    def __init__(self, registrar: PointRegistrar, config: MapConfig):
        self._registrar = registrar
        self._config = config
        self._pictures: list[np.ndarray] = []
        self._trainer: splat.Trainer | None = None
        self._known: set[int] = set()
        self._seeds = 0
        self._taken = 0
        self._refinements = 0

    def add_seed(self, rgb: np.ndarray) -> None:
        """A seed view, in the registrar's order."""
        self._seeds += 1
        self._pictures.append(rgb)

    def add(self, rgb: np.ndarray) -> None:
        """The view that the registrar took in last."""
        self._pictures.append(rgb)

    def refine(self, clock: Stopwatch) -> None:
        """`incremental_iterations` over all views, at their newest poses; first, once, the initial ones."""
        cameras = [view.camera for view in self._registrar.views()]
        if self._trainer is None:
            with clock("initialize_map"):
                self._trainer = self._start(cameras[: self._seeds])
            if self._trainer is None:
                return
        with clock("refine"):
            for index, camera in enumerate(cameras[: self._taken]):
                self._trainer.set_camera(index, camera)
            self._take(self._trainer, cameras)
            if self._config.add_points:
                self._add_new_points(self._trainer)
            self._trainer.refine(self._config.incremental_iterations)
            self._refinements += 1

    def fork(self, registrar: PointRegistrar) -> GaussianMap:
        """A twin over `registrar`, a fork of this map's, that goes its own way from here."""
        twin = GaussianMap(registrar, self._config)
        twin._pictures, twin._known = list(self._pictures), set(self._known)
        twin._seeds, twin._taken, twin._refinements = self._seeds, self._taken, self._refinements
        twin._trainer = None if self._trainer is None else self._trainer.fork()
        return twin

    def render(self, camera: Camera) -> Rendering | None:
        """The map's prediction; see `SpatialMap.render`."""
        if self._trainer is None:
            return None
        image, alpha, _ = splat.render(self._trainer.gaussians, camera, device=self._config.device)
        return Rendering(image, float(alpha.mean(dtype=np.float64)))

    def entry(self) -> MapEntry | None:
        """For the record; None while there is no map."""
        if self._trainer is None:
            return None
        return MapEntry(
            gaussians=len(self._trainer.gaussians), views=self._taken, refinements=self._refinements
        )

    def save(self, path: Path) -> None:
        """Writes the Gaussians as PLY."""
        if self._trainer is not None:
            self._trainer.gaussians.save_ply(str(path))

    def _start(self, cameras: list[Camera]) -> splat.Trainer | None:
        ids, points, colours = self._registrar.points_by_id()
        if len(points) < MIN_POINTS:
            return None
        trainer = splat.Trainer(
            splat.Gaussians.from_points(points, colours), self._config, self._config.device
        )
        self._known = set(ids.tolist())
        self._take(trainer, cameras)
        trainer.refine(self._config.initial_iterations)
        return trainer

    def _add_new_points(self, trainer: splat.Trainer) -> None:
        """Gaussians at points that were triangulated since the last refinement."""
        ids, points, colours = self._registrar.points_by_id()
        new = np.array([i not in self._known for i in ids.tolist()], bool)
        if new.any():
            trainer.add_points(points[new], colours[new])
            self._known.update(ids[new].tolist())

    def _take(self, trainer: splat.Trainer, cameras: list[Camera]) -> None:
        """Hands the trainer the views that it does not have yet."""
        for index in range(self._taken, len(cameras)):
            trainer.add_view(self._pictures[index], cameras[index])
        self._taken = len(cameras)
