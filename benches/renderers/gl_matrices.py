"""Matrices of OpenGL's conventions: a camera with x right, y up, looking along -z."""

from __future__ import annotations

import numpy as np

from renderers.scene import View

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def gl_camera(view: View) -> np.ndarray:
    """(4, 4) OpenGL's camera from world."""
    camera = np.eye(4)
    camera[:3, :3], camera[:3, 3] = view.rotation, view.translation
    return FLIP @ camera


def clip_from_camera(view: View, near: float, far: float) -> np.ndarray:
    """(4, 4) clip from OpenGL's camera."""
    fx, fy, cx, cy = view.intrinsics
    w, h = view.width, view.height
    return np.array(
        [
            [2 * fx / w, 0, 1 - 2 * cx / w, 0],
            [0, 2 * fy / h, 2 * cy / h - 1, 0],
            [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)],
            [0, 0, -1, 0],
        ]
    )
