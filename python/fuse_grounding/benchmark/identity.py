"""What makes two benchmark runs one experiment: everything that can change a result, by name.

Results whose identities differ are never mixed (`store.py`). Paths, times and the machine's name are
no part of it; commit and Python version are kept for people, in the provenance beside it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fuse_grounding.config import Config
from fuse_grounding.environment import Episode

IDENTITY_VERSION = 1
"""Raised when the meaning of a part changes; results of another version are refused."""

RUNTIME_SETTINGS = {
    "method": "each result names its own, and a resumed benchmark may add some",
    "segmenter.weights": "where the file lies; its bytes count, under `weights`",
    "segmenter.device": "what was wished for; what was taken counts, under `perception`",
    "encoder.weights": "where they lie; their bytes count, under `weights`",
    "encoder.device": "what was wished for; what was taken counts, under `perception`",
    "planner.weights": "where the file lies; its bytes count, under `weights`",
    "map.device": "what was wished for; what was taken counts, under `device`",
    "render.device": "what was wished for; what was taken counts, under `render_device`",
    **{
        f"{section}.{name}": why
        for section in ("knowledge.llm", "vlm")
        for name, why in (
            ("key_env", "who asks; the address and the name of the model count"),
            ("cache", "where replies lie"),
            ("offline", "whether more may be asked: without a reply, nothing runs"),
        )
    },
}
"""Settings without influence on a result, each with the reason; every other setting is identity."""

_PACKAGE = Path(__file__).parents[1]
_NO_RESULTS = ("cli", "training")
"""Folders of the package whose code never runs within an episode."""

_MEANINGS = {
    "identity_version": "by a version that describes its runs otherwise",
    "config": "with other settings",
    "episodes": "over other episodes",
    "weights": "with other weights",
    "code": "by another version of the code",
    "data": "with other objects, scenes or knowledge",
    "packages": "with other packages",
    "simd_level": "at another SIMD level",
    "device": "on another device",
    "render_device": "with pictures of another device",
    "perception": "with a segmenter or encoder on another device",
}


def identity(config: Config, episodes: Sequence[Episode], provenance: Mapping[str, Any]) -> dict[str, Any]:
    """The parts that decide results, as JSON values.

    `provenance` is an agent's: its packages, SIMD level, device and digests of weights count here.
    """
    return {
        "identity_version": IDENTITY_VERSION,
        "config": _settings(config),
        "episodes": {e.episode_id: digest(e.text.encode()) for e in episodes},
        "weights": provenance["sha256"],
        "code": code_digest(_PACKAGE),
        "data": _files_digest(_PACKAGE, (p for p in (_PACKAGE / "data").rglob("*") if _decides(p))),
        "packages": provenance["packages"],
        "simd_level": provenance["simd_level"],
        "device": provenance["device"],
        "render_device": provenance["render_device"],
        "perception": provenance["perception"],
    }


def name(identity: Mapping[str, Any]) -> str:
    """A short name, alike for alike identities: stamped on every result."""
    return digest(json.dumps(identity, sort_keys=True).encode())[:16]


def difference(found: Any, wanted: Mapping[str, Any]) -> str | None:
    """How the run of identity `found` was another one, continuing "was made ..."; None if it was not."""
    if not isinstance(found, Mapping):
        return f"{_MEANINGS['identity_version']} (no identity there)"
    for part in wanted:
        where = _first_difference(found.get(part), wanted[part], part)
        if where is not None:
            return f"{_MEANINGS[part]} ({where})"
    unknown = sorted(found.keys() - wanted.keys())
    return f"{_MEANINGS['identity_version']} (`{unknown[0]}` there)" if unknown else None


def digest(content: bytes) -> str:
    """SHA-256, hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def code_digest(package: Path) -> str:
    """One digest of the compiled module and all Python files that can run within an episode."""
    python = (p for p in package.rglob("*.py") if p.relative_to(package).parts[0] not in _NO_RESULTS)
    return _files_digest(package, (*python, *package.glob("_core*.so"), *package.glob("_core*.pyd")))


def _files_digest(root: Path, files: Any) -> str:
    total = hashlib.sha256()
    for path in sorted(files):
        total.update(f"{path.relative_to(root).as_posix()} {digest(path.read_bytes())}\n".encode())
    return total.hexdigest()


def _decides(path: Path) -> bool:
    """Whether a file of the data can change a result: not how long a set took to make."""
    return path.is_file() and not path.name.endswith(".generation.json")


def _settings(config: Config) -> dict[str, Any]:
    settings = config.to_dict()
    for key in RUNTIME_SETTINGS:
        *sections, last = key.split(".")
        table = settings
        for section in sections:
            table = table[section]
        del table[last]
    # A section of runtime settings only leaves nothing to compare.
    return {key: value for key, value in settings.items() if value != {}}


def _first_difference(found: Any, wanted: Any, key: str) -> str | None:
    """The first key whose values differ, with both; long digests are shortened."""
    if isinstance(found, Mapping) and isinstance(wanted, Mapping):
        for inner in sorted(found.keys() | wanted.keys()):
            where = _first_difference(found.get(inner), wanted.get(inner), f"{key}.{inner}")
            if where is not None:
                return where
        return None
    return None if found == wanted else f"`{key}` is {_short(found)} there and {_short(wanted)} here"


def _short(value: Any) -> str:
    if value is None:
        return "missing"
    return value[:12] if isinstance(value, str) and len(value) == 64 else repr(value)
