"""`fuse knowledge`: precision and recall of each knowledge source against the validity table."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from fuse_grounding import knowledge
from fuse_grounding.cli.console import print_json
from fuse_grounding.config import Config
from fuse_grounding.knowledge.judge import Judgement, judge, pooled, validity
from fuse_grounding.perception.doors import open_encoder, settled


def _share(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _row(judgement: Judgement) -> tuple[str, ...]:
    return (
        judgement.source,
        judgement.verb,
        ", ".join(judgement.proposed) or "nothing",
        ", ".join(judgement.wrong),
        ", ".join(judgement.missed),
        _share(judgement.precision),
        _share(judgement.recall),
    )


def command(
    source: Annotated[list[str] | None, typer.Option(help="Source to judge; repeat for several.")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file with settings.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value. Repeatable.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """Judge knowledge sources: would a reasonable person accept what they propose?

    The oracle is not listed: it tells what the table says, so that both of its figures are 1. `llm` is, where
    it is asked for and an endpoint is configured.
    """
    table, settings = validity(), Config.load(config, overrides or [])
    sources = {
        name: settings.with_(knowledge={"source": name}).knowledge
        for name in source or ["graph", "plain", "direct"]
    }
    comparing = [name for name, chosen in sources.items() if knowledge.compares(chosen)]
    encoder = open_encoder(settled(settings.encoder)).part if comparing else None
    judged = {name: judge(knowledge.make(chosen, encoder), table) for name, chosen in sources.items()}
    if as_json:
        print_json(
            {
                name: {
                    "precision": pooled(rows)[0],
                    "recall": pooled(rows)[1],
                    "encoder": encoder.name if encoder is not None and name in comparing else None,
                    "verbs": {
                        j.verb: {
                            "proposed": j.proposed,
                            "wrong": j.wrong,
                            "missed": j.missed,
                            "precision": j.precision,
                            "recall": j.recall,
                        }
                        for j in rows
                    },
                }
                for name, rows in judged.items()
            }
        )
        return
    shown = Table("source", "verb", "proposed", "wrong", "missed", "precision", "recall", box=None)
    for name, rows in judged.items():
        for judgement in rows:
            shown.add_row(*_row(judgement))
        precision, recall = pooled(rows)
        shown.add_row(name, "all verbs", "", "", "", _share(precision), _share(recall), style="bold")
    Console().print(shown)
    if encoder is not None:
        Console().print(f"labels were compared by {encoder.name} in: {', '.join(comparing)}")
