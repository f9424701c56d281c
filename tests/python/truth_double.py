"""A truth for the ring of `agent_doubles`, whose every mask is known; it counts how often it is asked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

import numpy as np
from agent_doubles import HEIGHT, WIDTH, camera

from fuse_grounding._core import Camera
from fuse_grounding.environment import Target

Block = tuple[slice, slice]
KNIFE: Block = (slice(14, 34), slice(5, 25))
"""Where `agent_doubles.Seer` sees its knife, 400 pixels."""


class Truth:
    """Blocks of instances at every viewpoint: `blocks(node, pitch_index)` gives id -> rows and columns."""

    def __init__(
        self,
        blocks: Callable[[int, int], Mapping[int, Block]],
        targets: Mapping[int, tuple[str, tuple[float, float, float]]],
    ):
        self._blocks, self._labels = blocks, targets
        self.asked: Counter[tuple[int | None, int | None]] = Counter()

    def true_instances(self, node: int | None, pitch_index: int | None) -> np.ndarray:
        self.asked[node, pitch_index] += 1
        return self._ids(*self._ring(node, pitch_index))

    def true_camera(self, node: int | None, pitch_index: int | None) -> Camera:
        return camera(*self._ring(node, pitch_index))

    def true_targets(self) -> list[Target]:
        return [self._target(i, label, np.array(at)) for i, (label, at) in self._labels.items()]

    @staticmethod
    def _ring(node: int | None, pitch_index: int | None) -> tuple[int, int]:
        """The double's canonical view is that of node 35, pitch index 2."""
        return (35, 2) if node is None or pitch_index is None else (node, pitch_index)

    def _ids(self, node: int, pitch_index: int) -> np.ndarray:
        ids = np.zeros((HEIGHT, WIDTH), np.uint32)
        for instance, block in self._blocks(node, pitch_index).items():
            ids[block] = instance
        return ids

    def _target(self, instance: int, label: str, position: np.ndarray) -> Target:
        counts = np.array(
            [[np.count_nonzero(self._ids(n, p) == instance) for p in range(3)] for n in range(36)]
        )
        distances = [np.linalg.norm(camera(n, p).center - position) for n in range(36) for p in range(3)]
        least, most = float(counts.min()), float(counts.max())
        near, far = float(min(distances)), float(max(distances))
        return Target(instance, label, position, least, most, near, far, counts, counts)
