"""A whole benchmark: what is missing in its folders is run by an engine, and written as it comes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from fuse_grounding.benchmark import gallery, store
from fuse_grounding.benchmark.identity import identity
from fuse_grounding.benchmark.methods import find
from fuse_grounding.benchmark.provenance import code_digest, machine
from fuse_grounding.benchmark.runner import Row
from fuse_grounding.benchmark.store import ResultStore
from fuse_grounding.benchmark.worker import Engine, Loaded, Setup, Task
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode
from fuse_grounding.errors import InputError


@dataclass(frozen=True)
class Plan:
    """One benchmark folder to fill: every method over every episode.

    `methods` are names or `package.module:factory`; `optional` ones need something that does not ship, and
    are left out, with the reason, where they cannot be loaded. `notes` are kept in `bench.json`. `gallery` is
    the number of episodes whose pictures are kept.
    """

    out: Path
    settings: Config
    episodes: Sequence[Episode]
    methods: Sequence[str]
    optional: Sequence[str] = ()
    notes: Mapping[str, Any] = field(default_factory=dict)
    gallery: int = 0
    resume: bool = False


@dataclass(frozen=True)
class Means:
    """How episodes are run: `engine` makes one for the setups of all parts; `name` and `jobs` are
    for the provenance."""

    engine: Callable[[Sequence[Setup]], Engine]
    name: str
    jobs: int | None

    @property
    def concurrent(self) -> bool:
        """Whether episodes run beside each other, so that their times measure that too."""
        return self.jobs != 1


class Listener(Protocol):
    """Told how a benchmark goes."""

    def opened(self, done: int, total: int) -> None:
        """The folders are open, and `done` of `total` rows are there."""
        ...

    def row(self, row: Row, part: str) -> None:
        """One more row is on disk; `part` names its folder where there are several, else it is empty."""
        ...

    def note(self, sentence: str) -> None:
        """Something that a person should know."""
        ...


@dataclass(frozen=True)
class Outcome:
    """The plan's rows, in order of episodes, then methods, and why optional methods are not among them."""

    rows: list[Row]
    refused: Mapping[str, str]


def names_of(references: Sequence[str]) -> dict[str, str]:
    """Name in rows → reference, for each. Raises InputError for unknown methods, or two of one name."""
    named: dict[str, str] = {}
    for reference in references:
        name = find(reference).name
        if named.setdefault(name, reference) != reference:
            raise InputError(f"methods `{named[name]}` and `{reference}` both call themselves `{name}`")
    return named


def run_benchmarks(plans: Sequence[Plan], means: Means, listener: Listener) -> list[Outcome]:
    """Runs what is missing of the plans, episode by episode, so that they can share what an episode takes.

    What is decided by the same in several plans is run once. Results do not depend on `means`, timings aside.
    A plan of which nothing could be loaded leaves no folder. Raises InputError for a folder that cannot be
    gone on with and for what no episode can run with, FuseError when the disk refuses. Interrupted, the
    folders keep all rows so far.
    """
    for plan in plans:
        store.check(plan.out, plan.resume)
    with means.engine([_setup(plan, means) for plan in plans]) as engine, ExitStack() as folders:
        parts = [
            _Part(number, plan, loaded)
            for number, (plan, loaded) in enumerate(zip(plans, engine.load(), strict=True))
        ]
        for part in parts:
            if part.loaded.provenances:
                part.rows = folders.enter_context(_opened(part, _left_out(part, parts), means, listener))
        _run(parts, engine, listener)
        return [Outcome(part.outcome(), part.loaded.refused) for part in parts]


@dataclass
class _Part:
    """A plan under way; `rows` is its folder, None where nothing could be loaded."""

    number: int
    plan: Plan
    loaded: Loaded
    rows: ResultStore | None = None

    def tasks(self) -> Iterator[tuple[tuple[int, str], Task]]:
        """What the plan asks for, with its place in the set, which seeds `random`, and its stamp."""
        if self.rows is not None:
            for index, episode in enumerate(self.plan.episodes):
                for name in self.loaded.provenances:
                    stamp = self.rows.stamp(name, episode.episode_id)
                    yield (index, stamp), Task(self.number, index, name, episode)

    def outcome(self) -> list[Row]:
        """The rows that the plan asks for, in order."""
        if self.rows is None:
            return []
        ids = {episode.episode_id for episode in self.plan.episodes}
        names = self.loaded.provenances
        return [r for r in self.rows.rows if r["method"] in names and r["episode_id"] in ids]


def _setup(plan: Plan, means: Means) -> Setup:
    required = names_of([m for m in plan.methods if m not in plan.optional])
    # Optional methods go by their reference until they are found: one may not even exist.
    optional = {name: name for name in plan.methods if name in plan.optional}
    return Setup(
        config=plan.settings.to_dict(),
        methods={**required, **optional},
        optional=frozenset(plan.optional),
        concurrent=means.concurrent,
        gallery=str(plan.out.absolute() / gallery.FOLDER) if plan.gallery else None,
        gallery_episodes=plan.gallery,
        path=(str(Path.cwd()), *(place for place in sys.path if place)),
    )


def _left_out(part: _Part, parts: Sequence[_Part]) -> dict[str, str]:
    """What a part's folder lists as not run, with the reason: methods of it, and whole parts of its group.

    A part of which nothing could be loaded has no folder to say so itself, unless one was made by hand.
    """
    group = part.plan.notes.get("group")
    beside = {
        other.plan.notes["part"]: next(iter(other.loaded.refused.values()))
        for other in parts
        if group is not None and other.plan.notes.get("group") == group
        if not other.loaded.provenances and not store.has_results(other.plan.out)
    }
    return {**part.loaded.refused, **beside}


def _opened(part: _Part, left_out: Mapping[str, str], means: Means, listener: Listener) -> ResultStore:
    plan, loaded = part.plan, part.loaded
    decided = identity(plan.settings, plan.episodes, loaded.provenances)
    not_run = [{"name": name, "reason": reason} for name, reason in left_out.items()]
    notes = {**plan.notes, "not_run": not_run}
    rows = ResultStore(plan.out, decided, _provenance(loaded, means), plan.resume, notes)
    for sentence in rows.announcements:
        listener.note(sentence)
    return rows


def _run(parts: Sequence[_Part], engine: Engine, listener: Listener) -> None:
    """What is decided by the same once: its row goes to all parts that ask for it."""
    asked: dict[tuple[int, str], list[tuple[ResultStore, Task]]] = {}
    for part in parts:
        for decided, task in part.tasks():
            assert part.rows is not None
            asked.setdefault(decided, []).append((part.rows, task))
    for places in asked.values():  # a folder that keeps pictures runs what it shares with others
        places.sort(key=lambda place: not parts[place[1].part].plan.gallery)
    left = {decided: places for decided, places in asked.items() if not _there(places)}
    listener.opened(len(asked) - len(left), len(asked))
    if doubles := sum(len(places) - 1 for places in left.values()):
        listener.note(f"{doubles} rows are asked for by several parts, and are run once")
    first = {(t.part, t.index, t.method): places for places in left.values() for _, t in places[:1]}
    tasks = sorted((places[0][1] for places in left.values()), key=lambda task: task.index)
    for done in engine.run(tasks):
        (rows, _), *others = first[done.part, done.row["index"], done.row["method"]]
        row = rows.append(done.row)
        for more, _ in others:
            more.adopt(row)
        listener.row(row, parts[done.part].plan.out.name if len(parts) > 1 else "")
        for sentence in done.notes:
            listener.note(sentence)
    for part in parts:
        if part.rows is not None:
            part.rows.finish()


def _there(places: Sequence[tuple[ResultStore, Task]]) -> bool:
    """Whether one of the places has the row; then all have it."""
    found = [rows.done(task.method, task.episode.episode_id) for rows, task in places]
    done = next((row for row in found if row is not None), None)
    if done is None:
        return False
    for (rows, _), row in zip(places, found, strict=True):
        if row is None:
            rows.adopt(done)
    return True


def _provenance(loaded: Loaded, means: Means) -> dict[str, Any]:
    """What made the rows, for people; what decided them is in the identity."""
    first = next(iter(loaded.provenances.values()))
    packages: dict[str, str] = {}
    for provenance in loaded.provenances.values():
        packages |= provenance["packages"]
    kept = {k: v for k, v in first.items() if k not in ("sha256", "device", "render_device", "perception")}
    return {
        **kept,
        "packages": packages,
        "code": code_digest(),
        "machine": machine(),
        "engine": means.name,
        "jobs": means.jobs,
    }
