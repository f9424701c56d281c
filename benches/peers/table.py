"""From measurements to one table in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

MILESTONES = (1000, 2500)
OPENSPLAT, TORCH, BRUSH = "OpenSplat", "torch-splatting", "Brush"


def train_seconds(timed: Mapping[int, float], gaussians: Mapping[int, int], until: int) -> float | None:
    """Seconds of `until` iterations: quiet seconds an iteration, measured at some numbers of Gaussians and
    interpolated between them (held beyond), summed over the numbers that the training went through.

    `timed`: Gaussians to seconds an iteration; `gaussians`: iteration to Gaussians. None where they end
    before `until` or nothing was timed.
    """
    at = sorted(i for i in gaussians if i <= until)
    if not timed or not at or at[-1] != until:
        return None
    counts = sorted(timed)
    total, last = 0.0, min(gaussians) if 0 not in gaussians else 0
    for here in at:
        now = float(np.interp(gaussians[here], counts, [timed[c] for c in counts]))
        before = gaussians.get(last, gaussians[here])
        then = float(np.interp(before, counts, [timed[c] for c in counts]))
        total += (here - last) * (now + then) / 2
        last = here
    return total


def time_to(curve: Sequence[Mapping[str, float]], psnr: float) -> float | None:
    """Seconds after which a curve first has this PSNR; None: never."""
    return next((point["seconds"] for point in curve if point["psnr"] >= psnr), None)


def _cell(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def _ratio(theirs: float | None, ours: float | None) -> str:
    return "–" if theirs is None or not ours else f"{theirs / ours:.0f}×"


def render(results: Mapping[str, Any]) -> str:
    """The table. `results`: what `peers.py` keeps, by program and measurement."""
    ours = results.get("fuse", {})
    same = {row["gaussians"]: row["seconds"] for row in ours.get("iterations", {}).get("rows", [])}
    trained = results.get(OPENSPLAT, {}).get("quality", {})
    reached = {int(i): row for i, row in trained.get("maps", {}).items()}
    head = ["program", "Gaussians", "s an iteration", "over ours", "memory, MiB"]
    head += [f"PSNR after {m}" for m in MILESTONES]
    for m in MILESTONES:
        head += [f"s to OpenSplat's PSNR at {m}", "over ours (best)"]
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]

    curves = {name: row["curve"] for name, row in ours.get("quality", {}).items() if isinstance(row, dict)}
    best = {}
    for m in MILESTONES:
        target = reached.get(m, {}).get("psnr")
        times = [time_to(c, target) for c in curves.values()] if target is not None else []
        best[m] = min((t for t in times if t is not None), default=None)
    for name in (OPENSPLAT, TORCH, BRUSH):
        peer = results.get(name, {})
        if "failed" in peer:
            lines.append(f"| {name} | not measured: {peer['failed']} |" + " |" * (len(head) - 2))
            continue
        rows = peer.get("iterations", {}).get("rows", [])
        for k, row in enumerate(rows):
            cells = [name, f"{row['gaussians']:,}", f"{row['seconds']:.3f}"]
            cells += [_ratio(row["seconds"], same.get(row["gaussians"])), f"{row['peak_mib']:,.0f}"]
            if name == OPENSPLAT and k == 0:
                timed = {r["gaussians"]: r["seconds"] for r in rows}
                grown = {0: rows[0]["gaussians"]} | {i: r["gaussians"] for i, r in reached.items()}
                cells += [_cell(reached.get(m, {}).get("psnr"), ".2f") for m in MILESTONES]
                for m in MILESTONES:
                    seconds = train_seconds(timed, grown, m)
                    cells += [_cell(seconds, ".0f"), _ratio(seconds, best[m])]
            lines.append("| " + " | ".join(cells + ["–"] * (len(head) - len(cells))) + " |")
    for gaussians, seconds in same.items():
        cells = ["FUSE, `official`", f"{gaussians:,}", f"{seconds:.4f}", "1×"]
        lines.append("| " + " | ".join(cells + ["–"] * (len(head) - len(cells))) + " |")
    for name, curve in curves.items():
        at = {p["iteration"]: p for p in curve}
        memory = ours["quality"][name]["peak_mib"]
        cells = [
            f"FUSE, `{name}`, whole trainings",
            f"to {curve[-1]['gaussians']:,}",
            "–",
            "–",
            f"{memory:,.0f}",
        ]
        cells += [_cell(at.get(m, {}).get("psnr"), ".2f") for m in MILESTONES]
        for m in MILESTONES:
            target = reached.get(m, {}).get("psnr")
            cells += [_cell(time_to(curve, target) if target is not None else None, ".1f"), ""]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
