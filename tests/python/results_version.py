"""Plays four development episodes by a setup that no machine changes, and tells what they came to.

`python tests/python/results_version.py --record` writes it to results_version.json, with the RESULTS_VERSION
that it is of; `--print` prints it. What depends on the machine is left out: the SIMD level is `portable`,
instead of a network's masks there are the true ones, instead of COLMAP's poses the known ones. So what the
networks' and COLMAP's callers do is not seen here: who changes that must know.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ["FUSE_SIMD"] = "portable"  # before the compiled module is loaded

import numpy as np

from fuse_grounding import _core
from fuse_grounding.agent import Agent
from fuse_grounding.assembly import assemble
from fuse_grounding.benchmark.identity import RESULTS_VERSION
from fuse_grounding.benchmark.runner import run_one
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode, TabletopEnvironment, load_episodes
from fuse_grounding.perception.protocol import Detection
from fuse_grounding.planning.explicit import Explicit
from fuse_grounding.planning.gated import Gated
from fuse_grounding.planning.protocol import Situation
from fuse_grounding.record import write_atomically

RECORDED = Path(__file__).with_suffix(".json")
CONFIG = Config().with_(
    registration={"backend": "posed"},
    map={"initial_iterations": 40, "incremental_iterations": 10, "fine_iterations": 10},
    budget={"actions": 3},
    planner={"name": "none"},
)
PLAYED = (("fuse", 3), ("random", 2), ("explicit", 1), ("geometry_only", 4))
"""Methods, and the development episode of each."""
LEFT_OUT = (
    *("concurrent", "calls", "timings", "wall_seconds", "runtime_seconds"),  # no results
    *("announcements", "gaussians"),  # wording; SIFT's vector code may find a point more
)
"""Columns of a row that are not compared."""


class TrueMasks:
    """Sees what is there: an instance's score is its share of the picture, up to one half."""

    labels = None

    def __init__(self, episode: Episode):
        self._categories = episode.categories
        self._world = TabletopEnvironment(episode)
        places = [(node, pitch) for node in range(36) for pitch in range(3)]
        start = episode.start[0]
        # Those around the start are taken first, from the end.
        self._places = sorted(places, key=lambda p: -abs((p[0] - start + 18) % 36 - 18))
        self._known: dict[bytes, np.ndarray] = {}

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        ids = self._ids(rgb)
        found = []
        for instance in np.unique(ids).tolist():
            label = self._categories.get(instance)
            if label is not None and label in labels:
                mask = ids == instance
                found.append(Detection(label, round(0.5 + 0.5 * min(1.0, 20 * mask.mean()), 4), mask))
        return sorted(found, key=lambda d: -d.score)

    def _ids(self, rgb: np.ndarray) -> np.ndarray:
        """Those of the view that a picture is of; it is looked for among all."""
        while (key := rgb.tobytes()) not in self._known:
            seen = self._world.render_at(*self._places.pop())
            assert seen.instance is not None
            self._known[seen.rgb.tobytes()] = seen.instance
        return self._known[key]


class Pendulum:
    """A planner that is sure in every other view."""

    name = "pendulum"

    def values(self, situation: Situation) -> np.ndarray:
        sharp = 1.0 if situation.index % 2 == 0 else 0.05
        return (sharp * np.cos(np.arange(15) - 8)).astype(np.float32)


def rounded(value: Any) -> Any:
    """Numbers to four digits, for people who read the recorded file."""
    if isinstance(value, float):
        return round(value, 4) + 0.0
    if isinstance(value, dict):
        return {key: rounded(inner) for key, inner in value.items()}
    return [rounded(inner) for inner in value] if isinstance(value, (list, tuple)) else value


def gated(config: Config) -> Any:
    """A factory of the policy of `fuse`, with the pendulum as its planner."""
    return lambda episode: Gated(Pendulum(), Explicit("explicit", config), config)


def play() -> dict[str, Any]:
    """What the episodes came to, by method and episode."""
    assert _core.simd_level == "portable"
    came_to = {}
    for method, index in PLAYED:
        episode = load_episodes("dev")[index]
        parts, config = assemble(CONFIG.with_(method=method))
        parts = replace(parts, segmenter=TrueMasks(episode))
        if method == "fuse":
            parts = replace(parts, policy=gated(config))
        row = run_one(Agent(config, parts), method, episode, index)
        assert row["status"] == "ok", row
        came_to[f"{method} {episode.episode_id}"] = {
            name: rounded(value) for name, value in row.items() if name not in LEFT_OUT
        }
    return came_to


if __name__ == "__main__":
    if "--record" in sys.argv:
        content = {"results_version": RESULTS_VERSION, "came_to": play()}
        write_atomically(RECORDED, json.dumps(content, indent=1) + "\n")
    else:
        print(json.dumps(play()))
