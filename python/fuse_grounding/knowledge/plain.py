"""Plain knowledge: labels by how alike their words and the verb are, in one hop (CRAFT's role in the paper).

    score(v, o) = max(0, cos(text(v), text(o)))

over the words of verb and label alone: no properties, no synonyms, nothing that the graph knows. How good it
is depends on the text encoder, which is therefore announced.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fuse_grounding.knowledge.protocol import Candidate, Confidant, Hypotheses, Query
from fuse_grounding.knowledge.vocabulary import within
from fuse_grounding.perception.prompts import words
from fuse_grounding.perception.protocol import TextEncoder


class Plain:
    """Labels by text similarity with the verb, best first.

    `labels` are ranked where the segmenter has no closed set of its own.
    """

    name = "plain"

    def __init__(self, encoder: TextEncoder, labels: Sequence[str], top_k: int):
        self._encoder, self._labels, self._top_k = encoder, tuple(labels), top_k

    def hypotheses(
        self, query: Query, vocabulary: Sequence[str] | None, world: Confidant | None = None
    ) -> Hypotheses:
        """See `KnowledgeSource.hypotheses`: none where no label is anything like the verb.

        Ties keep the order of the labels.
        """
        labels = self._labels if vocabulary is None else tuple(vocabulary)
        note = f"{self.name}: labels were compared with the verb `{query.verb}` by {self._encoder.name}"
        return within(
            self.name, self._rank(query.verb, labels), labels, top_k=self._top_k, announcements=(note,)
        )

    def _rank(self, verb: str, labels: Sequence[str]) -> list[Candidate]:
        if not labels:
            return []
        vectors = self._encoder.text([words(verb), *(words(label) for label in labels)])
        # Rounded: the last bits of a sum must not decide between equals.
        similarities = np.round(vectors[1:].astype(np.float64) @ vectors[0], 6)
        order = np.argsort(-similarities, kind="stable")
        reason = f"{self._encoder.name} similarity to `{verb}`"
        return [
            Candidate(labels[i], min(1.0, float(similarities[i])), reason)
            for i in order
            if similarities[i] > 0
        ]
