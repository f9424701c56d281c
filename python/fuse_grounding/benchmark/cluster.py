"""The Ray engine: every episode is a Ray task, on whatever nodes the cluster has.

Ray schedules, and starts a task elsewhere when its node or process is lost; there is no queue of ours. A
process loads its agents once and keeps them for the tasks that follow. The driver alone writes: a row counts
when it arrives, once a task, however often that was started.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from fuse_grounding.benchmark.identity import decisive, first_difference
from fuse_grounding.benchmark.worker import Done, Loaded, Setup, Task, Worker, dead
from fuse_grounding.environment import Episode
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.extras import require

RETRIES = 3
"""How often Ray starts an episode again whose node or process was lost; then it is recorded as an error."""

Answer = tuple[str, Any]


class RayEngine:
    """Tasks of one processor each on the cluster at `address`, or on one of `cpus` processors started here.

    A Ray that the caller has initialised is used as it is. See `worker.Engine`.
    """

    def __init__(self, setups: Sequence[Setup], address: str | None = None, cpus: int | None = None):
        self._setups, self._address, self._cpus = tuple(setups), address, cpus
        self._ray: Any = require("ray", "ray", "--engine ray")
        self._ours = False
        self._pending: list[Any] = []
        self._loaded: tuple[Loaded, ...] | None = None

    def __enter__(self) -> RayEngine:
        if not self._ray.is_initialized():
            where: dict[str, Any] = {"address": self._address}
            if self._address is None:
                where = {"num_cpus": self._cpus or os.cpu_count(), "include_dashboard": False}
            try:
                self._ray.init(**where, log_to_driver=False, logging_level=logging.ERROR)
            except Exception as error:
                place, why = self._address or "this machine", str(error).splitlines()[0]
                raise InputError(f"Ray cannot be reached or started on {place}: {why}") from None
            self._ours = True
        return self

    def __exit__(self, *_: object) -> None:
        for reference in self._pending:
            self._ray.cancel(reference, force=True)
        self._pending.clear()
        if self._ours:
            self._ray.shutdown()
            self._ours = False

    def load(self) -> tuple[Loaded, ...]:
        """What the first worker has. Raises InputError for what cannot be loaded, FuseError if it is lost."""
        if self._loaded is None:
            try:
                self._loaded = self._content(self._remote(_describe).remote(self._setups))
            except _LostError as loss:
                raise FuseError(
                    f"a worker of the cluster was lost {RETRIES + 1} times while it was loading ({loss}); "
                    "results so far are kept"
                ) from None
        assert self._loaded is not None
        return self._loaded

    def run(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """Every task once, in the order in which they end. Raises InputError for what concerns all."""
        ray, play = self._ray, self._remote(_play)
        setups, expected = ray.put(self._setups), ray.put(_decisive(self.load()))
        # Methods share an episode, which lies in the cluster once.
        stored = {text: ray.put(e) for text, e in {t.episode.text: t.episode for t in tasks}.items()}
        named = {
            play.remote(setups, expected, t.part, t.index, t.method, stored[t.episode.text]): t for t in tasks
        }
        self._pending = list(named)
        while self._pending:
            (ready,), self._pending = ray.wait(self._pending, num_returns=1)
            try:
                done = self._content(ready)
            except _LostError as loss:
                why = f"what ran it was lost {RETRIES + 1} times ({loss})"
                done = dead(self._setups[named[ready].part], named[ready], why)
            yield done

    def _remote(self, function: Any) -> Any:
        return self._ray.remote(num_cpus=1, max_retries=RETRIES)(function)

    def _content(self, reference: Any) -> Any:
        """A task's answer. Raises InputError, FuseError, and _LostError where Ray gave up."""
        errors = self._ray.exceptions
        try:
            kind, content = self._ray.get(reference)
        except errors.RayTaskError as error:
            raise FuseError(f"a worker of the cluster failed: {error}") from None
        except errors.RayError as error:
            raise _LostError(type(error).__name__) from None
        if kind == "refused":
            raise InputError(content)
        return content


class _LostError(Exception):
    """Ray started a task as often as it may, and it never came to an end."""


# -- on the nodes ----------------------------------------------------------------------------------

_kept: tuple[tuple[Setup, ...], Worker] | None = None
"""This process's agents, with what they were loaded for."""


def _worker(setups: tuple[Setup, ...]) -> Worker:
    global _kept
    if _kept is None or _kept[0] != setups:
        os.environ["RAYON_NUM_THREADS"] = "1"  # a task has one processor; native threads start later
        _kept = (setups, Worker(setups))
    return _kept[1]


def _describe(setups: tuple[Setup, ...]) -> Answer:
    try:
        return "loaded", _worker(setups).loaded
    except InputError as error:
        return "refused", str(error)


def _play(
    setups: tuple[Setup, ...],
    expected: Mapping[str, Any],
    part: int,
    index: int,
    method: str,
    episode: Episode,
) -> Answer:
    try:
        worker = _worker(setups)
        how = first_difference(_decisive(worker.loaded), expected, "methods")
        if how is not None:
            return "refused", (
                f"nodes of the cluster would give rows of two identities ({how}): give all the same "
                "packages, weights and devices, and with FUSE_SIMD the same level"
            )
        return "done", worker.run(Task(part, index, method, episode))
    except InputError as error:
        return "refused", str(error)


def _decisive(loaded: Sequence[Loaded]) -> dict[str, Any]:
    """By part and method."""
    return {
        f"{part}.{name}": decisive(provenance)
        for part, one in enumerate(loaded)
        for name, provenance in one.provenances.items()
    }
