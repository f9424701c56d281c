"""How searches end: what a failure returned, so that the eye's errors are told from the planner's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from statistics import mean

from fuse_grounding.benchmark.report import plots
from fuse_grounding.benchmark.report.load import Part
from fuse_grounding.benchmark.report.load import Row as Result
from fuse_grounding.benchmark.report.model import Cell, Column, Row, Table

_TOUCHES = 0.1
"""Least IoU with a valid object for a mask to be called one of it. Ours."""


def table(part: Part) -> Table:
    """Share of episodes by how they ended; and of failures, those that held a success on the way."""
    columns = [
        Column("method", "Method", word=True),
        Column("episodes", "n", "", 0),
        Column("success", "Success", "%", 1, 100.0, better="higher"),
        Column("rough", "Valid object, rough mask", "%", 1, 100.0),
        Column("another", "Another object", "%", 1, 100.0),
        Column("nothing", "Nothing found", "%", 1, 100.0),
        Column("error", "Error", "%", 1, 100.0),
        Column("lost", "Given up on the way", "% of failures", 1, 100.0, better="lower"),
        Column("unscored", "Never scored", "% of failures", 1, 100.0, better="lower"),
        Column("views_won", "Views, success", "per episode", 1),
        Column("views_lost", "Views, failure", "per episode", 1),
    ]
    lines = []
    for arm in part.arms:
        rows = list(arm.rows.values())
        if not rows:
            continue
        ends = Counter(ending(r) for r in rows)
        kinds = ("success", "rough", "another", "nothing", "error")
        cells = [Cell(plots.name(arm)), Cell(len(rows)), *(Cell(ends[k] / len(rows)) for k in kinds)]
        failures = [r for r in arm.done if not r["success"]]
        limit = float(arm.settings.get("metric.iou", 0.5))
        cells += [
            Cell(_share(failures, lambda r: max(s["best_iou"] for s in r["trace"]), at_least=limit)),
            Cell(_share(failures, lambda r: all(s["best_score"] is None for s in r["trace"]))),
            *(Cell(_views([r for r in arm.done if r["success"] == won])) for won in (True, False)),
        ]
        lines.append(Row(cells))
    caption = (
        f"Share of the episodes of `{part.set_name}` by how they ended. Rough mask: the returned mask "
        f"overlaps a valid object, with an IoU of at least {_TOUCHES:g} and below that of a success; another "
        "object: less than that; nothing found: no mask. Given up on the way: failures that would have been "
        "a success had the search ended at an earlier view; a surer or nearer mask replaced it. Never "
        "scored: failures in which no view had a region large enough."
    )
    return Table(f"{part.set_name}_{part.name}_endings", "How searches end", caption, columns, lines)


def ending(row: Result) -> str:
    """`success`, `rough`, `another`, `nothing` or `error`."""
    if row["status"] != "ok":
        return "error"
    if row["success"]:
        return "success"
    if row.get("label") is None:
        return "nothing"
    return "rough" if row["iou"] >= _TOUCHES else "another"


def _share(failures: Sequence[Result], of: Callable[[Result], float], at_least: float = 1) -> float | None:
    """Share of failures whose value reaches `at_least`; None without failures or traces."""
    if not failures or not all(r.get("trace") for r in failures):
        return None
    return mean(of(r) >= at_least for r in failures)


def _views(rows: Sequence[Result]) -> float | None:
    return mean(r["observations"] for r in rows) if rows else None
