"""Live registration with COLMAP: seeds start a model, each later view is added to it.

A view is matched, registered against the points it sees, triangulated and adjusted together with
its surroundings; poses known from the robot serve three ends only: the seeds' fix the similarity from
COLMAP's frame to the world, they rank neighbours where no ring position is known, and they place
a view that COLMAP cannot register.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import InputError
from fuse_grounding.registration import features
from fuse_grounding.registration.checks import check_seeds, check_view, known_camera
from fuse_grounding.registration.correspondences import (
    Correspondences,
    DatabaseCorrespondences,
    MemoryCorrespondences,
)
from fuse_grounding.registration.mapping import LiveModel, Pose
from fuse_grounding.registration.posed import PosedRegistrar
from fuse_grounding.registration.protocol import RegisteredView, RegistrationError
from fuse_grounding.registration.similarity import (
    Similarity,
    fit_similarity,
    project_to_rotation,
)

Profile = Literal["fast", "paper"]
OnFailure = Literal["posed_fallback", "error"]

_SEED_DISAGREEMENT = 0.1
"""Largest distance between a seed's fitted and known centre, as a share of the seeds' extent."""

logger = logging.getLogger(__name__)


@dataclass
class _Entry:
    """A view in the order of arrival; `placed` is its last known place in the world."""

    image_id: int
    known: Camera | None
    placed: Camera


class ColmapRegistrar:
    """A `Registrar` over a live in-memory COLMAP reconstruction with fixed intrinsics.

    `profile` "fast": OpenCV SIFT (`max_features` strongest at `contrast`), matched with the
    `neighbours` nearest views, local adjustment for each view and global adjustment every
    `global_every`. "paper": the supplement's database, SIFT and guided matching with the last
    `overlap` views, local and global adjustment for each view.
    `on_failure` "posed_fallback": a view that COLMAP cannot register takes its known pose and is recorded as
    such; "error": it raises RegistrationError. A view without a known pose always raises.
    The same `seed` gives the same bits in any process.
    """

    def __init__(
        self,
        profile: Profile = "fast",
        on_failure: OnFailure = "posed_fallback",
        neighbours: int = 6,
        overlap: int = 10,
        global_every: int = 5,
        max_features: int = features.MAX_FEATURES,
        contrast: float = features.CONTRAST,
        seed: int = 0,
    ) -> None:
        if profile not in ("fast", "paper"):
            raise InputError(f'registration profile must be "fast" or "paper", found {profile!r}')
        if on_failure not in ("posed_fallback", "error"):
            raise InputError(f'on_failure must be "posed_fallback" or "error", found {on_failure!r}')
        counts = dict(neighbours=neighbours, overlap=overlap, global_every=global_every)
        for name, value in {**counts, "max_features": max_features}.items():
            if value < 1:
                raise InputError(f"{name} must be 1 or more, found {value}")
        if seed < 0:
            raise InputError(f"seed must be 0 or more, found {seed}: COLMAP takes -1 for a random one")
        self._profile = profile
        self._on_failure = on_failure
        self._neighbours = neighbours
        self._overlap = overlap
        self._global_every = 1 if profile == "paper" else global_every
        self._max_features = max_features
        self._contrast = contrast
        self._seed = seed
        self._camera: Camera | None = None

    def initialize(self, seeds: Sequence[Observation]) -> list[RegisteredView]:
        """Starts afresh: registers the seed views together and fixes the frame by their known poses.

        If COLMAP finds no model, or one that contradicts the known poses, all views of the episode
        take their known poses and the points are triangulated from those; a warning says so.
        Raises InputError for fewer than two seeds, a missing camera, pictures of another size or
        seeds at one point; RegistrationError instead of any fallback under `on_failure="error"`.
        """
        self._camera = check_seeds(seeds)
        self._model = LiveModel(self._seed)
        self._correspondences = self._new_correspondences(self._camera)
        self._posed: PosedRegistrar | None = None
        self._world: Similarity | None = None
        self._colours: dict[int, np.ndarray] = {}
        self._point_colours: dict[int, np.ndarray] = {}
        self._registered = 0
        self._seed_count = len(seeds)
        ids = self._correspondences.add_seeds(seeds)
        self._entries = [
            _Entry(image_id, seed.camera, known_camera(seed, "seed"))
            for image_id, seed in zip(ids, seeds, strict=True)
        ]
        for image_id, seed in zip(ids, seeds, strict=True):
            self._keep_colours(image_id, seed)
        if self._model.start(self._correspondences.cache(), ids):
            self._world = self._fit_world()
        if self._world is None:
            self._give_up(seeds)
        self._refresh()
        self._colour_points()
        missing = [i for i, view in enumerate(self.views()) if view.status != "colmap"]
        if missing and self._on_failure == "error":
            self._camera = None
            raise RegistrationError(f"COLMAP did not register the seed views {missing}")
        if missing and self._world is not None:
            logger.warning("COLMAP did not register the seed views %s; they keep their known poses", missing)
        return self.views()

    def register(self, observation: Observation) -> RegisteredView:
        """Adds one view.

        Raises InputError before `initialize` or for a picture or intrinsics unlike the seeds';
        RegistrationError when COLMAP cannot place the view and its pose is unknown or may not be
        used. After an error the view is not among `views()`.
        """
        if self._camera is None:
            raise InputError("register was called before initialize: give the seed views first")
        check_view(observation, "the view", self._camera)
        if self._posed is not None:
            return self._register_posed(self._posed, observation)
        image_id = self._correspondences.add(observation)
        self._keep_colours(image_id, observation)
        globally = (self._registered + 1) % self._global_every == 0
        if self._model.add(self._correspondences.cache(), image_id, globally):
            self._registered += 1
            self._world = self._fit_world() or self._world
            placed = self._in_world(image_id)
        else:
            placed = None
        self._entries.append(_Entry(image_id, observation.camera, placed or self._fallback(observation)))
        self._refresh()
        self._colour_points()
        return self.views()[-1]

    def fork(self) -> ColmapRegistrar:
        """A twin that goes its own way from here, as if each had taken in all views so far.

        Raises InputError before `initialize` and under the profile "paper".
        """
        if self._camera is None:
            raise InputError("fork was called before initialize: give the seed views first")
        twin = copy.copy(self)
        twin._model, twin._correspondences = self._model.fork(), self._correspondences.fork()
        twin._posed = None if self._posed is None else self._posed.fork()
        twin._entries = [replace(entry) for entry in self._entries]
        twin._colours, twin._point_colours = dict(self._colours), dict(self._point_colours)
        return twin

    def views(self) -> list[RegisteredView]:
        """Every view so far, seeds first, with its camera after the latest adjustment."""
        if self._camera is None:
            return []
        return [
            RegisteredView(e.placed, "colmap" if self._is_registered(e.image_id) else "posed_fallback")
            for e in self._entries
        ]

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (N, 3) float64, metres in the world; colours (N, 3) uint8."""
        return self.points_by_id()[1:]

    def points_by_id(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ids (N,) int64 ascending, positions and colours of the points now in the model.

        An id is never given twice: ids that were not there before are new points, ids that are
        gone were merged or filtered, and a point that stays may move with an adjustment.
        """
        if self._posed is not None:
            return self._posed.points_by_id()
        model = self._model.reconstruction if self._camera is not None else None
        if model is None or self._world is None or model.num_points3D() == 0:
            return np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
        ids = sorted(model.point3D_ids())
        xyz = np.empty((len(ids), 3))
        rgb = np.empty((len(ids), 3))
        for row, point_id in enumerate(ids):
            point = model.point3D(point_id)
            xyz[row] = point.xyz
            rgb[row] = self._point_colours[point_id]
        return np.array(ids, np.int64), self._world.points(xyz), rgb.astype(np.uint8)

    def _new_correspondences(self, camera: Camera) -> Correspondences:
        if self._profile == "paper":
            return DatabaseCorrespondences(camera, self._overlap, self._seed)
        return MemoryCorrespondences(camera, self._neighbours, self._max_features, self._contrast, self._seed)

    def _keep_colours(self, image_id: int, view: Observation) -> None:
        self._colours[image_id] = features.sample(view.rgb, self._correspondences.keypoints(image_id))

    def _is_registered(self, image_id: int) -> bool:
        return self._world is not None and self._model.pose(image_id) is not None

    def _fit_world(self) -> Similarity | None:
        """World-from-map by the registered seeds; None if they are too few or contradict it."""
        pairs: list[tuple[Pose, Pose]] = []
        for entry in self._entries[: self._seed_count]:
            pose = self._model.pose(entry.image_id)
            if pose is not None and entry.known is not None:
                pairs.append((pose, (entry.known.rotation, entry.known.translation)))
        try:
            fitted = fit_similarity([pose for pose, _ in pairs], [known for _, known in pairs])
        except ValueError:
            return None
        fitted_centres = np.array([_centre(fitted.pose(*pose)) for pose, _ in pairs])
        known_centres = np.array([_centre(known) for _, known in pairs])
        off = float(np.linalg.norm(fitted_centres - known_centres, axis=1).max())
        extent = float(np.linalg.norm(np.ptp(known_centres, axis=0)))
        return fitted if off <= _SEED_DISAGREEMENT * extent else None

    def _in_world(self, image_id: int) -> Camera | None:
        pose = self._model.pose(image_id)
        if pose is None or self._world is None or self._camera is None:
            return None
        c = self._camera
        rotation, translation = self._world.pose(*pose)
        return Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy, project_to_rotation(rotation), translation)

    def _refresh(self) -> None:
        """Brings every view to where the latest adjustment put it; one that it dropped, to its known pose."""
        for entry in self._entries:
            entry.placed = self._in_world(entry.image_id) or entry.known or entry.placed

    def _colour_points(self) -> None:
        """A new point has the mean colour of the views that it was found in, whenever it is asked for."""
        if self._posed is not None:
            return
        for point_id, point in self._model.reconstruction.points3D.items():
            if point_id not in self._point_colours:
                seen = [self._colours[e.image_id][e.point2D_idx] for e in point.track.elements]
                self._point_colours[point_id] = np.rint(np.mean(seen, axis=0))

    def _fallback(self, observation: Observation) -> Camera:
        if self._on_failure == "error":
            raise RegistrationError("COLMAP could not register the view")
        if observation.camera is None:
            raise RegistrationError("COLMAP could not register the view, and its pose is not known")
        logger.info("COLMAP could not register a view; it keeps its known pose")
        return observation.camera

    def _give_up(self, seeds: Sequence[Observation]) -> None:
        logger.warning("COLMAP found no model in the seed views; this episode uses the known poses")
        self._posed = PosedRegistrar(self._neighbours)
        self._posed.initialize(seeds)

    def _register_posed(self, posed: PosedRegistrar, observation: Observation) -> RegisteredView:
        camera = self._fallback(observation)
        posed.register(observation)
        self._entries.append(_Entry(len(self._entries) + 1, camera, camera))
        return self.views()[-1]


def _centre(pose: Pose) -> np.ndarray:
    rotation, translation = pose
    return -rotation.T @ translation
