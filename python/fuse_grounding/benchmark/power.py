"""Power: how many episodes a difference would need, and which difference so many episodes can show.

Two-sided tests throughout. For success it is the power of the exact McNemar test itself, not of a normal
approximation to it; for means the paired t-test's, as a guide.
"""

from __future__ import annotations

import math

import numpy as np

from fuse_grounding.benchmark.statistics import stats_module
from fuse_grounding.errors import InputError

ALPHA = 0.05
POWER = 0.8
MOST_PAIRS = 1_000_000
"""Searches end here: a difference that needs more episodes than this counts as none."""


def mcnemar_power(pairs: int, reference_only: float, other_only: float, *, alpha: float = ALPHA) -> float:
    """Chance that the exact McNemar test of `pairs` episodes is significant.

    `reference_only` and `other_only` are the probabilities that an episode is solved by that method alone.
    The number of discordant pairs is M ~ Binomial(pairs, b + c), and given M = m those of the reference
    X ~ Binomial(m, b / (b + c)); the test rejects where min(X, m - X) <= k(m), the largest k with
    2 P[Binomial(m, 1/2) <= k] <= alpha. The sum runs over all m (but the farthest 1e-12 of them).
    """
    _probabilities(reference_only, other_only)
    discordant = reference_only + other_only
    if discordant == 0 or pairs == 0:
        return 0.0
    binom = stats_module("scipy.stats").binom
    low, high = binom.ppf(5e-13, pairs, discordant), binom.ppf(1 - 5e-13, pairs, discordant)
    m = np.arange(max(low, 0), high + 1)
    k = _critical(m, alpha)
    share = reference_only / discordant
    rejected = binom.cdf(k, m, share) + binom.sf(m - k - 1, m, share)
    return float(np.sum(binom.pmf(m, pairs, discordant) * np.where(k >= 0, rejected, 0.0)))


def _critical(m: np.ndarray, alpha: float) -> np.ndarray:
    """Largest k with 2 P[Binomial(m, 1/2) <= k] <= alpha for every m; -1 where there is none."""
    binom = stats_module("scipy.stats").binom
    k = binom.ppf(alpha / 2, m, 0.5)  # smallest k with P[X <= k] >= alpha / 2
    return np.where(2 * binom.cdf(k, m, 0.5) <= alpha, k, k - 1)


def pairs_needed(
    reference_only: float, other_only: float, *, power: float = POWER, alpha: float = ALPHA
) -> int | None:
    """Episodes at which the exact McNemar test reaches `power`; None for equal methods or over a million.

    The number n with power(n) >= `power` > power(n - 1) that bisection finds. The power of an exact test
    rises in small teeth, so that a number a few per cent smaller may reach it, too.
    """
    _probabilities(reference_only, other_only)
    if reference_only == other_only:
        return None

    def enough(n: int) -> bool:
        return mcnemar_power(n, reference_only, other_only, alpha=alpha) >= power

    high = max(2, connor(reference_only, other_only, power=power, alpha=alpha))
    low = 0  # of no power
    while high <= MOST_PAIRS and not enough(high):
        low, high = high, math.ceil(high * 1.25)
    if high > MOST_PAIRS:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def connor(reference_only: float, other_only: float, *, power: float = POWER, alpha: float = ALPHA) -> int:
    """Connor's (1987) normal approximation of `pairs_needed`, for two methods that differ.

    n = (z_{1-alpha/2} sqrt(b + c) + z_{power} sqrt(b + c - (b - c)^2))^2 / (b - c)^2. Too small for the
    exact test, which is conservative: the search starts here.
    """
    _probabilities(reference_only, other_only)
    delta, discordant = reference_only - other_only, reference_only + other_only
    if delta == 0:
        raise InputError("methods that do not differ need no number of episodes")
    normal = stats_module("scipy.stats").norm
    spread = normal.ppf(1 - alpha / 2) * math.sqrt(discordant)
    spread += normal.ppf(power) * math.sqrt(max(discordant - delta**2, 0.0))
    return math.ceil(spread**2 / delta**2)


def detectable_difference(
    pairs: int, discordant: float, *, power: float = POWER, alpha: float = ALPHA
) -> float | None:
    """Smallest difference of success rates that `pairs` episodes show with `power`, in [0, 1].

    `discordant` is the share of episodes that just one method solves. To four decimals, rounded up; None
    where even a difference as large as `discordant`, every such episode on one side, would not be shown.
    """

    def enough(delta: float) -> bool:
        return mcnemar_power(pairs, (discordant + delta) / 2, (discordant - delta) / 2, alpha=alpha) >= power

    if not enough(discordant):
        return None
    low, high = 0.0, discordant
    while high - low > 1e-5:
        middle = (low + high) / 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return min(math.ceil(high * 1e4) / 1e4, discordant)


def pairs_needed_mean(d_z: float, *, power: float = POWER, alpha: float = ALPHA) -> int | None:
    """Episodes at which a paired t-test shows a mean difference of `d_z` standard deviations.

    None for 0 or over a million. A guide for the Wilcoxon test, too, which on normal differences needs a
    twentieth more and on skewed ones often fewer.
    """
    if abs(d_z) < 1e-3:  # over a million episodes by (z_{1-alpha/2} + z_{power})^2 / d_z^2
        return None
    t_test = stats_module("statsmodels.stats.power").TTestPower()

    def enough(n: int) -> bool:
        return float(t_test.power(abs(d_z), n, alpha, alternative="two-sided")) >= power

    low, high = 1, 2
    while not enough(high):
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high if high <= MOST_PAIRS else None


def _probabilities(reference_only: float, other_only: float) -> None:
    if not (reference_only >= 0 and other_only >= 0 and reference_only + other_only <= 1 + 1e-9):
        raise InputError(
            f"{reference_only} and {other_only} are no shares of episodes: each in [0, 1], together at most 1"
        )
