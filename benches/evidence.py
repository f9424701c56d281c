"""Geometric uncertainty at 640x480: FUSE against OpenCV and NumPy, in the same run.

Two twins compute the same map in float32, as one would write them with care for speed:

- `numpy`:  OpenCV for grey, gradients and window sums, NumPy for the arithmetic between;
- `opencv`: OpenCV throughout, in place where it can be.

Calls of the three take turns, so that a busy machine slows all of them alike; the minimum over the
repeats is reported. Ratios are the twin's time over ours: above 1 we are faster.

    python benches/evidence.py [--repeats 300] [--json]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time

WIDTH, HEIGHT = 640, 480
THREADS = (1, 2)
GOAL = 10.0


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
    layers = [
        cv2.resize(rng.integers(0, 256, (HEIGHT // s, WIDTH // s, 3), dtype=np.uint8), (WIDTH, HEIGHT))
        for s in (1, 4, 16, 48)
    ]
    observed = np.mean(np.stack(layers), 0).astype(np.uint8)
    return observed, cv2.GaussianBlur(observed, (0, 0), 1.0)


def measure(threads: int, repeats: int) -> dict[str, float]:
    """Milliseconds of each, minimum over repeats, in a process with this many threads."""
    import cv2
    import numpy as np

    from fuse_grounding import evidence

    cv2.setNumThreads(threads)
    observed, rendered = pictures()
    floats = rendered.astype(np.float32) / 255
    calls = {
        "numpy": lambda: numpy_twin(observed, rendered),
        "opencv": lambda: opencv_twin(observed, rendered),
        "fuse": lambda: evidence.geometric_uncertainty(observed, rendered),
        "fuse_float": lambda: evidence.geometric_uncertainty(observed, floats),
    }
    ours = calls["fuse"]()
    for name in ("numpy", "opencv"):
        difference = float(np.abs(calls[name]() - ours).max())
        if difference > 2e-4:
            raise SystemExit(f"the {name} twin computes something else: differs by {difference}")
    best = dict.fromkeys(calls, float("inf"))
    for _ in range(repeats):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            best[name] = min(best[name], 1e3 * (time.perf_counter() - start))
    return best


def in_process(threads: int, repeats: int) -> dict[str, float]:
    """`measure` in a process of its own: the pool's size is set once a process."""
    run = subprocess.run(
        [sys.executable, __file__, "--threads", str(threads), "--repeats", str(repeats)],
        env=os.environ | {"RAYON_NUM_THREADS": str(threads), "OMP_NUM_THREADS": str(threads)},
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    return json.loads(run.stdout)


def main() -> int:
    """Prints milliseconds and ratios; exit status 1 when the goal is missed on two threads."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repeats", type=int, default=300)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--threads", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.threads:
        print(json.dumps(measure(arguments.threads, arguments.repeats)))
        return 0

    from fuse_grounding._core import simd_level

    results = {threads: in_process(threads, arguments.repeats) for threads in THREADS}
    ratios = {
        threads: {name: times[name] / times["fuse"] for name in ("numpy", "opencv")}
        for threads, times in results.items()
    }
    if arguments.json:
        print(json.dumps({"simd": simd_level, "milliseconds": results, "ratios": ratios}))
    else:
        print(f"geometric uncertainty, {WIDTH}x{HEIGHT}, {simd_level}; minimum of {arguments.repeats}")
        for threads, times in results.items():
            line = "  ".join(f"{name} {value:.3f} ms" for name, value in times.items())
            shown = "  ".join(f"{name} {value:.1f}x" for name, value in ratios[threads].items())
            print(f"{threads} thread{'s' * (threads > 1)}: {line}  | over ours: {shown}")
    return 0 if min(ratios[2].values()) >= GOAL else 1


if __name__ == "__main__":
    raise SystemExit(main())
