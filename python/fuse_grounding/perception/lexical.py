"""Words compared by their letters: what stands in for a text encoder where none is configured.

No network that embeds arbitrary words ships, and the property graph must not judge nearness, since it is
a knowledge source that others are measured against. So a text's vector is its count of character n-grams,

    n(x): 2-, 3- and 4-grams of each word with its borders,     sim(a, b) = <n(a), n(b)> / (|n(a)| |n(b)|),

which finds spellings, inflections and compounds ("soup_ladle" is near "ladle") and knows no meaning.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from fuse_grounding.perception.prompts import words


def ngrams(text: str) -> Counter[str]:
    """Counts of the 2-, 3- and 4-grams of each word, borders marked by spaces."""
    counts: Counter[str] = Counter()
    for word in words(text.lower()).split():
        padded = f" {word} "
        for n in (2, 3, 4):
            counts.update(padded[i : i + n] for i in range(len(padded) - n + 1))
    return counts


class Lexical:
    """Implements `TextEncoder` by letters; its vectors have an axis for every n-gram of the call."""

    name = "lexical"

    def text(self, texts: Sequence[str]) -> np.ndarray:
        """(N, D) float32 rows of length 1; a text that shares no n-gram with another is still its own."""
        counts = [ngrams(text) for text in texts]
        axes = {gram: i for i, gram in enumerate(sorted(set().union(*counts)))}
        vectors = np.zeros((len(counts), len(axes)), np.float32)
        for row, count in zip(vectors, counts, strict=True):
            for gram, times in count.items():
                row[axes[gram]] = times
        return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
