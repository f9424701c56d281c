"""What finds the candidates in a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class Detection:
    """One instance of a prompted label: `mask` (H, W) bool, `score` in [0, 1]."""

    label: str
    score: float
    mask: np.ndarray


class Segmenter(Protocol):
    """Finds instances of prompted labels."""

    @property
    def labels(self) -> tuple[str, ...] | None:
        """The labels that it knows, or None when any text will do."""
        ...

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        """Instances of `labels` in `rgb` (H, W, 3) uint8, best score first.

        Raises InputError for a label that is not known and for a picture of the wrong shape or dtype.
        """
        ...
