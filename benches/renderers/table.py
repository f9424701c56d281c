"""From measurements to one table in Markdown and one sheet of pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

AGREEMENT = 0.97
"""Share of pixels whose id must be ours for a picture to count as one of the same scene; edges differ."""
DEPTH = 0.01
"""Median difference of depth, of our depth, that may be."""


def agreement(theirs: Mapping[str, np.ndarray], ours: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Over all views: share of pixels with our id, of objects' pixels alone too, and the median relative
    difference of depth where both hit something."""
    same = theirs["ids"] == ours["ids"]
    objects = ours["ids"] > 0
    both = (ours["depth"] > 0) & (theirs["depth"] > 0)
    off = np.abs(theirs["depth"][both] / ours["depth"][both] - 1)
    return {
        "ids": float(same.mean()),
        "objects": float(same[objects].mean()),
        "depth": float(np.median(off)) if off.size else float("inf"),
    }


def faults(found: Mapping[str, float]) -> str:
    """What is wrong with a picture, or nothing."""
    wrong = []
    if not found["ids"] >= AGREEMENT:
        wrong.append(f"only {found['ids']:.1%} of the ids are ours")
    if not found["depth"] <= DEPTH:
        wrong.append(f"depth differs by {found['depth']:.1%}")
    return " and ".join(wrong)


def _fps(row: Mapping[str, Any], mode: str) -> str:
    rounds = row["fps"].get(mode)
    return f"{np.mean(rounds):.1f}" if rounds else "–"


def render(rows: Sequence[Mapping[str, Any]]) -> str:
    """Frames per second, mean of the rounds. Each row has `name` and `light`, and either `failed`, a
    sentence, or `fps` by mode, `setup` seconds and `agreement`."""
    head = ["renderer", "light", "colour", "colour + depth + ids", "depth + ids", "set-up, s", "ids as ours"]
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    for row in rows:
        if "failed" in row:
            cells = [row["name"], row["light"], row["failed"], "", "", "", ""]
        else:
            cells = [row["name"], row["light"], *(_fps(row, m) for m in ("color", "all", "depth_ids"))]
            found = row.get("agreement")
            cells += [f"{row['setup']:.1f}", "–" if found is None else faults(found) or f"{found['ids']:.1%}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def sheet(pictures: Sequence[tuple[str, np.ndarray]], columns: int = 3) -> Image.Image:
    """Labelled pictures (H, W, 3) of one size, in rows."""
    height, width = pictures[0][1].shape[:2]
    rows, bar = -(-len(pictures) // columns), 18
    whole = Image.new("RGB", (columns * width, rows * (height + bar)), "white")
    draw = ImageDraw.Draw(whole)
    for k, (name, picture) in enumerate(pictures):
        x, y = k % columns * width, k // columns * (height + bar)
        draw.text((x + 4, y + 3), name, fill="black")
        whole.paste(Image.fromarray(picture), (x, y + bar))
    return whole
