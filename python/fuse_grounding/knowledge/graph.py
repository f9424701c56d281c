"""Symbolic knowledge: verb -> required properties -> objects that have them.

score(v, o) = geometric mean over the required properties of v, and the best member of each
any-of group, of the degree to which o has them; o satisfies v only if every one of these degrees
reaches the graph's threshold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from fuse_grounding.knowledge.affordances import Affordances, Thing, Verb
from fuse_grounding.knowledge.protocol import (
    Candidate,
    Confidant,
    Hypotheses,
    NothingProposed,
    Query,
)
from fuse_grounding.knowledge.vocabulary import within


def satisfies(verb: Verb, thing: Thing, graph: Affordances) -> Candidate | None:
    """The candidate with its reason, or None where a required property is too weak."""
    degrees = [(name, thing.properties.get(name, 0.0)) for name in verb.requires]
    for group in verb.any_of:
        best = max(group, key=lambda name: thing.properties.get(name, 0.0))
        degrees.append((best, thing.properties.get(best, 0.0)))
    if min(degree for _, degree in degrees) < graph.threshold:
        return None
    score = math.prod(degree for _, degree in degrees) ** (1 / len(degrees))
    reason = ", ".join(f"{graph.meanings[name]} ({name} {degree:.1f})" for name, degree in degrees)
    return Candidate(thing.name, round(score, 6), reason)


class Graph:
    """Candidates by the property graph, best first."""

    name = "graph"

    def __init__(self, affordances: Affordances, top_k: int):
        self._graph = affordances
        self._top_k = top_k

    def hypotheses(
        self, query: Query, vocabulary: Sequence[str] | None, world: Confidant | None = None
    ) -> Hypotheses:
        """See `KnowledgeSource.hypotheses`; ties keep the graph's order of objects."""
        found = self._rank(query.verb)
        if not found:
            verb = self._graph.verbs[query.verb]
            served = [v for v in self._graph.verbs if self._rank(v)]
            raise NothingProposed(
                f"nothing in the graph satisfies `{query.verb}` ({verb.rationale}); "
                f"verbs that something does satisfy: {', '.join(served)}"
            )
        return within(self.name, found, vocabulary, top_k=self._top_k)

    def _rank(self, verb: str) -> list[Candidate]:
        things = self._graph.things.values()
        found = [satisfies(self._graph.verbs[verb], thing, self._graph) for thing in things]
        return sorted((c for c in found if c is not None), key=lambda c: -c.score)
