"""Keeps the episode record: translates what the agent did into the entries of `record`."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict

from fuse_grounding.config import Config
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.grounding import Grounded, encode_mask
from fuse_grounding.knowledge.protocol import Candidate, Hypotheses, Query
from fuse_grounding.parts import Parts
from fuse_grounding.planning.protocol import Decision
from fuse_grounding.record import (
    BoxEntry,
    CandidateEntry,
    EpisodeRecord,
    InitializationEntry,
    ReplacementEntry,
    ResultEntry,
    SeedEntry,
    StepEntry,
    Timings,
    ViewEntry,
)
from fuse_grounding.registration.protocol import RegisteredView


def open_record(config: Config, parts: Parts, query: Query, hypotheses: Hypotheses) -> EpisodeRecord:
    """A record without steps."""
    return EpisodeRecord(
        query=query.text,
        verb=query.verb,
        because=query.because,
        method=config.method,
        knowledge=hypotheses.source,
        candidates=_entries(hypotheses.candidates),
        candidates_unknown=_entries(hypotheses.unknown),
        candidates_replaced=[ReplacementEntry(**asdict(r)) for r in hypotheses.replaced],
        announcements=[*hypotheses.announcements, *parts.announcements],
        config=config.to_dict(),
        provenance=parts.provenance,
    )


def _entries(candidates: Sequence[Candidate]) -> list[CandidateEntry]:
    return [CandidateEntry(label=c.label, score=c.score, reason=c.reason) for c in candidates]


def pitch_deg(config: Config, seen: Observation) -> float | None:
    """Downward tilt of a view; None off the ring."""
    return None if seen.pitch_index is None else config.camera.pitches_deg[seen.pitch_index]


def initialization(
    config: Config,
    seeds: Sequence[Observation],
    views: Sequence[RegisteredView],
    points: int,
    timings: Timings,
) -> InitializationEntry:
    """The seed views as they were registered."""
    entries = [
        SeedEntry(node=seed.node, pitch_deg=pitch_deg(config, seed), registration=view.status)
        for seed, view in zip(seeds, views, strict=True)
    ]
    return InitializationEntry(seeds=entries, points=points, timings=timings)


def note(step: StepEntry, decision: Decision) -> None:
    """Writes a decision into its step."""
    step.branch, step.action = decision.branch, decision.action
    step.entropy, step.reason = decision.entropy, decision.reason
    if decision.values is not None:
        step.action_values = [float(v) if math.isfinite(v) else None for v in decision.values]


def result(
    record: EpisodeRecord,
    grounded: Grounded,
    fused_label: str | None,
    reason: str,
    planner: str | None,
    moves_before: int,
    wall_seconds: float,
) -> ResultEntry:
    """The end of the episode. `moves_before`: actions made before the first online view."""
    steps = record.steps
    actions = moves_before + sum(s.action is not None for s in steps)
    seeds = record.initialization.seeds if record.initialization is not None else []
    view, place = grounded.viewpoint, grounded.place
    return ResultEntry(
        status="grounded" if grounded.found else "not_found",
        stop_reason=reason,
        label=grounded.label,
        fused_label=fused_label,
        score=grounded.score,
        instance_score=grounded.instance_score,
        view=ViewEntry(
            index=view.index,
            node=view.node,
            pitch_deg=view.pitch_deg,
            center_m=None if view.camera is None else [float(x) for x in view.camera.center],
        ),
        centroid_m=None if place is None else [float(x) for x in place.centroid],
        box_m=None
        if place is None
        else BoxEntry(min=[float(x) for x in place.box[0]], max=[float(x) for x in place.box[1]]),
        mask=None if grounded.mask is None else encode_mask(grounded.mask),
        online_actions=actions,
        observations=len(steps),
        seed_motions=len(seeds),
        total_steps=actions + len(seeds),
        branches=_count([s.branch for s in steps if s.action is not None]),
        registrations=_count([s.registration for s in steps] + [s.registration for s in seeds]),
        planner=planner,
        timings=_sum_timings(record),
        wall_seconds=round(wall_seconds, 6),
    )


def _count(names: Sequence[str | None]) -> dict[str, int]:
    return dict(sorted(Counter(n for n in names if n is not None).items()))


def _sum_timings(record: EpisodeRecord) -> Timings:
    """Seconds by stage over seeds and steps."""
    total: Counter[str] = Counter()
    for timings in [
        record.initialization.timings if record.initialization is not None else {},
        *(s.timings for s in record.steps),
    ]:
        total.update(timings)
    return {stage: round(seconds, 6) for stage, seconds in total.items()}
