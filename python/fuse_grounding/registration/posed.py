"""Registration when every pose is known: nothing to estimate but the sparse points.

The map needs points to start from, so SIFT matches between neighbouring views are triangulated
linearly from the known poses, joined to tracks, and kept when every view of a track sees the point
in front of it and within `max_error` pixels.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import InputError
from fuse_grounding.registration import features
from fuse_grounding.registration.checks import check_seeds, check_view, known_camera
from fuse_grounding.registration.protocol import RegisteredView

_FREE = -1


class PosedRegistrar:
    """A `Registrar` that trusts the poses it is given.

    `neighbours`: earlier views to match each view with. `max_error`: largest reprojection error of a
    point, pixels. `min_angle_deg`: smallest angle between the rays of a new point.
    """

    def __init__(self, neighbours: int = 6, max_error: float = 2.0, min_angle_deg: float = 1.5) -> None:
        if neighbours < 1:
            raise InputError(f"neighbours must be 1 or more, found {neighbours}")
        self._neighbours = neighbours
        self._max_error = max_error
        self._min_angle = np.radians(min_angle_deg)
        self._reset()

    def _reset(self) -> None:
        self._views: list[Observation] = []
        self._cameras: list[Camera] = []
        self._features: list[features.Features] = []
        self._rays: list[np.ndarray] = []  # (N, 2): x/z, y/z of each keypoint
        self._colours: list[np.ndarray] = []
        self._owner: list[np.ndarray] = []  # (N,): the point that a keypoint belongs to
        self._tracks: list[list[tuple[int, int]]] = []  # (view, keypoint) of each point
        self._xyz: list[np.ndarray] = []

    def initialize(self, seeds: Sequence[Observation]) -> list[RegisteredView]:
        """Starts afresh with the seed views; InputError for fewer than two or without cameras."""
        check_seeds(seeds)
        self._reset()
        for seed in seeds:
            self._add(seed, known_camera(seed, "seed"))
        return self.views()

    def register(self, observation: Observation) -> RegisteredView:
        """Adds one view at its known pose; InputError without one or before `initialize`."""
        if not self._cameras:
            raise InputError("register was called before initialize: give the seed views first")
        camera = known_camera(observation, "the view")
        check_view(observation, "the view", self._cameras[0])
        self._add(observation, camera)
        return self.views()[-1]

    def fork(self) -> PosedRegistrar:
        """A twin that goes its own way from here."""
        twin = copy.copy(self)
        for name in ("_views", "_cameras", "_features", "_rays", "_colours", "_xyz"):
            setattr(twin, name, list(getattr(self, name)))
        twin._owner = [owner.copy() for owner in self._owner]
        twin._tracks = [list(track) for track in self._tracks]
        return twin

    def views(self) -> list[RegisteredView]:
        """Every view at its known pose, seeds first."""
        return [RegisteredView(camera, "posed") for camera in self._cameras]

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (N, 3) float64, metres in the world; colours (N, 3) uint8."""
        return self.points_by_id()[1:]

    def points_by_id(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ids (N,) int64, positions and colours. An id keeps its point; later views may move it."""
        colours = [
            np.mean([self._colours[view][keypoint] for view, keypoint in track], axis=0)
            for track in self._tracks
        ]
        return (
            np.arange(len(self._xyz), dtype=np.int64),
            np.array(self._xyz, np.float64).reshape(-1, 3),
            np.rint(np.array(colours).reshape(-1, 3)).astype(np.uint8),
        )

    def _add(self, view: Observation, camera: Camera) -> None:
        found = features.extract(view.rgb)
        index = len(self._views)
        partners = features.nearest_views(view, self._views, self._neighbours)
        self._views.append(replace(view, rgb=np.zeros((0, 0, 3), np.uint8), depth=None, instance=None))
        self._cameras.append(camera)
        self._features.append(found)
        self._rays.append((found.keypoints - [camera.cx, camera.cy]) / [camera.fx, camera.fy])
        self._colours.append(features.sample(view.rgb, found.keypoints))
        self._owner.append(np.full(len(found.keypoints), _FREE))
        touched: set[int] = set()
        for partner in partners:
            pairs = features.match(self._features[partner], found).astype(np.int64)
            self._continue_tracks(partner, index, pairs, touched)
            self._start_tracks(partner, index, pairs)
        for point in sorted(touched):
            self._settle(point)

    def _continue_tracks(self, partner: int, index: int, pairs: np.ndarray, touched: set[int]) -> None:
        for theirs, mine in pairs:
            point = int(self._owner[partner][theirs])
            if point == _FREE or self._owner[index][mine] != _FREE:
                continue
            if self._tracks[point][-1][0] == index:
                continue  # This view sees the point already, with another keypoint.
            if self._errors(self._xyz[point][None], index, np.array([mine]))[0] <= self._max_error:
                self._owner[index][mine] = point
                self._tracks[point].append((index, int(mine)))
                touched.add(point)

    def _start_tracks(self, partner: int, index: int, pairs: np.ndarray) -> None:
        free = (self._owner[partner][pairs[:, 0]] == _FREE) & (self._owner[index][pairs[:, 1]] == _FREE)
        pairs = pairs[free]
        if not len(pairs):
            return
        theirs, mine = pairs[:, 0], pairs[:, 1]
        xyz = triangulate(
            np.stack([_extrinsics(self._cameras[partner]), _extrinsics(self._cameras[index])]),
            np.stack([self._rays[partner][theirs], self._rays[index][mine]], axis=1),
        )
        error = np.maximum(self._errors(xyz, partner, theirs), self._errors(xyz, index, mine))
        angle = _ray_angle(xyz, self._cameras[partner].center, self._cameras[index].center)
        for row in np.flatnonzero((error <= self._max_error) & (angle >= self._min_angle)):
            self._owner[partner][theirs[row]] = self._owner[index][mine[row]] = len(self._xyz)
            self._tracks.append([(partner, int(theirs[row])), (index, int(mine[row]))])
            self._xyz.append(xyz[row])

    def _settle(self, point: int) -> None:
        """Re-triangulates a track that grew, and keeps the result if no view objects."""
        track = self._tracks[point]
        rays = np.array([[self._rays[view][keypoint] for view, keypoint in track]])
        xyz = triangulate(np.stack([_extrinsics(self._cameras[view]) for view, _ in track]), rays)
        worst = max(self._errors(xyz, view, np.array([keypoint]))[0] for view, keypoint in track)
        if worst <= self._max_error:
            self._xyz[point] = xyz[0]

    def _errors(self, xyz: np.ndarray, view: int, keypoints: np.ndarray) -> np.ndarray:
        """Reprojection errors (N,) in pixels; infinite behind the camera."""
        camera = self._cameras[view]
        local = xyz @ camera.rotation.T + camera.translation
        with np.errstate(divide="ignore", invalid="ignore"):
            off = (local[:, :2] / local[:, 2:] - self._rays[view][keypoints]) * [camera.fx, camera.fy]
        error = np.linalg.norm(off, axis=1)
        return np.where((local[:, 2] > 0.0) & np.isfinite(error), error, np.inf)


def triangulate(extrinsics: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Linear triangulation: poses (V, 3, 4) world → camera, rays (N, V, 2) as x/z, y/z → points (N, 3).

    Each view gives two rows, x P₃ − P₁ and y P₃ − P₂, of a homogeneous system that is solved in the least
    squares sense. Points at infinity come out as NaN.
    """
    rows = rays[..., None] * extrinsics[None, :, 2:3, :] - extrinsics[None, :, :2, :]
    solution = np.linalg.svd(rows.reshape(len(rays), -1, 4))[2][:, -1]
    with np.errstate(divide="ignore", invalid="ignore"):
        xyz = solution[:, :3] / solution[:, 3:]
    return np.where(np.isfinite(xyz), xyz, np.nan)


def _extrinsics(camera: Camera) -> np.ndarray:
    return np.column_stack([camera.rotation, camera.translation])


def _ray_angle(xyz: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    a, b = xyz - first, xyz - second
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.sum(a * b, axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
    return np.arccos(np.clip(cosine, -1.0, 1.0))
