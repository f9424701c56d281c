"""Which renderers there are, and how each is run: in a process of its own, with a limit in time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BENCHES = Path(__file__).parents[1]
PACKAGES = ("mujoco==4.0.0", "pybullet==3.2.7", "pyrender==0.1.45", "moderngl==5.13.0", "pillow", "numpy")
LATER = "PyOpenGL==3.1.10"
"""pyrender asks for 3.1.0, with which MuJoCo finds no EGL device; it works with this one too."""


@dataclass(frozen=True)
class Run:
    """A row of the table: a module of this package, how it draws, and what it casts."""

    name: str
    module: str
    package: str
    variant: str
    light: str
    threads: int | None = None

    @property
    def ours(self) -> bool:
        """Whether it runs in this interpreter."""
        return self.module == "ours"


RUNS = (
    Run("FUSE", "ours", "fuse_grounding", "-", "soft shadow, AO, anti-aliased"),
    Run("FUSE, one thread", "ours", "fuse_grounding", "-", "soft shadow, AO, anti-aliased", 1),
    Run("MuJoCo, EGL, defaults", "mujoco_gl", "mujoco", "default", "shadow 4096x4096, 4 samples"),
    Run("MuJoCo, EGL, tuned", "mujoco_gl", "mujoco", "tuned", "shadow 2048x2048"),
    Run("MuJoCo, EGL, tuned", "mujoco_gl", "mujoco", "tuned_plain", "no shadow"),
    Run("PyBullet, TinyRenderer", "bullet", "pybullet", "-", "no shadow"),
    Run("pyrender, EGL", "pyrender_gl", "pyrender", "-", "no shadow, 4 samples"),
    Run("own shaders, moderngl, EGL", "shaders", "moderngl", "shadow", "hard shadow 2048x2048"),
    Run("own shaders, moderngl, EGL", "shaders", "moderngl", "plain", "no shadow"),
)


def installed(python: Path, package: str) -> bool:
    """Whether an interpreter finds a package, without importing it."""
    code = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({package!r}) is None)"
    try:
        return subprocess.run([python, "-c", code], capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def install(folder: Path) -> Path:
    """An environment with all peers in `folder`; returns its interpreter."""
    python = folder / "bin" / "python"
    if not python.is_file():
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    pip = [python, "-m", "pip", "install", "--quiet"]
    subprocess.run([*pip, *PACKAGES], check=True)
    subprocess.run([*pip, "--no-deps", LATER], check=True)
    return python


def measure(run: Run, peers: Path, scene: Path, out: Path, rounds: int, limit: float) -> dict[str, Any]:
    """A row: what the child says, or `failed`. `out` gets its pictures."""
    row: dict[str, Any] = {"name": run.name, "light": run.light}
    python = Path(sys.executable) if run.ours else peers
    if not installed(python, run.package):
        return row | {"failed": "not installed"}
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(BENCHES), os.environ.get("PYTHONPATH", "")])}
    if run.threads is not None:
        env["RAYON_NUM_THREADS"] = str(run.threads)
    command = [python, "-W", "ignore", "-m", "renderers.child", run.module, run.variant, scene, out, rounds]
    # Its own group: what it starts ends with it.
    child = subprocess.Popen(
        [str(c) for c in command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=env,
        start_new_session=True,
    )
    try:
        said, errors = child.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGKILL)
        child.communicate()
        return row | {"failed": f"not done after {limit:.0f} s"}
    if child.returncode != 0:
        last = next((line for line in reversed(errors.splitlines()) if line.strip()), "no message")
        return row | {"failed": f"ended with status {child.returncode}: {last}".replace("|", "/")}
    return row | json.loads(said.splitlines()[-1])
