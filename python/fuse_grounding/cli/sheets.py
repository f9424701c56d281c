"""Pictures for the docs: each scene from six viewpoints, and what the sensor makes of a view."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fuse_grounding.environment import Episode, TabletopEnvironment, make_episode
from fuse_grounding.errors import InputError

VIEWS = tuple((6 * i + 1, 1 + i % 2) for i in range(6))
"""Every sixth node, 30 and 45 degrees down in turn."""
SENSORS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("off", {}),
    ("shot_noise 0.06, read_noise 0.02", {"shot_noise": 0.06, "read_noise": 0.02}),
    ("defocus_px 6, motion_px 8", {"defocus_px": 6.0, "motion_px": 8.0}),
    ("exposure_stops -1.5", {"exposure_stops": -1.5}),
    ("depth: off", {}),
    (
        "depth: a 0.002, b 0.004, edges 0.7",
        {"depth_noise_m": 0.002, "depth_noise_per_m": 0.004, "depth_edge_dropout": 0.7},
    ),
)
"""What the sensor's picture shows: caption and settings of each tile; those of `depth` in grey."""
_DETAIL = (slice(230, 455), slice(170, 470))
"""Rows and columns of the view in `dev_kitchen` that the sensor's picture shows."""
_VERBS = ("serve", "pour", "stir", "fasten", "pound", "wipe")
_TILE = (400, 300)
_LARGEST_BYTES = 250_000


def scene_sheet(scene: str) -> np.ndarray:
    """(600, 1200, 3) uint8: six views of an episode in the scene, node and pitch written into each.

    Raises InputError where no verb has an episode there.
    """
    world = TabletopEnvironment(_episode(scene))
    labels = [f"node {node}, {15 * (pitch + 1)} deg" for node, pitch in VIEWS]
    return _grid([world.render_at(node, pitch).rgb for node, pitch in VIEWS], labels)


def sensor_sheet() -> np.ndarray:
    """(600, 1200, 3) uint8: part of one view through each sensor of `SENSORS`."""
    episode = _episode("dev_kitchen")
    tiles = []
    for label, settings in SENSORS:
        seen = TabletopEnvironment(episode, sensor=settings).render_at(*VIEWS[0])
        assert seen.depth is not None
        tiles.append(_grey(seen.depth[_DETAIL]) if label.startswith("depth") else seen.rgb[_DETAIL])
    return _grid(tiles, [label for label, _ in SENSORS])


def _episode(scene: str) -> Episode:
    """The first that the verbs have in a scene. Raises InputError where none has."""
    last = None
    for seed, verb in enumerate(_VERBS):
        try:
            return make_episode(verb, scene, seed)
        except InputError as error:
            last = error
    raise last or InputError(f"no episode for scene {scene}")


def _grey(depth: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: from the nearest, white, to 2 m; what has no depth is black."""
    near = depth[depth > 0].min()
    shade = np.where(depth > 0, 255 - 215 * np.clip((depth - near) / (2.0 - near), 0, 1), 0)
    return np.repeat(shade.astype(np.uint8)[..., None], 3, axis=2)


def _grid(pictures: list[np.ndarray], labels: list[str]) -> np.ndarray:
    """Six pictures in two rows, each with its label."""
    tiles = []
    for picture, label in zip(pictures, labels, strict=True):
        larger = picture.shape[1] < _TILE[0]
        tile = cv2.resize(picture, _TILE, interpolation=cv2.INTER_NEAREST if larger else cv2.INTER_AREA)
        tile[:26] //= 3  # a dark bar
        cv2.putText(tile, label, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(tile)
    return np.vstack([np.hstack(tiles[:3]), np.hstack(tiles[3:])])


def write_sheet(folder: Path, name: str, sheet: np.ndarray) -> Path:
    """Writes folder/NAME.jpg, of at most 250 kB. Raises InputError."""
    path = folder / f"{name}.jpg"
    for quality in (90, 85, 80, 70, 60):
        done, packed = cv2.imencode(
            ".jpg", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]
        )
        if done and len(packed) <= _LARGEST_BYTES:
            break
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(packed.tobytes())
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror}") from None
    return path
