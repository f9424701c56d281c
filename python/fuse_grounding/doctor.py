"""What this machine has, what is missing, and how to get it."""

from __future__ import annotations

import importlib.metadata as metadata
import importlib.util
import os
import platform
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuse_grounding import _core, splat
from fuse_grounding.config import Config
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.perception.doors import ENCODER_GROUP, ENCODERS, SEGMENTER_GROUP, SEGMENTERS
from fuse_grounding.perception.own import entry_points, load
from fuse_grounding.registry import Registry

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


def _doors(kind: str, doors: Registry[Any], chosen: Any) -> list[Check]:
    """One line for each segmenter or encoder; none has to be usable but the one that is chosen."""
    checks = []
    for name in doors.names():
        door, configured = doors.get(name), chosen.name == name
        ways, missing = [], []
        for route in door.routes:
            absent = [package for package in route.packages if importlib.util.find_spec(package) is None]
            if absent:
                missing.append(f"{route.name}: {', '.join(absent)} missing (pip install 'fuse-grounding[{route.extra}]')")
            else:
                ways.append(route.name)
        usable = f"through {' and '.join(ways)}" if ways else ""
        found = "; ".join(filter(None, [usable, *missing])) or "usable"
        ok, hint = bool(ways) or not door.routes, "install one of the extras"
        if configured and (chosen.weights is not None or not door.routes):
            try:
                files = door.files(chosen)
                found += "" if not files else f"; weights: {len(files)} file(s) in {files[0].parent}"
            except InputError as error:
                ok, found, hint = False, f"{found}; {error}", "name another folder: --weights"
        elif door.routes:
            found += "; no checkpoint folder named (--weights, with --segmenter)"
            ok = ok and not configured
        checks.append(Check(f"{kind} {name}", ok or not configured, found, hint))
    return checks


def _own(kind: str, group: str, doors: Registry[Any], chosen: Any) -> list[Check]:
    """A line for each entry point, and for the class that is chosen."""
    names = {f"{kind} {name}": value for name, value in entry_points(group).items()}
    if chosen.name not in doors.names():
        names.setdefault(f"{kind} {chosen.name}", chosen.name)
    checks = []
    for name, value in names.items():
        try:
            load(kind, value)
            checks.append(Check(name, True, f"{value} can be loaded"))
        except InputError as error:
            checks.append(Check(name, False, f"{error}", "docs/models/doors.md"))
    return checks


def examine(config: Config | None = None) -> list[Check]:
    """All checks, in the order of the report; `config` says which segmenter and encoder must be usable."""
    config = config or Config()
    return [
        Check("fuse-grounding", True, _core.__version__),
        Check("python", True, f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        Check("processors", True, f"{os.cpu_count()} threads, SIMD level {_core.simd_level}"),
        _gpu(),
        _memory(),
        _disk(),
        *(_package(n) for n in ("numpy", "opencv-python-headless", "onnxruntime", "pycolmap", "pydantic")),
        _package("torch", "pip install 'fuse-grounding[train]' (only to train networks)", required=False),
        *_doors("segmenter", SEGMENTERS, config.segmenter),
        *_own("segmenter", SEGMENTER_GROUP, SEGMENTERS, config.segmenter),
        *_doors("encoder", ENCODERS, config.encoder),
        *_own("encoder", ENCODER_GROUP, ENCODERS, config.encoder),
        _shipped("objects", PACKAGE / "data" / "objects"),
        _shipped("scenes", PACKAGE / "data" / "scenes.json"),
        _shipped("segmenter weights", PACKAGE / "weights" / "segmenter.onnx"),
    ]
