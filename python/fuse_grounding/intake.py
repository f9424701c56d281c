"""Checks pictures where they enter, so that everything behind may rely on them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.arguments import whole
from fuse_grounding.config import CameraConfig
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import InputError


def take_in(
    config: CameraConfig,
    rgb: Any,
    depth: Any = None,
    pose: Any = None,
    node: int | None = None,
    pitch_index: int | None = None,
) -> Observation:
    """A checked observation, without instance ids whatever the caller holds.

    `rgb` (H, W, 3) uint8; `depth` (H, W) float metres or None, where unknown values may be 0,
    NaN or infinite; `pose` a Camera, or a (4, 4) world-to-camera matrix that goes with the configured
    intrinsics, or None; `node` and `pitch_index` a place on the ring, or None. Raises InputError naming
    the argument, what was found and what was expected.
    """
    height, width = config.height, config.width
    if not isinstance(rgb, np.ndarray) or rgb.dtype != np.uint8 or rgb.shape != (height, width, 3):
        raise InputError(f"rgb must be a ({height}, {width}, 3) uint8 array, found {_describe(rgb)}")
    return Observation(
        rgb=np.ascontiguousarray(rgb),
        depth=None if depth is None else _depth(depth, height, width),
        camera=None if pose is None else _camera(pose, config),
        node=None if node is None else whole("node", node, 0, config.nodes - 1),
        pitch_index=None
        if pitch_index is None
        else whole("pitch_index", pitch_index, 0, len(config.pitches_deg) - 1),
    )


def action_mask(mask: Any) -> np.ndarray:
    """(15,) bool with at least one action. Raises InputError."""
    array = np.asarray(mask)
    if array.shape != (15,) or array.dtype != np.bool_:
        raise InputError(f"action_mask must be a (15,) bool array, found {_describe(array)}")
    if not array.any():
        raise InputError("action_mask allows no action; at least one must be possible")
    return array


def pitch_mask(pitch_index: int, pitches: int) -> np.ndarray:
    """(15,) bool: the actions that stay within the pitch levels, index 5 (dr + 1) + (dp + 2)."""
    levels = pitch_index + np.arange(-1, 2)
    return np.repeat((levels >= 0) & (levels < pitches), 5)


def _depth(depth: Any, height: int, width: int) -> np.ndarray:
    if (
        not isinstance(depth, np.ndarray)
        or depth.shape != (height, width)
        or not np.issubdtype(depth.dtype, np.floating)
    ):
        raise InputError(
            f"depth must be a ({height}, {width}) float array in metres, found {_describe(depth)}"
        )
    known = np.isfinite(depth) & (depth > 0)
    return np.where(known, depth, 0.0).astype(np.float32)


def _camera(pose: Any, config: CameraConfig) -> Camera:
    if isinstance(pose, Camera):
        if (pose.width, pose.height) != (config.width, config.height):
            raise InputError(
                f"pose is a camera of {pose.width}x{pose.height} pixels, "
                f"expected {config.width}x{config.height}"
            )
        return pose
    matrix = _real_matrix(pose)
    if matrix is None or matrix.shape != (4, 4) or not np.allclose(matrix[3], [0, 0, 0, 1]):
        raise InputError(
            f"pose must be a Camera or a (4, 4) world-to-camera matrix with last row 0 0 0 1, "
            f"found {_describe(pose)}"
        )
    focal = 0.5 * config.width / math.tan(math.radians(0.5 * config.hfov_deg))
    return Camera(
        config.width,
        config.height,
        focal,
        focal,
        0.5 * config.width,
        0.5 * config.height,
        np.ascontiguousarray(matrix[:3, :3]),
        np.ascontiguousarray(matrix[:3, 3]),
    )


def _real_matrix(pose: Any) -> np.ndarray | None:
    """float64, or None for what is no array of real numbers."""
    try:
        array = np.asarray(pose)
    except ValueError:  # rows of several lengths
        return None
    return array.astype(np.float64) if array.dtype.kind in "fiu" else None


def _describe(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.shape} {value.dtype}"
    return type(value).__name__
