"""Geometric uncertainty at 640x480: FUSE against OpenCV and NumPy, in the same run.

Two twins compute the same map in float32, as one would write them with care for speed:

- `numpy`:  OpenCV for grey, gradients and window sums, NumPy for the arithmetic between;
- `opencv`: OpenCV throughout, in place where it can be.

Functions take turns in bursts of ten calls, so that a busy machine slows all of them alike and none
pays for waking threads that slept through the others' turns; minimum and median over the calls are
reported. Ratios are a twin's time over ours: above 1 we are faster. The twins make a
dozen temporary images a call. In a fresh process the allocator hands them back to the system each
time; in one that has freed a large array before (`warm heap`) it keeps them, which spares the
twins most of their page faults. Both are measured.

    python benches/evidence.py [--repeats 300] [--json]

With --check: exit status 1 when the ratio of minima to the NumPy twin is below 10 on two threads
in a fresh process, as it can be on a busy machine.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time

WIDTH, HEIGHT = 640, 480
THREADS = (1, 2)
TWINS = ("numpy", "opencv")
GOAL = 10.0
BURST = 10


def numpy_twin(observed, rendered):
    """OpenCV filters, NumPy arithmetic."""
    import cv2
    import numpy as np

    border = cv2.BORDER_REFLECT_101

    def magnitude(image):
        grey = cv2.cvtColor(image.astype(np.float32) * np.float32(1 / 255), cv2.COLOR_RGB2GRAY)
        dx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, borderType=border)
        dy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, borderType=border)
        return cv2.magnitude(dx, dy)

    def window(field):
        return cv2.boxFilter(field, cv2.CV_32F, (11, 11), normalize=False, borderType=border)

    a, b = magnitude(observed), magnitude(rendered)
    epsilon = np.float32(1e-8)
    ratio = (window(a * a) + epsilon) / (window((a - b) ** 2) + epsilon)
    db = np.clip(10 * np.log10(ratio), -30, 30)
    return 0.8 * (1 - (db + 30) / 60)


def opencv_twin(observed, rendered):
    """OpenCV throughout; scaled inside Sobel, squared inside the box filter's input, log in place."""
    import cv2
    import numpy as np

    border = cv2.BORDER_REFLECT_101

    def magnitude(image):
        grey = cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2GRAY)
        dx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / 255, borderType=border)
        dy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=1 / 255, borderType=border)
        return cv2.magnitude(dx, dy)

    def window(field):
        cv2.multiply(field, field, dst=field)
        return cv2.boxFilter(field, -1, (11, 11), normalize=False, borderType=border)

    a, b = magnitude(observed), magnitude(rendered)
    cv2.subtract(a, b, dst=b)
    signal, noise = window(a), window(b)
    signal += np.float32(1e-8)
    noise += np.float32(1e-8)
    cv2.divide(signal, noise, dst=signal)
    cv2.log(signal, dst=signal)
    limit = np.float32(3 * np.log(10))
    np.clip(signal, -limit, limit, out=signal)
    signal *= np.float32(-0.4) / limit
    signal += np.float32(0.4)
    return signal


def pictures():
    """An observation with structure at all scales and a blurred rendering of it."""
    import cv2
    import numpy as np

    rng = np.random.default_rng(0)
    observed = rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    for step in (4, 16, 48):
        layer = rng.integers(0, 256, (HEIGHT // step, WIDTH // step, 3), dtype=np.uint8)
        observed = cv2.addWeighted(observed, 0.5, cv2.resize(layer, (WIDTH, HEIGHT)), 0.5, 0)
    return observed, cv2.GaussianBlur(observed, (0, 0), 1.0)


def measure(threads: int, repeats: int, warm: bool) -> dict[str, list[float]]:
    """Milliseconds of each, [minimum, median], in this process with this many threads."""
    import cv2
    import numpy as np

    from fuse_grounding import evidence

    cv2.setNumThreads(threads)
    observed, rendered = pictures()
    floats = rendered.astype(np.float32) / np.float32(255)
    if warm:
        # The largest block that moves the allocator's limits (glibc: 32 MiB).
        large = np.ones(24 << 20, np.uint8)
        del large
    calls = {
        "numpy": lambda: numpy_twin(observed, rendered),
        "opencv": lambda: opencv_twin(observed, rendered),
        "fuse": lambda: evidence.geometric_uncertainty(observed, rendered),
        "fuse_float": lambda: evidence.geometric_uncertainty(observed, floats),
    }
    ours = calls["fuse"]()
    for name in ("numpy", "opencv", "fuse_float"):
        difference = float(np.abs(calls[name]() - ours).max())
        if difference > 2e-4:
            raise SystemExit(f"{name} computes something else: differs by {difference}")
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(-(-repeats // BURST)):
        for name, call in calls.items():
            for _ in range(BURST):
                start = time.perf_counter()
                call()
                times[name].append(1e3 * (time.perf_counter() - start))
    return {name: [min(t), statistics.median(t)] for name, t in times.items()}


def in_process(threads: int, repeats: int, warm: bool) -> dict[str, list[float]]:
    """`measure` in a process of its own: pool and allocator are set up once a process."""
    command = [sys.executable, __file__, "--threads", str(threads), "--repeats", str(repeats)]
    run = subprocess.run(
        command + ["--warm"] * warm,
        env=os.environ | {"RAYON_NUM_THREADS": str(threads)},
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return json.loads(run.stdout)


def main() -> int:
    """Prints milliseconds and ratios."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=300)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--check", action="store_true", help="exit 1 below the goal")
    parser.add_argument("--threads", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--warm", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.threads:
        print(json.dumps(measure(arguments.threads, arguments.repeats, arguments.warm)))
        return 0

    from fuse_grounding._core import simd_level

    rows = []
    for threads in THREADS:
        for warm in (False, True):
            times = in_process(threads, arguments.repeats, warm)
            ratios = {n: [a / b for a, b in zip(times[n], times["fuse"], strict=True)] for n in TWINS}
            heap = "warm heap" if warm else "fresh"
            rows.append({"threads": threads, "heap": heap, "milliseconds": times, "ratios": ratios})
    if arguments.json:
        print(json.dumps({"simd": simd_level, "rows": rows}))
    else:
        print(
            f"geometric uncertainty {WIDTH}x{HEIGHT}, {simd_level}, {arguments.repeats} repeats: min (median)"
        )
        for row in rows:
            shown = [f"{n} {t[0]:.2f} ({t[1]:.2f}) ms" for n, t in row["milliseconds"].items()]
            shown += [f"{n}/fuse {r[0]:.1f}x ({r[1]:.1f}x)" for n, r in row["ratios"].items()]
            print(f"{row['threads']} threads, {row['heap']:9}: " + "  ".join(shown))
    reached = next(r for r in rows if r["threads"] == 2 and r["heap"] == "fresh")["ratios"]["numpy"][0]
    return 1 if arguments.check and reached < GOAL else 0


if __name__ == "__main__":
    raise SystemExit(main())
