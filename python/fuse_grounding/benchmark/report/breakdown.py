"""Where methods succeed: by verb, by scene, by how much of the target the start shows."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence

from fuse_grounding.benchmark.report import plots
from fuse_grounding.benchmark.report.episodes import Nature
from fuse_grounding.benchmark.report.intervals import share
from fuse_grounding.benchmark.report.load import Arm, Part
from fuse_grounding.benchmark.report.model import Cell, Column, Figure, Row, Table
from fuse_grounding.benchmark.report.svg import Axis, Plot

_EDGES = (0.0, 0.2, 0.3, 0.4, 0.5, 1.0)
_FEW = 5
"""Most arms whose intervals can be told apart in one plot."""


def tables(part: Part, natures: Mapping[str, Nature]) -> list[Table]:
    """Success by verb and by scene, from the rows; by visibility, where the episodes are known."""
    verbs = _groups(part, lambda e, row: str(row.get("verb", "")).replace("_", " "))
    scenes = _groups(part, lambda e, row: str(row.get("scene", "")).replace("_", " "))
    found = [
        _table(part, "verb", "Success by verb", "Verb", verbs),
        _table(part, "scene", "Success by scene", "Scene", scenes),
    ]
    if natures:
        bins = _groups(part, lambda e, row: _bin(natures[e].start_fraction) if e in natures else "")
        found.append(
            _table(
                part, "visibility", "Success by visibility at the start", "Target visible at the start", bins
            )
        )
    return found


def _groups(part: Part, key: Callable[[str, Mapping[str, object]], str]) -> dict[str, set[str]]:
    """Group -> ids of its episodes, in order of the groups."""
    groups: dict[str, set[str]] = {}
    for arm in part.arms:
        for episode, row in arm.rows.items():
            if name := key(episode, row):
                groups.setdefault(name, set()).add(episode)
    return dict(sorted(groups.items()))


def _bin(fraction: float) -> str:
    low, high = next((a, b) for a, b in itertools.pairwise(_EDGES) if fraction < b or b == 1)
    return f"{100 * low:.0f} to {100 * high:.0f} %"


def _outcomes(arm: Arm, episodes: set[str]) -> list[bool]:
    return [bool(arm.rows[e].get("success", False)) for e in sorted(episodes) if e in arm.rows]


def _table(part: Part, name: str, title: str, heading: str, groups: Mapping[str, set[str]]) -> Table:
    columns = [Column(name, heading, word=True), Column("episodes", "n", "", 0)]
    columns += [Column(a.label, plots.name(a), "%", 0, 100.0) for a in part.arms]
    lines = []
    for group, episodes in groups.items():
        cells = [Cell(group), Cell(len(episodes))]
        for arm in part.arms:
            outcomes = _outcomes(arm, episodes)
            rate = sum(outcomes) / len(outcomes) if outcomes else None
            cells.append(Cell(rate, tint=rate))
        lines.append(Row(cells))
    caption = (
        f"Share of the group’s episodes of `{part.set_name}` that end in success; n is the number of "
        "episodes. Groups are small: with ten episodes a rate is known to about ± 30 percentage points."
    )
    return Table(f"{part.set_name}_{part.name}_by_{name}", title, caption, columns, lines)


def visibility(part: Part, natures: Mapping[str, Nature], why_not: str) -> Figure:
    """Success against how much of the target the start shows."""
    title, key = "Success against visibility at the start", f"{part.set_name}_visibility"
    groups = [
        ({e for e, n in natures.items() if _bin(n.start_fraction) == _bin((a + b) / 2)}, a, b)
        for a, b in itertools.pairwise(_EDGES)
    ]
    groups = [g for g in groups if g[0]]
    if not groups or not part.arms:
        return Figure(key, title, "", missing=f"not recorded: {why_not or 'no episode is known'}")
    style = plots.styles(part.arms)
    high = 100 * min(1.0, max(n.start_fraction for n in natures.values()) + 0.1)
    plot = Plot(Axis("target visible at the start, %", 0, high), Axis("success, % of episodes", 0, 100))
    for i, arm in enumerate(part.arms):
        line = []
        for episodes, *_ in groups:
            outcomes = _outcomes(arm, episodes)
            if not outcomes:
                continue
            at = 100 * sum(natures[e].start_fraction for e in episodes) / len(episodes)
            at += 0.8 * (i - (len(part.arms) - 1) / 2) * (len(part.arms) <= _FEW)
            rate = share(outcomes).times(100)
            if len(part.arms) <= _FEW:
                plot.whisker(at, rate.low, rate.high, style[arm.label])
            line.append((at, rate.value, len(outcomes)))
        plot.line([(x, y) for x, y, _ in line], style[arm.label])
        for x, y, n in line:
            plot.mark(x, y, style[arm.label], f"{plots.name(arm)}: {y:.0f} % of {n} episodes", size=4)
    caption = (
        "Share of episodes that end in success, grouped by visible over unoccluded pixels of the sampled "
        f"target in the start view, {_counts([len(e) for e, *_ in groups])}{_whiskers(part)}."
    )
    return Figure(key, title, caption, plot.svg(title), plots.legend(part.arms, style))


def _counts(sizes: Sequence[int]) -> str:
    return "n = " + ", ".join(map(str, sizes)) + " episodes from left to right"


def _whiskers(part: Part) -> str:
    return " (Wilson 95 % intervals)" if len(part.arms) <= _FEW else ""
