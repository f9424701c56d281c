"""Where the time of an episode goes, by component: the supplement's latency table, over any rows.

For N episodes, component c with n_ic calls and t_ic seconds in episode i:

    calls an episode = sum_i n_ic / N      seconds an episode = sum_i t_ic / N
    seconds a call = seconds an episode / calls an episode      share = t_c / sum_c t_c

(supplement, "Efficiency Analysis": calls and latency are first accumulated per episode and then averaged).
The total is the runtime of the supplement's protocol: from the seed views to the final view's evaluation,
without construction of the world, loading, and waiting for a hosted model. Rates of branches are of all
planning decisions; refinements have the sample's standard deviation.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import mean, stdev
from typing import Any

from fuse_grounding.benchmark.metrics import HOSTED
from fuse_grounding.errors import InputError

Row = Mapping[str, Any]


@dataclass(frozen=True)
class _Stages:
    """`seconds` are the stages whose time is a component's, `calls` those that count as its calls."""

    seconds: tuple[str, ...]
    calls: tuple[str, ...]


COMPONENTS = {
    "initialization": _Stages(("initialize", "initialize_map"), ("initialize",)),
    "segmentation": _Stages(("segment",), ("segment",)),
    "depth_and_stopping": _Stages(("ground",), ("ground",)),
    "amortized_planning": _Stages(("predict",), ("predict",)),
    "view_registration": _Stages(("register",), ("register",)),
    "map_refinement": _Stages(("refine",), ("refine",)),
    "explicit_evidence": _Stages(("evidence", "render"), ("evidence",)),
    "action_choice": _Stages(("plan",), ("plan",)),
    "camera_execution": _Stages(("observe", "act"), ("observe", "act")),
}
"""Components by stages of the stopwatch, in the order of the supplement's table, whose `sam3_grounding` is
`segmentation` and `gs_refinement` `map_refinement`. `action_choice`, `final_evaluation`, `other` are ours."""


@dataclass(frozen=True)
class Component:
    """Means over episodes; `s_per_call` is None where nothing was called."""

    calls_per_ep: float
    s_per_call: float | None
    s_per_ep: float
    share_pct: float


@dataclass(frozen=True)
class Spread:
    """Mean and sample standard deviation, 0 for a single episode."""

    mean: float
    sd: float


@dataclass(frozen=True)
class Latency:
    """One method's table. `concurrent` of the `episodes` ran beside others, `errors` are left out."""

    method: str
    episodes: int
    errors: int
    concurrent: int
    components: dict[str, Component]
    total_s_per_ep: float
    branch_pct: dict[str, float]
    refinements_per_ep: Spread

    def to_dict(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self)


def latency(rows: Sequence[Row], *, concurrent: bool = False) -> Latency:
    """The table of one method's rows, over any episodes and knowledge sources.

    Raises InputError for rows of several methods, for none that ran through, and for rows whose episodes ran
    beside others, unless `concurrent` allows these; they are counted then.
    """
    methods = sorted({row["method"] for row in rows})
    if len(methods) != 1:
        raise InputError(f"a latency table is of one method, found {', '.join(methods) or 'no rows'}")
    ran = [row for row in rows if row["status"] == "ok"]
    if not ran:
        raise InputError(f"method `{methods[0]}` has no episode that ran through: there is nothing to time")
    beside = sum(bool(row["concurrent"]) for row in ran)
    if beside and not concurrent:
        raise InputError(
            f"{beside} of {len(ran)} rows of `{methods[0]}` ran beside other episodes, and their times "
            "measure that too; measure with --jobs 1"
        )
    seconds, calls, runtime = _totals(ran)
    shares = sum(runtime) or 1.0
    components = {}
    for name in (*COMPONENTS, "final_evaluation", "other"):
        components[name] = Component(
            calls_per_ep=calls[name] / len(ran),
            s_per_call=seconds[name] / calls[name] if calls[name] else None,
            s_per_ep=seconds[name] / len(ran),
            share_pct=100 * seconds[name] / shares,
        )
    refinements = [row["calls"].get("refine", 0) for row in ran]
    return Latency(
        method=methods[0],
        episodes=len(ran),
        errors=len(rows) - len(ran),
        concurrent=beside,
        components=components,
        total_s_per_ep=sum(runtime) / len(ran),
        branch_pct=_branches(ran),
        refinements_per_ep=Spread(mean(refinements), stdev(refinements) if len(ran) > 1 else 0.0),
    )


def _totals(rows: Sequence[Row]) -> tuple[Counter[str], Counter[str], list[float]]:
    """Seconds and calls by component, summed over rows, and each row's runtime."""
    seconds, calls = Counter[str](), Counter[str]()
    runtime = []
    for row in rows:
        timings, counts = row["timings"], row["calls"]
        for name, stages in COMPONENTS.items():
            seconds[name] += sum(timings.get(stage, 0.0) for stage in stages.seconds)
            calls[name] += sum(counts.get(stage, 0) for stage in stages.calls)
        whole = row["runtime_seconds"]
        final = whole - (row["wall_seconds"] - timings.get(HOSTED, 0.0))
        seconds["final_evaluation"] += final
        calls["final_evaluation"] += 1
        told = sum(v for stage, v in timings.items() if stage != HOSTED and stage in _KNOWN)
        seconds["other"] += whole - final - told
        runtime.append(whole)
    return seconds, calls, runtime


_KNOWN = {stage for stages in COMPONENTS.values() for stage in stages.seconds}


def _branches(rows: Sequence[Row]) -> dict[str, float]:
    """Share of every branch in all planning decisions, per cent; the most frequent first."""
    counts = Counter[str]()
    for row in rows:
        counts.update(row["branches"])
    total = sum(counts.values()) or 1
    return {name: 100 * count / total for name, count in counts.most_common()}
