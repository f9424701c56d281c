"""What finds the candidates in a picture, and what compares pictures with words."""

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
        """Instances of `labels` in `rgb` (H, W, 3) uint8, best score first; no labels, no instances.

        Raises UnknownLabelError for a label that is not known, and InputError for one that cannot be a
        prompt and for a picture of the wrong shape or dtype.
        """
        ...


class TextEncoder(Protocol):
    """Places words in a space where what means the same is near."""

    @property
    def name(self) -> str:
        """How announcements and records call it."""
        ...

    def text(self, texts: Sequence[str]) -> np.ndarray:
        """(N, D) float32 rows of length 1, or all zero where a text has nothing in common with any.

        Rows of one call are comparable; no texts, no rows. Raises InputError for a text that cannot be
        encoded.
        """
        ...


class Encoder(TextEncoder, Protocol):
    """Places pictures and words in one space, as CLIP does; all vectors are float32 of length 1.

    Vectors of different calls are comparable, too.
    """

    def image(self, rgb: np.ndarray) -> np.ndarray:
        """(D,) of the whole picture (H, W, 3) uint8. Raises InputError."""
        ...

    def patches(self, rgb: np.ndarray) -> np.ndarray:
        """(h, w, D) of a grid of patches that covers the whole picture. Raises InputError."""
        ...
