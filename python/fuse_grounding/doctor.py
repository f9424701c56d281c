"""What this machine has, what is missing, and how to get it."""

from __future__ import annotations

import importlib.metadata as metadata
import os
import platform
import shutil
from dataclasses import dataclass
from pathlib import Path

from fuse_grounding import _core, splat
from fuse_grounding.errors import FuseError

PACKAGE = Path(__file__).parent


@dataclass(frozen=True)
class Check:
    """One line of the report; `hint` says what to do when it is not `ok`."""

    name: str
    ok: bool
    found: str
    hint: str = ""


def _package(name: str, hint: str = "", required: bool = True) -> Check:
    try:
        return Check(name, True, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Check(name, not required, "not installed", hint or f"pip install {name}")


def _shipped(name: str, path: Path) -> Check:
    hint = "reinstall fuse-grounding: the file belongs to the package"
    if not path.exists():
        return Check(name, False, f"{path.name} is missing", hint)
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    size = sum(p.stat().st_size for p in files)
    return Check(name, size > 0, f"{len(files)} file(s), {size / 1e6:.1f} MB", hint)


def _memory() -> Check:
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    except (ValueError, OSError, AttributeError):
        return Check("memory", True, "unknown")
    return Check("memory", total >= 4, f"{total:.1f} GiB", "an episode needs about 2 GiB")


def _disk() -> Check:
    free = shutil.disk_usage(Path.cwd()).free / 2**30
    return Check("free disk", free >= 1, f"{free:.1f} GiB here", "a run folder takes a few MB")


def _gpu() -> Check:
    """A GPU is never needed: without one, the line says what was found and why it is not taken. One that is
    there but fails is told, since `auto` does not pass it over."""
    try:
        auto = splat.device_name("auto")
    except FuseError as error:
        return Check("gpu", False, f"{error}", "`auto` and `gpu` fail with it; `cpu` works")
    try:
        return Check("gpu", True, f"`auto` takes {auto}; `gpu` takes {splat.device_name('gpu')}")
    except FuseError as error:
        return Check("gpu", True, f"{error}; maps are trained on {auto}")


def examine() -> list[Check]:
    """All checks, in the order of the report."""
    return [
        Check("fuse-grounding", True, _core.__version__),
        Check("python", True, f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        Check("processors", True, f"{os.cpu_count()} threads, SIMD level {_core.simd_level}"),
        _gpu(),
        _memory(),
        _disk(),
        *(
            _package(n)
            for n in ("numpy", "opencv-python-headless", "onnxruntime", "pycolmap", "pydantic", "safetensors")
        ),
        _package("torch", "pip install 'fuse-grounding[train]' (only to train networks)", required=False),
        _shipped("objects", PACKAGE / "data" / "objects"),
        _shipped("scenes", PACKAGE / "data" / "scenes.json"),
        _shipped("segmenter weights", PACKAGE / "weights" / "segmenter.onnx"),
    ]
