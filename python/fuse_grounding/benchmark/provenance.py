"""Where a result comes from: versions, SIMD level, device, weights. Nothing here names a user or a place."""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import platform
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from fuse_grounding import _core
from fuse_grounding.errors import InputError

_PACKAGES = ("numpy", "opencv-python-headless", "onnxruntime", "pycolmap")
_ROOT = Path(__file__).parents[3]


@cache
def _git() -> dict[str, Any]:
    """Commit and whether tracked files differ from it; empty outside a checkout of this project."""
    if not (_ROOT / "crates" / "fuse-py").is_dir():
        return {}
    try:
        commit, status = (
            subprocess.run(
                ["git", "-C", str(_ROOT), *arguments], capture_output=True, text=True, timeout=20, check=True
            ).stdout.strip()
            for arguments in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])
        )
    except (OSError, subprocess.SubprocessError):
        return {}
    return {"commit": commit, "dirty": bool(status)}


@cache
def code_digest() -> str:
    """One digest of the package's Python files and its compiled module, to tell what made a result."""
    package = Path(__file__).parents[1]
    total = hashlib.sha256()
    for path in sorted((*package.rglob("*.py"), *package.glob("_core*.so"), *package.glob("_core*.pyd"))):
        total.update(f"{path.relative_to(package).as_posix()} {_digest(path)}\n".encode())
    return total.hexdigest()


def machine() -> dict[str, Any]:
    """Processor, cores and memory, without a name: what wall times depend on."""
    model = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    except (OSError, ValueError, StopIteration):  # not Linux, or a processor that has no such line
        return {"processor": model, "cores": os.cpu_count()}
    return {"processor": model, "cores": os.cpu_count(), "memory_gib": round(memory, 1)}


def sha256(files: Sequence[Path]) -> str:
    """Hex digest of a file, or of several with their names, wherever they lie. Raises InputError."""
    digests = [(path.name, _digest(path)) for path in files]
    if len(digests) == 1:
        return digests[0][1]
    lines = sorted(f"{name} {digest}\n" for name, digest in digests)
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _digest(path: Path) -> str:
    total = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                total.update(block)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    return total.hexdigest()


def provenance(
    device: str,
    render_device: str,
    perception: Mapping[str, str],
    packages: Iterable[str] = (),
    **files: Sequence[Path],
) -> dict[str, Any]:
    """Versions of everything that computes, and digests of `files` by name, where there are any.

    `device` is what maps are trained on, from `splat.device_name`; `render_device` what the tabletop world
    is rendered on; `perception` what segmenter and encoder run on; `packages` the distributions they need.
    """
    versions = {}
    for name in dict.fromkeys((*_PACKAGES, *packages)):
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            versions[name] = "unknown"
    return {
        "fuse_grounding": _core.__version__,
        **_git(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "simd_level": _core.simd_level,
        "device": device,
        "render_device": render_device,
        "perception": dict(perception),
        "packages": versions,
        "sha256": {name: sha256(paths) for name, paths in files.items() if paths},
    }
