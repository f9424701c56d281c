"""Posed photos of a COLMAP or nerfstudio folder, some of them held out."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fuse_grounding._core import Camera, SplatDataset
from fuse_grounding.errors import InputError

# Photos are made smaller by a whole number until their longer side is at most this, as is usual.
LONGEST_SIDE = 1600
# What the trainer keeps of a view, bytes a pixel: the image, and two blurred copies in floats.
BYTES_PER_PIXEL = 27
# Photos that are decoded at a time: enough for all cores, and an interrupt is heard between two lots.
LOT = 16

View = tuple[NDArray[np.uint8], Camera]


class Dataset:
    """Views and sparse points of a folder. Photos are read when they are asked for.

    `downscale` divides both sides, None: the least that makes them at most 1600 pixels; every
    `holdout`-th view by file name, from the first, is held out, 0: none. Raises InputError naming the
    file and its fault.
    """

    def __init__(self, folder: Path, downscale: int | None = None, holdout: int = 8):
        if downscale is not None and downscale < 1:
            raise InputError(f"downscale must be at least 1, found {downscale}")
        if holdout < 0 or holdout == 1:
            raise InputError(f"holdout must be 0 (none) or at least 2, found {holdout}")
        self.folder = folder
        self._inner = SplatDataset(folder)
        self.kind, self.names, self.notes = self._inner.kind, self._inner.names, self._inner.notes
        self.downscale = downscale if downscale is not None else self._fitting()
        indices = range(len(self.names))
        self.held_out = tuple(i for i in indices if holdout and i % holdout == 0)
        self.train = tuple(i for i in indices if i not in set(self.held_out))
        if not self.train:
            raise InputError(f"{folder}: {len(self.names)} view(s), all held out; --holdout 0 holds out none")

    def _fitting(self) -> int:
        cameras = [self._inner.camera(i, 1) for i in range(len(self.names))]
        longest = max(max(c.width, c.height) for c in cameras)
        return -(-longest // LONGEST_SIDE)

    def camera(self, index: int) -> Camera:
        """The camera of a view as it is trained on: smaller, without distortion."""
        return self._inner.camera(index, self.downscale)

    def points(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions (N, 3) and colours (N, 3) in [0, 1] of the sparse points."""
        return self._inner.points()

    @property
    def has_points(self) -> bool:
        """Whether `points` are of the scene, and not random for want of any."""
        return not any("random points" in note for note in self.notes)

    def index(self, name: str) -> int:
        """The view of this name. Raises InputError, with names that are near."""
        if name in self.names:
            return self.names.index(name)
        near = [n for n in self.names if name.lower() in n.lower()] or self.names
        raise InputError(f"{self.folder} has no view `{name}`; there are {', '.join(near[:5])} …")

    def read(self, indices: Sequence[int], tell: Callable[[int], None] = lambda done: None) -> Iterator[View]:
        """Image (H, W, 3) uint8 and camera of each view, decoded in parallel, a lot at a time."""
        for start in range(0, len(indices), LOT):
            lot = self._inner.read(list(indices[start : start + LOT]), self.downscale)
            tell(start + len(lot))
            yield from lot

    def check_memory(self) -> None:
        """Raises InputError where the training views would not fit into the free memory."""
        pixels = 0
        for i in self.train:
            camera = self.camera(i)
            pixels += camera.width * camera.height
        need, free = pixels * BYTES_PER_PIXEL, _free_memory()
        if free is not None and need > 0.8 * free:
            raise InputError(
                f"{len(self.train)} training views take {need / 1e9:.1f} GB, {free / 1e9:.1f} GB are free; "
                f"--downscale {self.downscale + 1} or more makes them smaller"
            )


def _free_memory() -> int | None:
    """Bytes; None where the system does not say."""
    try:
        text = Path("/proc/meminfo").read_text()
        line = next(row for row in text.splitlines() if row.startswith("MemAvailable:"))
        return int(line.split()[1]) * 1024
    except (OSError, StopIteration, ValueError):
        pass
    try:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError, AttributeError):
        return None
