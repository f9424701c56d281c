"""A small ray-cast tabletop with exact cameras, independent of FUSE's renderer.

Textured rectangles only: a table top, a floor and four walls, boxes on the table. Textures are smooth seeded
noise whose finest detail is larger than a pixel, so that no filtering is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.environment.protocol import Observation

WIDTH, HEIGHT = 640, 480
FOCAL = WIDTH / (2.0 * np.tan(np.radians(30.0)))
PITCHES = np.radians([15.0, 30.0, 45.0])


@dataclass(frozen=True)
class Face:
    """A rectangle: corner, its two sides as vectors in metres, and a texture (h, w, 3) uint8."""

    corner: np.ndarray
    u: np.ndarray
    v: np.ndarray
    texture: np.ndarray


def noise(rng: np.random.Generator, metres: tuple[float, float], cell: float, contrast: float) -> np.ndarray:
    """Three octaves of smooth colour noise with cells from `cell` metres up, four texels to a cell."""
    rows, columns = (max(2, round(side / cell)) for side in (metres[1], metres[0]))
    size = (columns * 4, rows * 4)
    total = np.zeros((size[1], size[0], 3), np.float32)
    for octave in (1, 2, 4):
        coarse = rng.standard_normal((max(2, rows // octave), max(2, columns // octave), 3), np.float32)
        total += cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    base = rng.uniform(90.0, 160.0, 3).astype(np.float32)
    return np.clip(base + contrast * total, 0.0, 255.0).astype(np.uint8)


def _box(rng: np.random.Generator, low: np.ndarray, size: np.ndarray, angle: float) -> list[Face]:
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = (
        size[0] * np.array([c, s, 0.0]),
        size[1] * np.array([-s, c, 0.0]),
        size[2] * np.array([0, 0, 1.0]),
    )
    sides = [(low, x, z), (low + x, y, z), (low + x + y, -x, z), (low + y, -y, z), (low + z, x, y)]
    return [
        Face(corner, u, v, noise(rng, (float(np.linalg.norm(u)), float(np.linalg.norm(v))), 0.012, 16.0))
        for corner, u, v in sides
    ]


def scene(seed: int = 0, contrast: float = 14.0, boxes: int = 6) -> list[Face]:
    """The faces of a room with a table of 1.2 m and `boxes` boxes on it; `contrast` of all but the boxes."""
    rng = np.random.default_rng(seed)

    def plane(corner: list[float], u: list[float], v: list[float], cell: float) -> Face:
        sides = np.array(u, float), np.array(v, float)
        lengths = float(np.linalg.norm(sides[0])), float(np.linalg.norm(sides[1]))
        return Face(np.array(corner, float), *sides, noise(rng, lengths, cell, contrast))

    faces = [
        plane([-0.6, -0.6, 0.75], [1.2, 0, 0], [0, 1.2, 0], 0.02),
        plane([-2.5, -2.5, 0], [5, 0, 0], [0, 5, 0], 0.08),
        plane([-2.5, -2.5, 0], [5, 0, 0], [0, 0, 3], 0.08),
        plane([-2.5, 2.5, 0], [5, 0, 0], [0, 0, 3], 0.08),
        plane([-2.5, -2.5, 0], [0, 5, 0], [0, 0, 3], 0.08),
        plane([2.5, -2.5, 0], [0, 5, 0], [0, 0, 3], 0.08),
    ]
    for index in range(boxes):
        angle = 2 * np.pi * index / boxes
        spot = np.array([0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.75])
        faces += _box(rng, spot, rng.uniform(0.05, 0.16, 3), rng.uniform(0, np.pi))
    return faces


def camera(
    node: int, pitch_index: int, axes: tuple[float, float] = (0.7, 0.8), height: float = 1.5
) -> Camera:
    """The camera of a ring node, looking at the ellipse's centre and down by the pitch."""
    angle = 2 * np.pi * node / 36
    centre = np.array([axes[0] * np.cos(angle), axes[1] * np.sin(angle), height])
    yaw, pitch = np.arctan2(-centre[1], -centre[0]), PITCHES[pitch_index]
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, rotation, -rotation @ centre)


def render(faces: list[Face], view: Camera) -> np.ndarray:
    """(H, W, 3) uint8: the nearest face along each pixel's ray, bilinearly textured."""
    columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    local = np.stack([(columns - view.cx) / view.fx, (rows - view.cy) / view.fy, np.ones_like(rows)], axis=-1)
    rays = (local @ view.rotation).astype(np.float32)
    nearest = np.full((HEIGHT, WIDTH), np.inf, np.float32)
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    for face in faces:
        normal = np.cross(face.u, face.v)
        offset = face.corner - view.center
        # ray * t = offset + a u + b v, solved per pixel by Cramer's rule.
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.float32(normal @ offset) / (rays @ normal.astype(np.float32))
        hit = rays * t[..., None] - offset.astype(np.float32)
        a = hit @ (face.u / (face.u @ face.u)).astype(np.float32)
        b = hit @ (face.v / (face.v @ face.v)).astype(np.float32)
        inside = (t > 1e-3) & (t < nearest) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
        if not inside.any():
            continue
        height, width = face.texture.shape[:2]
        x, y = (a * width - 0.5).astype(np.float32), (b * height - 0.5).astype(np.float32)
        colour = cv2.remap(face.texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        image[inside] = colour[inside]
        nearest[inside] = t[inside]
    return image


def observe(faces: list[Face], node: int, pitch_index: int) -> Observation:
    """What the environment would hand out, without depth and ids."""
    view = camera(node % 36, pitch_index)
    return Observation(rgb=render(faces, view), camera=view, node=node % 36, pitch_index=pitch_index)


def seeds(faces: list[Face], start: int) -> list[Observation]:
    """The four views around a start node: ±1 and ±2 nodes at the middle pitch."""
    return [observe(faces, start + step, 1) for step in (-2, -1, 1, 2)]
