"""Runs methods over episodes, one after the other, and judges each result against the ground truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fuse_grounding.agent import Agent
from fuse_grounding.benchmark.metrics import evaluate
from fuse_grounding.benchmark.store import ResultStore
from fuse_grounding.environment import TabletopEnvironment
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.grounding import Grounded

Row = dict[str, Any]


def run_benchmark(
    episodes: Sequence[Any], agents: Mapping[str, Agent], store: ResultStore, tell: Callable[[Row], None]
) -> None:
    """One row for each episode and method that the store does not have; `tell` hears each new one.

    `agents` are the methods' by name.

    An episode that fails becomes a row with `status` "failed"; wrong input stops the benchmark.
    """
    for index, episode in enumerate(episodes):
        for name, agent in agents.items():
            if not store.done(name, episode.episode_id):
                row = run_one(agent, name, episode, index)
                store.append(row)
                tell(row)


def run_one(agent: Agent, method: str, episode: Any, index: int) -> Row:
    """One episode by one method. `index` is the episode's place in its set: it seeds `random`."""
    row: Row = {
        "method": method,
        "episode_id": episode.episode_id,
        "scene": episode.scene_id,
        "query": episode.query,
        "verb": episode.verb,
        "seed": episode.seed,
    }
    began = time.perf_counter()
    try:
        settings = agent.config
        environment = TabletopEnvironment(episode, settings.render.device, sensor=settings.sensor)
        grounded = agent.run(environment, episode.query, episode_index=index)
        metrics = evaluate(grounded, environment, agent.segmenter, agent.config)
    except InputError:
        raise
    except (FuseError, RuntimeError) as error:
        seconds = round(time.perf_counter() - began, 3)
        return {
            **row,
            "status": "failed",
            "error": f"{type(error).__name__}: {error}",
            "wall_seconds": seconds,
        }
    return {**row, "status": "ok", **metrics, **_outcome(grounded)}


def _outcome(grounded: Grounded) -> Row:
    """What the record says about the run, flat."""
    record, result = grounded.record, grounded.record.result
    assert result is not None
    return {
        "label": result.label,
        "score": result.score,
        "instance_score": result.instance_score,
        "candidates": [c.label for c in record.candidates],
        "candidates_unknown": [c.label for c in record.candidates_unknown],
        "candidates_replaced": {r.proposed: r.label for r in record.candidates_replaced},
        "knowledge": record.knowledge,
        "online_actions": result.online_actions,
        "observations": result.observations,
        "seed_motions": result.seed_motions,
        "total_steps": result.total_steps,
        "stop_reason": result.stop_reason,
        "branches": result.branches,
        "registrations": result.registrations,
        "planner": result.planner,
        "gaussians": record.steps[-1].map.gaussians if record.steps[-1].map is not None else None,
        "timings": result.timings,
        "wall_seconds": result.wall_seconds,
    }
