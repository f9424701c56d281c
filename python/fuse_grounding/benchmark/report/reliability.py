"""Whether the gate's entropy and the segmenter's score mean what they are used for."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from statistics import mean

from fuse_grounding.benchmark.report import plots
from fuse_grounding.benchmark.report.intervals import Interval, average, share
from fuse_grounding.benchmark.report.load import Arm, Part, Row
from fuse_grounding.benchmark.report.model import Figure
from fuse_grounding.benchmark.report.svg import Axis, Plot

_BINS = 6
_LEAST = 5
"""Fewest cases in a bin."""

Pair = tuple[float, float]


def figures(part: Part) -> list[Figure]:
    """Three plots; each says what exactly it shows."""
    gated = [a for a in part.arms if any(_entropies(a))]
    return [_gate_success(part, gated), _gate_gain(part, gated), _segmenter(part)]


def _entropies(arm: Arm) -> list[Row]:
    return [d for r in arm.done for d in plots.decisions(r) if d.get("entropy") is not None]


def _gate_success(part: Part, gated: Sequence[Arm]) -> Figure:
    title, key = "Gate: entropy against later success", f"{part.set_name}_gate_success"
    pairs = {
        a.label: [
            (d["entropy"], float(r["success"]))
            for r in a.done
            for d in plots.decisions(r)
            if d.get("entropy") is not None
        ]
        for a in gated
    }
    caption = (
        "Decisions in bins of equal count by the entropy of the planner's values; up: share of them "
        "whose search ended in success (Wilson 95 % interval), {n}. Decisions of one search share its "
        "outcome, so the intervals are too narrow."
    )
    y = Axis("in searches that succeed, %", 0, 100)
    return _binned(part, gated, pairs, title, key, caption, y, lambda v: share([bool(x) for x in v]), 100)


def _gate_gain(part: Part, gated: Sequence[Arm]) -> Figure:
    title, key = "Gate: entropy against what the next view brings", f"{part.set_name}_gate_gain"
    pairs: dict[str, list[Pair]] = {}
    for arm in gated:
        found = pairs.setdefault(arm.label, [])
        for row in arm.done:
            trace = row["trace"]
            for here, there in itertools.pairwise(trace):
                if here.get("entropy") is not None and "target_pixel_ratio" in here:
                    found.append((here["entropy"], there["target_pixel_ratio"] - here["target_pixel_ratio"]))
    caption = (
        "Decisions in bins of equal count by the entropy of the planner's values; up: mean change of the "
        "target pixel ratio from the view that was decided on to the next one (bootstrap 95 % interval), {n}."
    )
    changes = [abs(c) for found in pairs.values() for _, c in found]
    most = max(0.05, min(1.0, 1.5 * mean(changes))) if changes else 1.0
    y = Axis("change of pixel ratio, pp", -100 * most, 100 * most)
    return _binned(part, gated, pairs, title, key, caption, y, average, 100)


def _binned(
    part: Part,
    arms: Sequence[Arm],
    pairs: dict[str, list[Pair]],
    title: str,
    key: str,
    caption: str,
    y: Axis,
    summarise: Callable[[list[float]], Interval],
    scale: float,
) -> Figure:
    arms = [a for a in arms if len(pairs[a.label]) >= _LEAST]
    if not arms:
        traced = any(r.get("trace") for a in part.arms for r in a.done)
        few = "not recorded: no method here has a gate with enough decisions"
        return Figure(key, title, "", missing=few if traced else plots.NO_TRACE)
    style = plots.styles(part.arms)
    plot = Plot(Axis("entropy, 0 to 1", 0, 1), y)
    for arm in arms:
        points = []
        for group in _equal_count(pairs[arm.label]):
            result = summarise([v for _, v in group]).times(scale)
            at = mean(x for x, _ in group)
            low, high = (min(max(v, y.low), y.high) for v in (result.low, result.high))
            plot.whisker(at, low, high, style[arm.label])
            points.append((at, min(max(result.value, y.low), y.high), len(group)))
        plot.line([(x, v) for x, v, _ in points], style[arm.label])
        for x, v, count in points:
            plot.mark(x, v, style[arm.label], f"{plots.name(arm)}: {v:.1f} of {count} decisions", size=4)
    for eta in sorted({a.settings["gate.eta"] for a in arms if "gate.eta" in a.settings}):
        plot.rule(f"η = {eta:g}", x=eta)
    n = f"n = {sum(len(pairs[a.label]) for a in arms)} decisions"
    return Figure(key, title, caption.format(n=n), plot.svg(title), plots.legend(arms, style))


def _equal_count(pairs: Sequence[Pair]) -> list[list[Pair]]:
    ranked = sorted(pairs)
    bins = max(1, min(_BINS, len(ranked) // _LEAST))
    edges = [round(k * len(ranked) / bins) for k in range(bins + 1)]
    return [ranked[a:b] for a, b in itertools.pairwise(edges)]


def _segmenter(part: Part) -> Figure:
    title, key = "Segmenter: score against success", f"{part.set_name}_segmenter"
    found = [
        (min(max(float(r["instance_score"]), 0.0), 1.0), bool(r["success"]))
        for a in part.arms
        for r in a.done
        if r.get("instance_score") is not None
    ]
    if len(found) < _LEAST:
        return Figure(key, title, "", missing="not recorded: too few results with a segmenter's score")
    groups: dict[int, list[tuple[float, bool]]] = {}
    for score, won in found:
        groups.setdefault(min(int(score * 10), 9), []).append((score, won))
    plot = Plot(Axis("segmenter's score of the returned mask", 0, 1), Axis("success, %", 0, 100))
    plot.line([(0.0, 0.0), (1.0, 100.0)], 0, thin=True)
    line, error = [], 0.0
    for _, group in sorted(groups.items()):
        at, rate = mean(s for s, _ in group), share([won for _, won in group])
        error += len(group) / len(found) * abs(at - rate.value)
        plot.whisker(at, 100 * rate.low, 100 * rate.high, 8)
        line.append((at, 100 * rate.value, len(group)))
    plot.line([(x, y) for x, y, _ in line], 8)
    for x, y, count in line:
        plot.mark(x, y, 8, f"{y:.0f} % of {count} results at a score near {x:.2f}", size=4)
    caption = (
        "Results of all methods in bins of 0.1 by the score of the returned mask; up: share of them that are "
        f"a success (Wilson 95 % interval), n = {len(found)} results. On the thin line score and success "
        f"agree; expected calibration error {error:.3f}."
    )
    return Figure(key, title, caption, plot.svg(title))
