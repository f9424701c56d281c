"""What a search chooses among: feasible actions, and not back to where it was while anything new is in reach.

Looking twice from one place brings the same picture, and counts against patience. The paper's search may
(`search.revisit = true`), and then swings between two views.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fuse_grounding.config import Config
from fuse_grounding.planning.protocol import Situation


def options(situation: Situation, config: Config) -> np.ndarray:
    """(15,) bool: the feasible actions that lead to a new view; all feasible ones where none does."""
    if config.search.revisit:
        return situation.feasible.copy()
    new = situation.feasible & leads_on(situation.visited, config.camera.nodes)
    return new if new.any() else situation.feasible.copy()


def leads_on(visited: Sequence[tuple[int, int]], nodes: int) -> np.ndarray:
    """(15,) bool: the actions that lead from the last of `visited` to none of them, on a ring of `nodes`."""
    fresh = np.ones(15, bool)
    if visited:
        (position, pitch), seen = visited[-1], {(ring % nodes, level) for ring, level in visited}
        for action in range(15):
            fresh[action] = ((position + action % 5 - 2) % nodes, pitch + action // 5 - 1) not in seen
    return fresh
