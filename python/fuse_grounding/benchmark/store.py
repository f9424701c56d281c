"""A benchmark folder: `bench.json` says what is being run, `results.jsonl` grows by one whole line a run.

Only this file writes there. A crash can leave at most one unfinished last line, which is dropped
when the folder is resumed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.record import write_atomically

SCHEMA_VERSION = 1
RESULTS, HEADER = "results.jsonl", "bench.json"


class ResultStore:
    """Rows of one benchmark, keyed by method and episode."""

    def __init__(self, folder: Path, header: Mapping[str, Any], resume: bool):
        """Opens the folder. `header` has what decides results (`config`, `episodes`, ...).

        Raises InputError for a folder that is not empty unless `resume`, that cannot be written, or
        whose header differs; resuming a folder without results starts afresh.
        """
        self._folder = folder
        self._results = folder / RESULTS
        self.rows: list[dict[str, Any]] = []
        wanted = json.loads(json.dumps({"schema_version": SCHEMA_VERSION, **header}))
        try:
            self._open(wanted, resume)
        except OSError as error:
            raise InputError(f"output directory {folder} cannot be written: {error.strerror}") from None

    def _open(self, wanted: dict[str, Any], resume: bool) -> None:
        folder = self._folder
        if folder.is_dir() and any(folder.iterdir()):
            if not resume:
                raise InputError(
                    f"output directory {folder} exists and is not empty; use --resume or another"
                )
            if self._results.exists():
                _same_header(folder / HEADER, wanted)
                self.rows = _read_rows(self._results)
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / HEADER, json.dumps(wanted, indent=1) + "\n")
        lines = "".join(_line(row) for row in self.rows)
        write_atomically(self._results, lines)

    def done(self, method: str, episode_id: str) -> bool:
        """Whether this pair has a row that ran through."""
        return any(
            r["method"] == method and r["episode_id"] == episode_id and r["status"] == "ok" for r in self.rows
        )

    def append(self, row: dict[str, Any]) -> None:
        """Adds one line and flushes it to disk. Raises FuseError when the disk refuses."""
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


def _read_rows(path: Path) -> list[dict[str, Any]]:
    """Whole lines; an unfinished last one is dropped, failed runs too: they are tried again."""
    text = path.read_text(encoding="utf-8")
    lines = text.split("\n")[:-1]
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
            if row["status"] == "ok":
                rows.append(row)
        except (json.JSONDecodeError, KeyError, TypeError):
            raise InputError(f"{path}, line {number}: not a result; the file was changed by hand?") from None
    return rows


def _same_header(path: Path, wanted: dict[str, Any]) -> None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError):
        raise InputError(f"{path} is missing or broken; the results beside it cannot be resumed") from None
    difference = _first_difference(found, wanted)
    if difference is not None:
        raise InputError(f"{path} is of another benchmark: {difference}; choose another --out")


def _first_difference(found: Any, wanted: Any, key: str = "") -> str | None:
    if isinstance(found, dict) and isinstance(wanted, dict):
        for name in sorted(found.keys() | wanted.keys()):
            inner = _first_difference(found.get(name), wanted.get(name), f"{key}.{name}" if key else name)
            if inner is not None:
                return inner
        return None
    return None if found == wanted else f"`{key}` is {found!r} there and {wanted!r} here"
