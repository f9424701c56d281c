"""Direct conditioning: the verb itself is the prompt.

A segmenter with an open vocabulary gets the verb as it is. One with a closed set of labels cannot: the
label that is nearest to the verb (`knowledge.nearest`) is taken instead, announced and recorded.
"""

from __future__ import annotations

from collections.abc import Sequence

from fuse_grounding.knowledge.nearest import Nearest
from fuse_grounding.knowledge.protocol import Candidate, Confidant, Hypotheses, Query
from fuse_grounding.knowledge.vocabulary import replaced


class Direct:
    """The verb as prompt, or the nearest label of a closed set."""

    name = "direct"

    def __init__(self, nearest: Nearest):
        self._nearest = nearest

    def hypotheses(
        self, query: Query, vocabulary: Sequence[str] | None, world: Confidant | None = None
    ) -> Hypotheses:
        """See `KnowledgeSource.hypotheses`: one candidate, none where no label is anything like the verb."""
        verb = Candidate(query.verb, 1.0, "the verb itself")
        if vocabulary is None:
            return Hypotheses(self.name, (verb,))
        return replaced(Hypotheses(self.name, (verb,)), vocabulary, self._nearest)
