"""95 % intervals of shares and means, as a report prints them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fuse_grounding.benchmark import statistics

_BATCH = 1000
"""Resamples that are drawn at once."""


@dataclass(frozen=True)
class Interval:
    """A value with the ends of its 95 % interval; of a single value they are that value."""

    value: float
    low: float
    high: float

    def times(self, factor: float) -> Interval:
        """The same in another unit."""
        return Interval(self.value * factor, self.low * factor, self.high * factor)


def share(outcomes: Sequence[bool]) -> Interval:
    """Share of true ones with its Wilson interval."""
    found = statistics.wilson(sum(outcomes), len(outcomes))
    return Interval(sum(outcomes) / len(outcomes), found.low, found.high)


def average(values: Sequence[float]) -> Interval:
    """Mean with its percentile bootstrap interval."""
    mean = float(np.mean(values))
    found = statistics.bootstrap_mean(values)
    return Interval(mean, mean, mean) if found is None else Interval(mean, found.low, found.high)


def ratio(above: Sequence[float], below: Sequence[float]) -> Interval:
    """Ratio of two sums over the same episodes, with the percentile interval of paired resamples."""
    a, b = np.asarray(above, np.float64), np.asarray(below, np.float64)
    random = np.random.default_rng(statistics.SEED)
    ratios: list[float] = []
    while len(ratios) < statistics.RESAMPLES:
        drawn = random.integers(0, len(a), (_BATCH, len(a)))
        ratios += (a[drawn].sum(1) / b[drawn].sum(1)).tolist()
    tail = 50 * (1 - statistics.CONFIDENCE)
    low, high = np.percentile(ratios, [tail, 100 - tail])
    return Interval(float(a.sum() / b.sum()), float(low), float(high))
