"""What runs the episodes of a benchmark: loaded once a process, the same under every engine."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from fuse_grounding.agent import Agent
from fuse_grounding.assembly import Shelf, assemble
from fuse_grounding.benchmark.gallery import Gallery
from fuse_grounding.benchmark.runner import Row, failure, head, run_one
from fuse_grounding.benchmark.shared import Shared
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode
from fuse_grounding.errors import InputError


@dataclass(frozen=True)
class Setup:
    """What a worker loads for one part of a benchmark, as plain values that reach any process.

    `methods` are references by the name that rows carry: for a method of ours the name itself, for a user's
    own `package.module:factory`. Those that are `optional` may fail to load. `concurrent` says that other
    episodes run at the same time: times are no measurement, and methods share what they can (`shared.py`).
    `gallery` is the folder for the pictures of the first
    `gallery_episodes` episodes. `path` are folders in which modules are looked for.
    """

    config: Mapping[str, Any]
    methods: Mapping[str, str]
    optional: frozenset[str] = frozenset()
    concurrent: bool = False
    gallery: str | None = None
    gallery_episodes: int = 0
    path: tuple[str, ...] = ()


@dataclass(frozen=True)
class Task:
    """An episode for a method of a part. `index` is the episode's place in its set."""

    part: int
    index: int
    method: str
    episode: Episode = field(repr=False)


@dataclass(frozen=True)
class Loaded:
    """What a worker has of a part: provenance by method, and why optional ones could not be loaded."""

    provenances: Mapping[str, dict[str, Any]]
    refused: Mapping[str, str]


@dataclass(frozen=True)
class Done:
    """The row of a task of `part`, and what else there is to tell."""

    part: int
    row: Row
    notes: tuple[str, ...] = ()


class Engine(Protocol):
    """Runs tasks somewhere. A context manager: when it is left, nothing runs any more."""

    def __enter__(self) -> Engine: ...

    def __exit__(self, *_: object) -> None: ...

    def load(self) -> tuple[Loaded, ...]:
        """Starts the first worker and says what it has of each part. Raises InputError for what cannot
        be."""
        ...

    def run(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """Every task once, in any order. Raises InputError for what concerns all of them."""
        ...


def dead(setup: Setup, task: Task, why: str) -> Done:
    """The row of a task whose worker did not live to make one."""
    start = head(task.method, task.episode, task.index)
    return Done(task.part, {**start, "concurrent": setup.concurrent, **failure(why), "wall_seconds": 0.0})


class Worker:
    """The agents of one process. `loaded` says what they are, part by part."""

    def __init__(self, setups: Sequence[Setup]):
        """Loads. Raises InputError for a method that is not optional and cannot be."""
        self._setups, self._shelf, self._shared = setups, Shelf(), Shared()
        self._agents: dict[tuple[int, str], Agent] = {}
        self.loaded = tuple(self._load(part, setup) for part, setup in enumerate(setups))

    def _load(self, part: int, setup: Setup) -> Loaded:
        sys.path.extend(place for place in setup.path if place not in sys.path)
        config = Config.from_dict(setup.config)
        provenances: dict[str, dict[str, Any]] = {}
        refused: dict[str, str] = {}
        for name, reference in setup.methods.items():
            try:
                parts, settled = assemble(config.with_(method=reference), self._shelf)
            except InputError as error:
                if name not in setup.optional:
                    raise
                refused[name] = str(error)
            else:
                if setup.concurrent:
                    parts = self._shared.parts(parts, settled)
                self._agents[part, name] = Agent(settled, parts)
                provenances[name] = parts.provenance
        return Loaded(provenances, refused)

    def run(self, task: Task) -> Done:
        """One row. Raises UnusableError for what concerns all episodes."""
        setup, gallery = self._setups[task.part], None
        if setup.gallery is not None and task.index < setup.gallery_episodes:
            gallery = Gallery(setup.gallery, task.method, task.episode)
        watchers = () if gallery is None else (gallery,)
        agent = self._agents[task.part, task.method]
        self._shared.begin(task.episode)
        row = run_one(agent, task.method, task.episode, task.index, watchers, setup.concurrent)
        return Done(task.part, self._shared.alone(row), () if gallery is None else gallery.close())
