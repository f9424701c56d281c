"""What chooses the next action, and what it may look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np

from fuse_grounding.arguments import finite, instance_of, whole
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.knowledge.protocol import Candidate, Confidant
from fuse_grounding.perception.protocol import Detection
from fuse_grounding.record import Stopwatch


@dataclass(frozen=True)
class Rendering:
    """What the map predicts: `rgb` (H, W, 3) float32 sRGB in [0, 1]; `coverage` its mean opacity."""

    rgb: np.ndarray
    coverage: float


class SpatialMap(Protocol):
    """The scene as remembered: grows by refinement, predicts what a camera sees."""

    def refine(self, clock: Stopwatch) -> None:
        """Optimises over all views registered so far; the first call initialises the map."""
        ...

    def render(self, camera: Any) -> Rendering | None:
        """What `camera` would see, None while there is no map."""
        ...


@dataclass(frozen=True)
class Situation:
    """What is known when the next action is chosen.

    `rgb` (H, W, 3) uint8; `feasible` (15,) bool by action index; `camera` the registered camera;
    `scene` the map; both None for methods that neither register nor map. `depth` (H, W) metres,
    `node` and `pitch_index` where they are known. `visited` are the viewpoints seen in this search, this one
    last, as (ring position, pitch index): the node, or without one the nodes moved since the start.
    """

    index: int
    rgb: np.ndarray
    feasible: np.ndarray
    candidates: Sequence[Candidate]
    detections: Sequence[Detection]
    camera: Any | None = None
    scene: SpatialMap | None = None
    depth: np.ndarray | None = None
    pitch_index: int | None = None
    node: int | None = None
    visited: Sequence[tuple[int, int]] = ()


@dataclass(frozen=True)
class EvidenceMaps:
    """Evidence over the image, (H, W) float32 each.

    `semantic` in [0, 1]; `geometric` in [0, alpha], None where it was not computed; `field` is
    what the actions were scored on. `functional_uncertainty` is the mean of 1 - S + U_geo, `coverage`
    the mean opacity of the rendering behind U_geo, 0 where there was none.
    """

    semantic: np.ndarray
    geometric: np.ndarray | None
    field: np.ndarray
    functional_uncertainty: float | None = None
    coverage: float | None = None


@dataclass(frozen=True)
class Decision:
    """The next action, or None to end the search, and how it came about.

    `values` (15,) float, NaN where an action is masked. `notes` are what the record must announce.
    """

    action: int | None
    branch: str
    values: np.ndarray | None = None
    entropy: float | None = None
    reason: str = ""
    maps: EvidenceMaps | None = None
    notes: tuple[str, ...] = ()


class Policy(Protocol):
    """Chooses the next action."""

    @property
    def start(self) -> Literal["here", "canonical"]:
        """Where the first online observation is taken."""
        ...

    @property
    def planner(self) -> str | None:
        """The amortised planner behind it: `none` for a gated policy without one, None for others."""
        ...

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        """The next action; seconds go to the clock's stages refine, render, evidence, predict, plan."""
        ...


def check_policy(policy: Any, whose: str = "") -> Policy:
    """`policy`, held against `Policy`; `whose` begins the sentence. Raises InputError for what is none."""
    if isinstance(policy, type):
        raise InputError(f"{whose}policy `{policy.__name__}` is a class, expected an object of it")
    who, wanted = f"{whose}policy `{type(policy).__name__}`", ("start", "planner", "decide")
    for name in wanted:
        if not hasattr(policy, name):
            raise InputError(f"{who} has no `{name}`, expected {', '.join(wanted)} (planning/protocol.py)")
    if policy.start not in ("here", "canonical"):
        raise InputError(f"{who} has the start {policy.start!r}, expected `here` or `canonical`")
    if not (policy.planner is None or isinstance(policy.planner, str)):
        raise InputError(f"{who} has the planner {policy.planner!r}, expected its name or None")
    if not callable(policy.decide):
        raise InputError(f"{who} has a `decide` that is {policy.decide!r}, expected a method")
    return policy


def check_decision(policy: Policy, decision: Any) -> Decision:
    """What `policy` returned, its numbers as Python's: a record of them is JSON.

    Raises FuseError for what is no Decision, InputError for an action, entropy or values that are none.
    """
    who = f"policy `{type(policy).__name__}`"
    if not isinstance(decision, Decision):
        raise FuseError(f"{who} returned {type(decision).__name__}, expected a Decision")
    action, entropy, values = decision.action, decision.entropy, decision.values
    if action is not None:
        action = whole(f"{who}: action", action, 0, 14)
    if entropy is not None:
        entropy = finite(f"{who}: entropy", entropy)
    if values is not None and np.shape(values) != (15,):
        raise InputError(f"{who}: values must be (15,), found {np.shape(values)}")
    for name in ("branch", "reason"):
        instance_of(f"{who}: {name}", getattr(decision, name), str)
    return replace(decision, action=action, entropy=entropy)


@runtime_checkable
class Consulting(Protocol):
    """A policy that may ask the world openly for a label, before the first step."""

    def consult(self, world: Confidant | None) -> str | None:
        """Asks, and returns what the record announces of that; None where nothing was asked.

        Raises InputError where there is no world that knows.
        """
        ...


class Planner(Protocol):
    """Predicts what each action is worth without touching the map (amortised planning)."""

    @property
    def name(self) -> str:
        """How the record calls it."""
        ...

    def values(self, situation: Situation) -> np.ndarray:
        """(15,) float predicted utility of each action; picks its object context itself."""
        ...
