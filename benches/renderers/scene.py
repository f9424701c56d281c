"""The scene that all renderers draw, as files: GLB models and `scene.json` with places, cameras and the lamp.

The room and the table are those of a shipped scene without what stands along its walls. Their shapes are few
and are made here once more; their pictures are photographed off our own walls, floor and table top in even
light. The objects are twelve of the shipped ones, each triangle split in four, which changes no shape.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from renderers.glb import Part, read, split, write

WIDTH, HEIGHT = 640, 480
NAME = "train_workshop"
PITCH = 1
"""Index of the ring's pitch, 30° downwards."""
OBJECTS = (
    "pitcher_train_2",
    "hammer_train_0",
    "flashlight_train_0",
    "teapot_train_0",
    "mug_train_0",
    "measuring_cup_train_0",
    "book_train_0",
    "sponge_train_0",
    "plate_train_0",
    "tape_dispenser_train_0",
    "water_bottle_train_0",
    "scissors_train_0",
)
GRID = (4, 3)
SPACING = (0.19, 0.2)
"""Metres between middles of objects."""
EVEN = 0.7
"""Ambient radiance for photographing textures, below the tone curve's shoulder."""


@dataclass(frozen=True)
class View:
    """A pinhole camera: `intrinsics` (fx, fy, cx, cy) pixels, `rotation` (3, 3) and `translation` (3,) take
    the world into the camera, x right, y down, z forward."""

    width: int
    height: int
    intrinsics: tuple[float, float, float, float]
    rotation: np.ndarray
    translation: np.ndarray

    @property
    def center(self) -> np.ndarray:
        """(3,) where the camera is, metres."""
        return -self.rotation.T @ self.translation


@dataclass(frozen=True)
class Scene:
    """What `make` wrote: `instances` are (file, (4, 4) world from model, id)."""

    folder: Path
    instances: list[tuple[str, np.ndarray, int]]
    views: list[View]
    lamp: np.ndarray
    triangles: int

    @classmethod
    def load(cls, folder: Path) -> Scene:
        """From `scene.json`."""
        data = json.loads((folder / "scene.json").read_text())
        instances = [(i["file"], np.array(i["transform"]), i["id"]) for i in data["instances"]]
        views = [
            View(v["width"], v["height"], tuple(v["intrinsics"]), np.array(v["rotation"]), np.array(v["at"]))
            for v in data["views"]
        ]
        return cls(folder, instances, views, np.array(data["lamp"]), data["triangles"])

    def parts(self) -> list[tuple[Part, np.ndarray, int]]:
        """Every part with its place and id."""
        return [(part, m, id) for file, m, id in self.instances for part in read(self.folder / file)]


def episode(places: list[tuple[str, list[float], float]]) -> str:
    """An episode with these objects: (id, position, angle about z). Where it starts does not matter."""
    objects = [
        {
            "instance_id": i,
            "model_id": name,
            "category": name.rsplit("_", 2)[0],
            "translation": at,
            "rotation": {"w": math.cos(angle / 2), "x": 0.0, "y": 0.0, "z": math.sin(angle / 2)},
        }
        for i, (name, at, angle) in enumerate(places, 1)
    ]
    ids = [o["instance_id"] for o in objects]
    return json.dumps(
        {
            "schema_version": 2,
            "episode_id": "renderers",
            "scene_id": NAME,
            "split": "train",
            "seed": 0,
            "query": "cut",
            "verb": "cut",
            "target": 1,
            "objects": objects,
            "valid_target_ids": [1],
            "distractor_ids": ids[1:],
            "candidate_sets": {"oracle": [objects[0]["category"]]},
            "start_node": 0,
            "start_pitch": 1,
            "start_px": 500,
            "start_fraction": 0.5,
            "best_node": 1,
            "best_pitch": 1,
            "best_px": 1000,
            "best_fraction": 1.0,
            "moves_to_good_view": 1,
        }
    )


def make(
    folder: Path, width: int, height: int, views: int, splits: int = 1, texels: int | None = None
) -> None:
    """Writes models, `scene.json`, and what our own world is made of: `stage/`, `scenes.json` and
    `episode.json`. `texels` makes all pictures of the room smaller."""
    from fuse_grounding._core import Stage, World
    from fuse_grounding.environment.episodes import DATA
    from renderers import room

    stage = folder / "stage"
    stage.mkdir(parents=True, exist_ok=True)
    catalogue = json.loads((DATA / "objects" / "catalogue.json").read_text())
    catalogue["objects"] = [o for o in catalogue["objects"] if o["id"] in OBJECTS]
    (stage / "catalogue.json").write_text(json.dumps(catalogue))
    triangles, places = 0, []
    scenes = json.loads((DATA / "scenes.json").read_text())
    scenes["scenes"] = [s for s in scenes["scenes"] if s["name"] == NAME]
    shape = scenes["scenes"][0]
    shape["room"]["decor_density"] = 0.0
    if texels is not None:
        for place in (shape["room"], shape["table"]):
            for surface in place.values():
                if isinstance(surface, dict):
                    surface["texels"] = texels
    (folder / "scenes.json").write_text(json.dumps(scenes))
    for i, name in enumerate(OBJECTS):
        parts = read(DATA / "objects" / f"{name}.glb")
        for _ in range(splits):
            parts = [split(p) for p in parts]
        write(stage / f"{name}.glb", parts)
        triangles += sum(len(p.triangles) for p in parts)
        points = np.concatenate([p.positions for p in parts])
        low, high = points.min(0), points.max(0)
        angle = 0.7 * i
        c, s = math.cos(angle), math.sin(angle)
        middle = np.array([[c, -s], [s, c]]) @ ((low + high) / 2)[:2]
        column, row = i % GRID[0], i // GRID[0]
        x = (column - (GRID[0] - 1) / 2) * SPACING[0] - middle[0]
        y = (row - (GRID[1] - 1) / 2) * SPACING[1] - middle[1]
        places.append((name, [float(x), float(y), float(shape["table"]["height_m"] - low[2])], angle))
    text = episode(places)
    (folder / "episode.json").write_text(text)
    world = World(text, Stage(stage, folder / "scenes.json"))
    parts = room.parts(shape, room.photograph(folder, scenes, places))
    write(folder / "room.glb", parts)
    triangles += sum(len(p.triangles) for p in parts)
    instances: list[dict[str, Any]] = [{"file": "room.glb", "transform": np.eye(4).tolist(), "id": 0}]
    for i, (name, at, angle) in enumerate(places, 1):
        matrix = np.eye(4)
        c, s = math.cos(angle), math.sin(angle)
        matrix[:2, :2], matrix[:3, 3] = [[c, -s], [s, c]], at
        instances.append({"file": f"stage/{name}.glb", "transform": matrix.tolist(), "id": i})
    cameras = [world.camera(round(i * 36 / views), PITCH).resized(width, height) for i in range(views)]
    data = {
        "instances": instances,
        "triangles": triangles,
        "lamp": shape["light"]["position_m"],
        "views": [
            {
                "width": c.width,
                "height": c.height,
                "intrinsics": [c.fx, c.fy, c.cx, c.cy],
                "rotation": c.rotation.tolist(),
                "at": c.translation.tolist(),
            }
            for c in cameras
        ],
    }
    (folder / "scene.json").write_text(json.dumps(data))
