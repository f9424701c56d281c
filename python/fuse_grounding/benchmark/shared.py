"""What methods share of an episode: registration and map.

A state of either depends on the settings and on what it took in, in order, and on nothing else. Methods, and
variants of one, begin at the same seed views and see the same until they part; until then, each state is
computed once. A state is never changed: who goes on from it goes on from a fork, bit for bit as if alone.

Times stay those of a search alone: what is taken over counts with the seconds that it took whoever computed
it. They are no measurement all the same; `fuse bench --timing` shares nothing.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.benchmark.runner import Row
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.mapping import ForkingRegistrar, GaussianMap
from fuse_grounding.parts import Parts, Spatial
from fuse_grounding.planning.protocol import Rendering
from fuse_grounding.record import MapEntry, Stopwatch
from fuse_grounding.registration.protocol import RegisteredView

KEPT = 64
"""States kept in a process, those used last. A map of 20,000 Gaussians is 15 MB with its moments; pictures
are kept once."""

T = TypeVar("T")


@dataclass(frozen=True)
class _State:
    what: Any
    seconds: dict[str, float]


class Shared:
    """The states of one episode. One for each process."""

    def __init__(self, kept: int = KEPT):
        self._kept = kept
        self._episode: Episode | None = None
        self._states: OrderedDict[bytes, _State] = OrderedDict()
        self.saved: dict[str, float] = defaultdict(float)
        """Seconds by stage that the current search would have taken alone, beyond those that it took."""
        self.made = 0
        """States that were computed so far."""

    def begin(self, episode: Episode) -> None:
        """A search begins. States of another episode are forgotten."""
        self.saved.clear()
        if episode != self._episode:
            self._episode = episode
            self._states.clear()

    def alone(self, row: Row) -> Row:
        """A row of the search that began last, with the times that it would have taken alone."""
        if not self.saved:
            return row
        total = sum(self.saved.values())
        told: Row = {k: round(row[k] + total, 6) for k in ("wall_seconds", "runtime_seconds") if k in row}
        if "timings" in row:
            told["timings"] = {k: round(s + self.saved[k], 6) for k, s in row["timings"].items()}
        return {**row, **told}

    def parts(self, parts: Parts, config: Config) -> Parts:
        """`parts` whose registration and map are shared with those of all agents of the same settings.

        As they are where a registrar cannot fork (profile `paper`).
        """
        settings = config.registration
        if settings.backend == "colmap" and settings.profile == "paper":
            return parts
        root = _digest(settings.model_dump_json().encode(), config.map.model_dump_json().encode())

        def spatial() -> Spatial | None:
            fresh = parts.spatial()
            if fresh is None:
                return None
            assert isinstance(fresh.map, GaussianMap)
            registrar = SharedRegistrar(self, root, cast(ForkingRegistrar, fresh.registrar))
            return Spatial(registrar, SharedMap(self, root, registrar, fresh.map))

        return replace(parts, spatial=spatial)

    def state(self, key: bytes, clock: Stopwatch, make: Callable[[Stopwatch], T]) -> T:
        """The state of `key`; `make` it, timed by the clock that it is given, unless it is there.

        `clock` counts the stages as entered either way.
        """
        found = self._states.get(key)
        if found is None:
            inner = Stopwatch()
            what = make(inner)
            self.made += 1
            found = self._states[key] = _State(what, dict(inner.seconds))
            for stage, seconds in found.seconds.items():
                clock.add(stage, seconds)
            if len(self._states) > self._kept:
                self._states.popitem(last=False)
        else:
            self._states.move_to_end(key)
            for stage, seconds in found.seconds.items():
                clock.add(stage, 0.0)
                self.saved[stage] += seconds
        return cast(T, found.what)


class SharedRegistrar:
    """A `Registrar` at one of the shared states, `now`; `key` is that state's."""

    def __init__(self, shared: Shared, root: bytes, fresh: ForkingRegistrar):
        self._shared, self._root, self._fresh = shared, root, fresh
        self.key, self.now = root, fresh

    def initialize(self, seeds: Sequence[Observation]) -> list[RegisteredView]:
        """See `Registrar.initialize`."""

        def start(clock: Stopwatch) -> ForkingRegistrar:
            with clock("initialize"):
                self._fresh.initialize(seeds)
            return self._fresh

        self._go(_digest(self._root, b"seeds", *map(_fingerprint, seeds)), start)
        return self.views()

    def register(self, observation: Observation) -> RegisteredView:
        """See `Registrar.register`."""

        def add(clock: Stopwatch) -> ForkingRegistrar:
            twin = self.now.fork()
            with clock("register"):
                twin.register(observation)
            return twin

        self._go(_digest(self.key, b"view", _fingerprint(observation)), add)
        return self.views()[-1]

    def views(self) -> list[RegisteredView]:
        """See `Registrar.views`."""
        return self.now.views()

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """See `Registrar.points`."""
        return self.now.points()

    def points_by_id(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See `PointRegistrar.points_by_id`."""
        return self.now.points_by_id()

    def _go(self, key: bytes, make: Callable[[Stopwatch], ForkingRegistrar]) -> None:
        # The agent's own clock runs: it needs no telling.
        self.now = self._shared.state(key, Stopwatch(), make)
        self.key = key


class SharedMap:
    """A `GrowingMap` at one of the shared states."""

    def __init__(self, shared: Shared, root: bytes, registrar: SharedRegistrar, fresh: GaussianMap):
        self._shared, self._key = shared, root
        self._registrar, self._now = registrar, fresh
        self._waiting: list[tuple[bool, np.ndarray]] = []

    def add_seed(self, rgb: np.ndarray) -> None:
        """See `GrowingMap.add_seed`."""
        self._waiting.append((True, rgb))

    def add(self, rgb: np.ndarray) -> None:
        """See `GrowingMap.add`."""
        self._waiting.append((False, rgb))

    def refine(self, clock: Stopwatch) -> None:
        """See `SpatialMap.refine`."""
        views = [bytes([seed]) + rgb.tobytes() for seed, rgb in self._waiting]
        key = _digest(self._key, b"refine", self._registrar.key, *views)

        def grow(clock: Stopwatch) -> GaussianMap:
            twin = self._now.fork(self._registrar.now)
            for seed, rgb in self._waiting:
                (twin.add_seed if seed else twin.add)(rgb)
            twin.refine(clock)
            return twin.fork(self._registrar.now)  # without the memory that training took

        self._now, self._key = self._shared.state(key, clock, grow), key
        self._waiting = []

    def render(self, camera: Camera) -> Rendering | None:
        """See `SpatialMap.render`."""
        return self._now.render(camera)

    def entry(self) -> MapEntry | None:
        """See `GrowingMap.entry`."""
        return self._now.entry()

    def save(self, path: Path) -> None:
        """See `GrowingMap.save`."""
        self._now.save(path)


def _digest(*parts: bytes) -> bytes:
    total = hashlib.blake2b(digest_size=16)
    for part in parts:
        total.update(len(part).to_bytes(8, "little"))
        total.update(part)
    return total.digest()


def _fingerprint(view: Observation) -> bytes:
    """All that a registrar may read of a view."""
    arrays = [view.rgb, *(() if view.depth is None else (view.depth,))]
    where: list[Any] = [view.node, view.pitch_index]
    if (c := view.camera) is not None:
        where += [c.width, c.height, c.fx, c.fy, c.cx, c.cy]
        arrays += [c.rotation, c.translation]
    return _digest(repr(where).encode(), *(np.ascontiguousarray(a).tobytes() for a in arrays))
