"""Direct conditioning: the verb itself is the prompt.

A segmenter with an open vocabulary gets the verb as it is. One with a closed set of labels cannot:
the label that is nearest to the verb is taken instead, and that is announced. Nearness is lexical,
since no text-embedding network ships: the cosine between counts of padded character n-grams,

    sim(a, b) = <n(a), n(b)> / (|n(a)| |n(b)|),   n(x): 2-, 3- and 4-grams of each word with its borders,

between the verb and each of a label's words: its name, its synonyms and its functional part; the
best counts. Ties keep the order of the vocabulary.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from fuse_grounding.knowledge.affordances import Affordances
from fuse_grounding.knowledge.protocol import Candidate, Confidant, Hypotheses, Query


def ngrams(text: str) -> Counter[str]:
    """Counts of the 2-, 3- and 4-grams of each word, borders marked by spaces."""
    counts: Counter[str] = Counter()
    for word in text.lower().replace("_", " ").split():
        padded = f" {word} "
        for n in (2, 3, 4):
            counts.update(padded[i : i + n] for i in range(len(padded) - n + 1))
    return counts


def similarity(a: str, b: str) -> float:
    """Cosine of the two texts' n-gram counts, in [0, 1]."""
    x, y = ngrams(a), ngrams(b)
    dot = sum(x[g] * y[g] for g in sorted(x.keys() & y.keys()))
    norm = math.sqrt(sum(v * v for v in x.values()) * sum(v * v for v in y.values()))
    return dot / norm if norm else 0.0


class Direct:
    """The verb as prompt, or the lexically nearest label of a closed set."""

    name = "direct"

    def __init__(self, affordances: Affordances):
        self._graph = affordances

    def hypotheses(
        self, query: Query, vocabulary: Sequence[str] | None, world: Confidant | None = None
    ) -> Hypotheses:
        """See `KnowledgeSource.hypotheses`: always one candidate."""
        if vocabulary is None:
            return Hypotheses(self.name, (Candidate(query.verb, 1.0, "the verb itself"),))
        verb = query.verb.replace("_", " ")
        score, _, label, theirs = max(
            (similarity(verb, words), -rank, label, words)
            for rank, label in enumerate(vocabulary)
            for words in self._words_of_label(label)
        )
        note = (
            f"direct: the segmenter has a closed set of labels, so the verb `{query.verb}` is replaced by "
            f"the lexically nearest one, `{label}` (character n-grams of {theirs!r}, {score:.2f})"
        )
        reason = f"its {theirs!r} is lexically nearest to {verb!r}"
        return Hypotheses(self.name, (Candidate(label, round(score, 6), reason),), (note,))

    def _words_of_label(self, label: str) -> list[str]:
        words = [label.replace("_", " ")]
        thing = self._graph.things.get(label)
        return words if thing is None else [*words, thing.label, thing.functional_part, *thing.synonyms]
