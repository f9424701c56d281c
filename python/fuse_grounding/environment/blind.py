"""Takes the truth out of what an agent sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fuse_grounding.environment.protocol import Environment, Observation

_ASKED_OPENLY = ("oracle_target", "oracle_valid")


class Blind:
    """An environment whose observations have no instance ids.

    The label questions of the oracle pass through, because who asks them says so; nothing else of the
    wrapped environment is reachable.
    """

    def __init__(self, environment: Environment):
        self.__environment = environment

    def observe(self) -> Observation:
        """The view from where the camera is now, without ids."""
        return replace(self.__environment.observe(), instance=None)

    def action_mask(self) -> np.ndarray:
        """(15,) bool: which actions are possible from here."""
        return self.__environment.action_mask()

    def act(self, action: int) -> None:
        """Moves the camera."""
        self.__environment.act(action)

    def seed_observations(self) -> Sequence[Observation]:
        """The four views that start the map, without ids."""
        return [replace(seen, instance=None) for seen in self.__environment.seed_observations()]

    def __getattr__(self, name: str) -> Any:
        inner = self.__environment
        if name in _ASKED_OPENLY and hasattr(inner, name):
            return getattr(inner, name)
        if name == "canonical_observation" and hasattr(inner, name):
            return lambda: replace(getattr(inner, name)(), instance=None)
        raise AttributeError(f"an agent may not see `{name}` of its environment")
