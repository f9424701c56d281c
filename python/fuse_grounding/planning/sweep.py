"""Down as far as the camera goes, then around the table by two nodes: a search that sees nothing. Ours.

What a planner adds to height and to looking from all sides, it must add to this.
"""

from __future__ import annotations

from typing import Literal

from fuse_grounding import evidence
from fuse_grounding.planning.protocol import Decision, Situation
from fuse_grounding.record import Stopwatch

_ORDER = tuple(evidence.ACTIONS.index(move) for move in ((0, 1), (2, 0), (1, 0), (0, 0)))
"""Down; around by two nodes, by one where a capture has no such view; staying."""


class Sweep:
    """The first feasible of its moves; after a whole turn it comes by the same views again."""

    start: Literal["here"] = "here"
    planner = None

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        """Looks at what is feasible alone."""
        with clock("plan"):
            action = next(a for a in _ORDER if situation.feasible[a])
        return Decision(action, "sweep")
