"""Bounds of settings, and checks of arguments that name the argument, what was found and expected."""

from __future__ import annotations

import os
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from fuse_grounding.errors import InputError

Positive = Annotated[float, Field(gt=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Natural = Annotated[int, Field(ge=0)]
Flag = Annotated[bool, Field(strict=True)]


class Section(BaseModel):
    """A frozen group of settings; unknown keys are errors."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True, populate_by_name=True
    )


LARGEST = 2**31 - 1
"""What fits every integer of the native code."""


def whole(name: str, value: Any, low: int = 0, high: int = LARGEST) -> int:
    """A whole number from `low` to `high`, of Python or NumPy; a boolean is none. Raises InputError."""
    if (
        isinstance(value, (bool, np.bool_))
        or not isinstance(value, (int, np.integer))
        or not low <= value <= high
    ):
        raise InputError(f"{name} must be a whole number from {low} to {high}, found {value!r}")
    return int(value)


def finite(name: str, value: Any) -> float:
    """A finite number of Python or NumPy; a boolean is none. Raises InputError."""
    if (
        isinstance(value, (bool, np.bool_))
        or not isinstance(value, (int, float, np.integer, np.floating))
        or not np.isfinite(value)
    ):
        raise InputError(f"{name} must be a finite number, found {value!r}")
    return float(value)


def instance_of(name: str, value: Any, kind: type) -> None:
    """Raises InputError unless `value` is a `kind`."""
    if not isinstance(value, kind):
        raise InputError(f"{name} must be a {kind.__name__}, found {type(value).__name__}")


def check_simd_level() -> None:
    """Refuses an environment variable `FUSE_SIMD` that names no level: who asks for one asks for its bits."""
    wanted, levels = os.environ.get("FUSE_SIMD", ""), ("portable", "avx2+fma", "avx512")
    if wanted and wanted not in levels:
        raise InputError(f"FUSE_SIMD must be one of {', '.join(levels)}, found `{wanted}`")


def device_wish(device: object) -> str:
    """`cpu`, `gpu` or `auto`. Raises InputError for anything else."""
    if not isinstance(device, str) or device not in ("cpu", "gpu", "auto"):
        raise InputError(f"device must be `auto`, `cpu` or `gpu`, found {device!r}")
    return device
