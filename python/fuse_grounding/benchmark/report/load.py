"""Benchmark folders read for a report: what was run, under which settings, with every row checked."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fuse_grounding.benchmark import store
from fuse_grounding.benchmark.identity import first_difference
from fuse_grounding.benchmark.report import labels
from fuse_grounding.benchmark.store import HEADER, RESULTS
from fuse_grounding.benchmark.suites import group_of
from fuse_grounding.config import Config
from fuse_grounding.errors import InputError

Row = Mapping[str, Any]

GALLERY = "gallery"
MAIN, KNOWLEDGE = "main", "knowledge"
SOURCE = "knowledge.source"
_ABOUT_THE_RUN = ("identity", "commit", "index", "concurrent", "timings")
"""Fields of a row that may differ between two runs that come to the same."""
_DEPTH = 3
"""How many folders below the one that was named results are looked for."""


@dataclass(frozen=True)
class Folder:
    """One benchmark folder. `label` names it in the report, without where it lies on this machine.

    `part` is what it is compared within: the group of a suite's part, as `stopping`.
    """

    path: Path
    label: str
    part: str
    identity: Mapping[str, Any]
    provenance: Mapping[str, Any]
    not_run: Sequence[tuple[str, str]]
    """Name and reason."""
    rows: Sequence[Row]

    @property
    def settings(self) -> Mapping[str, Any]:
        """Every setting that decides results, as `section.key`."""
        return flat(self.identity.get("config", {}))

    @property
    def methods(self) -> list[str]:
        """Names of the methods that it set out to run."""
        return list(self.identity.get("methods", {}))

    @property
    def episodes(self) -> Mapping[str, str]:
        """Digest of each episode by its id."""
        return self.identity.get("episodes", {})


@dataclass
class Arm:
    """One method under one set of settings: a line of a table. `rows` are by episode id."""

    method: str
    settings: Mapping[str, Any]
    rows: dict[str, Row] = field(default_factory=dict)
    folders: list[Folder] = field(default_factory=list)
    label: str = ""
    """Unique within its part."""

    @property
    def expected(self) -> set[str]:
        """Ids of the episodes that its folders set out to run."""
        return {e for f in self.folders for e in f.episodes}

    @property
    def done(self) -> list[Row]:
        """Rows that ran through."""
        return [r for r in self.rows.values() if r["status"] == "ok"]

    @property
    def errors(self) -> list[Row]:
        """Rows of episodes that raised."""
        return [r for r in self.rows.values() if r["status"] != "ok"]


@dataclass(frozen=True)
class Part:
    """What is compared with each other: the arms of one part of the suite over one set of episodes."""

    name: str
    set_name: str
    arms: Sequence[Arm]
    not_run: Sequence[tuple[str, str]]
    varied: Sequence[str]
    """Settings whose values differ between the arms."""

    @property
    def episodes(self) -> list[str]:
        """Ids that all arms have a row of, in order."""
        shared = set.intersection(*(set(a.rows) for a in self.arms)) if self.arms else set()
        return sorted(shared)

    def default(self, arms: Sequence[Arm]) -> Arm:
        """Of some arms of the part the one at the default settings, without one the first."""
        usual = flat(Config().to_dict())
        return next((a for a in arms if all(a.settings.get(k) == usual.get(k) for k in self.varied)), arms[0])


@dataclass(frozen=True)
class Results:
    """Everything that was found, in the order it is reported."""

    folders: Sequence[Folder]
    parts: Sequence[Part]
    incomplete: Sequence[str]
    """What is missing, a sentence each; only with `partial`."""

    def part(self, name: str) -> list[Part]:
        """The part of that name, once for each set of episodes."""
        return [p for p in self.parts if p.name == name]


def flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings as `section.key`."""
    found: dict[str, Any] = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            found |= flat(value, f"{prefix}{key}.")
        else:
            found[prefix + key] = value
    return found


def load(folders: Sequence[Path], partial: bool = False) -> Results:
    """Reads benchmark folders, and those inside them.

    Raises InputError for a folder without results, a broken or foreign file, folders of different versions,
    one method under the same settings with two results or with other weights, packages or devices, and,
    unless `partial`, for episodes that some of what is compared lacks.
    """
    found = [_read(path, label) for path, label in _find(folders)]
    if not any(f.rows for f in found):
        raise InputError(
            f"{', '.join(str(f.path) for f in found)}: no results yet; expected lines in {RESULTS}"
        )
    _of_one_version(found)
    found.sort(key=lambda f: (labels.place(f.part, labels.PARTS), *_set_place(f)))
    parts, incomplete = _parts(found), []
    for part in parts:
        incomplete += _missing(part)
    if incomplete and not partial:
        raise InputError(
            f"{'; '.join(incomplete)}; paired comparisons need every episode of every method: finish with "
            "`fuse bench --resume`, or report on what there is with --partial"
        )
    return Results(found, [_without_empty(part) for part in parts], incomplete)


def _of_one_version(folders: Sequence[Folder]) -> None:
    """Raises InputError where the code, objects, scenes or knowledge of two folders differ."""
    first = folders[0]
    for key in ("identity_version", "results_version", "data"):
        for other in folders[1:]:
            where = _differs(key, first, first.identity.get(key), other, other.identity.get(key))
            if where is not None:
                raise InputError(f"{where}; results of two versions cannot be compared, report one of them")


def _differs(key: str, first: Folder, found: Any, other: Folder, wanted: Any) -> str | None:
    """The first key below `key` whose values differ, with both and the folders that they are in."""
    where = first_difference(found, wanted, key)
    if where is None:
        return None
    return where.replace(" there ", f" in {first.path} ").replace(" here", f" in {other.path}")


def _find(folders: Sequence[Path]) -> list[tuple[Path, str]]:
    found: dict[Path, tuple[Path, str]] = {}
    for folder in folders:
        if not folder.is_dir():
            raise InputError(
                f"results folder {folder} {'is a file' if folder.exists() else 'does not exist'}"
            )
        headers = sorted(
            h for depth in range(_DEPTH + 1) for h in folder.glob("*/" * depth + HEADER) if h.is_file()
        )
        if not headers:
            raise InputError(
                f"{folder} has no results: no {HEADER} in it or in the folders inside it; expected a folder "
                "that `fuse bench --out` wrote"
            )
        name = folder.resolve().name
        for header in headers:
            below = header.parent.relative_to(folder).as_posix()
            found.setdefault(header.resolve(), (header.parent, name if below == "." else f"{name}/{below}"))
    return list(found.values())


def _read(path: Path, label: str) -> Folder:
    header, rows = store.load(path)
    try:
        what, whence = dict(header["identity"]), dict(header["provenance"])
        not_run = [(str(entry["name"]), str(entry["reason"])) for entry in header.get("not_run") or ()]
        # A suite's part that was run by hand has its folder's name only.
        part = str(header.get("group") or header.get("part") or group_of(path.resolve().name) or MAIN)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path / HEADER} is not a benchmark's header: {error!r}") from None
    return Folder(path, label, part, what, whence, not_run, rows)


def _set_place(folder: Folder) -> tuple[bool, str]:
    """`eval`, which is for reporting, before other sets."""
    name = set_name(sorted(folder.episodes))
    return name != "eval", name


def set_name(episode_ids: Sequence[str]) -> str:
    """`eval` for `eval_0000`, ...; the words before the last number that all ids share, or `mixed`."""
    names = {e.rpartition("_")[0] or e for e in episode_ids}
    return names.pop() if len(names) == 1 else "mixed"


def _parts(folders: Sequence[Folder]) -> list[Part]:
    grouped: dict[tuple[str, str], list[Folder]] = {}
    for folder in folders:
        grouped.setdefault((folder.part, set_name(sorted(folder.episodes))), []).append(folder)
    return [_part(name, set_, members) for (name, set_), members in grouped.items()]


def _part(name: str, set_: str, folders: Sequence[Folder]) -> Part:
    arms: dict[tuple[str, str], Arm] = {}
    digests: dict[str, tuple[str, Folder]] = {}
    for folder in folders:
        for episode, digest in folder.episodes.items():
            known, where = digests.setdefault(episode, (digest, folder))
            if known != digest:
                raise InputError(
                    f"{where.path} and {folder.path} ran different episodes of the name {episode}; "
                    "they cannot be compared"
                )
        settings = json.dumps(folder.settings, sort_keys=True)
        for method in folder.methods:
            arm = arms.setdefault((method, settings), Arm(method, folder.settings))
            _made_alike(arm, folder)
            arm.folders.append(folder)
        for row in folder.rows:
            _add(arms[row["method"], settings], row, folder)
    for arm in arms.values() if name == KNOWLEDGE else ():
        arm.settings = {**arm.settings, SOURCE: _source(arm)}
    varied = _varied([a.settings for a in arms.values()])
    _label(list(arms.values()), varied)
    run = {f.path.resolve().name for f in folders if f.rows} | {r["method"] for f in folders for r in f.rows}
    not_run = list(dict.fromkeys(entry for f in folders for entry in f.not_run if entry[0] not in run))
    ordered = sorted(arms.values(), key=lambda a: labels.place(a.method))
    return Part(name, set_, ordered, not_run, varied)


def _made_alike(arm: Arm, folder: Folder) -> None:
    """Raises InputError where a folder has an arm's method with other weights, packages or devices."""
    for other in arm.folders:
        theirs, ours = (f.identity["methods"][arm.method] for f in (other, folder))
        where = _differs(f"methods.{arm.method}", other, theirs, folder, ours)
        if where is not None:
            raise InputError(f"{where}; these are two methods, report one of them")


def _without_empty(part: Part) -> Part:
    """Arms without a single result go to those that were not run."""
    empty = [(a.label, "no results yet") for a in part.arms if not a.rows]
    return replace(part, arms=[a for a in part.arms if a.rows], not_run=[*part.not_run, *empty])


def _source(arm: Arm) -> Any:
    """The knowledge source that was asked: some methods bring their own, whatever is configured."""
    return next((r["knowledge"] for r in arm.done if r.get("knowledge")), arm.settings.get(SOURCE))


def _add(arm: Arm, row: Row, folder: Folder) -> None:
    known = arm.rows.get(row["episode_id"])
    if known is not None and _result(known) != _result(row):
        others = [f.path for f in arm.folders if f is not folder]
        raise InputError(
            f"{', '.join(map(str, others))} and {folder.path} both have method `{arm.method}` under the same "
            f"settings, with different results of episode {row['episode_id']}; report one of them"
        )
    if known is None or (known.get("concurrent") and not row.get("concurrent")):
        arm.rows[row["episode_id"]] = row  # of equal results, the one whose times are a measurement


def _result(row: Row) -> dict[str, Any]:
    """A row without what may differ between two runs of it."""
    return {k: v for k, v in row.items() if k not in _ABOUT_THE_RUN and not k.endswith("_seconds")}


def _varied(settings: Sequence[Mapping[str, Any]]) -> list[str]:
    keys = sorted({k for s in settings for k in s})
    return [k for k in keys if len({json.dumps(s.get(k)) for s in settings}) > 1]


def _label(arms: Sequence[Arm], varied: Sequence[str]) -> None:
    """Names each arm: its method where that is enough, else the settings that set it apart."""
    methods = [a.method for a in arms]
    last = [k.rpartition(".")[2] for k in varied]
    names = last if len(set(last)) == len(last) else varied
    for arm in arms:
        what = ", ".join(f"{n} = {setting(arm.settings.get(k))}" for n, k in zip(names, varied, strict=True))
        if methods.count(arm.method) == 1:
            arm.label = arm.method
        else:
            arm.label = what if len(set(methods)) == 1 else f"{arm.method} ({what})"


def setting(value: Any) -> str:
    """A setting as it is printed."""
    return json.dumps(value) if isinstance(value, list | bool) or value is None else str(value)


def _missing(part: Part) -> list[str]:
    """Who lacks which episodes that the part set out to run, a sentence each."""
    wanted = sorted(set().union(*(a.expected for a in part.arms))) if part.arms else []
    sentences = []
    for arm in part.arms:
        lacking = [e for e in wanted if e not in arm.rows]
        if lacking:
            named = ", ".join(lacking[:5]) + (f" and {len(lacking) - 5} more" if len(lacking) > 5 else "")
            sentences.append(
                f"part `{part.name}` over `{part.set_name}`: `{arm.label}` lacks {len(lacking)} of "
                f"{len(wanted)} episodes ({named})"
            )
    return sentences
