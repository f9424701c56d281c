"""A whole benchmark: what is missing in the folder is run by an engine, and written as it comes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
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
    are left out, with the reason, where they cannot be loaded. `notes` are kept in `bench.json`. Rows of the
    folders `siblings` are taken over where they were decided by the same. `gallery` is the number of
    episodes whose pictures are kept.
    """

    out: Path
    settings: Config
    episodes: Sequence[Episode]
    methods: Sequence[str]
    optional: Sequence[str] = ()
    notes: Mapping[str, Any] = field(default_factory=dict)
    siblings: Sequence[Path] = ()
    gallery: int = 0
    resume: bool = False


@dataclass(frozen=True)
class Means:
    """How episodes are run: `engine` makes one for a setup; `name` and `jobs` are for the provenance."""

    engine: Callable[[Setup], Engine]
    name: str
    jobs: int | None

    @property
    def concurrent(self) -> bool:
        """Whether episodes run beside each other, so that their times measure that too."""
        return self.jobs != 1


class Listener(Protocol):
    """Told how a benchmark goes."""

    def opened(self, folder: Path, done: int, total: int) -> None:
        """The folder is open, and has `done` of `total` rows."""
        ...

    def row(self, row: Row) -> None:
        """One more row is on disk."""
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


def run_benchmark(plan: Plan, means: Means, listener: Listener) -> Outcome:
    """Runs what is missing. Results do not depend on `means`, timings aside.

    Raises InputError for a folder that cannot be gone on with and for what no episode can run with,
    FuseError when the disk refuses. Interrupted, the folder keeps all rows so far.
    """
    store.check(plan.out, plan.resume)
    required = names_of([m for m in plan.methods if m not in plan.optional])
    setup = Setup(
        config=plan.settings.to_dict(),
        methods={**required, **_optional_names(plan)},
        optional=frozenset(plan.optional),
        concurrent=means.concurrent,
        gallery=str(plan.out.absolute() / gallery.FOLDER) if plan.gallery else None,
        gallery_episodes=plan.gallery,
        path=(str(Path.cwd()), *(place for place in sys.path if place)),
    )
    with means.engine(setup) as engine:
        loaded = engine.load()
        if not loaded.provenances:
            return Outcome([], loaded.refused)
        return _run(plan, means, listener, engine, loaded)


def _optional_names(plan: Plan) -> dict[str, str]:
    """Optional methods go by their reference until they are found: one may not even exist."""
    return {name: name for name in plan.methods if name in plan.optional}


def _run(plan: Plan, means: Means, listener: Listener, engine: Engine, loaded: Loaded) -> Outcome:
    decided = identity(plan.settings, plan.episodes, loaded.provenances)
    not_run = [*plan.notes.get("not_run", ()), *_entries(loaded.refused)]
    notes = {**plan.notes, "not_run": not_run}
    whence = _provenance(loaded, means)
    with ResultStore(plan.out, decided, whence, plan.resume, notes) as rows:
        for sentence in rows.announcements:
            listener.note(sentence)
        names = list(loaded.provenances)
        tasks = [
            Task(index, name, episode)
            for index, episode in enumerate(plan.episodes)
            for name in names
            if not rows.done(name, episode.episode_id)
        ]
        tasks = _taken_over(tasks, plan.siblings, rows, listener)
        total = len(plan.episodes) * len(names)
        listener.opened(plan.out, total - len(tasks), total)
        for done in engine.run(tasks):
            listener.row(rows.append(done.row))
            for sentence in done.notes:
                listener.note(sentence)
        rows.finish()
        ids = {e.episode_id for e in plan.episodes}
        mine = [r for r in rows.rows if r["method"] in names and r["episode_id"] in ids]
        return Outcome(mine, loaded.refused)


def _taken_over(
    tasks: Sequence[Task], siblings: Sequence[Path], rows: ResultStore, listener: Listener
) -> list[Task]:
    """Adopts what sibling folders have of the tasks; those that are left."""
    theirs: dict[str, Row] = {}
    for folder in siblings:
        if store.has_results(folder):
            theirs |= {row["identity"]: row for row in store.load(folder)[1] if row["status"] == "ok"}
    left = []
    for task in tasks:
        row = theirs.get(rows.stamp(task.method, task.episode.episode_id))
        if row is None:
            left.append(task)
        else:
            rows.adopt(row)
    if len(left) < len(tasks):
        listener.note(f"{len(tasks) - len(left)} rows are those of other parts with the same identity")
    return left


def _entries(refused: Mapping[str, str]) -> list[dict[str, str]]:
    return [{"name": name, "reason": reason} for name, reason in refused.items()]


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
