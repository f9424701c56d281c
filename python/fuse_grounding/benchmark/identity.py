"""What makes two results comparable: everything that can change one, by name, with a version.

Results whose identities differ are never mixed (`store.py`). Each row is stamped with the hash of what
decides it: settings, weights, its episode, packages, devices, and `RESULTS_VERSION` for the code. Paths,
times, the machine and the commit are no part of it: they are kept for people, in the provenance beside it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fuse_grounding.config import Config
from fuse_grounding.environment import Episode

RESULTS_VERSION = 4
"""Raised by whoever changes what an episode comes to: decisions, scores or metrics (CONTRIBUTING.md).

`tests/python/test_results_version.py` plays two recorded episodes and fails where they come out otherwise. A
hash of the code would be stricter, but would throw away a night's results for the edit of a comment.
"""

IDENTITY_VERSION = 2
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

SERIES = {
    "numpy": "streams of random numbers change with feature releases alone (NEP 19), and `random` draws them",
    "opencv-python-headless": "its fourth number counts builds, its third repairs; SIFT and resizing decide",
}
"""Packages of which the first two numbers of the version count, with the reason. Of all others, such as
onnxruntime (kernels round as they were written) and pycolmap (poses), the whole version counts."""

_DATA = Path(__file__).parents[1] / "data"
_NO_RESULTS = ("episodes", "schema")
"""Folders of the data that decide nothing: the episodes that are played count one by one."""

_MEANINGS = {
    "identity_version": "by a version that describes its runs otherwise",
    "results_version": "by another version of the code",
    "config": "with other settings",
    "episodes": "over other episodes",
    "weights": "with other weights",
    "data": "with other objects, scenes or knowledge",
    "packages": "with other packages",
    "simd_level": "at another SIMD level",
    "device": "on another device",
    "render_device": "with pictures of another device",
    "perception": "with a segmenter or encoder on another device",
}


def identity(
    config: Config, episodes: Sequence[Episode], provenances: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """The parts that decide results, as JSON values.

    `provenances` are those of the methods' agents, by name: packages, SIMD level, devices and digests of
    weights count there, each method's for itself.
    """
    return {
        "identity_version": IDENTITY_VERSION,
        "results_version": RESULTS_VERSION,
        "config": _settings(config),
        "data": _files_digest(_DATA),
        "methods": {name: decisive(provenance) for name, provenance in provenances.items()},
        "episodes": {e.episode_id: digest(e.text.encode()) for e in episodes},
    }


def decisive(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """What decides results of an agent's provenance."""
    return {
        "weights": provenance["sha256"],
        "packages": {name: _release(name, v) for name, v in provenance["packages"].items()},
        **{part: provenance[part] for part in ("simd_level", "device", "render_device", "perception")},
    }


def stamp(identity: Mapping[str, Any], method: str, episode_id: str) -> str:
    """A short name of all that decides one result, alike for alike results whatever else was run."""
    decides = {key: value for key, value in identity.items() if key not in ("methods", "episodes")}
    decides |= {"method": [method, identity["methods"][method]], "episode": identity["episodes"][episode_id]}
    return digest(json.dumps(decides, sort_keys=True).encode())[:16]


def joined(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> dict[str, Any]:
    """The identity of a folder of identity `found` in which `wanted` goes on."""
    return {**wanted, "methods": {**found["methods"], **wanted["methods"]}}


def difference(found: Any, wanted: Mapping[str, Any]) -> str | None:
    """Why results of identity `found` cannot be gone on with, continuing "was made ..."; None if they can.

    Methods may be added, and episodes at the end: what is there stays true.
    """
    if not isinstance(found, Mapping):
        return f"{_MEANINGS['identity_version']} (no identity there)"
    for part in ("identity_version", "results_version", "config", "data"):
        where = first_difference(found.get(part), wanted[part], part)
        if where is not None:
            return f"{_MEANINGS[part]} ({where})"
    for method, parts in wanted["methods"].items():
        there = found.get("methods", {}).get(method)
        for part, value in parts.items():
            where = None if there is None else first_difference(there.get(part), value, part)
            if where is not None:
                return f"{_MEANINGS[part]} ({where}, method `{method}`)"
    where = _episodes_difference(found.get("episodes", {}), wanted["episodes"])
    if where is not None:
        return f"{_MEANINGS['episodes']} ({where})"
    unknown = sorted(found.keys() - wanted.keys())
    return f"{_MEANINGS['identity_version']} (`{unknown[0]}` there)" if unknown else None


def _episodes_difference(found: Mapping[str, str], wanted: Mapping[str, str]) -> str | None:
    for name, there in found.items():
        where = first_difference(there, wanted.get(name), f"episodes.{name}")
        if where is not None:
            return where
    for number, (there, here) in enumerate(zip(found, wanted, strict=False)):
        if there != here:  # an episode's place seeds `random`
            return f"episode {number} is `{there}` there and `{here}` here"
    return None


def _release(name: str, version: str) -> str:
    return ".".join(version.split(".")[:2]) if name in SERIES else version


def digest(content: bytes) -> str:
    """SHA-256, hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def _files_digest(folder: Path) -> str:
    """One digest of a folder's files with their paths."""
    total = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        place = path.relative_to(folder)
        if place.parts[0] not in _NO_RESULTS:
            total.update(f"{place.as_posix()} {digest(path.read_bytes())}\n".encode())
    return total.hexdigest()


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


def first_difference(found: Any, wanted: Any, key: str) -> str | None:
    """The first key whose values differ, with both; long digests are shortened."""
    if isinstance(found, Mapping) and isinstance(wanted, Mapping):
        for inner in sorted(found.keys() | wanted.keys()):
            where = first_difference(found.get(inner), wanted.get(inner), f"{key}.{inner}")
            if where is not None:
                return where
        return None
    return None if found == wanted else f"`{key}` is {_short(found)} there and {_short(wanted)} here"


def _short(value: Any) -> str:
    if value is None:
        return "missing"
    return value[:12] if isinstance(value, str) and len(value) == 64 else repr(value)
