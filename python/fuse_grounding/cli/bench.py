"""`fuse bench`: methods over episodes, one line of JSON each, and a table at the end."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from fuse_grounding.benchmark import store, suites
from fuse_grounding.benchmark.driver import Means, Outcome, Plan, run_benchmarks
from fuse_grounding.benchmark.latency import latency
from fuse_grounding.benchmark.methods import METHODS
from fuse_grounding.benchmark.processes import Processes
from fuse_grounding.benchmark.runner import Row
from fuse_grounding.cli.bench_console import Teller, latency_table, summary, summary_table
from fuse_grounding.cli.console import Interrupted, print_json
from fuse_grounding.cli.run import OpenVocabulary, Segmenter, Weights, configure
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode, load_episodes
from fuse_grounding.errors import InputError

_EPISODES, _METHODS = "dev", "static,random,explicit"


def command(
    out: Annotated[Path, typer.Option(help="New or empty folder, or one to --resume.")],
    episodes: Annotated[
        str | None, typer.Option(help="Name of a shipped set, or a .json.gz file; default: dev.")
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            help="Names, or package.module:factory, separated by commas; default: static,random,explicit."
        ),
    ] = None,
    suite: Annotated[
        str | None,
        typer.Option(
            help=f"Parts instead of --methods, separated by commas: {', '.join(suites.SUITES)}.",
        ),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Only the first N episodes.")] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, max=256, help="Worker processes; the results are the same.")
    ] = None,
    engine: Annotated[
        str, typer.Option(help="local, or ray: a Ray cluster (RAY_ADDRESS; docs/benchmark.md).")
    ] = "local",
    resume: Annotated[bool, typer.Option("--resume", help="Go on where --out stopped.")] = False,
    timing: Annotated[
        bool,
        typer.Option(
            "--timing",
            help="Measure one episode at a time; print seconds by component, or those of an existing --out.",
        ),
    ] = False,
    gallery: Annotated[
        int, typer.Option(min=0, help="Pictures of the first N episodes, in OUT/gallery/METHOD/EPISODE.")
    ] = 0,
    segmenter: Segmenter = None,
    weights: Weights = None,
    open_vocabulary: OpenVocabulary = None,
    config: Annotated[Path | None, typer.Option(help="TOML file with settings.")] = None,
    overrides: Annotated[
        list[str] | None, typer.Option("--set", help="One setting: section.key=value. Repeatable.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON only.")] = False,
) -> None:
    """Run methods over a set of episodes, or a suite of them; docs/benchmark.md."""
    if timing and episodes is methods is suite is limit is None and not resume:
        values = _timed(out, Teller(out, quiet=as_json))
        if as_json:
            print_json(values)
        return
    settings = configure(
        config,
        overrides or [],
        segmenter__name=segmenter,
        segmenter__weights=weights,
        knowledge__open_vocabulary=open_vocabulary,
    )
    means = _means(engine, jobs, timing, gallery)
    if suite is not None and methods is not None:
        raise InputError(f"--suite {suite} says which methods run; leave out --methods {methods}")
    chosen = load_episodes(_EPISODES if episodes is None else episodes)[:limit]
    if not chosen:
        raise InputError(f"{episodes} has no episodes")
    if suite is None:
        asked = _METHODS if methods is None else methods
        parts = [_plan(out, settings, chosen, asked, gallery, resume)]
    else:
        parts = suites.plans(suite, out, settings, chosen, gallery=gallery, resume=resume)
    if timing:
        for part in parts:
            _only_alone(part.out)
    teller = Teller(out, quiet=as_json)
    try:
        ran = run_benchmarks(parts, means, teller)
    except KeyboardInterrupt:
        raise Interrupted(teller.interrupted()) from None
    finally:
        teller.close()
    told = {p.out.name: _told(p, outcome, timing, teller) for p, outcome in zip(parts, ran, strict=True)}
    if as_json:
        print_json(told if suite is not None else told[out.name])
    if any(row["status"] != "ok" for outcome in ran for row in outcome.rows):
        raise typer.Exit(1)


def _plan(
    out: Path, settings: Config, episodes: list[Episode], methods: str, gallery: int, resume: bool
) -> Plan:
    names = [name.strip() for name in methods.split(",") if name.strip()]
    if not names:
        raise InputError(f"--methods is empty; known: {', '.join(METHODS.names())}")
    return Plan(out, settings, episodes, names, gallery=gallery, resume=resume)


def _timed(out: Path, teller: Teller) -> list[Any]:
    """Prints the latency tables of a folder. Raises InputError for one that has none."""
    if not store.has_results(out):
        parts = sorted(p.parent.name for p in out.glob(f"*/{store.RESULTS}"))
        found = f"its parts are {', '.join(parts)}" if parts else f"there is no {store.RESULTS} in it"
        raise InputError(
            "--timing without --episodes, --methods, --suite or --limit prints the times of a folder that "
            f"has results, and {out} has none itself: {found}"
        )
    values = _latencies(store.load(out)[1], teller)
    if not values:
        raise InputError(f"nothing in {out} can be timed")
    return values


def _only_alone(out: Path) -> None:
    """Raises InputError where rows are there already that would make the table no measurement."""
    if store.has_results(out) and (beside := sum(bool(r.get("concurrent")) for r in store.load(out)[1])):
        raise InputError(
            f"{beside} results in {out} were made beside others, with --jobs: their times are no "
            "measurement; choose another --out for --timing"
        )


def _means(engine: str, jobs: int | None, timing: bool, gallery: int) -> Means:
    if timing and (engine != "local" or (jobs or 1) > 1):
        found = f"--engine {engine}" if engine != "local" else f"--jobs {jobs}"
        raise InputError(
            f"--timing measures one episode after the other, so that none waits for another's share of the "
            f'processor (supplement, "Runtime Protocol"): leave out {found}'
        )
    if engine == "local":
        jobs = jobs or 1
        return Means(partial(Processes, jobs=jobs), "local", jobs)
    if engine != "ray":
        raise InputError(f"--engine must be local or ray, found {engine}")
    if gallery:
        raise InputError("--gallery writes pictures on this machine: leave out --engine ray")
    from fuse_grounding.benchmark.cluster import RayEngine

    address = os.environ.get("RAY_ADDRESS")
    if address and jobs is not None:
        raise InputError(f"the cluster {address} (RAY_ADDRESS) has its own size: leave out --jobs {jobs}")
    return Means(partial(RayEngine, address=address, cpus=jobs), "ray", None)


def _told(plan: Plan, outcome: Outcome, timing: bool, teller: Teller) -> list[Any]:
    """Prints a part's table; its values."""
    for name, reason in outcome.refused.items():
        teller.note(f"{plan.out.name}: {name} was not run: {reason}")
    if outcome.rows:
        teller.out.print(f"\nresults     {plan.out / store.RESULTS}")
    if timing:
        return _latencies(outcome.rows, teller)
    summaries = [summary(name, outcome.rows) for name in dict.fromkeys(r["method"] for r in outcome.rows)]
    if summaries:
        teller.table(summary_table(summaries))
    return summaries


def _latencies(rows: list[Row], teller: Teller) -> list[Any]:
    """Prints the latency of each method, or why there is none; the values."""
    values = []
    for name in dict.fromkeys(row["method"] for row in rows):
        try:
            table = latency([r for r in rows if r["method"] == name])
        except InputError as error:
            teller.note(str(error))
        else:
            teller.table(latency_table(table))
            values.append(table.to_dict())
    return values
