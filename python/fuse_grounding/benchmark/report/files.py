"""The files of a report, each written whole: report.html, report.md, tables/*.csv, tables/*.tex."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from fuse_grounding.benchmark.report import html, latex, markdown
from fuse_grounding.benchmark.report.model import Cell, Column, Report, Table
from fuse_grounding.errors import InputError
from fuse_grounding.record import write_atomically

PAGE, TEXT, TABLES = "report.html", "report.md", "tables"


def prepare(out: Path) -> None:
    """Makes the folder. Raises InputError unless it is new, empty or holds an earlier report."""
    try:
        if out.exists() and not out.is_dir():
            raise InputError(f"output directory {out} is a file")
        if out.is_dir() and any(out.iterdir()) and not (out / PAGE).is_file():
            raise InputError(
                f"output directory {out} is not empty and not an earlier report (no {PAGE}); "
                "choose another --out"
            )
        (out / TABLES).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"output directory {out} cannot be written: {error.strerror}") from None


def write(report: Report, out: Path) -> list[Path]:
    """Writes everything; tables of an earlier report that this one lacks are taken away.

    Raises InputError as `prepare` does, and when a file cannot be written.
    """
    prepare(out)
    contents = {out / PAGE: html.render(report), out / TEXT: markdown.render(report)}
    for made in report.tables():
        contents[out / TABLES / f"{made.name}.csv"] = csv_text(made)
        contents[out / TABLES / f"{made.name}.tex"] = latex.table(made)
    try:
        for path, text in contents.items():
            write_atomically(path, text)
        for suffix in (".csv", ".tex"):
            for path in (out / TABLES).glob(f"*{suffix}"):
                if path not in contents:
                    path.unlink()
    except OSError as error:
        raise InputError(f"{error.filename or out} cannot be written: {error.strerror}") from None
    return list(contents)


def csv_text(made: Table) -> str:
    """Full precision, one column for each end of an interval; a last column `note` where a row has one.

    Values are as computed: shares in [0, 1] whatever the page's unit.
    """
    wide = [
        any(r.cells[i].low is not None for r in made.rows if i < len(r.cells))
        for i in range(len(made.columns))
    ]
    noted = any(r.note for r in made.rows)
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*_heads(made.columns, wide), *(["note"] if noted else [])])
    for row in made.rows:
        cells = [*row.cells, *[Cell()] * (len(made.columns) - len(row.cells))]
        values: list[object] = []
        for cell, has_ends in zip(cells, wide, strict=True):
            values += [_plain(cell), *([cell.low, cell.high] if has_ends else [])]
        writer.writerow([*values, *([row.note] if noted else [])])
    return out.getvalue()


def _heads(columns: Sequence[Column], wide: Sequence[bool]) -> list[str]:
    heads = []
    for column, has_ends in zip(columns, wide, strict=True):
        heads += [column.key, *([f"{column.key}_low", f"{column.key}_high"] if has_ends else [])]
    return heads


def _plain(cell: Cell) -> object:
    return cell.text if cell.value is None else cell.value
