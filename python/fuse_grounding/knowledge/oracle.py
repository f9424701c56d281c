"""Ground-truth labels, asked from the world openly; no masks, poses, actions or stopping signals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from fuse_grounding.errors import InputError
from fuse_grounding.knowledge.protocol import Candidate, Confidant, Hypotheses, Query
from fuse_grounding.knowledge.vocabulary import within


class Oracle:
    """The episode's target label, or every valid label in the scene."""

    name = "oracle"

    def __init__(self, tell: Literal["target", "valid"]):
        self._tell = tell

    def hypotheses(
        self, query: Query, vocabulary: Sequence[str] | None, world: Confidant | None
    ) -> Hypotheses:
        """See `KnowledgeSource.hypotheses`. Raises InputError where there is no world that knows."""
        if world is None:
            raise InputError("knowledge source `oracle` needs an episode that knows its target; use `graph`")
        labels = [world.oracle_target()] if self._tell == "target" else list(world.oracle_valid())
        if not labels:
            raise InputError("the oracle was told no label: the episode has no valid object")
        what = "the episode's target" if self._tell == "target" else "a valid object in the scene"
        note = f"oracle: the world was asked for {what}, label only"
        candidates = tuple(Candidate(label, 1.0, f"{what}, told by the oracle") for label in labels)
        return within(self.name, candidates, vocabulary, announcements=(note,))
