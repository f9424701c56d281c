"""The label of a closed set that is nearest to a text, by the cosine of their embeddings.

A label is represented by its own words and by what else the property graph calls the thing: its synonyms
and its functional part. The best of them counts; ties keep the order of the labels.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fuse_grounding.knowledge.affordances import Affordances
from fuse_grounding.knowledge.protocol import Replacement
from fuse_grounding.perception.prompts import words
from fuse_grounding.perception.protocol import TextEncoder


class Nearest:
    """Finds the nearest label by what `encoder` makes of all its names."""

    def __init__(self, affordances: Affordances, encoder: TextEncoder):
        self._graph, self.encoder = affordances, encoder

    def to(self, text: str, labels: Sequence[str]) -> Replacement | None:
        """The nearest of `labels`, with how near; None where none is similar at all. Raises InputError."""
        names = [(label, name) for label in labels for name in self._names(label)]
        if not names:
            return None
        vectors = self.encoder.text([words(text), *(name for _, name in names)])
        # Rounded: the last bits of a sum must not decide between equals.
        similarities = np.round(vectors[1:] @ vectors[0], 6)
        best = int(np.argmax(similarities))
        if not similarities[best] > 0:
            return None
        return Replacement(text, *names[best], round(float(similarities[best]), 6), self.encoder.name)

    def _names(self, label: str) -> list[str]:
        thing = self._graph.things.get(label)
        others = () if thing is None else (thing.label, thing.functional_part, *thing.synonyms)
        return list(dict.fromkeys([words(label), *others]))
