"""`fuse bench`: methods over episodes, one line of JSON each, and a table at the end."""

from __future__ import annotations

from pathlib import Path
from statistics import mean
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from fuse_grounding.agent import Agent
from fuse_grounding.benchmark.identity import identity
from fuse_grounding.benchmark.methods import METHODS
from fuse_grounding.benchmark.runner import run_benchmark
from fuse_grounding.benchmark.store import RESULTS, ResultStore
from fuse_grounding.cli.console import print_json
from fuse_grounding.cli.run import OpenVocabulary, Segmenter, Weights, configure
from fuse_grounding.environment import load_episodes
from fuse_grounding.errors import InputError

Row = dict[str, Any]


def command(
    out: Annotated[Path, typer.Option(help="New or empty folder, or one to --resume.")],
    episodes: Annotated[str, typer.Option(help="Name of a shipped set, or a .json.gz file.")] = "dev",
    methods: Annotated[str, typer.Option(help="Names, separated by commas.")] = "static,random,explicit",
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first N episodes.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where --out stopped.")] = False,
    segmenter: Segmenter = None,
    weights: Weights = None,
    open_vocabulary: OpenVocabulary = None,
    config: Annotated[Path | None, typer.Option(help="TOML file with settings.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value. Repeatable.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON only.")] = False,
) -> None:
    """Run methods over a set of episodes, one after the other."""
    names = [METHODS.get(name.strip()).name for name in methods.split(",") if name.strip()]
    if not names:
        raise InputError(f"--methods is empty; known: {', '.join(METHODS.names())}")
    settings = configure(
        config,
        overrides or [],
        segmenter__name=segmenter,
        segmenter__weights=weights,
        knowledge__open_vocabulary=open_vocabulary,
    )
    chosen = load_episodes(episodes)[:limit]
    if not chosen:
        raise InputError(f"{episodes} has no episodes")
    agents = {name: Agent(settings.with_(method=name)) for name in names}
    provenance = agents[names[0]].provenance
    store = ResultStore(out, identity(settings, chosen, provenance), provenance, resume)
    console = Console(quiet=as_json, soft_wrap=True, highlight=False, markup=False)
    total = len(chosen) * len(names)

    def tell(row: Row) -> None:
        console.print(f"{len(store.rows):4d}/{total}  {_line(row)}")

    run_benchmark(chosen, agents, store, tell)
    rows = [r for r in store.rows if r["method"] in names]
    if as_json:
        print_json([summary(name, rows) for name in names])
    else:
        console.print(f"\nresults     {out / RESULTS}")
        shown = Console()
        shown.width = max(shown.width, 150)  # a log file is wide enough
        shown.print(_table([summary(name, rows) for name in names]))
    if any(r["status"] != "ok" for r in rows):
        raise typer.Exit(1)


def _line(row: Row) -> str:
    head = f"{row['episode_id']:<24} {row['method']:<14}"
    if row["status"] != "ok":
        return f"{head} failed: {row['error']}"
    verdict = "success" if row["success"] else "-"
    return (
        f"{head} {verdict:<8} IoU {row['iou']:.3f}  {row['online_actions']:2d} actions  "
        f"{row['wall_seconds']:.1f} s"
    )


def summary(method: str, rows: list[Row]) -> Row:
    """Means over the episodes that ran; `shares` is each stage's part of the measured time."""
    mine = [r for r in rows if r["method"] == method]
    ran = [r for r in mine if r["status"] == "ok"]
    if not ran:
        return {"method": method, "episodes": 0, "failed": len(mine)}
    stages: dict[str, float] = {}
    for row in ran:
        for stage, seconds in row["timings"].items():
            stages[stage] = stages.get(stage, 0.0) + seconds
    spent = sum(stages.values()) or 1.0
    return {
        "method": method,
        "episodes": len(ran),
        "failed": len(mine) - len(ran),
        "success": mean(float(r["success"]) for r in ran),
        "iou": mean(r["iou"] for r in ran),
        "online_actions": mean(r["online_actions"] for r in ran),
        "total_steps": mean(r["total_steps"] for r in ran),
        "seconds": mean(r["wall_seconds"] for r in ran),
        "shares": {s: v / spent for s, v in sorted(stages.items(), key=lambda item: -item[1])},
    }


def _table(summaries: list[Row]) -> Table:
    table = Table(
        "method", "episodes", "success", "IoU", "actions", "steps", "seconds", "share by stage", box=None
    )
    for s in summaries:
        if not s["episodes"]:
            table.add_row(s["method"], f"0 ({s['failed']} failed)")
            continue
        shares = ", ".join(f"{stage} {share:.0%}" for stage, share in s["shares"].items() if share >= 0.005)
        failed = f" ({s['failed']} failed)" if s["failed"] else ""
        table.add_row(
            s["method"],
            f"{s['episodes']}{failed}",
            f"{s['success']:.0%}",
            f"{s['iou']:.3f}",
            f"{s['online_actions']:.1f}",
            f"{s['total_steps']:.1f}",
            f"{s['seconds']:.1f}",
            shares,
        )
    return table
