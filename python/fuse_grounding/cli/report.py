"""`fuse report`: benchmark folders become tables, statistics, plots, one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fuse_grounding.benchmark.report import Options, build, load, write
from fuse_grounding.benchmark.report.gallery import LIMIT_MB
from fuse_grounding.benchmark.report.model import Table
from fuse_grounding.cli.console import print_json


def command(
    folders: Annotated[
        list[Path], typer.Argument(help="Folders that `fuse bench --out` wrote, or that hold such folders.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Where to write; default: `report` in the first one.")
    ] = None,
    partial: Annotated[
        bool,
        typer.Option("--partial", help="Report on unfinished runs, each line over what it has."),
    ] = False,
    reference: Annotated[
        str | None, typer.Option(help="Method that the main table's others are compared with; default: fuse.")
    ] = None,
    episodes: Annotated[
        list[Path] | None,
        typer.Option(help=".json.gz file of episodes that are in no shipped set. Repeatable."),
    ] = None,
    gallery_mb: Annotated[float, typer.Option(min=0, help="Most megabytes of embedded pictures.")] = LIMIT_MB,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Tables with intervals, paired statistics, plots and episodes of a benchmark, as one page."""
    results = load(folders, partial)
    made = build(results, Options(reference, episodes or (), gallery_mb))
    place = out or folders[0] / "report"
    written = write(made, place)
    tables = sum(isinstance(b, Table) for s in made.sections for b in s.blocks)
    if as_json:
        print_json({"page": str(written[0]), "files": [str(p) for p in written], "tables": tables})
        return
    for sentence in results.incomplete:
        typer.echo(f"note        {sentence}")
    typer.echo(f"page        {written[0]} ({written[0].stat().st_size / 1e6:.1f} MB)")
    typer.echo(f"text        {written[1]}")
    typer.echo(f"tables      {tables} in {place / 'tables'} (.csv, .tex)")
