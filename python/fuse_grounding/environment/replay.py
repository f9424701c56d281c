"""A folder of photos as a world to look around in: an action goes to the nearest photo in its direction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from fuse_grounding import splat
from fuse_grounding._core import Camera
from fuse_grounding.arguments import whole
from fuse_grounding.environment.capture import Capture, Scale, load_capture
from fuse_grounding.environment.frame import NODE_DEG, Ring, ring
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import InputError
from fuse_grounding.reconstruction.training import TrainOptions

ACTIONS = 15
NOOP = 7
REACH_NODES = 9.0
"""A photo more than a quarter of the way round lies in no direction from here."""
CONE = np.cos(np.radians(45.0))
"""Cosine of the largest angle between an action's direction and a photo's, in nodes and pitch steps."""
PROGRESS = 0.5
"""A move goes at least so many steps in its direction: two photos from one place are no move."""
MAP_ITERATIONS = 500
MAP_GAUSSIANS = 30_000
_OPAQUE = 0.5


class ReplayEnvironment:
    """Photos around a table, to act in: `Environment` over a `Capture`.

    `start` names the first photo, None the first by name; `seed_offsets` are places, in ring nodes from
    here at the middle pitch, whose nearest photos start the map. Where the scale is known and the photos
    have no depth, depth is rendered from a Gaussian map of all photos, which is trained when it is first
    wanted. Raises InputError for a photo that does not exist, and a start from which no other can be reached.
    """

    def __init__(
        self,
        capture: Capture,
        start: str | None = None,
        seed_offsets: Sequence[int] = (-2, -1, 1, 2),
        map_iterations: int = MAP_ITERATIONS,
    ):
        self.capture = capture
        self._ring: Ring = ring(capture.cameras, capture.middle)
        self._offsets = tuple(seed_offsets)
        if len(self._offsets) >= len(capture.names):
            raise InputError(
                f"capture {capture.folder} has {len(capture.names)} photos, "
                f"expected more than the {len(self._offsets)} seed views"
            )
        self._iterations = whole("map_iterations", map_iterations, 1)
        self._here = self._start = 0 if start is None else self._index(start)
        self._moves: dict[int, np.ndarray] = {}
        self.visited = [self.photo]
        if self.action_mask().sum() < 2:
            raise InputError(
                f"from {self.photo} no other photo is within {REACH_NODES * NODE_DEG:.0f} degrees around "
                "the table in the direction of any move; start from another photo, or take more"
            )

    @classmethod
    def open(
        cls,
        folder: str | Path,
        start: str | None = None,
        *,
        scale: Scale = None,
        hfov_deg: float | None = None,
        told: Callable[[str], None] = lambda text: None,
    ) -> ReplayEnvironment:
        """A folder's environment; the arguments are those of `load_capture`."""
        return cls(load_capture(folder, scale=scale, hfov_deg=hfov_deg, told=told), start)

    @property
    def photo(self) -> str:
        """Name of the photo that the camera is at."""
        return self.capture.names[self._here]

    @property
    def notes(self) -> list[str]:
        """What a reader of results must know of this world."""
        notes = list(self.capture.notes)
        if self._depth_from_map:
            notes.append(
                f"the photos have no depth: it is rendered from a Gaussian map of all "
                f"{len(self.capture.names)} of them"
            )
        return notes

    def reset(self) -> None:
        """Moves the camera back to the start."""
        self._here = self._start
        self.visited = [self.photo]

    def observe(self) -> Observation:
        """The photo that the camera is at."""
        return self._observation(self._here)

    def action_mask(self) -> np.ndarray:
        """(15,) bool: directions in which there is a photo; the no-op always."""
        return self._reached() >= 0

    def act(self, action: int) -> None:
        """Goes to the nearest photo in that direction. Raises InputError where there is none."""
        action = whole("action", action, 0, ACTIONS - 1)
        target = int(self._reached()[action])
        if target < 0:
            raise InputError(
                f"action {action} is not possible at {self.photo}: no photo lies in its direction"
            )
        self._here = target
        self.visited.append(self.photo)

    def seed_observations(self) -> Sequence[Observation]:
        """The photos nearest to the seed views' places, each another one, none the one that is here."""
        offsets = self._ring.offsets(self._here)
        offsets[:, 1] = self._ring.tilt - 2.0  # the middle pitch
        taken = [self._here]
        for nodes in self._offsets:
            order = np.argsort(np.linalg.norm(offsets - [nodes, 0.0], axis=1), kind="stable")
            taken.append(next(int(i) for i in order if i not in taken))
        return [self._observation(i) for i in taken[1:]]

    def _index(self, name: str) -> int:
        if name not in self.capture.names:
            some = ", ".join(self.capture.names[:5])
            raise InputError(f"capture {self.capture.folder} has no photo {name}; there are {some}, …")
        return self.capture.names.index(name)

    def _reached(self) -> np.ndarray:
        """(15,): the photo that each action leads to from here, -1 for none."""
        if self._here not in self._moves:
            self._moves[self._here] = nearest_in_direction(self._ring, self._here)
        return self._moves[self._here]

    def _observation(self, index: int) -> Observation:
        capture = self.capture
        node, pitch_index = self._ring.place(index)
        depth = None if capture.depths is None else capture.depths[index]
        if self._depth_from_map:
            depth = self._rendered_depth(capture.cameras[index])
        instance = None if capture.instances is None else capture.instances[index].astype(np.uint32)
        return Observation(capture.images[index], depth, instance, capture.cameras[index], node, pitch_index)

    def _rendered_depth(self, camera: Camera) -> np.ndarray:
        """(H, W) metres, 0 where the map is thin."""
        _, alpha, rendered = splat.render(self._map, camera)
        return np.where(alpha > _OPAQUE, rendered, 0.0).astype(np.float32)

    @property
    def _depth_from_map(self) -> bool:
        return self.capture.metric and self.capture.depths is None and len(self.capture.points) > 0

    @cached_property
    def _map(self) -> splat.Gaussians:
        capture = self.capture
        options = TrainOptions(iterations=self._iterations, max_gaussians=MAP_GAUSSIANS)
        start = splat.Gaussians.from_points(capture.points, capture.colours)
        trainer = splat.Trainer(start, options.config())
        for image, camera in zip(capture.images, capture.cameras, strict=True):
            trainer.add_view(image, camera)
        trainer.refine(self._iterations)
        return trainer.gaussians


def nearest_in_direction(ring: Ring, here: int) -> np.ndarray:
    """(15,) photo that each action leads to from photo `here`, -1 where none lies that way.

    An action asks for d = (Δp nodes, Δr pitch steps); a photo at v from here lies in its direction if the
    angle between them is at most 45 degrees, ⟨v, d⟩ / |d| at least `PROGRESS` and |v_nodes| at most
    `REACH_NODES`. Of those the one with the least |v - d| is taken, the first by name among equals.
    """
    offsets = ring.offsets(here)
    lengths = np.linalg.norm(offsets, axis=1)
    reached = np.full(ACTIONS, -1)
    reached[NOOP] = here
    for action in range(ACTIONS):
        wanted = np.array([action % 5 - 2, action // 5 - 1], float)
        if action == NOOP:
            continue
        along = offsets @ wanted / np.linalg.norm(wanted)
        ahead = (along >= PROGRESS) & (along >= CONE * lengths) & (np.abs(offsets[:, 0]) <= REACH_NODES)
        ahead[here] = False
        if ahead.any():
            far = np.where(ahead, np.linalg.norm(offsets - wanted, axis=1), np.inf)
            reached[action] = int(np.argmin(far))
    return reached
