"""Rows of results in, tables out: one method against others on the same episodes, and each by itself.

Rows are those of `results.jsonl`. A row whose `status` is not `ok` is a failed episode: success 0 and
IoU 0 (supplement: no mask, IoU zero), and no value of the other metrics, which leaves its pair out of
them. Tables depend neither on the order of the rows nor, but for the order of their lines, on that of the
methods.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fuse_grounding.benchmark import power, statistics
from fuse_grounding.benchmark.metrics import METRICS
from fuse_grounding.benchmark.statistics import RESAMPLES, SEED, Interval
from fuse_grounding.errors import InputError

Row = Mapping[str, Any]
ByEpisode = dict[str, Row]

CONTINUOUS = tuple(metric.name for metric in METRICS if metric.name != "success")
"""Metrics that are compared as numbers."""
_COUNTED_AS_ZERO = ("iou",)
_NAMED = 5


@dataclass(frozen=True)
class SuccessComparison:
    """A line of the paired success table. Points are percentage points, differences reference minus other.

    `holm_p` is adjusted over all others of the same call; `odds_ratio` and `cohens_g` are of the
    discordant pairs, None where undefined; `pairs_needed` episodes would show the observed difference with
    power 0.8, None for no difference or over a million; `detectable_points` is what this number of pairs
    shows at the observed share of discordant pairs, None where not even all of them on one side are
    enough.
    """

    reference: str
    other: str
    pairs: int
    reference_failed: int
    other_failed: int
    reference_successes: int
    other_successes: int
    delta_points: float
    interval_points: Interval | None
    both: int
    reference_only: int
    other_only: int
    neither: int
    p: float
    holm_p: float
    odds_ratio: float | None
    cohens_g: float | None
    pairs_needed: int | None
    detectable_points: float | None


@dataclass(frozen=True)
class ContinuousComparison:
    """A line of the paired continuous table: `pairs` have the metric for both methods, `left_out` do not.

    Means and `delta` (reference minus other) are over those pairs, None without any, as is what follows
    from them; `nonzero` differences were ranked. `holm_p` is adjusted within the metric, over all others of
    the same call. `d_z` and `rank_biserial` are effect sizes, None where undefined; `pairs_needed` as for
    success, by a paired t-test.
    """

    reference: str
    other: str
    metric: str
    pairs: int
    left_out: int
    reference_mean: float | None
    other_mean: float | None
    delta: float | None
    interval: Interval | None
    nonzero: int
    p: float | None
    holm_p: float | None
    d_z: float | None
    rank_biserial: float | None
    pairs_needed: int | None


@dataclass(frozen=True)
class Comparison:
    """Both tables of one reference, with what makes them again: `seed` and `resamples` of the bootstrap."""

    reference: str
    others: tuple[str, ...]
    episodes: int
    success: tuple[SuccessComparison, ...]
    continuous: tuple[ContinuousComparison, ...]
    seed: int
    resamples: int


@dataclass(frozen=True)
class Mean:
    """A metric of one method: its mean over `episodes` that have it, None without any."""

    metric: str
    episodes: int
    mean: float | None
    interval: Interval | None
    """Percentile bootstrap; None for fewer than two episodes."""


@dataclass(frozen=True)
class Summary:
    """A method by itself: `rate` of success in [0, 1] with Wilson's interval, and the means."""

    method: str
    episodes: int
    failed: int
    successes: int
    rate: float
    rate_interval: Interval
    means: tuple[Mean, ...]


def compare(
    rows: Iterable[Row],
    reference: str,
    others: Sequence[str] | None = None,
    *,
    metrics: Sequence[str] | None = None,
    by: str = "method",
    resamples: int = RESAMPLES,
    seed: int = SEED,
) -> Comparison:
    """Paired tables of `reference` against `others`, by default all that the rows have.

    `metrics` are by default those of `CONTINUOUS` that the rows have; `by` is the column that tells the
    compared apart, such as `knowledge` where one method ran with several sources. Holm's families: all
    McNemar tests of the call; and for every metric, all of its Wilcoxon tests.
    Raises InputError for an unknown name, for two rows of one episode, and naming episodes that do
    not have both results.
    """
    table = _by_method(rows, by)
    if others is None:
        others = [name for name in table if name != reference]
    _known(table, [reference, *others], by)
    if reference in others or len(set(others)) < len(others):
        raise InputError(f"`{reference}` is compared with {', '.join(others)}: each must be there once")
    chosen = {name: table[name] for name in (reference, *others)}
    for other in others:
        _complete(reference, table[reference], other, table[other])
    names = _metric_names(metrics, chosen)
    order = sorted(table[reference])
    settings = {"resamples": resamples, "seed": seed}
    success = [_success(reference, other, chosen, order, settings) for other in others]
    adjusted = statistics.holm([line.p for line in success])
    continuous: list[ContinuousComparison] = []
    for metric in names:
        family = [_continuous(reference, other, metric, chosen, order, settings) for other in others]
        within = statistics.holm([line.p for line in family])
        continuous += [replace(line, holm_p=p) for line, p in zip(family, within, strict=True)]
    return Comparison(
        reference=reference,
        others=tuple(others),
        episodes=len(order),
        success=tuple(
            replace(line, holm_p=p) for line, p in zip(success, adjusted, strict=True) if p is not None
        ),
        continuous=tuple(sorted(continuous, key=lambda line: others.index(line.other))),
        **settings,
    )


def summarize(
    rows: Iterable[Row],
    *,
    metrics: Sequence[str] | None = None,
    by: str = "method",
    resamples: int = RESAMPLES,
    seed: int = SEED,
) -> tuple[Summary, ...]:
    """Every method by itself, in the order of the rows. Raises InputError as `compare` does."""
    table = _by_method(rows, by)
    names = _metric_names(metrics, table)
    found = []
    for method, results in table.items():
        order = sorted(results)
        solved = [_solved(results[episode]) for episode in order]
        means = []
        for metric in names:
            values = [v for episode in order if (v := _value(results[episode], metric)) is not None]
            interval = statistics.bootstrap_mean(values, resamples=resamples, seed=seed)
            means.append(Mean(metric, len(values), float(np.mean(values)) if values else None, interval))
        found.append(
            Summary(
                method=method,
                episodes=len(order),
                failed=sum(row["status"] != "ok" for row in results.values()),
                successes=sum(solved),
                rate=sum(solved) / len(order),
                rate_interval=statistics.wilson(sum(solved), len(order)),
                means=tuple(means),
            )
        )
    return tuple(found)


def _success(
    reference: str, other: str, table: Mapping[str, ByEpisode], order: Sequence[str], settings: dict[str, int]
) -> SuccessComparison:
    a, b = (np.array([_solved(table[name][episode]) for episode in order]) for name in (reference, other))
    test = statistics.mcnemar(a, b)
    interval = statistics.bootstrap_mean(100.0 * (a.astype(float) - b), **settings)
    detectable = power.detectable_difference(test.pairs, test.discordant / test.pairs)
    failed = [sum(table[name][episode]["status"] != "ok" for episode in order) for name in (reference, other)]
    return SuccessComparison(
        reference=reference,
        other=other,
        pairs=test.pairs,
        reference_failed=failed[0],
        other_failed=failed[1],
        reference_successes=int(a.sum()),
        other_successes=int(b.sum()),
        delta_points=100.0 * (test.reference_only - test.other_only) / test.pairs,
        interval_points=interval,
        both=test.both,
        reference_only=test.reference_only,
        other_only=test.other_only,
        neither=test.neither,
        p=test.p,
        holm_p=test.p,
        odds_ratio=test.odds_ratio,
        cohens_g=test.cohens_g,
        pairs_needed=power.pairs_needed(test.reference_only / test.pairs, test.other_only / test.pairs),
        detectable_points=None if detectable is None else 100.0 * detectable,
    )


def _continuous(
    reference: str,
    other: str,
    metric: str,
    table: Mapping[str, ByEpisode],
    order: Sequence[str],
    settings: dict[str, int],
) -> ContinuousComparison:
    both = [(_value(table[reference][e], metric), _value(table[other][e], metric)) for e in order]
    pairs = np.array([p for p in both if None not in p], np.float64).reshape(-1, 2)
    d = pairs[:, 0] - pairs[:, 1]
    there = len(d) > 0
    test = statistics.wilcoxon(d)
    d_z = statistics.cohens_dz(d)
    return ContinuousComparison(
        reference=reference,
        other=other,
        metric=metric,
        pairs=len(d),
        left_out=len(order) - len(d),
        reference_mean=float(pairs[:, 0].mean()) if there else None,
        other_mean=float(pairs[:, 1].mean()) if there else None,
        delta=float(d.mean()) if there else None,
        interval=statistics.bootstrap_mean(d, **settings),
        nonzero=test.nonzero,
        p=test.p if there else None,
        holm_p=None,
        d_z=d_z,
        rank_biserial=statistics.rank_biserial(d),
        pairs_needed=None if d_z is None else power.pairs_needed_mean(d_z),
    )


def _by_method(rows: Iterable[Row], by: str) -> dict[str, ByEpisode]:
    """Rows by method and episode, methods in the order in which they come."""
    table: dict[str, ByEpisode] = {}
    for number, row in enumerate(rows, 1):
        missing = [key for key in (by, "episode_id", "status") if key not in row]
        if missing:
            raise InputError(f"result {number} has no `{missing[0]}`")
        results = table.setdefault(str(row[by]), {})
        if row["episode_id"] in results:
            raise InputError(f"`{row[by]}` has two results for episode {row['episode_id']}")
        results[row["episode_id"]] = row
    if not table:
        raise InputError("there are no results to compute statistics of")
    return table


def _known(table: Mapping[str, ByEpisode], names: Sequence[str], by: str) -> None:
    for name in names:
        if name not in table:
            raise InputError(f"the results have no {by} `{name}`; they have {', '.join(table)}")


def _complete(reference: str, ours: ByEpisode, other: str, theirs: ByEpisode) -> None:
    for name, lacks, has in ((other, theirs, ours), (reference, ours, theirs)):
        missing = sorted(has.keys() - lacks.keys())
        if missing:
            more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
            raise InputError(
                f"`{reference}` and `{other}` are compared episode by episode, and `{name}` has no result "
                f"for {', '.join(missing[:_NAMED])}{more}"
            )


def _metric_names(wanted: Sequence[str] | None, table: Mapping[str, ByEpisode]) -> list[str]:
    there = {key for results in table.values() for row in results.values() for key in row}
    if wanted is None:
        return [name for name in CONTINUOUS if name in there]
    for name in wanted:
        if name not in there:
            raise InputError(f"no result has the metric `{name}`; known: {', '.join(CONTINUOUS)}")
    return list(wanted)


def _solved(row: Row) -> bool:
    """Whether the episode is a success; a failed one is not."""
    if row["status"] != "ok":
        return False
    solved = row.get("success")
    if not isinstance(solved, bool):
        raise InputError(f"episode {row['episode_id']}: `success` is {solved!r}, expected true or false")
    return solved


def _value(row: Row, metric: str) -> float | None:
    """A metric of a row; None where there is none."""
    if row["status"] != "ok":
        return 0.0 if metric in _COUNTED_AS_ZERO else None
    value = row.get(metric)
    if value is not None and not isinstance(value, int | float):
        raise InputError(f"episode {row['episode_id']}: `{metric}` is {value!r}, expected a number")
    return None if value is None else float(value)
