"""What every network asks of a picture."""

from __future__ import annotations

from typing import Any

import numpy as np

from fuse_grounding.errors import InputError

SMALLEST = 32


def check_rgb(rgb: Any) -> np.ndarray:
    """A contiguous (H, W, 3) uint8 array of at least 32 pixels either way. Raises InputError for anything
    else."""
    if not isinstance(rgb, np.ndarray) or rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3:
        found = (
            f"{rgb.dtype} array of shape {rgb.shape}" if isinstance(rgb, np.ndarray) else type(rgb).__name__
        )
        raise InputError(f"rgb must be a (H, W, 3) uint8 array, found {found}")
    if min(rgb.shape[:2]) < SMALLEST:
        raise InputError(f"rgb must be at least {SMALLEST} pixels wide and high, found shape {rgb.shape}")
    return np.ascontiguousarray(rgb)
