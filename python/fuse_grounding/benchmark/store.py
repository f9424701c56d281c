"""A benchmark folder: `bench.json` says what is being run, `results.jsonl` grows by one whole line a run.

Only this file writes there. A folder holds results of one identity (`identity.py`); every line is
stamped with its name. A crash can leave at most one unfinished last line, which is dropped
when the folder is resumed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fuse_grounding.benchmark.identity import difference, name
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.record import write_atomically

SCHEMA_VERSION = 2
RESULTS, HEADER = "results.jsonl", "bench.json"


class ResultStore:
    """Rows of one benchmark, keyed by method and episode."""

    def __init__(
        self, folder: Path, identity: Mapping[str, Any], provenance: Mapping[str, Any], resume: bool
    ):
        """Opens the folder. `identity` decides results; `provenance` is kept for people.

        Raises InputError for a folder that is not empty unless `resume`, that cannot be written, or
        whose results have another identity; resuming a folder without results starts afresh.
        """
        self._folder = folder
        self._results = folder / RESULTS
        self.rows: list[dict[str, Any]] = []
        wanted = json.loads(json.dumps(dict(identity)))
        self._name = name(wanted)
        try:
            self._open(wanted, dict(provenance), resume)
        except OSError as error:
            raise InputError(f"output directory {folder} cannot be written: {error.strerror}") from None

    def _open(self, wanted: dict[str, Any], provenance: dict[str, Any], resume: bool) -> None:
        folder = self._folder
        if folder.exists() and not folder.is_dir():
            raise InputError(f"output directory {folder} is a file")
        if folder.is_dir() and any(folder.iterdir()):
            if not resume:
                raise InputError(
                    f"output directory {folder} exists and is not empty; use --resume or another"
                )
            if self._results.exists():
                _same_identity(folder, wanted)
                self.rows = _read_rows(self._results, self._name)
        folder.mkdir(parents=True, exist_ok=True)
        header = {"schema_version": SCHEMA_VERSION, "identity": wanted, "provenance": provenance}
        write_atomically(folder / HEADER, json.dumps(header, indent=1) + "\n")
        lines = "".join(_line(row) for row in self.rows)
        write_atomically(self._results, lines)

    def done(self, method: str, episode_id: str) -> bool:
        """Whether this pair has a row that ran through."""
        return any(
            r["method"] == method and r["episode_id"] == episode_id and r["status"] == "ok" for r in self.rows
        )

    def append(self, row: dict[str, Any]) -> None:
        """Adds one line, stamped, and flushes it to disk. Raises FuseError when the disk refuses."""
        row = {"identity": self._name, **row}
        try:
            with self._results.open("a", encoding="utf-8") as file:
                file.write(_line(row))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise FuseError(f"{self._results} cannot be written: {error.strerror}") from None
        self.rows.append(row)


def _line(row: Mapping[str, Any]) -> str:
    return json.dumps(row, allow_nan=False) + "\n"


def _read_rows(path: Path, identity: str) -> list[dict[str, Any]]:
    """Whole lines; an unfinished last one is dropped, failed runs too: they are tried again."""
    text = path.read_text(encoding="utf-8")
    lines = text.split("\n")[:-1]
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
            stamp, status, _, _ = (row[key] for key in ("identity", "status", "method", "episode_id"))
        except (json.JSONDecodeError, KeyError, TypeError):
            raise InputError(f"{path}, line {number}: not a result; the file was changed by hand?") from None
        if stamp != identity:
            raise InputError(
                f"{path}, line {number}: a result of another run ({stamp}, not {identity}); "
                "results of two runs must not be mixed"
            )
        if status == "ok":
            rows.append(row)
    return rows


def _same_identity(folder: Path, wanted: dict[str, Any]) -> None:
    path = folder / HEADER
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        there, version = found["identity"], found["schema_version"]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            f"{path} is missing or broken; the results beside it cannot be resumed, choose another --out"
        ) from None
    if version != SCHEMA_VERSION:
        raise InputError(f"{path} has schema_version {version!r}, expected {SCHEMA_VERSION}")
    how = difference(there, wanted)
    if how is not None:
        raise InputError(
            f"the results in {folder} were made {how}; results of two runs must not be mixed, "
            "choose another --out"
        )
