"""Pictures of the scenes: each with an episode on its table, from six viewpoints around it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from fuse_grounding.environment import TabletopEnvironment, make_episode
from fuse_grounding.errors import InputError

VIEWS = tuple((6 * i + 1, 1 + i % 2) for i in range(6))
"""Every sixth node, 30 and 45 degrees down in turn."""
_VERBS = ("serve", "pour", "stir", "fasten", "pound", "wipe")
_TILE = (400, 300)
_LARGEST_BYTES = 250_000


def scene_sheet(scene: str) -> np.ndarray:
    """(600, 1200, 3) uint8: six views of an episode in the scene, node and pitch written into each.

    Raises InputError where no verb has an episode there.
    """
    episode, last = None, None
    for seed, verb in enumerate(_VERBS):
        try:
            episode = make_episode(verb, scene, seed)
            break
        except InputError as error:
            last = error
    if episode is None:
        raise last or InputError(f"no episode for scene {scene}")
    world = TabletopEnvironment(episode)
    tiles = []
    for node, pitch in VIEWS:
        tile = cv2.resize(world.render_at(node, pitch).rgb, _TILE, interpolation=cv2.INTER_AREA)
        label = f"node {node}, {15 * (pitch + 1)} deg"
        cv2.putText(tile, label, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.putText(tile, label, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(tile)
    return np.vstack([np.hstack(tiles[:3]), np.hstack(tiles[3:])])


def write_sheet(folder: Path, scene: str, sheet: np.ndarray) -> Path:
    """Writes folder/SCENE.jpg, of at most 250 kB. Raises InputError."""
    path = folder / f"{scene}.jpg"
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
