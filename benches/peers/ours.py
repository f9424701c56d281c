"""Our side, in a process of its own: `python ours.py WHAT SCENE ...` prints one JSON object.

iteration SCENE [PLY] [--discard N --count N]   seconds an iteration at a fixed number of Gaussians
quality SCENE SCHEDULE ITERATIONS [--every N]   a whole training: its held-out PSNR, time and memory
judge SCENE RED,GREEN,BLUE PLY...               held-out PSNR of maps that others trained
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding import splat
from fuse_grounding.reconstruction.dataset import Dataset, View
from fuse_grounding.reconstruction.training import TrainOptions

NEVER = 2**31
HOLDOUT = 8


def judges(scene: Path) -> list[View]:
    """The held-out photos, by name."""
    data = Dataset(scene / "all", 1, HOLDOUT)
    return list(data.read(data.held_out))


def psnr(gaussians: splat.Gaussians, views: list[View], background: tuple[float, ...] = (0, 0, 0)) -> float:
    """Mean over views, decibel, of renderings in 8 bits."""
    return float(np.mean([splat.quality(gaussians, c, image, background)[0] for image, c in views]))


def trainer(scene: Path, config: splat.TrainerConfig, ply: Path | None) -> splat.Trainer:
    """With all training photos, from a map or from the COLMAP points."""
    data = Dataset(scene / "train", 1, 0)
    start = splat.Gaussians.from_ply(ply) if ply else splat.Gaussians.from_points(*data.points())
    made = splat.Trainer(start, config)
    for image, camera in data.read(data.train):
        made.add_view(image, camera)
    return made


def iteration(scene: Path, ply: Path | None, discard: int, count: int, rounds: int) -> dict[str, Any]:
    """`official` without densification and resets: nothing else differs from a training."""
    config = replace(splat.TrainerConfig.official(), densify_start=NEVER, opacity_reset_interval=NEVER)
    training = trainer(scene, config, ply)
    training.refine(discard)
    taken = [training.refine(count).seconds / count for _ in range(rounds)]
    return {"seconds": float(np.median(taken)), "least": min(taken), "gaussians": len(training.gaussians)}


def quality(scene: Path, schedule: str, iterations: int, every: int) -> dict[str, Any]:
    """As `fuse splat train` does it, in one go; measured on the way every `every` iterations (0: not), which
    does not count as training."""
    config = TrainOptions(iterations=iterations, schedule=schedule).config()
    training, held_out = trainer(scene, config, None), judges(scene)
    curve, seconds, at = [], 0.0, 0
    while at < iterations:
        steps = min(every or iterations, iterations - at)
        at += steps
        begin = time.perf_counter()
        training.refine(steps, iterations - at)
        seconds += time.perf_counter() - begin
        found = training.gaussians
        curve.append(
            {"iteration": at, "seconds": seconds, "psnr": psnr(found, held_out), "gaussians": len(found)}
        )
    return {"curve": curve, "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}


def judge(scene: Path, background: tuple[float, ...], maps: list[Path]) -> list[dict[str, Any]]:
    """Maps of others, drawn as ours are, over the background that they were trained with."""
    held_out, rows = judges(scene), []
    for path in maps:
        lost = drop_not_finite(path)
        gaussians = splat.Gaussians.from_ply(path)
        row = {"psnr": psnr(gaussians, held_out, background), "gaussians": len(gaussians)}
        rows.append(row | ({"not_finite": lost} if lost else {}))
    return rows


def drop_not_finite(path: Path) -> int:
    """Rewrites a binary PLY of floats without the Gaussians that hold NaN or infinity, which a viewer does
    not draw and we refuse; returns how many."""
    head, mark, body = path.read_bytes().partition(b"end_header\n")
    count = int(re.search(rb"element vertex (\d+)", head)[1])  # type: ignore[index]
    rows = np.frombuffer(body, "<f4").reshape(count, -1)
    kept = rows[np.isfinite(rows).all(axis=1)]
    if len(kept) < count:
        head = head.replace(b"element vertex %d" % count, b"element vertex %d" % len(kept))
        path.write_bytes(head + mark + kept.tobytes())
    return count - len(kept)


def main() -> None:
    """Prints what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    what = parser.add_subparsers(dest="what", required=True)
    one = what.add_parser("iteration")
    one.add_argument("scene", type=Path)
    one.add_argument("ply", type=Path, nargs="?")
    one.add_argument("--discard", type=int, default=42)
    one.add_argument("--count", type=int, default=84)
    one.add_argument("--rounds", type=int, default=5)
    whole = what.add_parser("quality")
    whole.add_argument("scene", type=Path)
    whole.add_argument("schedule")
    whole.add_argument("iterations", type=int)
    whole.add_argument("--every", type=int, default=0)
    others = what.add_parser("judge")
    others.add_argument("scene", type=Path)
    others.add_argument("background")
    others.add_argument("maps", type=Path, nargs="+")
    asked = parser.parse_args()
    if asked.what == "iteration":
        found: Any = iteration(asked.scene, asked.ply, asked.discard, asked.count, asked.rounds)
    elif asked.what == "quality":
        found = quality(asked.scene, asked.schedule, asked.iterations, asked.every)
    else:
        background = tuple(float(v) for v in asked.background.split(","))
        found = judge(asked.scene, background, asked.maps)
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
