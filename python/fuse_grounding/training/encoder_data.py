"""Training pictures of the encoder: whole scenes, windows and crops of objects, with what is where in them.

Pictures come from two folders of shards (`segmenter_data`): randomised ones, and views of the training
scenes. NumPy and OpenCV only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fuse_grounding.environment import TabletopEnvironment, load_episodes
from fuse_grounding.perception.embedded_encoder import STRIDE, letterbox
from fuse_grounding.training.segmenter_data import SHARD, Picture, Shards, augment

CELLS = (4, 3)
"""Columns and rows that the layout is told in."""
VIEWS = 32
"""Pictures of one laid table in a shard."""
WHOLE, WINDOW = 0.35, 0.2
"""Shares of whole pictures and of random windows; the rest are crops of one object."""
LEAST_PIXELS = 24
"""Pixels of the network's input that a thing must have to count as in the picture."""
IGNORED = -1


@dataclass
class Sample:
    """One picture of the network's input size (w, h) with its truth; labels by index, last is background."""

    image: np.ndarray  # (h, w, 3) uint8
    present: np.ndarray  # (labels,) float32, sums to 1: how much of the picture is about each
    patches: np.ndarray  # (h/16, w/16) int64, label of each patch, `IGNORED` where it is mixed
    cells: np.ndarray  # (12, labels) float32, 1 where the label is in the cell


def scene_pictures(name: str, seed: int, count: int) -> list[Picture]:
    """`count` views of laid tables of the set `name`, chosen by `seed`: pictures, ids, objects."""
    rng, episodes = np.random.default_rng(seed), load_episodes(name)
    pictures: list[Picture] = []
    while len(pictures) < count:
        environment = TabletopEnvironment(episodes[int(rng.integers(len(episodes)))])
        kinds = environment.episode.categories
        for _ in range(min(VIEWS, count - len(pictures))):
            seen = environment.render_at(int(rng.integers(36)), int(rng.integers(3)))
            assert seen.instance is not None
            pixels = np.bincount(seen.instance.reshape(-1), minlength=256)
            objects = [
                {"id": i, "category": c, "visible_px": int(pixels[i]), "unoccluded_px": 0}
                for i, c in kinds.items()
                if pixels[i]
            ]
            pictures.append((seen.rgb, seen.instance, objects))
    return pictures


class Mixture:
    """Pictures of several folders as one sequence."""

    def __init__(self, folders: Sequence[Shards]) -> None:
        self.folders = tuple(folders)
        self._shards = [(f, i) for f in self.folders for i in range(len(f) // SHARD)]

    def __len__(self) -> int:
        return len(self._shards) * SHARD

    def __getitem__(self, index: int) -> tuple[Picture, np.ndarray]:
        """A picture and the label of each of its ids."""
        folder, shard = self._shards[index // SHARD]
        picture = folder[shard * SHARD + index % SHARD]
        return picture, folder.category_of_id(picture[2])


def crop_box(ids: np.ndarray, which: int, margin: float) -> tuple[int, int, int, int]:
    """(x, y, w, h) around an object, its longer side times `margin`, inside the picture."""
    height, width = ids.shape
    rows, columns = np.nonzero((ids == which).any(1))[0], np.nonzero((ids == which).any(0))[0]
    w, h = columns[-1] + 1 - columns[0], rows[-1] + 1 - rows[0]
    side = max(w, h, 32) * margin
    w, h = int(min(max(w * margin, side * 0.75), width)), int(min(max(h * margin, side * 0.75), height))
    x = int(np.clip((columns[0] + columns[-1]) / 2 - w / 2, 0, width - w))
    y = int(np.clip((rows[0] + rows[-1]) / 2 - h / 2, 0, height - h))
    return x, y, w, h


def make_sample(
    picture: Picture, table: np.ndarray, labels: int, size: tuple[int, int], rng: np.random.Generator
) -> Sample:
    """A random augmented view of `size` (width, height), multiples of 96 and 96, with its truth."""
    rgb, ids, objects = picture
    height, width = ids.shape
    draw, about = rng.random(), None
    box = (0, 0, width, height)
    visible = [o["id"] for o in objects if o["visible_px"] >= 150]
    if draw >= WHOLE + WINDOW and visible:
        about = int(rng.choice(visible))
        x, y, w, h = crop_box(ids, about, float(rng.uniform(1.05, 2.2)))
        dx, dy = rng.uniform(-0.12, 0.12, 2) * (w, h)
        box = (int(np.clip(x + dx, 0, width - w)), int(np.clip(y + dy, 0, height - h)), w, h)
    elif draw >= WHOLE:
        zoom = rng.uniform(0.4, 0.9)
        w, h = int(width * zoom), int(height * zoom)
        box = (int(rng.integers(width - w + 1)), int(rng.integers(height - h + 1)), w, h)
    x, y, w, h = box
    seen, known = np.asarray(rgb[y : y + h, x : x + w]), np.asarray(ids[y : y + h, x : x + w])
    if rng.random() < 0.5:
        seen, known = seen[:, ::-1], known[:, ::-1]
    image, inner = letterbox(augment(np.ascontiguousarray(seen), rng), size)
    small = np.zeros((size[1], size[0]), np.uint8)
    resized = cv2.resize(np.ascontiguousarray(known.astype(np.uint8)), inner, interpolation=cv2.INTER_NEAREST)
    small[: inner[1], : inner[0]] = resized
    return targets(image, table[small], None if about is None else int(table[about]), labels)


def targets(image: np.ndarray, kinds: np.ndarray, about: int | None, labels: int) -> Sample:
    """The truth of a picture whose pixels are of `kinds` (h, w), `labels` meaning background."""
    height, width = kinds.shape
    rows, columns = height // STRIDE, width // STRIDE
    blocks = kinds.reshape(rows, STRIDE, columns, STRIDE).transpose(0, 2, 1, 3).reshape(rows, columns, -1)
    counts = np.stack([(blocks == k).sum(2) for k in range(labels + 1)], 2)
    things = counts[..., :labels]
    best, most = things.argmax(2), things.max(2)
    area = STRIDE * STRIDE
    patches = np.where(most >= 0.3 * area, best, IGNORED)
    patches = np.where(counts[..., labels] >= 0.95 * area, labels, patches)
    pixels = np.bincount(kinds.reshape(-1), minlength=labels + 1)[:labels].astype(np.float64)
    weight = np.where(pixels >= LEAST_PIXELS, np.sqrt(pixels), 0.0)
    if about is not None and pixels[about] > 0:
        weight *= 0.2 / max(weight.sum() - weight[about], 1e-9)
        weight[about] = 0.8
    present = weight / max(weight.sum(), 1e-9)
    cell = things.reshape(CELLS[1], rows // CELLS[1], CELLS[0], columns // CELLS[0], labels).sum((1, 3))
    cells = (cell.reshape(-1, labels) >= LEAST_PIXELS).astype(np.float32)
    return Sample(image, present.astype(np.float32), patches.astype(np.int64), cells)
