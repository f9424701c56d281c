"""Paired statistics on arrays: what is computed, with which conventions. SciPy and statsmodels compute.

Pairs are episodes: entry i of `reference` and of `other` are two methods on one episode. Differences are
reference minus other. Source: supplement, "Paired Statistical Protocol"; docs/metrics.md has the formulas.
Every function raises InputError for arrays of other shapes and for values that are not finite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fuse_grounding.errors import InputError
from fuse_grounding.extras import require

RESAMPLES = 10_000
"""Bootstrap resamples (supplement)."""
SEED = 0
CONFIDENCE = 0.95
_BATCH = 1000
_EXACT = 50


@dataclass(frozen=True)
class Interval:
    """A closed confidence interval."""

    low: float
    high: float


@dataclass(frozen=True)
class McNemar:
    """Episodes by who solved them, and the exact two-sided p-value; 1 without a discordant pair."""

    both: int
    reference_only: int
    other_only: int
    neither: int
    p: float

    @property
    def pairs(self) -> int:
        """All episodes."""
        return self.both + self.discordant + self.neither

    @property
    def discordant(self) -> int:
        """Episodes that just one method solved."""
        return self.reference_only + self.other_only

    @property
    def odds_ratio(self) -> float | None:
        """Reference only over other only; None where the other solved no episode alone."""
        return self.reference_only / self.other_only if self.other_only else None

    @property
    def cohens_g(self) -> float | None:
        """Share of the reference among the discordant pairs, less one half; None without any."""
        return self.reference_only / self.discordant - 0.5 if self.discordant else None


@dataclass(frozen=True)
class Wilcoxon:
    """Signed-rank test: `nonzero` differences were ranked, `statistic` is the smaller rank sum."""

    nonzero: int
    statistic: float
    p: float


def stats_module(name: str) -> Any:
    """A module of SciPy or statsmodels. Raises InputError naming the extra that brings it."""
    return require(name, "report", "the statistics of a benchmark")


def mcnemar(reference: ArrayLike, other: ArrayLike) -> McNemar:
    """Exact McNemar test of two boolean arrays (n,)."""
    a, b = (np.asarray(values) for values in (reference, other))
    if a.dtype != bool or b.dtype != bool:
        raise InputError(f"McNemar's test takes booleans, not {a.dtype} and {b.dtype}")
    _same_length(a, b)
    only, lost = int(np.count_nonzero(a & ~b)), int(np.count_nonzero(~a & b))
    both = int(np.count_nonzero(a & b))
    return McNemar(both, only, lost, len(a) - both - only - lost, mcnemar_p(only, lost))


def mcnemar_p(reference_only: int, other_only: int) -> float:
    """Exact two-sided p = min(1, 2 P[X <= min(b, c)]), X ~ Binomial(b + c, 1/2); 1 where b + c = 0."""
    if min(reference_only, other_only) < 0:
        raise InputError(f"discordant counts cannot be negative: {reference_only} and {other_only}")
    tables = stats_module("statsmodels.stats.contingency_tables")
    return float(tables.mcnemar([[0, reference_only], [other_only, 0]], exact=True).pvalue)


def wilcoxon(differences: ArrayLike) -> Wilcoxon:
    """Two-sided Wilcoxon signed-rank test of differences (n,).

    Zero differences are dropped before ranking (Wilcoxon's own treatment, SciPy's `zero_method="wilcox"`);
    ties share their mean rank. Up to 50 nonzero differences the p-value is exact, given the ties: twice the
    smaller tail over all signs of the ranks. Beyond, it is SciPy's normal approximation, corrected for ties
    and not for continuity. Where every difference is zero, or there is none, p = 1.
    """
    d = _finite(differences, "differences")
    d = d[d != 0]
    if len(d) == 0:
        return Wilcoxon(0, 0.0, 1.0)
    stats = stats_module("scipy.stats")
    if len(d) <= _EXACT:
        ranks = stats.rankdata(np.abs(d))
        positive, total = float(ranks[d > 0].sum()), float(ranks.sum())
        return Wilcoxon(len(d), min(positive, total - positive), _signed_rank_p(ranks, positive))
    # SciPy 1.15 and later take the method's old name, too.
    found = stats.wilcoxon(d, zero_method="wilcox", correction=False, method="approx")
    return Wilcoxon(len(d), float(found.statistic), float(found.pvalue))


def _signed_rank_p(ranks: np.ndarray, positive: float) -> float:
    """Exact two-sided p of a rank sum: SciPy's exact test knows no ties, its enumeration takes seconds.

    The distribution of the sum of positive ranks, every sign as likely, grows by one rank at a time; ranks
    are doubled, which makes mean ranks whole.
    """
    chances = np.ones(1)
    for rank in np.rint(2 * ranks).astype(int):
        grown = np.zeros(len(chances) + rank)
        grown[: len(chances)] += chances / 2
        grown[rank:] += chances / 2
        chances = grown
    at = round(2 * positive)
    return float(min(1.0, 2 * min(chances[: at + 1].sum(), chances[at:].sum())))


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Holm's step-down adjusted p-values of one family, in the order given.

    None is a comparison that could not be made: it stays None and does not count as a test.
    """
    tested = [p for p in p_values if p is not None]
    for p in tested:
        if not 0 <= p <= 1:  # NaN is refused, too
            raise InputError(f"{p} is not a p-value")
    if not tested:
        return list(p_values)
    adjusted = iter(stats_module("statsmodels.stats.multitest").multipletests(tested, method="holm")[1])
    return [None if p is None else float(next(adjusted)) for p in p_values]


def bootstrap_mean(
    values: ArrayLike, *, resamples: int = RESAMPLES, seed: int = SEED, confidence: float = CONFIDENCE
) -> Interval | None:
    """Percentile bootstrap interval of the mean of (n,) values; None for fewer than two.

    Of paired differences it is the paired bootstrap: whole episodes are drawn. The same values in the same
    order, seed and number of resamples give the same interval.
    """
    x = _finite(values, "values")
    if len(x) < 2:
        return None
    found = (
        stats_module("scipy.stats")
        .bootstrap(
            (x,),
            np.mean,
            n_resamples=resamples,
            batch=_BATCH,
            vectorized=True,
            confidence_level=confidence,
            method="percentile",
            rng=np.random.default_rng(seed),
        )
        .confidence_interval
    )
    return Interval(float(found.low), float(found.high))


def wilson(successes: int, trials: int, *, confidence: float = CONFIDENCE) -> Interval:
    """Wilson's score interval of a success rate, in [0, 1]."""
    if not 0 <= successes <= trials or trials == 0:
        raise InputError(f"{successes} successes of {trials} trials have no rate")
    proportion = stats_module("statsmodels.stats.proportion")
    low, high = proportion.proportion_confint(successes, trials, alpha=1 - confidence, method="wilson")
    return Interval(max(0.0, float(low)), min(1.0, float(high)))


def cohens_dz(differences: ArrayLike) -> float | None:
    """Mean over standard deviation (n - 1) of paired differences; None for fewer than two or no spread."""
    d = _finite(differences, "differences")
    if len(d) < 2 or np.ptp(d) <= 1e-12 * np.max(np.abs(d)):  # what rounding leaves is none
        return None
    return float(np.mean(d) / np.std(d, ddof=1))


def rank_biserial(differences: ArrayLike) -> float | None:
    """(W+ - W-) / (W+ + W-) over the ranks of the nonzero differences, in [-1, 1]; None without any.

    1 where every difference favours the reference. Zeros and ties as in `wilcoxon`.
    """
    d = _finite(differences, "differences")
    d = d[d != 0]
    if len(d) == 0:
        return None
    ranks = stats_module("scipy.stats").rankdata(np.abs(d))
    return float(np.sum(ranks * np.sign(d)) / np.sum(ranks))


def _finite(values: ArrayLike, name: str) -> np.ndarray:
    """(n,) float64."""
    x = np.asarray(values, np.float64)
    if x.ndim != 1:
        raise InputError(f"{name} have shape {x.shape}, expected (n,)")
    if not np.all(np.isfinite(x)):
        raise InputError(f"{name} have {np.count_nonzero(~np.isfinite(x))} entries that are not finite")
    return x


def _same_length(a: np.ndarray, b: np.ndarray) -> None:
    if a.ndim != 1 or a.shape != b.shape:
        raise InputError(f"pairs need two arrays of one length, not of shapes {a.shape} and {b.shape}")
