"""`fuse doctor`: what this machine has, what is missing, how to get it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fuse_grounding.cli.run import Segmenter, Weights, configure
from fuse_grounding.doctor import examine


def command(
    segmenter: Segmenter = None,
    weights: Weights = None,
    config: Annotated[Path | None, typer.Option(help="TOML file with settings.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value. Repeatable.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """Say what this machine has, what is missing, and how to get it.

    With settings, whether the segmenter, encoder and planner that they choose are usable too.
    """
    settings = configure(config, overrides or [], segmenter__name=segmenter, segmenter__weights=weights)
    checks = examine(settings)
    if as_json:
        typer.echo(json.dumps([dataclasses.asdict(c) for c in checks], indent=1))
    else:
        table = Table(box=None, show_header=False, padding=(0, 2))
        for _ in range(4):
            table.add_column(overflow="fold")
        for c in checks:
            state = "ok" if c.ok else "[red]not ok[/red]" if c.needed else "-"
            table.add_row(state, c.name, escape(c.found), "" if c.ok else escape(c.hint))
        Console().print(table)
    if not all(c.ok or not c.needed for c in checks):
        raise typer.Exit(1)
