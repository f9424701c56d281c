"""What `fuse bench` says while it runs, and its tables at the end."""

from __future__ import annotations

import time
from pathlib import Path
from statistics import mean

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from fuse_grounding.benchmark.latency import Latency
from fuse_grounding.benchmark.runner import Row

_WIDTH = 150
"""Columns of a table at least: a log file is wide enough."""


class Teller:
    """A listener that tells each row in a line, with the time left; a bar below them on a terminal."""

    def __init__(self, folder: Path, quiet: bool):
        self._folder = folder
        self.out = Console(quiet=quiet, soft_wrap=True, highlight=False, markup=False)
        self._err = Console(stderr=True, soft_wrap=True, highlight=False, markup=False)
        self._progress: Progress | None = None
        self._done, self._before, self._total, self._errors = 0, 0, 0, 0
        self._began = 0.0

    def opened(self, done: int, total: int) -> None:
        """The clock starts."""
        self.close()
        self._done, self._before, self._total, self._errors = done, done, total, 0
        self._began = time.monotonic()
        if done:
            self.out.print(f"{done} of {total} results are there already")
        if self._err.is_terminal and not self.out.quiet:
            columns = (
                TextColumn("results"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[left]}"),
            )
            self._progress = Progress(*columns, console=self._err, transient=True, redirect_stdout=False)
            self._progress.start()
            self._progress.add_task("", total=total, completed=done, left="")

    def row(self, row: Row, part: str) -> None:
        """One line."""
        self._done += 1
        self._errors += row["status"] != "ok"
        left = "" if self._done == self._total else f"  {self._left()} left"
        if self._progress is not None:
            self._progress.update(self._progress.task_ids[0], completed=self._done, left=left.strip())
            left = ""
        self._say(f"{self._done:4d}/{self._total}  {part}{'  ' if part else ''}{row_line(row)}{left}")

    def note(self, sentence: str) -> None:
        """One line."""
        self._say(f"note  {sentence}")

    def table(self, table: Table) -> None:
        """Prints a table, not narrower than it needs."""
        console = Console(quiet=self.out.quiet)
        console.width = max(console.width, _WIDTH)
        console.print(table)

    def close(self) -> None:
        """Takes the bar away, whatever happened."""
        if self._progress is not None:
            self._progress.stop()
            self._progress = None

    def interrupted(self) -> str:
        """What is there, and how to go on."""
        if not self._total:
            return "interrupted before the first episode; nothing was run"
        errors = f", {self._errors} of them errors" if self._errors else ""
        return (
            f"interrupted: {self._done} of {self._total} results are in {self._folder}{errors}; "
            "the same command with --resume goes on"
        )

    def _say(self, line: str) -> None:
        """One line; above the bar where both are on one terminal."""
        together = self._progress is not None and self.out.is_terminal
        (self._err if together else self.out).print(line)

    def _left(self) -> str:
        each = (time.monotonic() - self._began) / (self._done - self._before)
        return duration(each * (self._total - self._done))


def duration(seconds: float) -> str:
    """Seconds as people say them: `40 s`, `12 min`, `3 h 05 min`."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def row_line(row: Row) -> str:
    """A result in one line."""
    start = f"{row['episode_id']:<24} {row['method']:<14}"
    if row["status"] != "ok":
        return f"{start} error: {row['error']}"
    verdict = "success" if row["success"] else "-"
    return (
        f"{start} {verdict:<8} IoU {row['iou']:.3f}  {row['online_actions']:2d} actions  "
        f"{row['wall_seconds']:.1f} s"
    )


def summary(method: str, rows: list[Row]) -> Row:
    """Means over a method's episodes. An error counts as no success at IoU 0, and is in no other mean.

    `shares` is each stage's part of the measured time.
    """
    mine = [r for r in rows if r["method"] == method]
    ran = [r for r in mine if r["status"] == "ok"]
    counts = {"method": method, "episodes": len(mine), "errors": len(mine) - len(ran)}
    if not ran:
        return counts
    stages: dict[str, float] = {}
    for row in ran:
        for stage, seconds in row["timings"].items():
            stages[stage] = stages.get(stage, 0.0) + seconds
    spent = sum(stages.values()) or 1.0
    return {
        **counts,
        "success": mean(float(r["status"] == "ok" and r["success"]) for r in mine),
        "iou": mean(r["iou"] if r["status"] == "ok" else 0.0 for r in mine),
        "online_actions": mean(r["online_actions"] for r in ran),
        "total_steps": mean(r["total_steps"] for r in ran),
        "seconds": mean(r["wall_seconds"] for r in ran),
        "shares": {s: v / spent for s, v in sorted(stages.items(), key=lambda item: -item[1])},
    }


def summary_table(summaries: list[Row]) -> Table:
    """The summaries, a line a method."""
    table = Table(
        "method", "episodes", "success", "IoU", "actions", "steps", "seconds", "share by stage", box=None
    )
    for s in summaries:
        episodes = f"{s['episodes']} ({s['errors']} errors)" if s["errors"] else f"{s['episodes']}"
        if "success" not in s:
            table.add_row(s["method"], episodes)
            continue
        shares = ", ".join(f"{stage} {share:.0%}" for stage, share in s["shares"].items() if share >= 0.005)
        table.add_row(
            s["method"],
            episodes,
            f"{s['success']:.0%}",
            f"{s['iou']:.3f}",
            f"{s['online_actions']:.1f}",
            f"{s['total_steps']:.1f}",
            f"{s['seconds']:.1f}",
            shares,
        )
    return table


def latency_table(latency: Latency) -> Table:
    """The latency of one method, a line a component."""
    beside = f"; {latency.concurrent} of them beside others: no measurement" if latency.concurrent else ""
    title = f"{latency.method}, {latency.episodes} episodes{beside}"
    table = Table(
        "component",
        "calls/episode",
        "s/call",
        "s/episode",
        "share",
        box=None,
        title=title,
        title_justify="left",
    )
    for name, c in latency.components.items():
        each = "-" if c.s_per_call is None else f"{c.s_per_call:.4f}"
        table.add_row(name, f"{c.calls_per_ep:.2f}", each, f"{c.s_per_ep:.4f}", f"{c.share_pct:.2f} %")
    table.add_row("total", "", "", f"{latency.total_s_per_ep:.4f}", "100 %")
    for name, rate in latency.branch_pct.items():
        table.add_row(f"branch {name}", "", "", "", f"{rate:.2f} %")
    spread = latency.refinements_per_ep
    table.add_row("refinements/episode", f"{spread.mean:.2f} ± {spread.sd:.2f}")
    return table
