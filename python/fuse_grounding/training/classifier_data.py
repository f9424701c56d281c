"""Training crops of the classifier, from the segmenter's pictures: masks as a network would draw them,
frames that are a little off, other cameras. NumPy and OpenCV only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from fuse_grounding.perception import crops
from fuse_grounding.training.segmenter_data import Picture, augment

SMALLEST_PX = 120
# Share of the crops that hold none of the categories.
NONE_SHARE = 0.12


@dataclass
class Crop:
    """One crop with its truth."""

    image: np.ndarray  # (96, 128, 4) uint8
    geometry: np.ndarray  # (GEOMETRY,) float32
    category: int  # number of categories: none of them


def training_crops(picture: Picture, table: np.ndarray, rng: np.random.Generator, most: int) -> list[Crop]:
    """Up to `most` crops of one picture. `table` (256,): category of each id."""
    rgb, ids, _ = picture
    area = np.bincount(ids.reshape(-1), minlength=256)
    present = [int(i) for i in np.nonzero(area >= SMALLEST_PX)[0] if i > 0]
    chosen: np.ndarray | list[int] = rng.permutation(present)[:most] if present else []
    found = []
    for i in chosen:
        mask, category = ids == i, int(table[i])
        if rng.random() < NONE_SHARE:
            mask = _wrong(mask, ids, rng)
            category = int(table[0])
        mask = _redrawn(mask, rng)
        if np.count_nonzero(mask) < SMALLEST_PX // 2:
            continue
        frame = _shaken(crops.frame_of(mask), rng)
        image = crops.crop(rgb, mask, frame)
        image[..., :3] = augment(np.ascontiguousarray(image[..., :3]), rng)
        if rng.random() < 0.5:
            # Mirrored across the long axis: the heavy end stays where it is.
            image = np.ascontiguousarray(image[::-1] if frame.angle else image[:, ::-1])
        found.append(Crop(image, frame.geometry, category))
    return found


def _wrong(mask: np.ndarray, ids: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A mask that is no object's: this one's shape somewhere else, or two objects at once."""
    others = [int(i) for i in np.unique(ids[::4, ::4]) if i > 0]
    if others and rng.random() < 0.35:
        other = ids == rng.choice(others)
        if np.count_nonzero(other & ~mask) > 0.6 * np.count_nonzero(mask):
            return mask | other
    rows, columns = np.nonzero(mask)
    height, width = mask.shape
    shift = np.array(
        [rng.integers(-rows.min(), height - rows.max()), rng.integers(-columns.min(), width - columns.max())]
    )
    moved = np.zeros_like(mask)
    moved[rows + shift[0], columns + shift[1]] = True
    # Where it still lies mostly on one object it would be right.
    hit = np.bincount(ids[moved], minlength=256)[1:].max(initial=0)
    return moved if hit < 0.3 * len(rows) else moved & (ids == 0)


def _redrawn(mask: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The mask as seen through a network: smoother, its edge a little in or out, now and then a bite."""
    if rng.random() < 0.3:
        return mask
    soft: np.ndarray = mask.astype(np.float32)
    sigma = float(rng.uniform(0.6, 2.2))
    soft = cv2.GaussianBlur(soft, (0, 0), sigma)
    level = float(np.clip(rng.normal(0.45, 0.1), 0.2, 0.75))
    if rng.random() < 0.35:
        noise = cv2.resize(
            rng.standard_normal((15, 20), np.float32), mask.shape[::-1], interpolation=cv2.INTER_CUBIC
        )
        soft = soft - 0.15 * noise * (soft > 0.02)
    found = soft > level
    return found if found.any() else mask


def _shaken(frame: crops.Frame, rng: np.random.Generator) -> crops.Frame:
    off = rng.normal(0, 3.0, 2) / frame.scale
    angle = frame.angle + float(rng.normal(0, 0.09))
    if frame.angle and rng.random() < 0.12:
        angle += np.pi
    return replace(
        frame,
        center=(frame.center[0] + off[0], frame.center[1] + off[1]),
        angle=angle,
        scale=frame.scale * float(np.exp(rng.normal(0, 0.09))),
        geometry=(frame.geometry + rng.normal(0, 0.06, crops.GEOMETRY)).astype(np.float32),
    )
