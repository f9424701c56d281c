"""The choice of the gate's threshold η on development episodes: `fuse tune gate`.

For each η of {0.6, 0.7, 0.8, 0.9} (supplement, "Confidence Gate") the method `fuse` plays the same episodes.
The largest share of successes wins, then the largest mean IoU, then the fewest explicit decisions, then the
larger η.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import mean
from typing import Any

from fuse_grounding.agent import Agent
from fuse_grounding.benchmark.runner import Row, run_one
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode
from fuse_grounding.errors import FuseError, InputError

SCHEMA_VERSION = 1
THRESHOLDS = (0.6, 0.7, 0.8, 0.9)


def tune(config: Config, episodes: Sequence[Episode], tell: Callable[[float, Row], None]) -> dict[str, Any]:
    """Plays and chooses; the curve as JSON values. `tell` hears each result.

    Raises InputError for episodes of evaluation and without a planner; FuseError when an episode fails.
    """
    for episode in episodes:
        if episode.split == "eval":
            raise InputError(f"episode {episode.episode_id} is for evaluation: nothing is tuned on it")
    curve, provenance = [], {}
    for eta in THRESHOLDS:
        agent = Agent(config.with_(method="fuse", gate={"eta": eta}))
        provenance = agent.provenance
        if "planner" not in provenance["sha256"]:
            raise InputError("there is no planner whose gate could be tuned: planner.weights names one")
        rows = []
        for index, episode in enumerate(episodes):
            row = run_one(agent, "fuse", episode, index)
            if row["status"] != "ok":
                raise FuseError(f"episode {episode.episode_id} failed at eta {eta}: {row['error']}")
            rows.append(row)
            tell(eta, row)
        curve.append(_point(eta, rows))
    best = max(curve, key=lambda p: (p["success"], p["iou"], -p["explicit"], p["eta"]))
    return {
        "schema_version": SCHEMA_VERSION,
        "chosen": best["eta"],
        "episodes": [e.episode_id for e in episodes],
        "planner": config.planner.name,
        "temperature": config.gate.temperature,
        "curve": curve,
        "provenance": provenance,
    }


def _point(eta: float, rows: list[Row]) -> dict[str, Any]:
    """Means over the episodes; `explicit` and `amortized` are decisions an episode."""
    branches = {name: mean(r["branches"].get(name, 0) for r in rows) for name in ("explicit", "amortized")}
    return {
        "eta": eta,
        "success": mean(float(r["success"]) for r in rows),
        "iou": round(mean(r["iou"] for r in rows), 5),
        "online_actions": mean(r["online_actions"] for r in rows),
        **branches,
        "wall_seconds": round(mean(r["wall_seconds"] for r in rows), 2),
    }
