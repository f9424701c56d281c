"""What a registrar refuses, in words that say what to change."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import InputError


def known_camera(view: Observation, name: str) -> Camera:
    """The view's known camera, or InputError."""
    if view.camera is None:
        raise InputError(f"{name} has no camera: its pose and intrinsics must be known")
    return view.camera


def check_picture(view: Observation, name: str, camera: Camera) -> None:
    """Raises InputError unless `view.rgb` is (height, width, 3) uint8 of `camera`'s size."""
    rgb = view.rgb
    if not isinstance(rgb, np.ndarray) or rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
        found = f"{rgb.dtype} {rgb.shape}" if isinstance(rgb, np.ndarray) else type(rgb).__name__
        raise InputError(f"{name}: rgb must be a uint8 array (height, width, 3), found {found}")
    if rgb.shape[:2] != (camera.height, camera.width):
        raise InputError(
            f"{name}: the picture has {rgb.shape[1]}x{rgb.shape[0]} pixels, "
            f"the intrinsics are for {camera.width}x{camera.height}"
        )


def check_view(view: Observation, name: str, camera: Camera) -> None:
    """Raises InputError for a picture that is not `camera`'s or a known camera of other intrinsics."""
    check_picture(view, name, camera)
    if view.camera is None:
        return
    ours, theirs = _intrinsics(camera), _intrinsics(view.camera)
    if not np.allclose(ours, theirs, rtol=0.0, atol=1e-6):
        raise InputError(
            f"{name}: intrinsics (fx, fy, cx, cy) {theirs} differ from the first view's {ours}; "
            "one registrar serves one camera"
        )


def check_seeds(seeds: Sequence[Observation]) -> Camera:
    """The first seed's camera; InputError unless two or more seeds of one camera stand apart."""
    if len(seeds) < 2:
        raise InputError(f"registration needs two or more seed views, found {len(seeds)}")
    camera = known_camera(seeds[0], "seed 0")
    for index, seed in enumerate(seeds):
        known_camera(seed, f"seed {index}")
        check_view(seed, f"seed {index}", camera)
    centres = np.array([known_camera(seed, "seed").center for seed in seeds])
    if float(np.ptp(centres, axis=0).max()) < 1e-6:
        raise InputError("all seed views stand at one point: without a baseline there is no depth")
    return camera


def _intrinsics(camera: Camera) -> tuple[float, float, float, float]:
    return camera.fx, camera.fy, camera.cx, camera.cy
