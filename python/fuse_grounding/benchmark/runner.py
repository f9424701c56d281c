"""One episode by one method: runs it, judges it against the ground truth, and makes a row of it.

An error of any kind is that episode's result, not the benchmark's end: `status` says `error`, and `success`
and `iou` count as failure.
"""

from __future__ import annotations

import json
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fuse_grounding.agent import Agent, Session
from fuse_grounding.benchmark.trace import Trace
from fuse_grounding.environment import Episode, TabletopEnvironment
from fuse_grounding.errors import UnusableError
from fuse_grounding.grounding import Grounded
from fuse_grounding.parts import Watcher
from fuse_grounding.perception import last_picture
from fuse_grounding.record import StepEntry

Row = dict[str, Any]

_FRAMES = 6
"""How many calls of a traceback are kept, the innermost ones."""


def run_one(
    agent: Agent,
    method: str,
    episode: Episode,
    index: int,
    watchers: Sequence[Watcher] = (),
    concurrent: bool = False,
) -> Row:
    """One episode by one method. `index` is the episode's place in its set: it seeds `random`.

    `concurrent` says of the row that others ran beside it, so that its times are no measurement. Raises
    UnusableError, which concerns every episode; any other error is in the row.
    """
    row = {**head(method, episode, index), "concurrent": concurrent}
    began = time.perf_counter()
    try:
        settings = agent.config
        environment = TabletopEnvironment(episode, settings.render.device, sensor=settings.sensor)
        environment.true_targets()  # counts pixels where an episode brings no statistics
        last_picture.forget()  # networks are shared, and no method pays for another's first view
        began = time.perf_counter()
        trace, calls = Trace(settings), _Calls()
        watching: list[Watcher] = [trace, calls, *watchers]
        grounded = agent.run(environment, episode.query, episode_index=index, watchers=watching)
        judged = trace.judge(grounded, environment, agent.segmenter)
        assert grounded.record.result is not None
        grounded.record.result.metrics = judged.metrics
        told = {**judged.metrics, **_outcome(grounded), "calls": calls.counts, "trace": judged.step_rows()}
        json.dumps(told, allow_nan=False)  # what a method of a user's put in is no reason to stop the others
    except (KeyboardInterrupt, UnusableError):
        raise
    except BaseException as error:  # a panic of native code is no Exception
        seconds = round(time.perf_counter() - began, 6)
        return {**row, **failure(error), "wall_seconds": seconds}
    return {**row, "status": "ok", **told}


class _Calls:
    """A watcher that keeps how often each stage was entered."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}

    def started(self, session: Session) -> None:
        """Nothing yet."""

    def stepped(self, session: Session, step: StepEntry) -> None:
        """Nothing yet: the clock goes on."""

    def finished(self, session: Session, grounded: Grounded) -> None:
        """The clock has stopped."""
        self.counts = dict(session.clock.calls)


def head(method: str, episode: Episode, index: int) -> Row:
    """What a row says of its episode."""
    return {
        "index": index,
        "method": method,
        "episode_id": episode.episode_id,
        "scene": episode.scene_id,
        "query": episode.query,
        "verb": episode.verb,
        "seed": episode.seed,
    }


def failure(error: BaseException | str) -> Row:
    """What a row says of an error: message, the innermost calls, and that it counts as a failure."""
    calls: list[str] = []
    if isinstance(error, BaseException):
        # What is shared with other methods is a way there, and depends on how many workers there are.
        frames = [
            f for f in traceback.extract_tb(error.__traceback__) if Path(f.filename).name != "shared.py"
        ]
        frames = frames[-_FRAMES:]
        calls = [f"{Path(f.filename).name}:{f.lineno} in {f.name}" for f in frames]
        error = f"{type(error).__name__}: {error}"
    return {"status": "error", "error": error, "traceback": calls, "success": False, "iou": 0.0}


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
        "announcements": record.announcements,
        "online_actions": result.online_actions,
        "observations": result.observations,
        "seed_motions": result.seed_motions,
        "total_steps": result.total_steps,
        "stop_reason": result.stop_reason,
        "branches": result.branches,
        "registrations": result.registrations,
        "planner": result.planner,
        "gaussians": record.steps[-1].map.gaussians if record.steps[-1].map is not None else None,
        "refinements": 0 if record.steps[-1].map is None else record.steps[-1].map.refinements,
        "timings": result.timings,
        "wall_seconds": result.wall_seconds,
    }
