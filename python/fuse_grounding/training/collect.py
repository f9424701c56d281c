"""`fuse collect`: many walks, in parallel and in parts, so that an interrupted run goes on.

Every trajectory is a part of its own, `OUT/parts/0000.safetensors`, which depends on the request and its
number alone: the result has the same bytes for any number of jobs and interruptions. `OUT/plan.json` says
what the parts are of; those of another request are refused.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding import _core, tensors
from fuse_grounding.child import settle, threads_each
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode, load_episodes
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.perception.embedded_encoder import EmbeddedEncoder
from fuse_grounding.record import hold
from fuse_grounding.training import transitions
from fuse_grounding.training.rollouts import Prober, tables

RESULT, CARD, PLAN, PARTS = "transitions.safetensors", "transitions.json", "plan.json", "parts"
SPLITS = ("train", "dev")


@dataclass(frozen=True)
class Request:
    """What is collected. `states`: how many states of a trajectory have every action measured; 0: a plain
    walk, of as many `actions`, or of 5 to 13."""

    split: str
    trajectories: int
    seed: int
    states: int
    actions: int | None
    encoder: str | None
    config: dict[str, Any]


@dataclass(frozen=True)
class Collected:
    """What came out."""

    path: Path
    transitions: int
    trajectories: int
    left_out: dict[str, int]


def labels() -> tuple[str, ...]:
    """Labels whose text vectors come with the transitions: those of the catalogue."""
    return tuple(name for name, _ in _core.object_categories())


class _Worker:
    """One process's loaded parts; makes trajectories by their numbers."""

    def __init__(self, request: Request) -> None:
        self.request = request
        encoder = EmbeddedEncoder(request.encoder)
        self.prober = Prober(Config.from_dict(request.config), encoder, labels())
        self.texts = encoder.text(labels())
        self.episodes = load_episodes(request.split)

    def episode(self, number: int) -> Episode:
        """Episode of a trajectory: the set's, from its first on, again and again."""
        return self.episodes[number % len(self.episodes)]

    def make(self, number: int) -> bytes:
        """The part's bytes."""
        episode, rng = self.episode(number), np.random.default_rng([self.request.seed, number])
        if not self.prober.candidates(episode):
            return tensors.encode(
                "left out", transitions.SCHEMA_VERSION, {}, {"why": "no candidate is known"}
            )
        if self.request.states:
            walk = self.prober.survey(number, episode, self.request.states, rng)
        else:
            walk = self.prober.walk(number, episode, rng, self.request.actions)
        note = {"episode_id": episode.episode_id, "scene": episode.scene_id}
        return tables(walk, self.texts, labels()).encode(note)


_worker: _Worker | None = None


def _begin(request: Request, threads: int) -> None:
    """In a process of its own."""
    global _worker
    settle(threads)
    _worker = _Worker(request)


def _make(number: int, path: Path) -> None:
    assert _worker is not None
    tensors.write(path, _worker.make(number))


def collect(
    out: Path,
    request: Request,
    *,
    jobs: int = 1,
    resume: bool = False,
    tell: Callable[[int, int], None] = lambda done, total: None,
) -> Collected:
    """Makes what is missing of the parts and joins them in `OUT/transitions.safetensors`, a card beside it.

    `tell` hears how many trajectories are done, of how many. Raises InputError for a folder that is not empty
    without `resume` or holds another request's parts; FuseError when a process dies or the disk refuses.
    """
    plan = _plan(request)
    _open(out, plan, resume)
    try:
        held = hold(out, "collection")
    except OSError as error:
        raise InputError(f"output directory {out} cannot be written: {error.strerror}") from None
    try:
        _keep_plan(out, plan)
        return _fill(out, plan, request, jobs, tell)
    finally:
        os.close(held)


def _fill(
    out: Path, plan: dict[str, Any], request: Request, jobs: int, tell: Callable[[int, int], None]
) -> Collected:
    """Makes what is missing of the parts and joins them."""
    folder = out / PARTS
    paths = [folder / f"{number:05d}.safetensors" for number in range(request.trajectories)]
    missing = [number for number, path in enumerate(paths) if not path.exists()]
    done = request.trajectories - len(missing)
    began = time.perf_counter()
    tell(done, request.trajectories)
    for _ in _made(request, [(n, paths[n]) for n in missing], jobs):
        done += 1
        tell(done, request.trajectories)
    seconds = time.perf_counter() - began
    return _join(
        out, plan, paths, {"jobs": jobs, "made": len(missing), "last_run_seconds": round(seconds, 1)}
    )


def card(out: Path) -> dict[str, Any]:
    """The card of a finished collection."""
    return json.loads((out / CARD).read_text(encoding="utf-8"))


def _made(request: Request, wanted: list[tuple[int, Path]], jobs: int) -> Iterator[None]:
    """Makes the parts, yielding after each."""
    if not wanted:
        return
    if jobs == 1:
        worker = _Worker(request)
        for number, path in wanted:
            tensors.write(path, worker.make(number))
            yield
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, _begin, (request, threads_each(jobs))) as pool:
        try:
            yield from _finished(pool.submit(_make, number, path) for number, path in wanted)
        except BrokenProcessPool:
            raise FuseError(
                "a process of the collection died (out of memory?); what was finished is kept, use --resume"
            ) from None
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.kill()  # what they write, they write whole or not at all
            raise


def _finished(futures: Iterable[Future[None]]) -> Iterator[None]:
    waiting = set(futures)
    while waiting:
        finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
        for future in finished:
            future.result()
            yield


def _plan(request: Request) -> dict[str, Any]:
    """What decides the bytes of the parts."""
    config = Config.from_dict(request.config)
    encoder = EmbeddedEncoder(request.encoder)
    prober = Prober(config, encoder, labels())
    asked = asdict(request)
    del asked["encoder"]  # where the file lies; its bytes count
    return {
        "request": asked,
        "labels": list(labels()),
        "episodes": hashlib.sha256(
            "".join(e.text for e in load_episodes(request.split)).encode()
        ).hexdigest(),
        "weights": prober.parts.provenance["sha256"],
        "encoder": encoder.settings.sha256,
        "versions": {
            k: prober.parts.provenance[k] for k in ("fuse_grounding", "simd_level", "device", "packages")
        },
    }


def _open(out: Path, plan: dict[str, Any], resume: bool) -> None:
    """Makes the folder, or takes up that of the same request."""
    where = out / PLAN
    try:
        if out.is_dir() and any(out.iterdir()):
            if not resume:
                raise InputError(f"output directory {out} exists and is not empty; use --resume or another")
            if where.exists():
                _same(where, plan)
        (out / PARTS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"output directory {out} cannot be written: {error.strerror}") from None


def _keep_plan(out: Path, plan: dict[str, Any]) -> None:
    where = out / PLAN
    if not where.exists():
        if any((out / PARTS).iterdir()):
            raise InputError(
                f"{where} is missing; the parts beside it cannot be resumed, choose another --out"
            )
        tensors.write(where, json.dumps(plan, indent=1) + "\n")
    else:
        _same(where, plan)  # somebody else's, who was faster


def _same(where: Path, plan: dict[str, Any]) -> None:
    try:
        there = json.loads(where.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{where} is not complete JSON: {error}; choose another --out") from None
    for key, value in plan.items():
        found = there.get(key) if isinstance(there, dict) else None
        if found != value:
            differing = _first_difference(found, value, key)
            raise InputError(
                f"{where.parent} keeps parts of another collection ({differing}); choose another --out"
            )


def _first_difference(found: Any, wanted: Any, key: str) -> str:
    if isinstance(found, dict) and isinstance(wanted, dict):
        for inner in sorted(found.keys() | wanted.keys()):
            if found.get(inner) != wanted.get(inner):
                return _first_difference(found.get(inner), wanted.get(inner), f"{key}.{inner}")
    return f"`{key}` is {found!r} there and {wanted!r} here"


def _join(out: Path, plan: dict[str, Any], paths: list[Path], run: dict[str, Any]) -> Collected:
    parts, walked = [], []
    left_out: dict[str, int] = {}
    for number, path in enumerate(paths):
        try:
            part, note = transitions.load(path)
        except InputError as error:
            why = _why_left_out(path)
            if why is None:
                raise InputError(f"{error}; take the part away to have it made anew") from None
            left_out[why] = left_out.get(why, 0) + 1
            continue
        parts.append(part)
        walked.append({"trajectory": number, **note})
    if not parts:
        raise InputError(f"no trajectory was made: {left_out}")
    whole = transitions.joined(parts)
    note = {
        "labels": plan["labels"],
        "split": plan["request"]["split"],
        "encoder": plan["encoder"],
        "trajectories": walked,
    }
    content = whole.encode(note)
    tensors.write(out / RESULT, content)
    tensors.write(out / CARD, json.dumps(_card(whole, plan, left_out, content, run), indent=1) + "\n")
    return Collected(out / RESULT, len(whole), len(parts), left_out)


def _why_left_out(path: Path) -> str | None:
    try:
        return str(tensors.load(path, "left out", transitions.SCHEMA_VERSION)[1]["why"])
    except InputError:
        return None


def _card(
    whole: transitions.Transitions,
    plan: dict[str, Any],
    left_out: dict[str, int],
    content: bytes,
    run: dict[str, Any],
) -> dict[str, Any]:
    return {
        "schema_version": transitions.SCHEMA_VERSION,
        "sha256": hashlib.sha256(content).hexdigest(),
        "bytes": len(content),
        "trajectories": len(whole.number),
        "transitions": len(whole),
        "states": len(whole.feature),
        "left_out": left_out,
        "arrays": {k: {"dtype": str(v.dtype), "shape": list(v.shape)} for k, v in whole.arrays().items()},
        "terms": {
            name: {
                "weight": weight,
                "mean": round(float(whole.terms[:, i].mean()), 5),
                "std": round(float(whole.terms[:, i].std()), 5),
            }
            for i, (name, weight) in enumerate(
                zip(transitions.TERMS, transitions.UTILITY_WEIGHTS, strict=True)
            )
        },
        "utility": {
            "mean": round(float(whole.utility.mean()), 5),
            "std": round(float(whole.utility.std()), 5),
            "clipped": round(float((np.abs(whole.utility) >= 1.0).mean()), 5),
        },
        **plan,
        "run": run,
    }
