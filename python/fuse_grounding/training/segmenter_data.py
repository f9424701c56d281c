"""Training pictures of the segmenter: rendered shards, augmentation, targets. NumPy and OpenCV only.

A shard is a folder `shard_00012/` with `rgb.npy` (N, H, W, 3) uint8, `ids.npy` (N, H, W) uint8 (0: room
and table) and `objects.json`: for each picture its seed and its objects (id, category, pixels).
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from fuse_grounding.errors import FuseError, InputError

SHARD = 64
# (rgb, ids, objects) of one picture; an object is {"id", "category", "visible_px", "unoccluded_px"}.
Picture = tuple[np.ndarray, np.ndarray, list[dict]]


def write_shards(
    folder: Path,
    pictures: int,
    render: Callable[[int, int], list[Picture]],
    base_seed: int,
    progress: Callable[[int], None],
) -> None:
    """Renders what is missing of `pictures` in shards of 64; `render(seed, count)` makes `count` pictures.

    Shard `i` has the seed `base_seed + i`, whatever was there before: an interrupted run resumes and ends
    with the same bits. Raises FuseError when the disk refuses.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for index in range((pictures + SHARD - 1) // SHARD):
        final = folder / f"shard_{index:05d}"
        if not final.exists():
            batch = render(base_seed + index, SHARD)
            part = folder / f".part_{index:05d}_{os.getpid()}"
            header = {"seed": base_seed + index, "pictures": [p[2] for p in batch]}
            try:
                part.mkdir()
                np.save(part / "rgb.npy", np.stack([p[0] for p in batch]))
                np.save(part / "ids.npy", np.stack([p[1] for p in batch]).astype(np.uint8))
                (part / "objects.json").write_text(json.dumps(header))
            except OSError as error:
                shutil.rmtree(part, ignore_errors=True)
                raise FuseError(f"{part} cannot be written: {error.strerror or error}") from None
            try:
                part.rename(final)
            except OSError:
                # Another process was first; both made the same bits.
                shutil.rmtree(part)
        progress((index + 1) * SHARD)


class Shards:
    """The first `count` pictures of a rendered folder, mapped into memory; whole shards."""

    def __init__(self, folder: Path, labels: tuple[str, ...], count: int) -> None:
        self.folder, self.labels = folder, labels
        self._shards: list[tuple[np.ndarray, np.ndarray, list[list[dict]]]] = []
        for path in sorted(folder.glob("shard_*"))[: (count + SHARD - 1) // SHARD]:
            try:
                rgb = np.load(path / "rgb.npy", mmap_mode="r")
                ids = np.load(path / "ids.npy", mmap_mode="r")
                pictures = json.loads((path / "objects.json").read_text())["pictures"]
            except (OSError, ValueError, KeyError) as e:
                raise InputError(f"{path} is not a sound shard: {e}") from e
            self._shards.append((rgb, ids, pictures))
        if not self._shards:
            raise InputError(f"{folder} holds no rendered shards (shard_*/rgb.npy)")

    def __len__(self) -> int:
        return sum(len(s[2]) for s in self._shards)

    def __getitem__(self, index: int) -> Picture:
        for rgb, ids, pictures in self._shards:
            if index < len(pictures):
                return rgb[index], ids[index], pictures[index]
            index -= len(pictures)
        raise IndexError(index)

    def category_of_id(self, objects: list[dict]) -> np.ndarray:
        """(256,) int64: index of the category of each id, `len(labels)` for the background."""
        table = np.full(256, len(self.labels), np.int64)
        for o in objects:
            table[o["id"]] = self.labels.index(o["category"])
        return table


@dataclass
class Sample:
    """One augmented crop with everything that the losses need. Sizes of a crop of (h, w)."""

    image: np.ndarray  # (h, w, 3) uint8
    heat: np.ndarray  # (h/8, w/8) float32, 1 at the middle of an instance
    heat_weight: np.ndarray  # (h/8, w/8) float32, 0 where an instance is ignored
    cells: np.ndarray  # (n, 2) int64, column and row of each instance's cell
    kept: np.ndarray  # (n,) int64, positions of these instances in `mask4` and `category`
    mask4: np.ndarray  # (m, h/4, w/4) bool, every instance, sampled where `Exported` samples
    category: np.ndarray  # (m,) int64
    points: np.ndarray  # (p,) int64, flat positions at stride 2
    point_weight: np.ndarray  # (p,) float32, one over the chance of having been drawn
    point_mask: np.ndarray  # (n, p) float32, share of the pixel that the instance covers
    dense: np.ndarray  # (h/8, w/8) int64, category of each cell
    dense_weight: np.ndarray  # (h/8, w/8) float32


def augment(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Light, colour, blur, noise and compression of another camera. (h, w, 3) uint8 → the same."""
    x = image.astype(np.float32)
    if rng.random() < 0.8:
        x = 255.0 * (x / 255.0) ** np.float32(np.exp(rng.uniform(-0.45, 0.45)))
    if rng.random() < 0.8:
        gain = np.exp(rng.uniform(-0.12, 0.12, 3) + rng.uniform(-0.25, 0.25)).astype(np.float32)
        x = (x - 128.0) * np.float32(rng.uniform(0.7, 1.25)) + 128.0
        x *= gain
    if rng.random() < 0.5:
        gray = x @ np.array([0.299, 0.587, 0.114], np.float32)
        x = gray[..., None] + (x - gray[..., None]) * np.float32(rng.uniform(0.4, 1.5))
    if rng.random() < 0.25:
        hsv = cv2.cvtColor(np.clip(x, 0, 255).astype(np.uint8), cv2.COLOR_RGB2HSV)
        hsv[..., 0] = (hsv[..., 0].astype(np.int32) + int(rng.integers(-12, 13))) % 180
        x = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB).astype(np.float32)
    if rng.random() < 0.3:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.3, 1.3)).astype(np.float32, copy=False)
    if rng.random() < 0.4:
        x += rng.standard_normal(x.shape, np.float32) * np.float32(rng.uniform(1.0, 9.0))
    out = np.clip(x, 0, 255).astype(np.uint8)
    if rng.random() < 0.2:
        _, code = cv2.imencode(".jpg", out, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(35, 90))])
        out = np.asarray(cv2.imdecode(code, cv2.IMREAD_COLOR), np.uint8)
    return out


def _window(ids: np.ndarray, size: tuple[int, int], rng: np.random.Generator) -> tuple[int, int, int, int]:
    """A random crop (x, y, w, h) of the aspect of `size`, more often around something."""
    height, width = ids.shape
    full = min(width / size[0], height / size[1])
    # Now and then the whole picture; mostly about as large as the network sees things at run time.
    zoom = full * np.exp(rng.uniform(np.log(0.48), np.log(0.9))) if rng.random() < 0.92 else full
    w, h = int(size[0] * zoom), int(size[1] * zoom)
    present = np.unique(ids[::8, ::8])
    present = present[present > 0]
    if len(present) and rng.random() < 0.9:
        ys, xs = np.nonzero(ids[::4, ::4] == rng.choice(present))
        cx, cy = 4 * xs.mean() if len(xs) else width / 2, 4 * ys.mean() if len(ys) else height / 2
        cx, cy = cx + rng.uniform(-0.35, 0.35) * w, cy + rng.uniform(-0.35, 0.35) * h
    else:
        cx, cy = rng.uniform(0, width), rng.uniform(0, height)
    return int(np.clip(cx - w / 2, 0, width - w)), int(np.clip(cy - h / 2, 0, height - h)), w, h


def make_sample(
    picture: Picture, table: np.ndarray, size: tuple[int, int], rng: np.random.Generator
) -> Sample:
    """A random augmented crop of `size` (width, height), multiples of 32, and its targets."""
    rgb, full_ids, _ = picture
    x, y, w, h = _window(full_ids, size, rng)
    whole = np.bincount(full_ids.reshape(-1), minlength=256)
    ids = cv2.resize(full_ids[y : y + h, x : x + w], size, interpolation=cv2.INTER_NEAREST)
    crop = np.ascontiguousarray(rgb[y : y + h, x : x + w])
    image = cv2.resize(crop, size, interpolation=cv2.INTER_AREA if w > size[0] else cv2.INTER_LINEAR)
    if rng.random() < 0.5:
        image, ids = np.ascontiguousarray(image[:, ::-1]), np.ascontiguousarray(ids[:, ::-1])
    image = augment(image, rng)
    share = np.bincount(full_ids[y : y + h, x : x + w].reshape(-1), minlength=256) / np.maximum(whole, 1)
    return _targets(image, ids, share, table, rng)


def _targets(
    image: np.ndarray, ids: np.ndarray, share: np.ndarray, table: np.ndarray, rng: np.random.Generator
) -> Sample:
    height, width = ids.shape
    rows, columns = height // 8, width // 8
    heat = np.zeros((rows, columns), np.float32)
    heat_weight = np.ones((rows, columns), np.float32)
    area = np.bincount(ids.reshape(-1), minlength=256)
    everything = [int(i) for i in np.nonzero(area)[0] if i > 0]
    cells: list[tuple[int, int]] = []
    kept: list[int] = []
    grid_y, grid_x = np.mgrid[0:rows, 0:columns].astype(np.float32)
    for position, i in enumerate(everything):
        ys, xs = np.nonzero(ids == i)
        if len(kept) >= 20 or area[i] < 40 or (share[i] < 0.35 and area[i] < 1500):
            heat_weight[ys // 8, xs // 8] = 0.0
            continue
        middle = np.argmin((xs - xs.mean()) ** 2 + (ys - ys.mean()) ** 2)
        column, row = int(xs[middle]) // 8, int(ys[middle]) // 8
        sigma = float(np.clip(np.sqrt(area[i]) / 48.0, 0.55, 1.6))
        bump = np.exp(-((grid_x - column) ** 2 + (grid_y - row) ** 2) / (2 * sigma**2))
        heat = np.maximum(heat, bump)
        heat[row, column] = 1.0
        if rng.random() < 0.4:
            # The peak found at run time may be a cell off.
            column = int(np.clip(column + rng.integers(-1, 2), 0, columns - 1))
            row = int(np.clip(row + rng.integers(-1, 2), 0, rows - 1))
        cells.append((column, row))
        kept.append(position)
    heat_weight[heat == 1.0] = 1.0
    points, weight = _draw_points(ids, area, rng)
    blocks = ids.reshape(height // 2, 2, width // 2, 2).transpose(0, 2, 1, 3).reshape(-1, 4)[points]
    kept_ids = np.array([everything[k] for k in kept], np.uint8)
    # Where `Exported` looks: every second pixel of stride 2.
    coarse = ids[1::4, 1::4]
    dense_ids = ids[int(rng.integers(8)) :: 8, int(rng.integers(8)) :: 8][:rows, :columns]
    dense_weight = 1.0 / np.sqrt(area[dense_ids] / 64.0 + 1.0)
    dense_weight[dense_ids == 0] = 0.05
    return Sample(
        image=image,
        heat=heat.astype(np.float32),
        heat_weight=heat_weight,
        cells=np.array(cells, np.int64).reshape(-1, 2),
        kept=np.array(kept, np.int64),
        mask4=coarse[None] == np.array(everything, np.uint8)[:, None, None],
        category=table[np.array(everything, np.int64)],
        points=points,
        point_weight=weight,
        point_mask=(blocks[None] == kept_ids[:, None, None]).mean(2, dtype=np.float32),
        dense=table[dense_ids],
        dense_weight=dense_weight.astype(np.float32),
    )


def _draw_points(
    ids: np.ndarray, area: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of stride 2 at which mask losses are taken: up to 300 of an instance, edges, some background."""
    half = ids[1::2, 1::2]
    chance = np.minimum(1.0, 300.0 / np.maximum(area / 4.0, 1.0))
    chance[0] = 0.06
    p = chance[half]
    low, high = cv2.erode(half, np.ones((5, 5), np.uint8)), cv2.dilate(half, np.ones((5, 5), np.uint8))
    p = np.where(low != high, np.maximum(p, 0.45), p).reshape(-1)
    points = np.nonzero(rng.random(len(p)) < p)[0]
    return points, (1.0 / p[points]).astype(np.float32)
