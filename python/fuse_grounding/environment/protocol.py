"""What an agent sees of a world, and what it can ask of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fuse_grounding._core import Camera


@dataclass(frozen=True)
class Observation:
    """One picture with what came along.

    Shapes: `rgb` (H, W, 3) uint8; `depth` (H, W) float32, planar metres along the optical axis,
    0 where unknown; `instance` (H, W) uint32, 0 is room and table. `camera` is the pose known
    from the robot or simulator (world: z up, metres). `node` in [0, 36) and `pitch_index` in
    [0, 3) place the view on the ring (pitches 15, 30, 45 degrees down).
    """

    rgb: np.ndarray
    depth: np.ndarray | None = None
    instance: np.ndarray | None = None
    camera: Camera | None = None
    node: int | None = None
    pitch_index: int | None = None


class Environment(Protocol):
    """A place that can be looked at from a discrete set of viewpoints."""

    def observe(self) -> Observation:
        """The view from where the camera is now."""
        ...

    def action_mask(self) -> np.ndarray:
        """(15,) bool: which actions are possible from here; the no-op is index 7."""
        ...

    def act(self, action: int) -> None:
        """Moves the camera. Raises InputError for an action that is masked or out of range."""
        ...

    def seed_observations(self) -> Sequence[Observation]:
        """The four views that start the map; the camera is afterwards where it was."""
        ...
