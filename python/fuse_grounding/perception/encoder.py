"""What puts pictures and words into one space, as CLIP does."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np


class Encoder(Protocol):
    """Pictures, their patches and labels as unit vectors of one space: what belongs together is close.

    `name` is how records call it, `dimensions` the length D of the vectors.
    """

    name: str
    dimensions: int

    def image(self, rgb: np.ndarray) -> np.ndarray:
        """(H, W, 3) uint8 → (D,) float32 of unit length. Raises InputError for another shape or dtype."""
        ...

    def text(self, labels: Sequence[str]) -> np.ndarray:
        """N labels or phrases → (N, D) float32 of unit length. Raises InputError for an empty list."""
        ...

    def patches(self, rgb: np.ndarray) -> np.ndarray:
        """(H, W, 3) uint8 → (h, w, D) float32 of unit length, row by row over the whole picture."""
        ...
