"""What places each view in the map's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import FuseError


class RegistrationError(FuseError):
    """A view could not be placed, and its known pose is missing or may not be used."""


RegistrationStatus = Literal["colmap", "posed", "posed_fallback"]


@dataclass(frozen=True)
class RegisteredView:
    """A view with its camera in the world frame (metres, z up) and how the pose was found."""

    camera: Camera
    status: RegistrationStatus


class Registrar(Protocol):
    """Places views; keeps a sparse reconstruction alive between calls."""

    def initialize(self, seeds: Sequence[Observation]) -> list[RegisteredView]:
        """Registers the seed views together and fixes the frame."""
        ...

    def register(self, observation: Observation) -> RegisteredView:
        """Adds one view."""
        ...

    def views(self) -> list[RegisteredView]:
        """Every view so far, seeds first, with its current (re-adjusted) camera."""
        ...

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Sparse points: positions (N, 3) float64 metres in the world frame, colours (N, 3) uint8."""
        ...
