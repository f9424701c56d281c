"""Plots of methods against each other: success over time and steps, the gate over steps, time by stage."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import mean, quantiles

from fuse_grounding.benchmark.report import labels
from fuse_grounding.benchmark.report.intervals import share
from fuse_grounding.benchmark.report.load import Arm, Part, Row
from fuse_grounding.benchmark.report.model import Figure
from fuse_grounding.benchmark.report.svg import STYLES, Axis, Plot

NO_TRACE = "not recorded: these results have no step-by-step trace"
NOTHING_RAN = "not recorded: no episode ran through"


def styles(arms: Sequence[Arm]) -> dict[str, int]:
    """A series style for each arm: a method's own where each arm is another method, else in turn."""
    methods = [a.method for a in arms]
    known = list(labels.METHODS)
    if len(set(methods)) == len(methods) and all(m in known for m in methods):
        return {a.label: known.index(a.method) for a in arms}
    return {a.label: i % STYLES for i, a in enumerate(arms)}


def name(arm: Arm) -> str:
    """An arm's name for people."""
    rest = arm.label.removeprefix(arm.method)
    return arm.label if rest == arm.label else labels.method(arm.method) + rest


def seconds(row: Row) -> float:
    """Runtime of an episode, as the supplement defines it."""
    return float(row["runtime_seconds"])


def legend(arms: Sequence[Arm], style: dict[str, int]) -> list[tuple[int, str]]:
    """Style and name of each arm."""
    return [(style[a.label], name(a)) for a in arms]


def pareto(part: Part) -> Figure:
    """Success against seconds an episode; the front joins what nothing beats in both."""
    title, key = "Success against time", f"{part.set_name}_pareto"
    arms = [a for a in part.arms if a.done]
    if not arms:
        return Figure(key, title, "", missing=NOTHING_RAN)
    style = styles(part.arms)
    points = {a.label: (mean(map(seconds, a.done)), share([_won(r) for r in a.rows.values()])) for a in arms}
    times = [x for x, _ in points.values()]
    room = 4  # for the names of what is slowest
    x = Axis("runtime, s per episode (log scale)", min(times) / 1.6, max(times) * room, log=True)
    plot = Plot(x, Axis("success, % of episodes", 0, 100), height=350)
    front, best = [], -1.0
    for label in sorted(points, key=lambda k: (points[k][0], -points[k][1].value)):
        time, success = points[label]
        if success.value > best:
            front.append((time, 100 * success.value))
            best = success.value
    plot.line(front, 0, steps=True, thin=True)
    plot.avoid(front)
    for arm in arms:
        time, success = points[arm.label]
        plot.whisker(time, 100 * success.low, 100 * success.high, style[arm.label])
        plot.avoid([(time, 100 * success.low), (time, 100 * success.high)])
    for arm in arms:
        time, success = points[arm.label]
        tip = f"{name(arm)}: {100 * success.value:.1f} % in {time:.1f} s"
        plot.mark(time, 100 * success.value, style[arm.label], tip)
    for arm in arms:
        time, success = points[arm.label]
        plot.name(time, 100 * success.value, name(arm))
    caption = (
        f"Share of {counted(arms)} that end in success (Wilson 95 % interval) against mean runtime; the "
        "stepped line joins the methods that no other beats in both."
    )
    return Figure(key, title, caption, plot.svg(title), legend(arms, style))


def over_steps(part: Part) -> Figure:
    """Share of searches whose best view so far would be a success, after each action."""
    title, key = "Success over steps", f"{part.set_name}_success_over_steps"
    arms = [a for a in part.arms if a.done and all(r.get("trace") for r in a.done)]
    arms = [a for a in arms if max(len(r["trace"]) for r in a.done) > 1]
    if not arms:
        return Figure(key, title, "", missing=NO_TRACE)
    style = styles(part.arms)
    longest = max(len(r["trace"]) for a in arms for r in a.done) - 1
    plot = Plot(Axis("online actions taken", 0, longest), Axis("success if ended here, %", 0, 100))
    for arm in arms:
        limit = float(arm.settings.get("metric.iou", 0.5))
        curve = []
        for k in range(longest + 1):
            there = [r["trace"][min(k, len(r["trace"]) - 1)]["best_iou"] >= limit for r in arm.done]
            curve.append((float(k), 100 * sum(there) / len(arm.rows)))
        plot.line(curve, style[arm.label])
        for at, y in curve[:: max(1, longest // 6)]:
            tip = f"{name(arm)}: {y:.0f} % after {at:.0f} actions"
            plot.mark(at, y, style[arm.label], tip, size=4)
    caption = (
        f"Share of {counted(arms)} whose best view so far would count as success if the search ended after "
        "that many actions; a search that has stopped keeps its result. Methods of one view are left out."
    )
    return Figure(key, title, caption, plot.svg(title), legend(arms, style))


def _gated(part: Part) -> list[Arm]:
    return [a for a in part.arms if any(d["entropy"] is not None for r in a.done for d in decisions(r))]


def decisions(row: Row) -> list[Row]:
    """Observations of a trace that a decision followed."""
    return [step for step in row.get("trace") or () if step.get("action") is not None]


def _by_step(arm: Arm) -> list[list[Row]]:
    rows = [decisions(r) for r in arm.done]
    return [[d[k] for d in rows if len(d) > k] for k in range(max(map(len, rows), default=0))]


def entropy(part: Part) -> Figure:
    """The gate's entropy at each decision, with the quartiles."""
    title, key = "Entropy over steps", f"{part.set_name}_entropy_over_steps"
    arms = _gated(part)
    if not arms:
        return Figure(key, title, "", missing=_no_gate(part))
    style, steps = styles(part.arms), {a.label: _by_step(a) for a in arms}
    longest = max(map(len, steps.values()))
    plot = Plot(_decision_axis(longest), Axis("entropy, 0 to 1", 0, 1))
    spread: list[tuple[list[tuple[float, float, float]], int]] = []
    for arm in arms:
        middle, band = [], []
        for k, made in enumerate(steps[arm.label], 1):
            values = [d["entropy"] for d in made if d["entropy"] is not None]
            if values:
                low, centre, high = (
                    quantiles(values, n=4, method="inclusive") if len(values) > 1 else values * 3
                )
                middle.append((float(k), centre))
                band.append((float(k), low, high))
        spread.append((band, style[arm.label]))
        plot.band(band, style[arm.label])
        plot.line(middle, style[arm.label])
    for eta in sorted({a.settings["gate.eta"] for a in arms if "gate.eta" in a.settings}):
        plot.rule(f"η = {eta:g}", y=eta)
    caption = (
        f"Median and quartiles of the normalised entropy at each decision, {_decided(steps)}; the gate takes "
        "the explicit branch at η and above."
    )
    return Figure(key, title, caption, plot.svg(title), legend(arms, style))


def branches(part: Part) -> Figure:
    """Share of decisions by the explicit branch, over steps."""
    title, key = "Explicit branch over steps", f"{part.set_name}_branch_over_steps"
    arms = _gated(part)
    if not arms:
        return Figure(key, title, "", missing=_no_gate(part))
    style, steps = styles(part.arms), {a.label: _by_step(a) for a in arms}
    longest = max(map(len, steps.values()))
    plot = Plot(_decision_axis(longest), Axis("explicit branch, % of decisions", 0, 100))
    for arm in arms:
        line = []
        for k, made in enumerate(steps[arm.label], 1):
            part_of = share([d["branch"] == "explicit" for d in made])
            line.append((float(k), 100 * part_of.value))
            plot.whisker(k, 100 * part_of.low, 100 * part_of.high, style[arm.label])
        plot.line(line, style[arm.label])
        for at, y in line:
            tip = f"{name(arm)}: {y:.0f} % of {len(steps[arm.label][int(at) - 1])} decisions"
            plot.mark(at, y, style[arm.label], tip, size=4)
    caption = f"Share of decisions that the explicit branch made (Wilson 95 % interval), {_decided(steps)}."
    return Figure(key, title, caption, plot.svg(title), legend(arms, style))


def _decision_axis(longest: int) -> Axis:
    every = max(1, round(longest / 10))
    return Axis("decision", 0.5, longest + 0.5, ticks=list(range(1, longest + 1, every)))


def _decided(steps: dict[str, list[list[Row]]]) -> str:
    first = sum(len(s[0]) for s in steps.values() if s)
    last = sum(len(s[-1]) for s in steps.values() if s)
    return f"n = {first} decisions at the first step and {last} at the last"


def _no_gate(part: Part) -> str:
    traced = any(r.get("trace") for a in part.arms for r in a.done)
    return "not recorded: no method here has a gate" if traced else NO_TRACE


def _won(row: Row) -> bool:
    return bool(row.get("success", False))


def counted(arms: Sequence[Arm]) -> str:
    """How many episodes each arm has, for a caption."""
    counts = sorted({len(a.rows) for a in arms})
    said = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    return f"n = {said} episodes per method"
