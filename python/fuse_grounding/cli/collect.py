"""`fuse collect`: what the amortised planner is trained and judged on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from fuse_grounding.cli.console import print_json
from fuse_grounding.cli.run import configure
from fuse_grounding.environment import load_episodes
from fuse_grounding.environment.sets import SETS
from fuse_grounding.errors import InputError


def command(
    out: Annotated[Path, typer.Option(help="New or empty folder, or one to --resume.")],
    split: Annotated[str, typer.Option(help="Whose episodes: train, or dev to judge planners on.")] = "train",
    trajectories: Annotated[
        int | None, typer.Option(min=1, help="Random walks; default: one for each episode (train has 416).")
    ] = None,
    exhaustive: Annotated[
        bool, typer.Option("--exhaustive", help="Measure every feasible action at the states visited.")
    ] = False,
    states: Annotated[
        int, typer.Option(min=1, help="With --exhaustive: states of each trajectory, from its start on.")
    ] = 3,
    actions: Annotated[
        int | None, typer.Option(min=1, help="Actions of each walk; default: 5 to 13, at random.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, max=256, help="Processes; the result is the same.")] = 1,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where --out stopped.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of viewpoints and actions.")] = 0,
    encoder: Annotated[
        Path | None, typer.Option(help="encoder.onnx with its files beside it; default: shipped.")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file with settings.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value. Repeatable.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the card as JSON only.")] = False,
) -> None:
    """Random walks in training scenes, with every term of the planner's utility measured."""
    from fuse_grounding.training import collect

    if split not in collect.SPLITS:
        raise InputError(f"--split must be {' or '.join(collect.SPLITS)}, found {split}")
    if exhaustive and actions is not None:
        raise InputError(f"--actions {actions} is for plain walks: with --exhaustive, --states counts")
    if trajectories is None:
        trajectories = SETS[split].count if split == "train" else len(load_episodes(split))
    request = collect.Request(
        split=split,
        trajectories=trajectories,
        seed=seed,
        states=states if exhaustive else 0,
        actions=actions,
        encoder=None if encoder is None else str(encoder),
        config=configure(config, overrides or []).to_dict(),
    )
    err = Console(stderr=True)
    columns = (TextColumn("trajectories"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err, disable=not err.is_terminal) as progress:
        task = progress.add_task("", total=trajectories)
        made = collect.collect(
            out,
            request,
            jobs=jobs,
            resume=resume,
            tell=lambda done, total: progress.update(task, completed=done),
        )
    if as_json:
        print_json(collect.card(out))
        return
    console = Console(soft_wrap=True, highlight=False, markup=False)
    size = made.path.stat().st_size / 1e6
    console.print(
        f"{made.path}: {made.transitions} transitions of {made.trajectories} trajectories, {size:.1f} MB"
    )
    for why, count in made.left_out.items():
        console.print(f"left out: {count} trajectories ({why})")
