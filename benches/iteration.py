"""One training iteration of the Gaussian map on an episode's views, stage by stage.

A map is grown on fourteen 640x480 views of a shipped scene until it has so many Gaussians; then nothing
is added or removed any more, and the best of several rounds over all views is reported, with the time of a
rendering. One thread and all of them, each in a process of its own.

    python benches/iteration.py [--gaussians 10000 20000] [--threads 1 2] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from map_quality import walk

from fuse_grounding import splat
from fuse_grounding.environment import TabletopEnvironment, make_episode
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.registration import PosedRegistrar

GROWTH = 3000
"""Iterations, at half the resolution, in which the map grows."""


def views(scene: str) -> tuple[list[Observation], np.ndarray, np.ndarray]:
    """Seeds and ten moves, with the points that the seeds give."""
    environment = TabletopEnvironment(make_episode("cut", scene, 0))
    seeds = list(environment.seed_observations())
    registrar = PosedRegistrar()
    registrar.initialize(seeds)
    _, xyz, rgb = registrar.points_by_id()
    return seeds + list(walk(environment, 10, np.random.default_rng(0))), xyz, rgb


def trainer(
    start: splat.Gaussians, config: splat.TrainerConfig, observations: list[Observation]
) -> splat.Trainer:
    """A trainer with all views."""
    made = splat.Trainer(start, config)
    for view in observations:
        assert view.camera is not None
        made.add_view(view.rgb, view.camera)
    return made


def measure(path: Path, scene: str, rounds: int) -> dict[str, Any]:
    """Milliseconds of an iteration, of its stages and of a rendering, in this process."""
    observations, *_ = views(scene)
    gaussians = splat.Gaussians.from_ply(path)
    config = splat.TrainerConfig(densify_start=2**31, opacity_reset_interval=2**31, degree_interval=1)
    training = trainer(gaussians, config, observations)
    count = 2 * len(observations)
    training.refine(count)
    best = min((training.refine(count) for _ in range(rounds)), key=lambda stats: stats.seconds)
    renderings = []
    for view in observations * 2:
        assert view.camera is not None
        begin = time.perf_counter()
        splat.render(gaussians, view.camera)
        renderings.append(time.perf_counter() - begin)
    return {
        "gaussians": len(gaussians),
        "iteration": 1e3 * best.seconds / count,
        "stages": {name: 1e3 * seconds / count for name, seconds in best.stage_seconds.items()},
        "render": 1e3 * min(renderings),
    }


def main() -> None:
    """Grows the maps, measures them in processes of their own, prints a line each."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", default="dev_kitchen")
    parser.add_argument("--gaussians", type=int, nargs="+", default=[10_000, 20_000])
    parser.add_argument("--threads", type=int, nargs="+", default=sorted({1, os.cpu_count() or 1}))
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measure(options.measure, options.scene, options.rounds)))
        return

    observations, xyz, rgb = views(options.scene)
    growing = splat.TrainerConfig(fine_iterations=0, densify_gradient=1e-4, densify_end=GROWTH)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for count in options.gaussians:
            config = replace(growing, max_gaussians=count)
            grown = trainer(splat.Gaussians.from_points(xyz, rgb), config, observations)
            grown.refine(GROWTH)
            path = Path(folder) / f"{count}.ply"
            grown.gaussians.save_ply(path)
            for threads in options.threads:
                command = [sys.executable, __file__, "--measure", str(path), "--scene", options.scene]
                run = subprocess.run(
                    [*command, "--rounds", str(options.rounds)],
                    env=os.environ | {"RAYON_NUM_THREADS": str(threads)},
                    check=True,
                    stdout=subprocess.PIPE,
                    text=True,
                )
                row = {"threads": threads, **json.loads(run.stdout)}
                rows.append(row)
                if not options.json:
                    stages = ", ".join(f"{n} {v:.2f}" for n, v in row["stages"].items() if n != "densify")
                    print(
                        f"{row['gaussians']:6d} Gaussians, {threads} thread(s): {row['iteration']:.2f} ms an "
                        f"iteration ({stages}); a rendering {row['render']:.2f} ms",
                        flush=True,
                    )
    if options.json:
        print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
