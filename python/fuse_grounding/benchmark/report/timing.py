"""Runtime, the speed-up over explicit search, and where the time goes."""

from __future__ import annotations

from collections.abc import Mapping

from fuse_grounding.benchmark.latency import Latency, latency
from fuse_grounding.benchmark.report import labels, paper, plots
from fuse_grounding.benchmark.report.intervals import average, ratio
from fuse_grounding.benchmark.report.load import Arm, Part
from fuse_grounding.benchmark.report.model import Block, Cell, Column, Figure, Row, Table
from fuse_grounding.benchmark.report.summary import concurrent
from fuse_grounding.benchmark.report.svg import STYLES, Axis, Plot

_LEAST = 0.005
"""Seconds an episode below which a component is not shown."""
_SLOW = "explicit"
"""The method that speed-ups are over (supplement, "Computational Speed Up Analysis")."""


def blocks(part: Part) -> list[Block]:
    """Runtime and speed-up, bars, and the latency tables."""
    found = _profiles(part)
    made: list[Block] = [runtime(part), _bars(part, found)]
    if found:
        made.append(_by_component(part, found))
    fuse = next((a for a in part.arms if a.method == "fuse" and a.label in found), None)
    if fuse is not None:
        made.append(_beside_paper(part, fuse, found[fuse.label]))
    return made


def runtime(part: Part) -> Table:
    """Seconds an episode, hours for a hundred, speed-up over explicit search where both finished."""
    known = paper.facts()["runtime"]
    slow = next((a for a in part.arms if a.method == _SLOW), None)
    columns = [
        Column("method", "Method", word=True),
        Column("episodes", "n", "", 0),
        Column("seconds", "Runtime", "s per episode", 2, better="lower"),
        Column("hours", "100 episodes", "h", 3),
        Column("speedup", "here", "× over explicit", 2, better="higher", group="Speed-up"),
        Column("speedup_paper", "paper", "× over explicit", 2, group="Speed-up"),
        Column("seconds_paper", "Runtime in the paper", "s per episode", 1),
    ]
    lines = []
    for arm in part.arms:
        if not arm.done:
            continue
        mean = average([plots.seconds(r) for r in arm.done])
        theirs = known.get(arm.method, {})
        lines.append(
            Row(
                [
                    Cell(plots.name(arm)),
                    Cell(len(arm.done)),
                    Cell(mean.value, mean.low, mean.high),
                    Cell(mean.value * 100 / 3600),
                    _speedup(slow, arm),
                    Cell(theirs.get("speedup")),
                    Cell(theirs.get("seconds")),
                ]
            )
        )
    caption = (
        f"Runtime over the episodes of `{part.set_name}` that ran through, without loading (supplement, "
        "Runtime Protocol); speed-up: summed time of explicit search over that of the method, on the "
        "episodes that both finished, empty where one was measured alone and the other was not; in brackets "
        "bootstrap 95 % intervals. The last query, for the final score, takes nothing where the returned "
        "view is the last one that was looked at, as it always is for methods of one view."
    )
    notes = [paper.WARNING, *concurrent(part.arms)]
    return Table(
        f"{part.set_name}_{part.name}_runtime", "Runtime and speed-up", caption, columns, lines, notes
    )


def _speedup(slow: Arm | None, arm: Arm) -> Cell:
    if slow is None:
        return Cell()
    theirs = {r["episode_id"]: plots.seconds(r) for r in slow.done}
    beside = {r["episode_id"]: bool(r.get("concurrent")) for r in slow.done}
    shared = [r for r in arm.done if r["episode_id"] in theirs]
    pairs = [(theirs[r["episode_id"]], plots.seconds(r)) for r in shared]
    # Of times taken alone and beside others no ratio says anything of the methods.
    if not pairs or any(bool(r.get("concurrent")) != beside[r["episode_id"]] for r in shared):
        return Cell()
    if arm is slow:
        return Cell(1.0)
    found = ratio([a for a, _ in pairs], [b for _, b in pairs])
    return Cell(found.value, found.low, found.high)


def _profiles(part: Part) -> dict[str, Latency]:
    """The latency of every arm that ran through an episode, by label."""
    return {a.label: latency(list(a.rows.values()), concurrent=True) for a in part.arms if a.done}


def _by_component(part: Part, found: Mapping[str, Latency]) -> Table:
    """Seconds an episode by component, a line a method."""
    spent = {c for p in found.values() for c, part in p.components.items() if part.s_per_ep >= _LEAST}
    components = [c for c in next(iter(found.values())).components if c in spent]
    columns = [
        Column("method", "Method", word=True),
        Column("total", "Total", "s", 2),  # first: on a narrow page the rest is scrolled to
        *(Column(c, labels.component(c), "s", 2) for c in components),
        Column("explicit", "Explicit branch", "% of decisions", 1),
        Column("refinements", "Refinements", "per episode ± sd", 2),
    ]
    lines = []
    for arm in part.arms:
        if arm.label not in found:
            continue
        profile = found[arm.label]
        spread = profile.refinements_per_ep
        lines.append(
            Row(
                [
                    Cell(plots.name(arm)),
                    Cell(profile.total_s_per_ep),
                    *(Cell(profile.components[c].s_per_ep) for c in components),
                    Cell(profile.branch_pct.get("explicit")),
                    Cell(spread.mean, text=f"{spread.mean:.2f} ± {spread.sd:.2f}"),
                ]
            )
        )
    caption = (
        f"Mean seconds per episode of `{part.set_name}` by component (supplement, Efficiency Analysis), "
        "without loading and without waiting for hosted models. Components that take no method "
        f"{_LEAST} s are left out."
    )
    title = "Latency by component"
    return Table(
        f"{part.set_name}_{part.name}_latency", title, caption, columns, lines, concurrent(part.arms)
    )


def _beside_paper(part: Part, arm: Arm, profile: Latency) -> Table:
    """FUSE's components with the calls, beside the paper's profile."""
    known = paper.facts()["latency"]
    columns = [Column("component", "Component", word=True)]
    for key, title, unit, digits, scale in (
        ("calls", "Calls", "per episode", 2, 1.0),
        ("seconds_per_call", "Time per call", "s", 4, 1.0),
        ("seconds", "Time", "s per episode", 3, 1.0),
        ("share", "Share", "% of the runtime", 2, 100.0),
    ):
        columns.append(Column(f"{key}_here", "here", unit, digits, scale, group=title))
        columns.append(Column(f"{key}_paper", "paper", unit, digits, scale, group=title))
    lines = []
    for name, ours in profile.components.items():
        theirs = known["components"].get(name, {})
        values = [
            (ours.calls_per_ep, theirs.get("calls")),
            (ours.s_per_call, theirs.get("seconds_per_call")),
            (ours.s_per_ep, theirs.get("seconds")),
            (ours.share_pct / 100, theirs.get("share")),
        ]
        lines.append(Row([Cell(labels.component(name)), *(Cell(v) for pair in values for v in pair)]))
    total = [None, None, None, None, profile.total_s_per_ep, known["seconds"], 1.0, 1.0]
    lines.append(Row([Cell("Total"), *(Cell(v) for v in total)]))
    explicit, spread = profile.branch_pct.get("explicit", 0.0), profile.refinements_per_ep
    notes = [
        f"Explicit branch: {explicit:.1f} % of decisions here, {100 * known['explicit_share']:.1f} % in the "
        f"paper. Map refinements per episode: {spread.mean:.2f} ± {spread.sd:.2f} here, "
        f"{known['refinements']['mean']:.2f} ± {known['refinements']['sd']:.2f} in the paper.",
        paper.WARNING,
    ]
    caption = (
        f"{plots.name(arm)}: calls and time by component over n = {profile.episodes} episodes of "
        f"`{part.set_name}`; in the paper over {known['episodes']}, of all its knowledge sources."
    )
    title = "Latency beside the paper’s (another world)"
    return Table(f"{part.set_name}_{part.name}_latency_paper", title, caption, columns, lines, notes)


def _bars(part: Part, found: Mapping[str, Latency]) -> Figure:
    """Seconds an episode by component, one bar a method; what is nowhere 1 % of a bar is `the rest`."""
    title, key = "Runtime by component", f"{part.set_name}_latency"
    arms = [a for a in part.arms if a.label in found]
    if not arms:
        return Figure(key, title, "", missing=plots.NOTHING_RAN)
    everything = list(next(iter(found.values())).components)
    named = [c for c in everything if c != "other"]  # what no stage counted is of the rest
    shown = [c for c in named if any(p.components[c].share_pct >= 1 for p in found.values())]
    shown = shown[: STYLES - 1]
    most = max(p.total_s_per_ep for p in found.values())
    names = [plots.name(a) for a in arms]
    plot = Plot(
        Axis("runtime, s per episode (mean)", 0, most * 1.12),
        Axis("", 0.4, len(arms) + 0.6, ticks=list(range(len(arms), 0, -1)), names=names),
        width=560,
        height=64 + 30 * len(arms),
        left=min(200, 16 + int(6.8 * max(map(len, names)))),
    )
    for place, arm in zip(range(len(arms), 0, -1), arms, strict=True):
        profile, at = found[arm.label], 0.0
        spent = [(labels.component(c), profile.components[c].s_per_ep) for c in shown]
        spent.append(("the rest", max(0.0, profile.total_s_per_ep - sum(s for _, s in spent))))
        for style, (name, seconds) in enumerate(spent):
            plot.flat_bar(place, at, at + seconds, 0.62, style, f"{plots.name(arm)}, {name}: {seconds:.2f} s")
            at += seconds
        plot.word(at, place, f"{at:.1f} s", 5, 4, "start")
    caption = f"Mean runtime by component, {plots.counted(arms)}; loading and hosted models are left out."
    legend = list(enumerate([*(labels.component(c) for c in shown), "the rest"]))
    return Figure(key, title, caption, plot.svg(title), legend)
