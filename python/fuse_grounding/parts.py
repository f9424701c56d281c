"""What an agent is assembled from, and who is told what it does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from fuse_grounding.environment.protocol import Observation
from fuse_grounding.grounding import Grounded, Scored, Viewpoint, best_instance
from fuse_grounding.knowledge.protocol import KnowledgeSource, Query
from fuse_grounding.perception.protocol import Detection, Segmenter
from fuse_grounding.planning.protocol import EvidenceMaps, Policy, Rendering, Situation, SpatialMap
from fuse_grounding.record import MapEntry, StepEntry
from fuse_grounding.registration.protocol import Registrar

if TYPE_CHECKING:
    from fuse_grounding.agent import Session


class GrowingMap(SpatialMap, Protocol):
    """The map as the agent fills it: pictures in the registrar's order."""

    def add_seed(self, rgb: np.ndarray) -> None:
        """A seed view."""
        ...

    def add(self, rgb: np.ndarray) -> None:
        """The view that the registrar took in last."""
        ...

    def entry(self) -> MapEntry | None:
        """For the record; None while there is no map."""
        ...

    def save(self, path: Path) -> None:
        """Writes the map as PLY, nothing while there is none."""
        ...


@dataclass(frozen=True)
class Spatial:
    """Registration and the map on top of it, made for one episode."""

    registrar: Registrar
    map: GrowingMap


@dataclass(frozen=True)
class Parts:
    """What an agent is assembled from; the factories make what one episode uses up.

    `policy` takes the episode's index (it seeds the random policy); `spatial` gives None for methods
    that neither register nor map; `look` makes evidence maps outside a decision.
    """

    understand: Callable[[str], Query]
    knowledge: KnowledgeSource
    segmenter: Segmenter
    policy: Callable[[int], Policy]
    spatial: Callable[[], Spatial | None]
    look: Callable[[Situation, Rendering | None], EvidenceMaps]
    provenance: dict[str, Any]
    announcements: Sequence[str] = ()
    """What the record announces of every episode."""


@dataclass(frozen=True)
class Glance:
    """One online view with all that was made of it."""

    observation: Observation
    viewpoint: Viewpoint
    scored: Sequence[Scored]
    maps: EvidenceMaps | None = None

    @property
    def detections(self) -> list[Detection]:
        """Instances of the candidates, best first."""
        return [s.detection for s in self.scored]


def surer(held: Glance | None, new: Glance) -> Glance | None:
    """The view with the surer instance, whatever its size; None while nothing was seen."""
    ours, theirs = (None if g is None else best_instance(g.scored) for g in (held, new))
    if theirs is None or (ours is not None and ours.detection.score >= theirs.detection.score):
        return held
    return new


class Watcher(Protocol):
    """Told what happens, as it happens: the console, the run folder."""

    def started(self, session: Session) -> None:
        """The query is understood and candidates are there."""
        ...

    def stepped(self, session: Session, step: StepEntry) -> None:
        """One more step is in the record."""
        ...

    def finished(self, session: Session, grounded: Grounded) -> None:
        """The search is over and the result is in the record."""
        ...
