"""Cameras to render from: written as JSON, taken from a data set, or on an orbit around what it shows."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.errors import InputError
from fuse_grounding.reconstruction.dataset import Dataset

_FULL = ("width", "height", "fx", "fy", "cx", "cy", "rotation", "translation")


def from_json(path: Path) -> list[Camera]:
    """One camera (an object) or a path of them (a list).

    A camera has `width`, `height`, `fx`, `fy`, `cx`, `cy`, and `rotation` (three rows) and `translation`
    from world to camera as in COLMAP. Raises InputError naming file, camera and fault.
    """
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path} is not JSON: {error}") from None
    entries = value if isinstance(value, list) else [value]
    if not entries:
        raise InputError(f"{path}: the list of cameras is empty")
    return [_camera(entry, f"{path}, camera {i}") for i, entry in enumerate(entries)]


def to_json(camera: Camera) -> dict[str, Any]:
    """What `from_json` reads."""
    numbers = {name: getattr(camera, name) for name in _FULL[:6]}
    return {**numbers, "rotation": camera.rotation.tolist(), "translation": camera.translation.tolist()}


def _camera(entry: Any, where: str) -> Camera:
    if not isinstance(entry, dict):
        raise InputError(f"{where}: expected an object with {', '.join(_FULL)}")
    missing = [name for name in _FULL if name not in entry]
    unknown = [name for name in entry if name not in _FULL]
    if missing or unknown:
        fault = f"`{missing[0]}` is missing" if missing else f"unknown key `{unknown[0]}`"
        raise InputError(f"{where}: {fault}; expected {', '.join(_FULL)}")
    try:
        rotation = np.array(entry["rotation"], dtype=np.float64)
        translation = np.array(entry["translation"], dtype=np.float64)
        width, height = (int(entry[name]) for name in ("width", "height"))
        fx, fy, cx, cy = (float(entry[name]) for name in ("fx", "fy", "cx", "cy"))
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise ValueError(f"rotation has shape {rotation.shape}, translation {translation.shape}")
        return Camera(width, height, fx, fy, cx, cy, rotation, translation)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{where}: {error}") from None


def orbit(dataset: Dataset, frames: int) -> list[Camera]:
    """A circle around what the data set's cameras look at, at their mean distance and height.

    The axis is upright where the cameras were held level; the intrinsics are those of the first view.
    """
    if frames < 1:
        raise InputError(f"an orbit needs at least one frame, found {frames}")
    views = [dataset.camera(i) for i in range(len(dataset.names))]
    centers = np.array([v.center for v in views])
    up = up_axis(views)
    try:
        target = focus(views)
    except InputError as error:
        raise InputError(f"{dataset.folder}: {error}; there is nothing to orbit") from None
    arms = centers - target
    height = float(np.mean(arms @ up))
    radius = float(np.mean(np.linalg.norm(arms - np.outer(arms @ up, up), axis=1)))
    first = _unit(arms[0] - (arms[0] @ up) * up)
    side = np.cross(up, first)
    like = views[0]
    angles = 2 * np.pi * np.arange(frames) / frames
    eyes = [target + height * up + radius * (np.cos(a) * first + np.sin(a) * side) for a in angles]
    return [_look_at(eye, target, up, like) for eye in eyes]


def focus(views: Sequence[Camera]) -> np.ndarray:
    """(3,): the point nearest to all optical axes. Raises InputError for parallel ones."""
    centers = np.array([v.center for v in views])
    forwards = np.array([v.rotation[2] for v in views])
    across = np.eye(3) - forwards[:, :, None] * forwards[:, None, :]
    matrix = across.sum(0)
    if np.linalg.cond(matrix) > 1e6:
        raise InputError("the cameras look in one direction")
    return np.linalg.solve(matrix, np.einsum("nij,nj->i", across, centers))


def up_axis(views: Sequence[Camera]) -> np.ndarray:
    """(3,) of length 1: what is perpendicular to all cameras' right; looking down tilts a camera's own up.

    Raises InputError where the cameras agree on no direction.
    """
    mean = _unit(-np.mean([v.rotation[1] for v in views], axis=0))
    rights = np.array([v.rotation[0] for v in views])
    values, vectors = np.linalg.eigh(rights.T @ rights / len(views))
    if values[1] < 0.02:
        return mean  # all look in one direction, which says nothing about the axis
    return vectors[:, 0] * (1.0 if vectors[:, 0] @ mean > 0 else -1.0)


def _unit(vector: np.ndarray) -> np.ndarray:
    length = float(np.linalg.norm(vector))
    if length < 1e-9:
        raise InputError("the cameras have no common up direction; there is no axis to orbit about")
    return vector / length


def _look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray, like: Camera) -> Camera:
    forward = _unit(target - eye)
    right = _unit(np.cross(forward, up))
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera(like.width, like.height, like.fx, like.fy, like.cx, like.cy, rotation, -rotation @ eye)
