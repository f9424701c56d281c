"""Where a result comes from: versions, SIMD level, device, weights. Nothing here names a user or a place."""

from __future__ import annotations

import hashlib
import importlib.metadata
import platform
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

from fuse_grounding import _core

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


def sha256(path: Path) -> str:
    """Hex digest of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def provenance(device: str, render_device: str, **files: Path) -> dict[str, Any]:
    """Versions of everything that computes, and digests of `files` by name.

    `device` is what maps are trained on, from `splat.device_name`; `render_device` what the tabletop world
    is rendered on.
    """
    packages = {}
    for name in _PACKAGES:
        try:
            packages[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            packages[name] = "unknown"
    return {
        "fuse_grounding": _core.__version__,
        **_git(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "simd_level": _core.simd_level,
        "device": device,
        "render_device": render_device,
        "packages": packages,
        "sha256": {name: sha256(path) for name, path in files.items() if path.exists()},
    }
