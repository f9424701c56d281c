"""Actions sampled uniformly from the feasible ones (supplement, "Random Active")."""

from __future__ import annotations

from typing import Literal

import numpy as np

from fuse_grounding.planning.protocol import Decision, Situation
from fuse_grounding.record import Stopwatch


class RandomWalk:
    """Uniform over feasible actions, the no-op included; the same seed walks the same walk."""

    start: Literal["here"] = "here"
    planner = None

    def __init__(self, seed: int):
        self._random = np.random.default_rng(seed)

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        """One draw."""
        with clock("plan"):
            action = int(self._random.choice(np.flatnonzero(situation.feasible)))
        return Decision(action, "random")
