"""How well an encoder puts pictures and labels together, on pictures whose truth is known. NumPy only."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from fuse_grounding.perception.protocol import Encoder
from fuse_grounding.training.encoder_data import crop_box
from fuse_grounding.training.segmenter_data import Picture

LEAST_PIXELS = 500
MARGIN = 1.35
"""The least that leaves a thin object's crop as wide as encoders ask for."""


@dataclass
class Score:
    """Ranks of the right label, from 1: of each object's crop, and of what a whole picture shows.

    `scenes` has, for each picture, the best rank among the labels in it; `contexts`, for random sets of five
    labels of which one or more are in the picture, whether the chosen one is, and the chance of that by
    guessing.
    """

    crops: list[tuple[str, int]] = field(default_factory=list)
    scenes: list[int] = field(default_factory=list)
    contexts: list[tuple[bool, float]] = field(default_factory=list)

    def top(self, k: int) -> float:
        """Share of crops whose label is among the first `k`."""
        return float(np.mean([rank <= k for _, rank in self.crops]))

    def mean_rank(self) -> float:
        """Mean rank of the label of a crop."""
        return float(np.mean([rank for _, rank in self.crops]))


def evaluate(encoder: Encoder, pictures: Iterable[Picture], labels: Sequence[str], seed: int = 0) -> Score:
    """Objects with at least 500 visible pixels, each in a crop with a margin of about a third."""
    score, rng = Score(), np.random.default_rng(seed)
    texts = encoder.text(labels)
    for rgb, ids, objects in pictures:
        ids = np.asarray(ids)
        for o in objects:
            if o["visible_px"] < LEAST_PIXELS or o["category"] not in labels:
                continue
            x, y, w, h = crop_box(ids, o["id"], MARGIN)
            crop = np.ascontiguousarray(rgb[y : y + h, x : x + w])
            rank = ranks(texts @ encoder.image(crop))[labels.index(o["category"])]
            score.crops.append((o["category"], int(rank)))
        seen = {o["category"] for o in objects if o["visible_px"] >= LEAST_PIXELS} & set(labels)
        if not seen:
            continue
        there = np.array([label in seen for label in labels])
        similarity = texts @ encoder.image(np.ascontiguousarray(rgb))
        score.scenes.append(int(ranks(similarity)[there].min()))
        some = rng.choice(len(labels), min(5, len(labels)), replace=False)
        if there[some].any():
            chosen = some[similarity[some].argmax()]
            score.contexts.append((bool(there[chosen]), float(there[some].mean())))
    return score


def ranks(values: np.ndarray) -> np.ndarray:
    """(N,) int64: 1 for the largest value, and so on; equal ones in their order."""
    order = np.argsort(-values, kind="stable")
    found = np.empty(len(values), np.int64)
    found[order] = np.arange(1, len(values) + 1)
    return found


def nearest(encoder: Encoder, words: Sequence[str], labels: Sequence[str]) -> list[tuple[str, float]]:
    """For each word the label whose text is closest, with the cosine."""
    similarity = encoder.text(words) @ encoder.text(labels).T
    return [(labels[int(row.argmax())], float(row.max())) for row in similarity]
