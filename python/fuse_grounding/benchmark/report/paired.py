"""Paired tables: an arm against others on the same episodes (supplement, Paired Statistical Protocol)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from fuse_grounding.benchmark import comparison
from fuse_grounding.benchmark.metrics import METRICS
from fuse_grounding.benchmark.report import labels, plots
from fuse_grounding.benchmark.report.load import MAIN, Arm, Part
from fuse_grounding.benchmark.report.model import Cell, Column, Row, Table
from fuse_grounding.benchmark.report.summary import ARM, metric_column, rows
from fuse_grounding.benchmark.statistics import Interval

_METRICS = (
    "iou",
    "online_actions",
    "target_pixel_ratio",
    "target_pixel_ratio_90",
    "best_target_score",
    "center_score",
    "distance_score",
    "runtime_seconds",
)
"""The continuous metrics of the paper's table, and runtime."""


def has(part: Part, wanted: str | None) -> bool:
    """Whether an arm of the part has that label or method."""
    return any(wanted in (a.label, a.method) for a in part.arms)


def names(parts: Sequence[Part]) -> list[str]:
    """What `has` knows, each once."""
    return list(dict.fromkeys(name for p in parts for a in p.arms for name in (a.method, a.label)))


def reference(part: Part, wanted: str | None = None) -> Arm:
    """The arm that the others are compared with.

    `wanted` is a label or a method that the part has; without it, the arm at the default settings, FUSE
    before others.
    """
    if wanted is not None:
        return part.default([a for a in part.arms if wanted in (a.label, a.method)])
    fuse = [a for a in part.arms if a.method == "fuse"]
    return part.default(fuse or list(reversed(part.arms)))


def tables(part: Part, wanted: str | None = None) -> list[Table]:
    """Success, then the continuous metrics; empty where there is nothing to compare.

    Where several methods were run under several settings, each is compared with itself.
    """
    by_method = Counter(arm.method for arm in part.arms)
    several = [method for method, arms in by_method.items() if arms > 1]
    if len(several) < 2 or part.name == MAIN:
        return _of(part, wanted)
    parts = [
        replace(part, name=f"{part.name}_{m}", arms=[a for a in part.arms if a.method == m]) for m in several
    ]
    made = [
        (table, labels.method(method))
        for method, mine in zip(several, parts, strict=True)
        for table in _of(mine)
    ]
    return [replace(table, title=f"{table.title}, {name}") for table, name in made]


def _of(part: Part, wanted: str | None = None) -> list[Table]:
    shared = set(part.episodes)
    if len(part.arms) < 2 or not shared:
        return []
    first = reference(part, wanted)
    of_shared = _times_of_a_kind([r for r in rows(part) if r["episode_id"] in shared], first)
    there = {k for r in of_shared for k in r}
    metrics = [m for m in _METRICS if m in there]
    found = comparison.compare(of_shared, first.label, metrics=metrics, by=ARM)
    names = {a.label: plots.name(a) for a in part.arms}
    return [_success(part, found, names), _continuous(part, found, names)]


def _times_of_a_kind(found: Sequence[Mapping[str, Any]], first: Arm) -> list[dict[str, Any]]:
    """Rows without the runtime that was measured otherwise (alone, beside others) than the reference's."""
    beside = {e: bool(r.get("concurrent")) for e, r in first.rows.items()}
    return [
        {**r, "runtime_seconds": None} if bool(r.get("concurrent")) != beside[r["episode_id"]] else dict(r)
        for r in found
    ]


def _heading(part: Part, found: comparison.Comparison, names: dict[str, str]) -> str:
    return (
        f"{names[found.reference]} against the others on the same {found.episodes} episodes of "
        f"`{part.set_name}`. Differences are the reference minus the other"
    )


def _ends(value: float | None, interval: Interval | None) -> Cell:
    return Cell(value) if interval is None else Cell(value, interval.low, interval.high)


def _p(value: float | None) -> Cell:
    return Cell(value, text="< 0.001") if value is not None and value < 0.001 else Cell(value)


def _needed(value: int | None) -> Cell:
    return Cell(value) if value is not None else Cell(text="none")


def _success(part: Part, found: comparison.Comparison, names: dict[str, str]) -> Table:
    columns = [
        Column("other", "Other", word=True),
        Column("reference_successes", "Reference", "successes", 0),
        Column("other_successes", "Other", "successes", 0),
        Column("delta_points", "Δ", "pp", 1),
        Column("reference_only", "Reference only", "episodes", 0),
        Column("other_only", "Other only", "episodes", 0),
        Column("p", "McNemar p", "exact", 3),
        Column("holm_p", "Holm p", "", 3),
        Column("odds_ratio", "Odds ratio", "", 2),
        Column("cohens_g", "Cohen’s g", "", 2),
        Column("pairs_needed", "Episodes needed", "power 0.8", 0),
        Column("detectable_points", "Detectable", "pp", 1),
    ]
    lines = [
        Row(
            [
                Cell(names[c.other]),
                Cell(c.reference_successes),
                Cell(c.other_successes),
                _ends(c.delta_points, c.interval_points),
                Cell(c.reference_only),
                Cell(c.other_only),
                _p(c.p),
                _p(c.holm_p),
                Cell(c.odds_ratio),
                Cell(c.cohens_g),
                _needed(c.pairs_needed),
                Cell(c.detectable_points),
            ]
        )
        for c in found.success
    ]
    caption = (
        f"{_heading(part, found, names)}, with the 95 % interval of {found.resamples:,} paired bootstrap "
        "resamples; the exact two-sided McNemar test; Holm’s adjustment over all lines of this table."
    )
    notes = [
        "“Episodes needed”: how many pairs would show a difference of this size with power 0.8 at the level "
        "0.05 (none: no difference, or over a million). “Detectable”: the smallest difference that these "
        "pairs would show, at the observed share of discordant pairs."
    ]
    title = "Paired: success"
    return Table(f"{part.set_name}_{part.name}_paired_success", title, caption, columns, lines, notes)


def _continuous(part: Part, found: comparison.Comparison, names: dict[str, str]) -> Table:
    known = {m.name: m for m in METRICS}
    columns = [
        Column("other", "Other", word=True),
        Column("metric", "Metric", word=True),
        Column("pairs", "Pairs", "", 0),
        Column("reference_mean", "Reference", "mean", 3),
        Column("other_mean", "Other", "mean", 3),
        Column("delta", "Δ", "", 3),
        Column("p", "Wilcoxon p", "", 3),
        Column("holm_p", "Holm p", "", 3),
        Column("d_z", "Effect", "d_z", 2),
        Column("rank_biserial", "Effect", "rank-biserial", 2),
        Column("pairs_needed", "Episodes needed", "power 0.8", 0),
    ]
    lines = []
    for c in found.continuous:
        metric = metric_column(known[c.metric])
        unit = f", {metric.unit}" if metric.unit in ("s", "m") else ""
        lines.append(
            Row(
                [
                    Cell(names[c.other]),
                    Cell(f"{metric.title}{unit}"),
                    Cell(c.pairs),
                    Cell(c.reference_mean),
                    Cell(c.other_mean),
                    _ends(c.delta, c.interval),
                    _p(c.p),
                    _p(c.holm_p),
                    Cell(c.d_z),
                    Cell(c.rank_biserial),
                    _needed(c.pairs_needed),
                ]
            )
        )
    caption = (
        f"{_heading(part, found, names)}, with the 95 % interval of {found.resamples:,} paired bootstrap "
        "resamples; two-sided Wilcoxon signed-rank tests; Holm’s adjustment within each metric."
    )
    notes = [
        "Shares and scores are in [0, 1]. Pairs in which either method has no value are left out, and pairs "
        "of times of which one was measured alone and the other beside other episodes."
    ]
    title = "Paired: other metrics"
    return Table(f"{part.set_name}_{part.name}_paired_metrics", title, caption, columns, lines, notes)
