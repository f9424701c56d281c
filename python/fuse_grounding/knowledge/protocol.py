"""What turns a functional query into candidate labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from fuse_grounding.errors import InputError


@dataclass(frozen=True)
class Query:
    """A query in words and the verb it was understood as, with the words that decided."""

    text: str
    verb: str
    because: str


@dataclass(frozen=True)
class Candidate:
    """A label that may serve the verb: `score` in [0, 1], `reason` for people."""

    label: str
    score: float
    reason: str


@dataclass(frozen=True)
class Replacement:
    """A proposed label that became `label`, near to it through `words` by the text encoder of that name."""

    proposed: str
    label: str
    words: str
    similarity: float
    encoder: str


@dataclass(frozen=True)
class Hypotheses:
    """Candidates, best first, and what a reader must know about how they came about.

    `unknown` were proposed and left out, because the segmenter does not know them; `replaced` were
    proposed in other words (`knowledge.vocabulary`). `api_seconds` were spent on a language model.
    """

    source: str
    candidates: tuple[Candidate, ...]
    announcements: tuple[str, ...] = ()
    unknown: tuple[Candidate, ...] = ()
    replaced: tuple[Replacement, ...] = ()
    api_seconds: float = field(default=0.0, compare=False)

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the candidates, best first."""
        return tuple(c.label for c in self.candidates)


class NothingProposed(InputError):
    """A source knows the verb, and nothing that serves it."""


class Confidant(Protocol):
    """A world that tells an oracle source, asked openly, which label the episode is about."""

    def oracle_target(self) -> str:
        """Label of the episode's target."""
        ...

    def oracle_valid(self) -> Sequence[str]:
        """Labels of every valid object in the scene, sorted."""
        ...


class KnowledgeSource(Protocol):
    """Proposes candidates for a verb."""

    @property
    def name(self) -> str:
        """The name it is registered under."""
        ...

    def hypotheses(
        self, query: Query, vocabulary: Sequence[str] | None, world: Confidant | None
    ) -> Hypotheses:
        """At most the configured number of candidates out of `vocabulary` (None: anything goes).

        What it proposes beyond `vocabulary` is in `unknown`; there may be no candidate but those.
        `world` is there for sources that ask it openly; others do not touch it. Raises InputError,
        NothingProposed where the verb is served by nothing.
        """
        ...
