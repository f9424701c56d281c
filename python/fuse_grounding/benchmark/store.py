"""A benchmark folder: `bench.json` says what is being run, `results.jsonl` grows by one whole line a run.

Only this file writes these, and only one process at a time. Every line is stamped with what decided it
(`identity.py`). A line of a run that failed stays until a later one of the same method and episode takes its
place. A finished benchmark is rewritten in order of episodes, then methods, whatever order it was run in.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fuse_grounding.benchmark.identity import IDENTITY_VERSION, difference, joined, stamp
from fuse_grounding.benchmark.rows import fault
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.record import hold, write_atomically

SCHEMA_VERSION = 3
RESULTS, HEADER = "results.jsonl", "bench.json"

Row = dict[str, Any]
Key = tuple[str, str]
"""Method and episode."""


def check(folder: Path, resume: bool) -> None:
    """Raises InputError for a folder that is a file, or not empty without `resume`."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"output directory {folder} is a file")
    if folder.is_dir() and any(folder.iterdir()) and not resume:
        raise InputError(f"output directory {folder} exists and is not empty; use --resume or another")


def has_results(folder: Path) -> bool:
    """Whether a folder is one of a benchmark that has begun."""
    return (folder / HEADER).is_file() and (folder / RESULTS).is_file()


def load(folder: Path) -> tuple[dict[str, Any], list[Row]]:
    """Header and rows of a benchmark folder, one row a method and episode, in order; nothing is written.

    Raises InputError for a folder that is none, and for broken lines but a last one.
    """
    header = _read_header(folder)
    try:
        version = header["identity"]["identity_version"]
    except (KeyError, TypeError):
        version = None
    if version != IDENTITY_VERSION:
        raise InputError(f"{folder / HEADER} has identity_version {version!r}, expected {IDENTITY_VERSION}")
    rows, _ = _read_rows(folder / RESULTS, header["identity"])
    return header, _in_order(rows.values())


class ResultStore:
    """Rows of one benchmark, keyed by method and episode. A context manager that holds the folder."""

    def __init__(
        self,
        folder: Path,
        identity: Mapping[str, Any],
        provenance: Mapping[str, Any],
        resume: bool,
        notes: Mapping[str, Any] | None = None,
    ):
        """Opens the folder. `identity` decides results; `provenance` and `notes` are kept for people.

        Raises InputError for a folder that is not empty unless `resume`, that cannot be written or is being
        written, or whose results have another identity; resuming a folder without results starts afresh.
        """
        self._folder, self._results = folder, folder / RESULTS
        self._identity = json.loads(json.dumps(dict(identity)))
        self._commit = provenance.get("commit")
        self._rows: dict[Key, Row] = {}
        self._held: int | None = None
        self.announcements: list[str] = []
        """What was put right when the folder was opened."""
        check(folder, resume)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._held = hold(folder, "benchmark")
            self._open(dict(provenance), dict(notes or {}))
        except OSError as error:
            self.close()
            raise InputError(f"output directory {folder} cannot be written: {error.strerror}") from None
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> ResultStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def rows(self) -> list[Row]:
        """One row a method and episode, in order of episodes, then methods."""
        return _in_order(self._rows.values())

    def done(self, method: str, episode_id: str) -> Row | None:
        """The row of a pair that ran through; None where there is none, or a failed one, which is tried
        again."""
        row = self._rows.get((method, episode_id))
        return row if row is not None and row["status"] == "ok" else None

    def stamp(self, method: str, episode_id: str) -> str:
        """What a row of this pair is stamped with."""
        return stamp(self._identity, method, episode_id)

    def append(self, row: Row) -> Row:
        """Adds one line, stamped, and flushes it to disk; the row as it was written.

        Raises FuseError when the disk refuses, and leaves no part of the line.
        """
        stamped = {"identity": self.stamp(row["method"], row["episode_id"]), "commit": self._commit, **row}
        self.adopt(stamped)
        return stamped

    def adopt(self, row: Row) -> None:
        """Adds a row that another folder has, stamped alike. Raises FuseError as `append` does."""
        assert row["identity"] == self.stamp(row["method"], row["episode_id"])
        try:
            _append(self._results, _line(row).encode())
        except OSError as error:
            raise self._refused("written", error) from None
        self._rows[_key(row)] = row

    def finish(self) -> None:
        """Rewrites the lines in order, one a method and episode. Raises FuseError when the disk refuses."""
        try:
            write_atomically(self._results, "".join(_line(row) for row in self.rows))
        except OSError as error:
            raise self._refused("put in order", error) from None

    def close(self) -> None:
        """Lets go of the folder."""
        if self._held is not None:
            os.close(self._held)
            self._held = None

    def _refused(self, what: str, error: OSError) -> FuseError:
        return FuseError(
            f"{self._results} cannot be {what}: {error.strerror}; the {len(self._rows)} results in it are "
            "whole: put it right, then go on with --resume"
        )

    def _open(self, provenance: dict[str, Any], notes: dict[str, Any]) -> None:
        earlier: list[Any] = []
        if self._results.exists():
            header = _read_header(self._folder)
            how = difference(header["identity"], self._identity)
            if how is not None:
                raise InputError(
                    f"the results in {self._folder} were made {how}; results of two runs must not be mixed, "
                    "choose another --out"
                )
            self._identity = joined(header["identity"], self._identity)
            self._rows, torn = _read_rows(self._results, self._identity)
            if torn is not None:
                self.announcements.append(f"{torn}; it is left out, and what has no result is run")
            earlier = header.get("earlier", [])
            if header["provenance"] != provenance:
                earlier = [*earlier, header["provenance"]]
        header = {
            "schema_version": SCHEMA_VERSION,
            **notes,
            "identity": self._identity,
            "provenance": provenance,
            "earlier": earlier,
        }
        write_atomically(self._folder / HEADER, _header_text(header))
        write_atomically(self._results, "".join(_line(row) for row in self._rows.values()))


def _append(path: Path, line: bytes) -> None:
    """All of `line` or nothing, on disk."""
    with path.open("ab", buffering=0) as file:
        before = file.seek(0, os.SEEK_END)
        try:
            written = 0
            while written < len(line):
                written += file.write(line[written:])
            os.fsync(file.fileno())
        except BaseException:
            file.truncate(before)
            raise


def _header_text(header: Mapping[str, Any]) -> str:
    return json.dumps(header, indent=1) + "\n"


def _line(row: Mapping[str, Any]) -> str:
    return json.dumps(row, allow_nan=False) + "\n"


def _key(row: Mapping[str, Any]) -> Key:
    return row["method"], row["episode_id"]


def _in_order(rows: Iterable[Row]) -> list[Row]:
    return sorted(rows, key=lambda row: (row["index"], row["method"]))


def _read_rows(path: Path, identity: Mapping[str, Any]) -> tuple[dict[Key, Row], str | None]:
    """The newest row of each pair, and what is wrong with the last line, if anything is.

    Raises InputError for any other line that is no result, or one of something else.
    """
    try:
        *lines, rest = path.read_bytes().split(b"\n")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    rows: dict[Key, Row] = {}
    places = {episode: place for place, episode in enumerate(identity["episodes"])}
    last = len(lines) + (1 if rest else 0)
    torn = f"{path}: the last line ({last}) was not written to its end" if rest else None
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
            wrong = fault(row, places)
        except (ValueError, RecursionError):
            if number == last:
                return rows, f"{path}: the last line ({number}) is broken"
            row, wrong = None, "broken JSON"
        if wrong is not None:
            raise InputError(
                f"{path}, line {number}: not a result ({wrong}); the file was changed or damaged"
            )
        method, episode = key = _key(row)
        if method not in identity["methods"] or episode not in identity["episodes"]:
            raise InputError(f"{path}, line {number}: `{method}` on `{episode}` is no part of this benchmark")
        found, wanted = row["identity"], stamp(identity, method, episode)
        if found != wanted:
            raise InputError(
                f"{path}, line {number}: a result of another run ({found}, not {wanted}); "
                "results of two runs must not be mixed"
            )
        rows[key] = row
    return rows, torn


def _read_header(folder: Path) -> dict[str, Any]:
    path = folder / HEADER
    try:
        header = json.loads(path.read_text(encoding="utf-8"))
        version, _, identity = header["schema_version"], header["provenance"], header["identity"]
        if identity.get("identity_version") == IDENTITY_VERSION:
            dict(identity["episodes"]), dict(identity["config"]), list(header.get("earlier", []))
            for method in dict(identity["methods"]).values():
                dict(method)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{path} is missing or broken; the results beside it cannot be used, choose another folder"
        ) from None
    if version != SCHEMA_VERSION:
        raise InputError(
            f"{path} has schema_version {version!r}, expected {SCHEMA_VERSION}: it is of another version"
        )
    return header
