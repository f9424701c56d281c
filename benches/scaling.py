"""How the time of a training iteration grows with pixels, with Gaussians, and with threads.

A map is grown on fourteen views of a shipped scene, then resampled to each number of Gaussians: drawn with
replacement, moved within their own extent, and made smaller or larger so that together they cover what the
map covers. Every figure is taken in a process of its own, the best of several rounds over all views, with
nothing added or removed; that process's peak memory is printed beside it.

    python benches/scaling.py                          # a table
    python benches/scaling.py --plot docs/images/scaling.png [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from iteration import trainer, views
from plot import Panel, save

from fuse_grounding import splat

SIZES = [(160, 120), (320, 240), (640, 480), (960, 720), (1280, 960)]
COUNTS = [5_000, 10_000, 20_000, 50_000, 100_000, 200_000]
MIDDLE_SIZE, MIDDLE_COUNT = (640, 480), 20_000
"""What is held while the other grows."""
GROWTH = 2000
"""Iterations, at half the resolution, in which the map grows."""
POSITION, SCALE, ROTATION = slice(0, 3), slice(3, 6), slice(6, 10)


def resample(parameters: np.ndarray, count: int) -> np.ndarray:
    """(N, 59) → (count, 59) float32. Each Gaussian gives way to count / N smaller ones within its extent."""
    rng = np.random.default_rng(0)
    rows = parameters[rng.integers(len(parameters), size=count)].copy()
    share = count / len(parameters)
    if share <= 1:
        rows = parameters[rng.permutation(len(parameters))[:count]].copy()
    else:
        w, x, y, z = (rows[:, ROTATION] / np.linalg.norm(rows[:, ROTATION], axis=1, keepdims=True)).T
        axes = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        local = np.exp(rows[:, SCALE]) * rng.standard_normal((count, 3))
        rows[:, POSITION] += np.einsum("ijn,nj->ni", axes, local)
    # They are flat: what they cover goes with the square of their size.
    rows[:, SCALE] -= 0.5 * np.log(share)
    return rows.astype(np.float32)


def write_ply(path: Path, parameters: np.ndarray) -> None:
    """The original's PLY; harmonics are stored alike, channel after channel."""
    columns = {
        **{n: parameters[:, i] for i, n in enumerate("xyz")},
        **{n: np.zeros(len(parameters)) for n in ("nx", "ny", "nz")},
        **{f"f_dc_{i}": parameters[:, 11 + i] for i in range(3)},
        **{f"f_rest_{i}": parameters[:, 14 + i] for i in range(45)},
        "opacity": parameters[:, 10],
        **{f"scale_{i}": parameters[:, 3 + i] for i in range(3)},
        **{f"rot_{i}": parameters[:, 6 + i] for i in range(4)},
    }
    properties = "".join(f"property float {name}\n" for name in columns)
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(parameters)}\n{properties}end_header\n"
    )
    path.write_bytes(header.encode() + np.column_stack(list(columns.values())).astype("<f4").tobytes())


def measure(path: Path, scene: str, width: int, height: int, rounds: int) -> dict[str, Any]:
    """Milliseconds of an iteration and peak memory, in this process."""
    observations, *_ = views(scene)
    config = splat.TrainerConfig(
        densify_start=2**31, opacity_reset_interval=2**31, degree_interval=1, max_gaussians=10**6
    )
    training = splat.Trainer(splat.Gaussians.from_ply(path), config)
    for view in observations:
        assert view.camera is not None
        smaller = width < view.rgb.shape[1]
        image = cv2.resize(
            view.rgb, (width, height), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
        )
        training.add_view(image, view.camera.resized(width, height))
    training.refine(len(observations))
    best = min((training.refine(len(observations)) for _ in range(rounds)), key=lambda stats: stats.seconds)
    return {
        "gaussians": best.gaussians,
        "pixels": width * height,
        "iteration": 1e3 * best.seconds / len(observations),
        "stages": {name: 1e3 * seconds / len(observations) for name, seconds in best.stage_seconds.items()},
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


class Bench:
    """Runs each measurement once, in a process of its own."""

    def __init__(self, folder: Path, options: argparse.Namespace) -> None:
        self.options, self.folder = options, folder
        observations, xyz, rgb = views(options.scene)
        config = splat.TrainerConfig(
            fine_iterations=0, densify_gradient=1e-4, densify_end=GROWTH, max_gaussians=MIDDLE_COUNT
        )
        grown = trainer(splat.Gaussians.from_points(xyz, rgb), config, observations)
        grown.refine(GROWTH)
        self.map = grown.gaussians.parameters
        self.rows: dict[tuple[int, tuple[int, int], int], dict[str, Any]] = {}

    def row(self, count: int, size: tuple[int, int], threads: int) -> dict[str, Any]:
        """The figures of one setting; prints them when they are new."""
        key = (count, size, threads)
        if key in self.rows:
            return self.rows[key]
        path = self.folder / f"{count}.ply"
        if not path.exists():
            write_ply(path, resample(self.map, count))
        command = [sys.executable, __file__, "--measure", str(path), "--scene", self.options.scene]
        command += ["--size", *map(str, size), "--rounds", str(self.options.rounds)]
        run = subprocess.run(
            command,
            env=os.environ | {"RAYON_NUM_THREADS": str(threads)},
            check=True,
            stdout=subprocess.PIPE,
            text=True,
        )
        row = {"threads": threads, "size": size, **json.loads(run.stdout)}
        self.rows[key] = row
        if not self.options.json:
            print(
                f"{row['gaussians']:7d} Gaussians, {size[0]:4d}x{size[1]:<4d}, {threads:2d} thread(s): "
                f"{row['iteration']:7.2f} ms an iteration, peak memory {row['peak_mib']:5.0f} MiB",
                flush=True,
            )
        return row


def report(bench: Bench, options: argparse.Namespace) -> dict[str, Any]:
    """All measurements, and how steeply time grows."""
    cores = os.cpu_count() or 1
    threads = sorted({1, min(2, cores)})
    by_pixels = {t: [bench.row(MIDDLE_COUNT, size, t) for size in SIZES] for t in threads}
    by_count = {t: [bench.row(count, MIDDLE_SIZE, t) for count in COUNTS] for t in threads}
    steps = sorted({*threads, cores, *(2**k for k in range(8) if 2**k <= cores)})
    by_threads = [bench.row(MIDDLE_COUNT, MIDDLE_SIZE, t) for t in steps]
    one = by_threads[0]["iteration"]
    efficiency = {r["threads"]: one / (r["threads"] * r["iteration"]) for r in by_threads}
    growth = {
        name: max(
            np.log(b["iteration"] / a["iteration"]) / np.log(b[name] / a[name])
            for lines in table.values()
            for a, b in pairwise(lines)
        )
        for name, table in (("pixels", by_pixels), ("gaussians", by_count))
    }
    if not options.json:
        shown = ", ".join(f"{t}: {e:.0%}" for t, e in efficiency.items())
        print(f"parallel efficiency by threads: {shown}")
        print(
            f"steepest growth, as a power (1 is linear): {growth['pixels']:.2f} of pixels, "
            f"{growth['gaussians']:.2f} of Gaussians"
        )
    if options.plot:
        save(Path(options.plot), panels(by_pixels, by_count, efficiency))
    return {"rows": list(bench.rows.values()), "efficiency": efficiency, "growth": growth}


def panels(
    by_pixels: dict[int, list[dict[str, Any]]],
    by_count: dict[int, list[dict[str, Any]]],
    efficiency: dict[int, float],
) -> list[Panel]:
    """Time against pixels and Gaussians, with a linear guide; efficiency where there are threads for it."""

    def curves(table: dict[int, list[dict[str, Any]]], name: str) -> dict[str, list[tuple[float, float]]]:
        lines = {
            f"{t} thread{'s' * (t > 1)}": [(r[name], r["iteration"]) for r in rows]
            for t, rows in table.items()
        }
        first, last = table[1][0], table[1][-1]
        guide = last["iteration"] / last[name]
        return lines | {"linear": [(first[name], guide * first[name]), (last[name], guide * last[name])]}

    size = "x".join(map(str, MIDDLE_SIZE))
    out = [
        Panel(
            f"{MIDDLE_COUNT:,} Gaussians",
            "pixels",
            "ms an iteration",
            curves(by_pixels, "pixels"),
            True,
            {"linear"},
        ),
        Panel(size, "Gaussians", "ms an iteration", curves(by_count, "gaussians"), True, {"linear"}),
    ]
    if len(efficiency) > 2:
        line = {"measured": [(float(t), e) for t, e in efficiency.items()]}
        out.append(Panel(f"{size}, {MIDDLE_COUNT:,}", "threads", "parallel efficiency", line))
    return out


def main() -> None:
    """Measures, prints, draws."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scene", default="dev_kitchen")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--plot", help="draw the table to this PNG")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--size", type=int, nargs=2, default=MIDDLE_SIZE, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        print(json.dumps(measure(options.measure, options.scene, *options.size, options.rounds)))
        return
    with tempfile.TemporaryDirectory() as folder:
        result = report(Bench(Path(folder), options), options)
    if options.json:
        print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
