"""A world frame for photos that were taken around a table: z up, the scene's middle, a scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.errors import InputError
from fuse_grounding.reconstruction.cameras import focus, up_axis
from fuse_grounding.registration.similarity import Similarity, project_to_rotation

NODE_DEG, PITCH_DEG = 10.0, 15.0
"""What one step along the ring, and one of pitch, means: 36 nodes, pitches 15, 30 and 45 degrees."""
NODES, PITCHES = 36, 3


@dataclass(frozen=True)
class Ring:
    """Where views stand: `azimuth` counter-clockwise seen from above and `tilt` downwards.

    In nodes (10 degrees) and pitch steps (15), (N,) float64 each, not rounded; a tilt of 1 is pitch index 0.
    """

    azimuth: np.ndarray
    tilt: np.ndarray

    def place(self, index: int) -> tuple[int, int]:
        """Nearest node in [0, 36) and pitch index in [0, 3)."""
        node = int(np.rint(self.azimuth[index])) % NODES
        return node, int(np.clip(np.rint(self.tilt[index]) - 1, 0, PITCHES - 1))

    def offsets(self, index: int) -> np.ndarray:
        """(N, 2): from view `index` to every view, the short way round, in nodes and pitch steps."""
        around = (self.azimuth - self.azimuth[index] + NODES / 2) % NODES - NODES / 2
        return np.stack([around, self.tilt - self.tilt[index]], axis=1)


def level(cameras: Sequence[Camera], distance: float = 1.0) -> Similarity:
    """World from the cameras' frame: z up, origin at what they look at, x towards the first camera.

    `distance` is the mean distance from a camera to the origin in the new frame. Up is what the pictures'
    horizontal axes are perpendicular to. Raises InputError for cameras that look in one direction.
    """
    up, middle = up_axis(cameras), focus(cameras)
    arms = np.array([camera.center for camera in cameras]) - middle
    across = arms[0] - (arms[0] @ up) * up
    if np.linalg.norm(across) < 1e-9:
        raise InputError("the first photo looks straight down: there is no direction to count from")
    x = across / np.linalg.norm(across)
    rotation = np.stack([x, np.cross(up, x), up])
    scale = distance / float(np.mean(np.linalg.norm(arms, axis=1)))
    return Similarity(scale, rotation, -scale * rotation @ middle)


def moved(camera: Camera, world: Similarity) -> Camera:
    """The camera in another frame."""
    rotation, translation = world.pose(camera.rotation, camera.translation)
    c = camera
    return Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy, project_to_rotation(rotation), translation)


def turned(camera: Camera, quarter_turns: int) -> Camera:
    """The camera of a picture that was turned clockwise: `np.rot90(picture, -quarter_turns)`."""
    for _ in range(quarter_turns % 4):
        turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        camera = Camera(
            camera.height,
            camera.width,
            camera.fy,
            camera.fx,
            camera.height - camera.cy,
            camera.cx,
            turn @ camera.rotation,
            turn @ camera.translation,
        )
    return camera


def ring(cameras: Sequence[Camera], middle: np.ndarray) -> Ring:
    """Where cameras stand around `middle` (3,), in a frame with z up."""
    arms = np.array([camera.center for camera in cameras]) - middle
    forwards = np.array([camera.rotation[2] for camera in cameras])
    azimuth = np.degrees(np.arctan2(arms[:, 1], arms[:, 0])) / NODE_DEG
    return Ring(azimuth % NODES, np.degrees(np.arcsin(np.clip(-forwards[:, 2], -1, 1))) / PITCH_DEG)
