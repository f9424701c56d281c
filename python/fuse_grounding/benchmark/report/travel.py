"""Where the camera went: how high, how far around, how many views it saw twice."""

from __future__ import annotations

from collections import Counter
from statistics import mean

from fuse_grounding.benchmark.report import plots
from fuse_grounding.benchmark.report.load import Arm, Part
from fuse_grounding.benchmark.report.load import Row as Result
from fuse_grounding.benchmark.report.model import Cell, Column, Row, Table


def table(part: Part) -> Table | None:
    """Means over episodes of searches that moved along the ring; None where no trace says where."""
    paths = {a.label: found for a in part.arms if (found := _paths(a))}
    if not paths:
        return None
    pitches = sorted({pitch for found in paths.values() for path, _ in found for _, pitch in path})
    columns = [
        Column("method", "Method", word=True),
        Column("episodes", "n", "", 0),
        Column("views", "Views", "per episode", 1),
        Column("distinct", "Distinct views", "per episode", 1),
        Column("around", "Farthest around", "degrees from the start", 0),
        *(
            Column(f"pitch_{p:g}", f"At {p:g}°", "% of views", 0, 100.0, group="After the start")
            for p in pitches
        ),
    ]
    lines = []
    for arm in part.arms:
        if arm.label not in paths:
            continue
        found = paths[arm.label]
        heights = Counter(pitch for path, _ in found for _, pitch in path[1:])
        moved = sum(heights.values()) or 1
        lines.append(
            Row(
                [
                    Cell(plots.name(arm)),
                    Cell(len(found)),
                    Cell(mean(len(path) for path, _ in found)),
                    Cell(mean(len(set(path)) for path, _ in found)),
                    Cell(mean(far for _, far in found)),
                    *(Cell(heights[p] / moved, tint=heights[p] / moved) for p in pitches),
                ]
            )
        )
    caption = (
        f"Viewpoints of the searches of `{part.set_name}`. Farthest around: the largest angle between the "
        "start and any view; pitch is how far the camera looks down."
    )
    return Table(f"{part.set_name}_{part.name}_travel", "Where the camera went", caption, columns, lines)


def _paths(arm: Arm) -> list[tuple[list[tuple[int, float]], float]]:
    """Node and pitch of every view of a search that has several, and its farthest angle around, degrees."""
    nodes = int(arm.settings.get("camera.nodes", 36))
    found = []
    for row in arm.done:
        path = _path(row)
        if len(path) > 1:
            away = [abs(node - path[0][0]) for node, _ in path]
            found.append((path, max(min(d, nodes - d) for d in away) * 360 / nodes))
    return found


def _path(row: Result) -> list[tuple[int, float]]:
    steps = row.get("trace") or ()
    return [(s["node"], s["pitch_deg"]) for s in steps if s["node"] is not None]
