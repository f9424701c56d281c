"""The paired statistics: by hand, by independent computations, by the paper's own figures, by properties."""

from __future__ import annotations

import itertools
import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from fuse_grounding.benchmark import power, statistics
from fuse_grounding.errors import InputError

PAPER: dict[str, Any] = json.loads((Path(__file__).parent / "paper_statistics.json").read_text())
EPISODES = PAPER["episodes"]
PUBLISHED = [(group, name) for group in ("planners", "knowledge") for name in PAPER[group]]

outcomes = st.lists(st.tuples(st.booleans(), st.booleans()), min_size=2, max_size=60)
numbers = st.lists(st.integers(-8, 8).map(lambda k: k / 4), min_size=2, max_size=40)
p_values = st.lists(st.floats(0, 1), min_size=1, max_size=12)


def halves(pairs: list[tuple[bool, bool]]) -> tuple[np.ndarray, np.ndarray]:
    array = np.array(pairs, bool)
    return array[:, 0], array[:, 1]


# -- the paper's own figures ---------------------------------------------------------------------


@pytest.mark.parametrize("name", list(PAPER["planners"]))
def test_the_papers_mcnemar_values_recompute(name: str):
    line = PAPER["planners"][name]
    p = statistics.mcnemar_p(line["reference_only"], line["other_only"])
    assert round(p, 3) == line["p"]


def test_the_papers_adjusted_values_recompute():
    """Holm over all seven knowledge sources, the oracle among them; six digits, then as published."""
    lines = list(PAPER["knowledge"].values())
    adjusted = statistics.holm(
        [statistics.mcnemar_p(line["reference_only"], line["other_only"]) for line in lines]
    )
    assert adjusted == pytest.approx([line["adjusted_p_recomputed"] for line in lines], abs=5e-7)
    assert [round(p or 0.0, 3) for p in adjusted] == [line["adjusted_p"] for line in lines]


@pytest.mark.parametrize(("group", "name"), PUBLISHED)
def test_the_papers_counts_and_intervals_recompute(group: str, name: str):
    """Interval ends lie on a grid of one point, so that a draw can decide between neighbours. One of eighteen
    differs: CRAFT's upper end is published as 28, and 97.43 % of the exact distribution lie at or below."""
    line = PAPER[group][name]
    won, lost = line["reference_only"], line["other_only"]
    assert line["delta"] == won - lost == line["reference"] - line["other"]
    interval = statistics.bootstrap_mean(
        np.repeat([100.0, -100.0, 0.0], [won, lost, EPISODES - won - lost]), seed=1
    )
    assert interval is not None
    off = np.array([interval.low, interval.high]) - line["ci95"]
    one_point = {"craft": [0, 1]}
    assert off == pytest.approx(one_point.get(name, [0, 0]), abs=1e-9)


# -- McNemar -------------------------------------------------------------------------------------


def test_mcnemar_by_hand():
    a = np.array([1, 1, 1, 1, 0, 0, 1, 0], bool)
    b = np.array([1, 0, 0, 0, 1, 0, 1, 0], bool)
    found = statistics.mcnemar(a, b)
    assert (found.both, found.reference_only, found.other_only, found.neither) == (2, 3, 1, 2)
    assert (found.pairs, found.discordant) == (8, 4)
    assert found.p == pytest.approx(2 * (1 + 4) / 16)
    assert found.odds_ratio == 3.0
    assert found.cohens_g == 0.25
    assert found.p == scipy.stats.binomtest(3, 4, 0.5).pvalue


def test_without_discordant_pairs_nothing_speaks_against_equality():
    same = np.array([True, False, True])
    found = statistics.mcnemar(same, same)
    assert (found.p, found.odds_ratio, found.cohens_g) == (1.0, None, None)
    one_sided = statistics.mcnemar(same, same & False)
    assert (one_sided.odds_ratio, one_sided.cohens_g) == (None, 0.5)


@settings(deadline=None)
@given(outcomes)
def test_mcnemar_does_not_care_who_comes_first(pairs: list[tuple[bool, bool]]):
    a, b = halves(pairs)
    one, other = statistics.mcnemar(a, b), statistics.mcnemar(b, a)
    assert one.p == other.p
    assert (one.reference_only, one.other_only) == (other.other_only, other.reference_only)
    assert one.cohens_g == pytest.approx(None if other.cohens_g is None else -other.cohens_g)
    if one.odds_ratio and other.odds_ratio:
        assert one.odds_ratio * other.odds_ratio == pytest.approx(1)


@settings(deadline=None)
@given(outcomes, st.randoms(use_true_random=False))
def test_mcnemar_does_not_care_about_the_order_of_episodes(pairs: list[tuple[bool, bool]], random: Any):
    shuffled = random.sample(pairs, len(pairs))
    assert statistics.mcnemar(*halves(pairs)) == statistics.mcnemar(*halves(shuffled))


# -- Wilcoxon ------------------------------------------------------------------------------------


def enumerated(differences: list[float]) -> float:
    """Two-sided p of the signed-rank test from its definition: all signs of the ranks that there are."""
    d = np.array([x for x in differences if x != 0])
    ranks = scipy.stats.rankdata(np.abs(d))
    signs = np.array(list(itertools.product([0, 1], repeat=len(d))))
    sums, observed = signs @ ranks, ranks[d > 0].sum()
    tails = np.mean(sums <= observed + 1e-9), np.mean(sums >= observed - 1e-9)
    return min(1.0, 2 * min(tails))


@pytest.mark.parametrize(
    "differences",
    [
        [0.3, -0.1, 0.7, 0.2, 0.0, 1.4],
        [0.5, 0.5, -0.5, 0.25, 0.0, 0.0, 1.0],
        [-1.0, -2.0, -3.0, -4.0, -5.0, -6.0, 7.0, 8.0],
        [1.0],
        [0.5, -0.5] * 6,
    ],
)
def test_wilcoxon_is_exact_for_few_differences(differences: list[float]):
    found = statistics.wilcoxon(differences)
    assert found.nonzero == np.count_nonzero(differences)
    assert found.p == pytest.approx(enumerated(differences))


def test_wilcoxon_without_ties_is_scipys_exact_test():
    d = np.random.default_rng(4).normal(0.3, 1, 50)
    theirs = scipy.stats.wilcoxon(d, method="exact")
    found = statistics.wilcoxon(d)
    assert (found.statistic, found.p) == pytest.approx((theirs.statistic, theirs.pvalue), rel=1e-12)


def test_wilcoxon_for_many_tied_differences_is_normal_with_tie_correction():
    d = np.repeat([1.0, -1.0, 2.0, -2.0, 0.0], [28, 12, 18, 6, 40])
    ranks = scipy.stats.rankdata(np.abs(d[d != 0]))
    n, positive = len(ranks), ranks[d[d != 0] > 0].sum()
    variance = n * (n + 1) * (2 * n + 1) / 24 - (40**3 - 40 + 24**3 - 24) / 48
    z = (positive - n * (n + 1) / 4) / math.sqrt(variance)
    found = statistics.wilcoxon(d)
    assert found.nonzero == 64
    assert found.p == pytest.approx(2 * scipy.stats.norm.sf(abs(z)))


def test_all_zero_differences_are_no_evidence():
    assert statistics.wilcoxon(np.zeros(7)) == statistics.Wilcoxon(0, 0.0, 1.0)
    assert statistics.wilcoxon([]) == statistics.Wilcoxon(0, 0.0, 1.0)
    assert statistics.rank_biserial(np.zeros(7)) is None


@settings(deadline=None)
@given(numbers, st.randoms(use_true_random=False))
def test_wilcoxon_and_effect_sizes_are_symmetric_and_know_no_order(values: list[float], random: Any):
    d = np.array(values)
    shuffled = np.array(random.sample(values, len(values)))
    for other, sign in ((-d, -1.0), (shuffled, 1.0)):
        assert statistics.wilcoxon(other).p == pytest.approx(statistics.wilcoxon(d).p, rel=1e-9)
        for effect in (statistics.rank_biserial, statistics.cohens_dz):
            mine, theirs = effect(d), effect(other)
            assert mine == (None if theirs is None else pytest.approx(sign * theirs, abs=1e-9))


def test_effect_sizes_by_hand():
    d = [3.0, 1.0, -2.0, 0.0]
    assert statistics.rank_biserial(d) == pytest.approx((3 + 1 - 2) / 6)
    assert statistics.cohens_dz(d) == pytest.approx(0.5 / np.std(d, ddof=1))
    assert statistics.rank_biserial([0.1, 0.2]) == 1.0
    assert statistics.cohens_dz([0.2, 0.2]) is None
    assert statistics.cohens_dz([0.2]) is None
    assert statistics.cohens_dz([0.9 - 0.6, 0.8 - 0.5, 0.7 - 0.4]) is None  # alike but for rounding


# -- Holm ----------------------------------------------------------------------------------------


def test_holm_by_hand():
    assert statistics.holm([0.04, 0.01, 0.03]) == pytest.approx([0.06, 0.03, 0.06])
    assert statistics.holm([]) == []


def test_a_comparison_that_could_not_be_made_is_not_counted():
    assert statistics.holm([0.01, None, 0.04]) == pytest.approx([0.02, None, 0.04])
    assert statistics.holm([None]) == [None]
    with pytest.raises(InputError, match="nan is not a p-value"):
        statistics.holm([0.01, math.nan])


@settings(deadline=None, max_examples=40)
@given(p_values, st.randoms(use_true_random=False))
def test_holm_is_monotone_and_never_below_the_raw_value(p: list[float], random: Any):
    adjusted = [q or 0.0 for q in statistics.holm(p)]
    assert all(raw <= q <= 1 for raw, q in zip(p, adjusted, strict=True))
    ordered = [q for _, q in sorted(zip(p, adjusted, strict=True))]
    assert ordered == sorted(ordered)
    assert adjusted[int(np.argmin(p))] == pytest.approx(min(1.0, len(p) * min(p)))
    order = random.sample(range(len(p)), len(p))
    assert statistics.holm([p[i] for i in order]) == pytest.approx([adjusted[i] for i in order])


# -- intervals -----------------------------------------------------------------------------------


def test_the_bootstrap_is_scipys_paired_one():
    rng = np.random.default_rng(5)
    a, b = rng.random(80), rng.random(80)
    mine = statistics.bootstrap_mean(a - b, seed=3)
    theirs = scipy.stats.bootstrap(
        (a, b),
        lambda x, y, axis: np.mean(x, axis) - np.mean(y, axis),
        paired=True,
        method="percentile",
        n_resamples=10_000,
        batch=1000,
        rng=np.random.default_rng(3),
    ).confidence_interval
    assert mine is not None
    assert (mine.low, mine.high) == pytest.approx((theirs.low, theirs.high), abs=1e-12)


def test_the_bootstrap_is_what_its_definition_says():
    """Against a plain loop with draws of its own; the ends agree within four of their standard errors."""
    d = np.random.default_rng(6).exponential(size=50)
    rng = np.random.default_rng(7)
    means = [d[rng.integers(0, 50, 50)].mean() for _ in range(10_000)]
    found = statistics.bootstrap_mean(d)
    assert found is not None
    assert (found.low, found.high) == pytest.approx(tuple(np.percentile(means, [2.5, 97.5])), abs=0.02)


def test_the_same_seed_gives_the_same_interval():
    d = np.random.default_rng(8).normal(size=40)
    assert statistics.bootstrap_mean(d) == statistics.bootstrap_mean(d)
    assert statistics.bootstrap_mean(d) != statistics.bootstrap_mean(d, seed=1)


@settings(deadline=None)
@given(numbers, st.integers(0, 3))
def test_the_bootstrap_turns_with_its_differences(values: list[float], seed: int):
    d = np.array(values)
    one = statistics.bootstrap_mean(d, resamples=200, seed=seed)
    other = statistics.bootstrap_mean(-d, resamples=200, seed=seed)
    assert one is not None
    assert other is not None
    assert (one.low, one.high) == pytest.approx((-other.high, -other.low), abs=1e-12)
    assert d.min() - 1e-12 <= one.low <= one.high <= d.max() + 1e-12


def test_an_interval_needs_two_values():
    assert statistics.bootstrap_mean([]) is None
    assert statistics.bootstrap_mean([0.5]) is None
    assert statistics.bootstrap_mean([0.5, 0.5]) == statistics.Interval(0.5, 0.5)


def test_wilson_by_its_formula():
    z = scipy.stats.norm.ppf(0.975)
    for k, n in ((72, 100), (0, 10), (10, 10), (1, 3)):
        middle, scale = (k + z**2 / 2) / (n + z**2), z / (n + z**2)
        half = scale * math.sqrt(k * (n - k) / n + z**2 / 4)
        found = statistics.wilson(k, n)
        assert (found.low, found.high) == pytest.approx((middle - half, middle + half), abs=1e-12)
        assert 0 <= found.low <= found.high <= 1
    with pytest.raises(InputError, match="11 successes of 10 trials"):
        statistics.wilson(11, 10)


# -- power ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("won", "lost"), [(0.3, 0.1), (0.45, 0.05), (0.2, 0.2)])
def test_power_is_the_sum_over_all_outcomes(won: float, lost: float):
    n = 24
    counts = [(b, c, n - b - c) for b in range(n + 1) for c in range(n + 1 - b)]
    chances = scipy.stats.multinomial.pmf(np.array(counts), n, [won, lost, 1 - won - lost])
    rejected = [statistics.mcnemar_p(b, c) <= 0.05 for b, c, _ in counts]
    assert power.mcnemar_power(n, won, lost) == pytest.approx(float(chances @ rejected), abs=1e-9)


@pytest.mark.parametrize(("won", "lost"), [(0.08, 0.02), (0.23, 0.04), (0.10, 0.15)])
def test_the_number_of_episodes_is_confirmed_by_simulation(won: float, lost: float):
    n = power.pairs_needed(won, lost)
    assert n is not None
    draws = np.random.default_rng(9).multinomial(n, [won, lost, 1 - won - lost], size=20_000)[:, :2]
    outcomes, times = np.unique(draws, axis=0, return_counts=True)
    rejected = [statistics.mcnemar_p(int(b), int(c)) <= power.ALPHA for b, c in outcomes]
    assert float(np.average(rejected, weights=times)) == pytest.approx(power.POWER, abs=0.012)  # four errors
    assert power.mcnemar_power(n - 1, won, lost) < power.POWER <= power.mcnemar_power(n, won, lost)
    assert 0 <= n - power.connor(won, lost) <= 0.15 * n


def test_what_the_papers_differences_would_need():
    """2 points at 4 and 2 discordant pairs of 100 are far beyond 100 episodes, 6 points at 8 and 2 too."""
    needed = {
        name: power.pairs_needed(line["reference_only"] / EPISODES, line["other_only"] / EPISODES)
        for name, line in PAPER["planners"].items()
    }
    assert needed == {"explicit": 1244, "amortized": 231}


def test_equal_methods_need_no_number():
    assert power.pairs_needed(0.05, 0.05) is None
    assert power.pairs_needed(0.0, 0.0) is None
    assert power.pairs_needed(0.2000, 0.2001) is None
    assert power.mcnemar_power(100, 0.0, 0.0) == 0.0
    assert power.mcnemar_power(5, 1.0, 0.0) == 0.0  # 5 of 5 is p = 0.0625
    assert power.mcnemar_power(6, 1.0, 0.0) == 1.0
    assert power.pairs_needed(1.0, 0.0) == 6


def test_what_a_hundred_pairs_can_show():
    delta = power.detectable_difference(100, 0.2)
    assert delta is not None
    assert power.mcnemar_power(100, 0.1 + delta / 2, 0.1 - delta / 2) >= power.POWER
    assert power.mcnemar_power(100, 0.1 + delta / 2 - 1e-4, 0.1 - delta / 2 + 1e-4) < power.POWER
    assert delta == pytest.approx(0.1278, abs=1e-6)
    assert power.detectable_difference(100, 0.06) is None  # not even six against none
    assert power.detectable_difference(100, 0.0) is None


def test_the_power_of_a_paired_t_test():
    assert power.pairs_needed_mean(0.5) == 34  # the textbook's
    assert power.pairs_needed_mean(-0.5) == 34
    assert power.pairs_needed_mean(0.0) is None
    assert power.pairs_needed_mean(0.002) is None  # near two million
    d = np.random.default_rng(10).normal(0.3, 1, (4000, power.pairs_needed_mean(0.3) or 0))
    significant = scipy.stats.ttest_1samp(d, 0, axis=1).pvalue <= power.ALPHA
    assert np.mean(significant) == pytest.approx(power.POWER, abs=0.026)


# -- wrong input ---------------------------------------------------------------------------------


def test_wrong_arrays_are_refused():
    with pytest.raises(InputError, match=r"one length, not of shapes \(2,\) and \(3,\)"):
        statistics.mcnemar(np.ones(2, bool), np.ones(3, bool))
    with pytest.raises(InputError, match="takes booleans, not int64 and bool"):
        statistics.mcnemar(np.ones(2, int), np.ones(2, bool))
    with pytest.raises(InputError, match="differences have 1 entries that are not finite"):
        statistics.wilcoxon([0.1, math.nan])
    with pytest.raises(InputError, match=r"values have shape \(2, 2\)"):
        statistics.bootstrap_mean(np.zeros((2, 2)))
    with pytest.raises(InputError, match="cannot be negative"):
        statistics.mcnemar_p(-1, 2)
    with pytest.raises(InputError, match=r"0\.7 and 0\.5 are no shares"):
        power.pairs_needed(0.7, 0.5)


def test_a_missing_package_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "statsmodels.stats.proportion", None)
    monkeypatch.setitem(sys.modules, "statsmodels", None)
    with pytest.raises(InputError, match=r"needs the optional package `statsmodels`[\s\S]*\[report\]"):
        statistics.wilson(1, 2)
