"""The shell of a shipped room and its table, as our own world draws them without decor."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np

from renderers.glb import Part

DISTANCE = 0.3
"""Metres between a surface and the camera that photographs it; any does, for a plane that faces it."""


def photograph(folder: Path, scenes: dict[str, Any], places: list[Any]) -> dict[str, np.ndarray]:
    """Pictures of floor, walls (`wall0` to `wall3`), table top and table frame, in the sizes of our textures.

    Even light without a lamp gives back the base colour; the objects wait below the floor.
    """
    from fuse_grounding._core import Camera, Stage, World
    from renderers.scene import EVEN, episode

    shape = scenes["scenes"][0]
    size, table = np.array(shape["room"]["size_m"]), shape["table"]

    def world(center: tuple[float, float]) -> Any:
        even = copy.deepcopy(scenes)
        light = even["scenes"][0]["light"]
        light |= {
            "intensity": [0.0] * 3,
            "sky": [EVEN] * 3,
            "ground": [EVEN] * 3,
            "glows": [],
            "exposure": 1.0,
        }
        even["scenes"][0]["table"]["center_m"] = list(center)
        (folder / "even.json").write_text(json.dumps(even))
        hidden = [(name, [0.0, 0.0, -2.0], 0.0) for name, _, _ in places]
        return World(episode(hidden), Stage(folder / "stage", folder / "even.json"))

    def take(
        world: Any,
        middle: np.ndarray,
        right: Any,
        down: Any,
        extent: tuple[float, float],
        texels: int,
        away: float = DISTANCE,
    ) -> np.ndarray:
        # Wide surfaces have fewer texels across, as ours have.
        w, h = (max(int(texels * e / max(extent)), 16) for e in extent)
        rotation = np.array([right, down, np.cross(right, down)], float)
        center = middle - away * rotation[2]
        camera = Camera(
            w, h, w * away / extent[0], h * away / extent[1], w / 2, h / 2, rotation, -rotation @ center
        )
        rgb = world.render_camera(camera)[0]
        linear = np.where(rgb <= 10, rgb / (255 * 12.92), ((rgb / 255 + 0.055) / 1.055) ** 2.4) / EVEN
        encoded = np.where(
            linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
        )
        return np.clip(np.rint(encoded * 255), 0, 255).astype(np.uint8)

    # The table stands in one corner, then in the other: what it hides in one picture is in the other.
    reach = (size[:2] - np.array(table["size_m"])) / 2 - 0.01
    corners = [world(tuple(s * reach)) for s in (-1.0, 1.0)]
    floors = [
        take(
            w, np.zeros(3), (1, 0, 0), (0, -1, 0), (size[0], size[1]), shape["room"]["floor"]["texels"], 12.0
        )
        for w in corners
    ]
    half = floors[0].shape[1] // 2
    made = {"floor": np.concatenate([floors[1][:, :half], floors[0][:, half:]], axis=1)}
    laid = world((0.0, 0.0))
    texels = shape["room"]["wall"]["texels"]
    for i, (inward, across, length) in enumerate(walls(size)):
        right = np.cross((0, 0, 1), inward)
        middle = -inward * across / 2 + np.array([0, 0, size[2] / 2])
        made[f"wall{i}"] = take(laid, middle, right, (0, 0, -1), (length, size[2]), texels)
    width, depth = table["size_m"]
    top = np.array([0, 0, table["height_m"]])
    made["top"] = take(laid, top, (1, 0, 0), (0, -1, 0), (width, depth), table["top"]["texels"])
    edge = top + np.array([0, -depth / 2, -0.015])
    made["frame"] = take(laid, edge, (1, 0, 0), (0, 0, -1), (width, 0.028), 512)
    return made


def walls(size: np.ndarray) -> list[tuple[np.ndarray, float, float]]:
    """Inward direction, distance between this wall and the one across, and length of each wall."""
    x, y = float(size[0]), float(size[1])
    inward = np.array([(-1, 0, 0), (0, -1, 0), (1, 0, 0), (0, 1, 0)], float)
    return list(zip(inward, (x, y, x, y), (y, x, y, x), strict=True))


def quad(corners: Any, texture: np.ndarray, repeat: tuple[float, float] = (1.0, 1.0), **more: Any) -> Part:
    """A rectangle, corners counter-clockwise from the lower left one."""
    p = np.array(corners, np.float32)
    normal = np.cross(p[1] - p[0], p[3] - p[0])
    normal /= np.linalg.norm(normal)
    u, v = repeat
    uvs = np.array([[0, v], [u, v], [u, 0], [0, 0]], np.float32)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    return Part(p, np.tile(normal, (4, 1)).astype(np.float32), uvs, triangles, texture=texture, **more)


def merged(parts: list[Part]) -> Part:
    """Parts of one texture as one."""
    counts = np.cumsum([0, *(len(p.positions) for p in parts)])
    return Part(
        np.concatenate([p.positions for p in parts]),
        np.concatenate([p.normals for p in parts]),
        np.concatenate([p.uvs for p in parts]),
        np.concatenate([p.triangles + n for p, n in zip(parts, counts[:-1], strict=True)]).astype(np.uint32),
        texture=parts[0].texture,
        roughness=parts[0].roughness,
    )


def cuboid(low: Any, high: Any, texture: np.ndarray, **more: Any) -> list[Part]:
    """The six faces of a box, the texture once along each."""
    faces = [
        [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],
        [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
        [(1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1)],
        [(0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1)],
        [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
        [(0, 1, 0), (1, 1, 0), (1, 0, 0), (0, 0, 0)],
    ]
    low, high = np.array(low, float), np.array(high, float)
    return [quad(low + (high - low) * np.array(face), texture, **more) for face in faces]


def parts(shape: dict[str, Any], pictures: dict[str, np.ndarray]) -> list[Part]:
    """Shell, skirting and table with these pictures."""
    size, table = np.array(shape["room"]["size_m"]), shape["table"]
    x, y, z = size / (2, 2, 1)
    rough = {key: shape["room"][key]["roughness"] for key in ("floor", "wall")}
    floor = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]
    made = [quad(floor, pictures["floor"], roughness=rough["floor"])]
    for i, (inward, across, length) in enumerate(walls(size)):
        right = np.cross((0, 0, 1), inward)
        foot, side, up = -inward * across / 2, right * length / 2, np.array([0, 0, z])
        picture = pictures[f"wall{i}"]
        corners = [foot - side, foot + side, foot + side + up, foot - side + up]
        made.append(quad(corners, picture, roughness=rough["wall"]))
        board = picture[-int(0.08 / z * len(picture)) :]
        ends = (foot - side, foot + side + inward * 0.015 + np.array([0, 0, 0.09]))
        made.append(merged(cuboid(np.minimum(*ends), np.maximum(*ends), np.ascontiguousarray(board))))
    return made + table_parts(table, pictures)


def table_parts(table: dict[str, Any], pictures: dict[str, np.ndarray]) -> list[Part]:
    """Top, edge, legs and apron of a rectangular table."""
    (w, d), h = np.array(table["size_m"]) / 2, table["height_m"]
    cx, cy = table["center_m"]
    made = [
        quad(
            [(cx - w, cy - d, h), (cx + w, cy - d, h), (cx + w, cy + d, h), (cx - w, cy + d, h)],
            pictures["top"],
            roughness=table["top"]["roughness"],
        )
    ]
    wood, under = pictures["frame"], h - 0.03
    outline = [(cx - w, cy - d), (cx + w, cy - d), (cx + w, cy + d), (cx - w, cy + d)]
    frame = [
        quad([(*a, under), (*b, under), (*b, h), (*a, h)], wood)
        for a, b in zip(outline, outline[1:] + outline[:1], strict=True)
    ]
    fx, fy = 0.88 * w, 0.88 * d
    for sx in (-1, 1):
        for sy in (-1, 1):
            at = np.array([cx + sx * fx, cy + sy * fy, 0])
            frame += cuboid(at - (0.03, 0.03, 0), at + np.array([0.03, 0.03, under]), wood)
    for side in (-1, 1):
        low = np.array([cx - fx, cy + side * fy - 0.012, under - 0.08])
        frame += cuboid(low, low + np.array([2 * fx, 0.024, 0.08]), wood)
        low = np.array([cx + side * fx - 0.012, cy - fy, under - 0.08])
        frame += cuboid(low, low + np.array([0.024, 2 * fy, 0.08]), wood)
    return [*made, merged(frame)]
