"""The paper's figures, to stand beside ours: another simulator, other objects and scenes, other networks."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from fuse_grounding.benchmark.report.load import Arm, Part
from fuse_grounding.benchmark.report.model import Cell, Column, Row, Table
from fuse_grounding.benchmark.report.summary import Summary

WARNING = (
    "The paper's columns are from another world: another simulator, other objects and scenes, other networks "
    "and hardware. They say which way its comparisons went; the numbers themselves are not comparable."
)
NOT_RUN = "not run here"

_METRICS = (
    ("success", "Success", "%", 1, 100.0),
    ("iou", "IoU", "%", 1, 100.0),
    ("steps", "Steps", "actions", 2, 1.0),
    ("target_pixel_ratio", "Target pixel ratio", "%", 1, 100.0),
    ("center_score", "Center", "%", 1, 100.0),
    ("distance_score", "Distance", "%", 1, 100.0),
    ("final_score", "Final score", "%", 1, 100.0),
)


@cache
def facts() -> Mapping[str, Any]:
    """`assets/paper_tables.json`: its keys say what it holds, `about` the units."""
    path = Path(__file__).parent / "assets" / "paper_tables.json"
    return json.loads(path.read_text(encoding="utf-8"))


def _main(arm: Arm) -> str:
    return arm.method


def _knowledge(arm: Arm) -> str:
    source = next((str(r["knowledge"]) for r in arm.rows.values() if r.get("knowledge")), "")
    return {"graph": "crafte", "plain": "craft", "oracle": "oracle"}.get(source.split(":")[0], source)


def _stopping(arm: Arm) -> str:
    depth = arm.settings.get("stopping.weights", [0.7, 0.3])[1] > 0
    return f"sam3_{'depth_' if depth else ''}k{arm.settings.get('stopping.patience', 5)}"


def _evidence(arm: Arm) -> str:
    return "clip_patch" if "patch" in str(arm.settings.get("segmenter.name", "")) else "sam3_pixel"


_COUNTERPARTS: Mapping[str, Callable[[Arm], str]] = {
    "main": _main,
    "knowledge": _knowledge,
    "stopping": _stopping,
    "evidence": _evidence,
}
"""Which row of the paper's table of that name an arm answers to."""


def beside(part: Part, summaries: Mapping[str, Summary]) -> Table | None:
    """Every row of the paper's table of this part, ours beside it; None for a part without one."""
    known = facts().get(part.name)
    counterpart = _COUNTERPARTS.get(part.name)
    if known is None or counterpart is None:
        return None
    answering: dict[str, list[Arm]] = {}
    for arm in part.arms:
        answering.setdefault(counterpart(arm), []).append(arm)
    arms = {name: part.default(found) for name, found in answering.items()}
    shown = [m for m in _METRICS if any(m[0] in row for row in known.values())]
    columns = [Column("row", "Row of the paper", word=True)]
    if part.name != "main":
        columns.append(Column("arm", "Here", word=True))
    for key, title, unit, digits, scale in shown:
        columns.append(Column(f"{key}_here", "here", unit, digits, scale, group=title))
        columns.append(Column(f"{key}_paper", "paper", unit, digits, scale, group=title))
    rows = [_row(part, entry, arms.get(name), summaries, shown) for name, entry in known.items()]
    title = "Beside the paper’s figures (another world: other simulator, objects, networks)"
    caption = (
        f"“Here”: means over the episodes of `{part.set_name}` in this world. “Paper”: as published, over "
        f"{facts()['episodes']} episodes. Steps are online actions here."
    )
    return Table(f"{part.set_name}_{part.name}_paper", title, caption, columns, rows, [WARNING])


def _row(
    part: Part,
    entry: Mapping[str, Any],
    arm: Arm | None,
    summaries: Mapping[str, Summary],
    shown: Sequence[tuple[str, str, str, int, float]],
) -> Row:
    cells = [Cell(entry["label"])]
    if part.name != "main":
        cells.append(Cell(NOT_RUN if arm is None else arm.label))
    for key, *_ in shown:
        ours = None
        if arm is not None:
            ours = summaries[arm.label].value("online_actions" if key == "steps" else key)
        nothing = NOT_RUN if arm is None and part.name == "main" and key == shown[0][0] else None
        cells.append(Cell(ours, text=nothing))
        cells.append(Cell(entry.get(key)))
    return Row(cells)
