"""`fuse tune`: settings that are chosen on development episodes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from fuse_grounding import tensors
from fuse_grounding.benchmark.runner import Row
from fuse_grounding.cli.run import configure
from fuse_grounding.environment import load_episodes
from fuse_grounding.errors import InputError

app = typer.Typer(help="Choose settings on development episodes.", no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Choose settings on development episodes."""


@app.command()
def gate(
    out: Annotated[Path, typer.Option(help="JSON file for the choice and its curve.")],
    episodes: Annotated[str, typer.Option(help="Name of a set, or a .json.gz file.")] = "dev",
    limit: Annotated[int, typer.Option(min=1, help="Only the first N episodes.")] = 5,
    config: Annotated[Path | None, typer.Option(help="TOML file with settings.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value. Repeatable.")
    ] = None,
) -> None:
    """Choose gate.eta of {0.6, 0.7, 0.8, 0.9} by playing the first development episodes with each."""
    from fuse_grounding.training.gate import tune

    if not out.parent.is_dir():
        raise InputError(f"--out {out}: there is no folder {out.parent}")
    console = Console(soft_wrap=True, highlight=False, markup=False)

    def tell(eta: float, row: Row) -> None:
        verdict = "success" if row["success"] else "-"
        told = f"{verdict:<8} IoU {row['iou']:.3f}  {row['wall_seconds']:.1f} s"
        console.print(f"eta {eta}  {row['episode_id']:<24} {told}")

    result = tune(configure(config, overrides or []), load_episodes(episodes)[:limit], tell)
    tensors.write(out, json.dumps(result, indent=1) + "\n")
    for point in result["curve"]:
        mark = "  <- chosen" if point["eta"] == result["chosen"] else ""
        console.print(
            f"eta {point['eta']}: success {point['success']:.0%}, IoU {point['iou']:.3f}, "
            f"{point['amortized']:.1f} amortised and {point['explicit']:.1f} explicit decisions, "
            f"{point['wall_seconds']:.1f} s{mark}"
        )
