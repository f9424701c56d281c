"""OpenSplat on the CPU: built against an installed torch, without its densification or as it comes.

Needs `cmake`, `ninja`, a C++20 compiler, torch in this Python, and of the system (Debian's names):
libopencv-dev, nlohmann-json3-dev, libnanoflann-dev, libcxxopts-dev.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
from pathlib import Path
from typing import Any

from peers.process import Failed, Ran, environment, replace_all, run

BACKGROUND = (0.6130, 0.0101, 0.3984)
"""What OpenSplat trains over."""
NEVER = 1_000_000
REPLACEMENTS = {
    # What today's torch asks for.
    "CMakeLists.txt": [("CXX_STANDARD 17", "CXX_STANDARD 20")],
    # It reads this column as if it were an array of its own and so sorts by the wrong numbers: its maps then
    # look right in its own renderer only, by 2.6 dB after 260 iterations.
    "rasterizer/gsplat-cpu/gsplat_cpu.cpp": [
        ('camDepths = pProj.index({"...", 2});', 'camDepths = pProj.index({"...", 2}).contiguous();')
    ],
}
STEP = re.compile(r"^Step (\d+): ")
# No smaller photos at first (it starts with a quarter of the width otherwise): the same resolution for all.
FULL_SIZE = ["--cpu", "--keep-crs", "--num-downscales", "0"]


def build(sources: Path, folder: Path) -> Path:
    """The executable. Raises Failed, with what is missing."""
    program = folder / "build" / "opensplat"
    if program.is_file():
        return program
    torch = importlib.util.find_spec("torch")
    if torch is None or torch.origin is None:
        raise Failed("needs torch: `pip install torch`")
    copy = folder / "source"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(sources, copy, ignore=shutil.ignore_patterns(".git"))
    replace_all(copy, REPLACEMENTS)
    configure = [
        *("cmake", "-S", copy, "-B", folder / "build", "-G", "Ninja"),
        *("-DGPU_RUNTIME=CPU", "-DCMAKE_BUILD_TYPE=Release", "-DCMAKE_CXX_FLAGS=-march=native"),
        f"-DTorch_DIR={Path(__file__).parent / 'cmake'}",
        f"-DTORCH_WHEEL={Path(torch.origin).parent}",
        "-DFETCHCONTENT_TRY_FIND_PACKAGE_MODE=ALWAYS",
    ]
    run(configure, folder / "configure.log")
    run(["ninja", "-C", folder / "build"], folder / "build.log")
    return program


def _environment() -> dict[str, str]:
    # Its rasteriser starts two threads of its own; torch's pool would spin beside them.
    return environment(OMP_NUM_THREADS="1", LC_ALL="C")


def step_seconds(lines: list[tuple[float, str]], discard: int) -> float:
    """Mean seconds between two steps, without the first `discard`."""
    times = [seconds for seconds, text in lines if STEP.match(text)]
    if len(times) < discard + 2:
        raise Failed(f"OpenSplat did {len(times)} steps, expected more than {discard + 1}")
    return (times[-1] - times[discard]) / (len(times) - 1 - discard)


def iteration(
    program: Path, scene: Path, folder: Path, start: Path | None, at: int, count: int, discard: int
) -> dict[str, Any]:
    """Seconds an iteration without densification, from the COLMAP points or from a map that OpenSplat
    wrote after `at` iterations."""
    folder.mkdir(parents=True, exist_ok=True)
    command: list[object] = [program, scene / "train", *FULL_SIZE, "-n", at + count, "--warmup-length", NEVER]
    command += ["-o", folder / "timed.ply"] + (["--resume", start] if start else [])
    ran = run(command, folder / f"iteration-{at}.log", _environment())
    return {"seconds": step_seconds(ran.lines, discard), "peak_mib": ran.peak_mib, "others": ran.others}


def quality(program: Path, scene: Path, folder: Path, iterations: int, every: int) -> Ran:
    """A training as OpenSplat does it, at full resolution; leaves a map every `every` iterations."""
    folder.mkdir(parents=True, exist_ok=True)
    command = [program, scene / "train", *FULL_SIZE, "-n", iterations, "-s", every]
    return run([*command, "-o", folder / "map.ply"], folder / "quality.log", _environment())


def maps(folder: Path) -> dict[int, Path]:
    """The maps of `quality`, by iteration."""
    found = {int(p.stem.split("_")[1]): p for p in folder.glob("map_*.ply") if os.path.getsize(p)}
    return dict(sorted(found.items()))
