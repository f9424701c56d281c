"""Each arm by itself: every metric with its interval, and what was not run with its reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fuse_grounding.benchmark import comparison
from fuse_grounding.benchmark.metrics import METRICS, Metric
from fuse_grounding.benchmark.report import labels, plots
from fuse_grounding.benchmark.report.load import Arm, Part, setting
from fuse_grounding.benchmark.report.model import Cell, Column, Row, Table

ARM = "arm"
"""Column of the rows that `rows` makes: the arm's label."""

_PERCENT = ("share", "share of episodes", "score")
_MAIN = (
    "iou",
    "online_actions",
    "total_steps",
    "target_pixel_ratio",
    "center_score",
    "distance_score",
    "final_score",
    "runtime_seconds",
)
_MORE = (
    "observations",
    "target_pixel_ratio_90",
    "observed_pixel_ratio_90",
    "best_target_score",
    "position_error_m",
)


@dataclass(frozen=True)
class Summary:
    """An arm's means by metric."""

    found: comparison.Summary

    def cell(self, metric: str) -> Cell:
        """Mean and interval of a metric; empty where no episode has it."""
        if metric == "success":
            ends = self.found.rate_interval
            return Cell(self.found.rate, ends.low, ends.high)
        mean = next((m for m in self.found.means if m.metric == metric), None)
        if mean is None or mean.mean is None:
            return Cell()
        if mean.interval is None:
            return Cell(mean.mean)
        return Cell(mean.mean, mean.interval.low, mean.interval.high)

    def value(self, metric: str) -> float | None:
        """Mean of a metric."""
        found = self.cell(metric).value
        return float(found) if isinstance(found, float | int) else None

    def episodes(self, metric: str) -> int:
        """How many episodes have a metric."""
        return next((m.episodes for m in self.found.means if m.metric == metric), 0)


def rows(part: Part) -> list[dict[str, object]]:
    """All rows of a part with the label of their arm, for the paired statistics."""
    return [{**row, ARM: arm.label} for arm in part.arms for row in arm.rows.values()]


def summaries(part: Part) -> dict[str, Summary]:
    """By the arm's label."""
    if not part.arms:
        return {}
    return {s.method: Summary(s) for s in comparison.summarize(rows(part), by=ARM)}


def metric_column(metric: Metric) -> Column:
    """The column of a metric: shares in per cent, all else in its unit."""
    percent = metric.unit in _PERCENT
    unit = "%" if percent else {"actions and seed motions": "actions"}.get(metric.unit, metric.unit)
    better = "" if metric.better == "neither" else metric.better
    digits = 1 if percent else 3 if unit == "m" else 2
    return Column(metric.name, metric.title, unit, digits, 100.0 if percent else 1.0, better)


def first_columns(part: Part) -> list[Column]:
    """Method, and each setting that is not the same for all arms."""
    many = len({a.method for a in part.arms}) > 1 or not part.varied
    methods = [Column("method", "Method", word=True)] if many else []
    return methods + [Column(k, k, word=True) for k in part.varied]


def first_cells(part: Part, arm: Arm) -> list[Cell]:
    """What stands in `first_columns` of an arm's line."""
    many = len({a.method for a in part.arms}) > 1 or not part.varied
    methods = [Cell(labels.method(arm.method))] if many else []
    return methods + [_setting_cell(arm.settings.get(k)) for k in part.varied]


def _setting_cell(value: object) -> Cell:
    return Cell(value, text=setting(value)) if isinstance(value, float | int) else Cell(setting(value))


def table(part: Part, found: Mapping[str, Summary]) -> Table:
    """The main table of a part."""
    return _table(part, found, ("success", *_MAIN), "", "Success, cost and view quality")


def more(part: Part, found: Mapping[str, Summary]) -> Table | None:
    """The metrics that the main table leaves out; None without any of them."""
    there = [m for m in _MORE if any(s.value(m) is not None for s in found.values())]
    return _table(part, found, there, "_more", "Further metrics") if there else None


def _table(
    part: Part, found: Mapping[str, Summary], names: tuple[str, ...] | list[str], suffix: str, title: str
) -> Table:
    known = {m.name: m for m in METRICS}
    shown = [n for n in names if n == "success" or any(s.value(n) is not None for s in found.values())]
    columns = [*first_columns(part), Column("episodes", "n", digits=0), Column("errors", "Errors", digits=0)]
    columns += [metric_column(known[n]) for n in shown]
    lines = []
    for arm in part.arms:
        summary = found[arm.label]
        head = [*first_cells(part, arm), Cell(len(arm.rows)), Cell(len(arm.errors))]
        lines.append(Row([*head, *(summary.cell(n) for n in shown)]))
    lines += [Row([Cell(labels.method(name))], note=f"not run: {reason}") for name, reason in part.not_run]
    caption = (
        f"Means over the episodes of `{part.set_name}`, in brackets 95 % intervals: Wilson for success, "
        "percentile bootstrap (10,000 resamples) for the rest."
    )
    notes = _notes(part, found, shown)
    return Table(f"{part.set_name}_{part.name}{suffix}", title, caption, columns, lines, notes)


def concurrent(arms: Sequence[Arm]) -> list[str]:
    """A warning where episodes ran beside others, so that their times are not the protocol's."""
    beside = [plots.name(a) for a in arms if any(r.get("concurrent") for r in a.done)]
    if not beside:
        return []
    return [
        f"Measured while other episodes ran at the same time, which makes them slower: {', '.join(beside)}. "
        "The supplement's protocol runs one after the other (`fuse bench --jobs 1`)."
    ]


def _notes(part: Part, found: Mapping[str, Summary], shown: list[str]) -> list[str]:
    known = {m.name: m for m in METRICS}
    notes = concurrent(part.arms) if "runtime_seconds" in shown else []
    if any(a.errors for a in part.arms):
        notes.append(
            "An episode that ended in an error is a failure: success 0, IoU 0, no value of the other metrics."
        )
    fewer: dict[str, list[str]] = {}
    for name in shown:
        if name == "success":
            continue
        counts = [(a, found[a.label].episodes(name)) for a in part.arms]
        lacking = [f"{plots.name(a)} {n}" for a, n in counts if n < len(a.rows)]
        if lacking:
            fewer.setdefault(", ".join(lacking), []).append(known[name].title)
    notes += [
        f"{', '.join(titles)}: of the episodes that have a value ({who})." for who, titles in fewer.items()
    ]
    return notes
