"""The four sets of episodes, and how a set is generated: in parts, so that an interrupted run goes on.

Parts lie in a folder beside the output until the set is complete: `NAME.json.gz.parts`. `plan.json` in it
says what they are parts of; parts of anything else are refused.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuse_grounding import _core
from fuse_grounding.arguments import whole
from fuse_grounding.environment.episodes import (
    DATA,
    Episode,
    knobs,
    phrasings,
    save_episodes,
    stage,
    valid_categories,
)
from fuse_grounding.errors import InputError
from fuse_grounding.record import write_atomically
from fuse_grounding.registry import unknown

PART = 8
"""Episodes of a part: what an interruption costs at most."""


@dataclass(frozen=True)
class SetPlan:
    """A set: scenes and objects of `split`, its natural size and its recorded seed."""

    name: str
    split: str
    count: int
    seed: int
    purpose: str


SETS = {
    plan.name: plan
    for plan in (
        SetPlan(
            "train", "train", 416, 11001, "what planners are trained on (the paper has 416 trajectories)"
        ),
        SetPlan("dev", "dev", 25, 22002, "what is tuned on; its first five choose the gate's threshold"),
        SetPlan("eval", "eval", 100, 33003, "what is reported"),
        SetPlan("large", "eval", 1000, 44004, "what is reported where 100 episodes are too few"),
    )
}
"""The sets by name. `eval` and `large` share scenes and instances, and no seed."""


@dataclass(frozen=True)
class Generated:
    """A finished set. `seconds` were spent on it over all runs; `rejected` counts layouts by reason."""

    path: Path
    episodes: int
    rejected: dict[str, int]
    seconds: float


def plan_of(name: str) -> SetPlan:
    """The set of that name. Raises InputError."""
    if name not in SETS:
        raise InputError(unknown("split", name, list(SETS)))
    return SETS[name]


def timing_path(path: Path) -> Path:
    """Where the time that a set took is noted: beside it, as it is no part of the set."""
    return path.with_name(path.name.removesuffix(".json.gz") + ".generation.json")


def generate_set(
    name: str,
    path: Path,
    *,
    count: int | None = None,
    seed: int | None = None,
    difficulty: Mapping[str, Any] | None = None,
    threads: int | None = None,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> Generated:
    """Writes a set and its statistics; the same arguments give the same bytes on any number of threads.

    `count` and `seed` default to the set's. `tell` hears how many episodes are done, of how many. Raises
    InputError for unknown names, and for parts of something else beside `path`.
    """
    plan = plan_of(name)
    count = plan.count if count is None else whole("count", count, 1)
    seed = plan.seed if seed is None else whole("seed", seed, 0, 2**53 - 1)
    threads = None if threads is None else whole("threads", threads, 1, 1024)
    settings = knobs(difficulty)
    asked = stage().plan_episodes(name, plan.split, phrasings(plan.split), count, seed)
    request = {
        "set": name,
        "split": plan.split,
        "count": count,
        "seed": seed,
        "difficulty": json.loads(settings),
    }
    folder = path.with_name(path.name + ".parts")
    _open_parts(folder, {**request, "made_by": _makers_digest()})
    made: list[tuple[str, str, dict[str, int]]] = []
    seconds = 0.0
    tell(0, count)
    for first in range(0, count, PART):
        part = folder / f"{first:06d}.json"
        if not part.exists():
            began = time.perf_counter()
            fresh = stage().make_episodes(valid_categories(), asked[first : first + PART], settings, threads)
            spent = time.perf_counter() - began
            write_atomically(part, json.dumps({"made": fresh, "part_seconds": spent}))
        stored = _read_part(part, min(PART, count - first))
        made += [tuple(m) for m in stored["made"]]
        seconds += stored["part_seconds"]
        tell(min(first + PART, count), count)
    rejected = _total(reasons for _, _, reasons in made)
    episodes = [Episode(text, statistics) for text, statistics, _ in made]
    save_episodes(path, episodes, {**request, "rejected": rejected})
    timing = {"generate_seconds": round(seconds, 1), "threads": threads or os.cpu_count()}
    write_atomically(timing_path(path), json.dumps(timing) + "\n")
    shutil.rmtree(folder)
    return Generated(path, len(episodes), rejected, seconds)


def _total(counts: Any) -> dict[str, int]:
    total: Counter[str] = Counter()
    for reasons in counts:
        total.update(reasons)
    return dict(sorted(total.items()))


def _open_parts(folder: Path, wanted: dict[str, Any]) -> None:
    """Makes the folder of parts, or takes up that of the same request."""
    plan = folder / "plan.json"
    try:
        folder.mkdir(exist_ok=True)
        if not plan.exists():
            write_atomically(plan, json.dumps(wanted, indent=1) + "\n")
        found = json.loads(plan.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {error.strerror}") from None
    except ValueError as error:
        raise InputError(
            f"{plan} is not complete JSON: {error}; take {folder} away to start afresh"
        ) from None
    for key, value in wanted.items():
        there = found.get(key) if isinstance(found, dict) else None
        if there != value:
            raise InputError(
                f"{folder} keeps parts of another request (`{key}` is {there!r} there and {value!r} here); "
                "repeat that one, or take the folder away"
            )


def _read_part(path: Path, episodes: int) -> dict[str, Any]:
    try:
        part = json.loads(path.read_text(encoding="utf-8"))
        if not all(len(m) == 3 for m in part["made"]):
            raise ValueError("an entry does not have three values")
        if len(part["made"]) != episodes:
            raise ValueError(f"{len(part['made'])} episodes, expected {episodes}")
        return {"made": part["made"], "part_seconds": float(part["part_seconds"])}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is not a part of this set: {error}; take it away to make it anew") from None


def _makers_digest() -> str:
    """What decides the episodes beside the request: the compiled module, objects, scenes and tables."""
    total = hashlib.sha256()
    files = (p for p in DATA.rglob("*") if p.is_file() and (DATA / "episodes") not in p.parents)
    for path in (Path(_core.__file__), *sorted(files)):
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()[:16]
