"""Baselines that look once: from where the camera is, or from above the scene's centre."""

from __future__ import annotations

from typing import Literal

from fuse_grounding.planning.protocol import Decision, Situation
from fuse_grounding.record import Stopwatch


class Fixed:
    """Ends the search at the first observation."""

    planner = None

    def __init__(self, name: str, start: Literal["here", "canonical"]):
        self._name = name
        self.start = start

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        """No action: one view decides."""
        return Decision(None, self._name, reason="one view decides")
