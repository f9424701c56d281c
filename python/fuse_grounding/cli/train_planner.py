"""`fuse train planner`: the learned planner from collected transitions, and how good its choices are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from fuse_grounding import tensors
from fuse_grounding.benchmark.provenance import sha256
from fuse_grounding.cli.console import print_json, writable_folder
from fuse_grounding.errors import InputError
from fuse_grounding.extras import require
from fuse_grounding.planning.amortized import KINDS, Network, shipped
from fuse_grounding.training import transitions


def planner(
    source: Annotated[Path, typer.Option("--transitions", help="transitions.safetensors of `fuse collect`.")],
    out: Annotated[Path, typer.Option(help="Folder for the weights; with --evaluate, for figures and plot.")],
    kind: Annotated[str, typer.Option(help="plain, summary, or both.")] = "both",
    seed: Annotated[int, typer.Option(min=0, help="Seed of split, start and order.")] = 0,
    evaluate: Annotated[
        bool,
        typer.Option(
            "--evaluate",
            help="Train nothing: judge planners on --transitions, where all actions are measured.",
        ),
    ] = False,
    weights: Annotated[
        Path | None, typer.Option(help="With --evaluate: folder of planners; default: the shipped ones.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON only.")] = False,
) -> None:
    """Train the amortised planner (seconds), or judge one: ranks, regret, calibration of the gate."""
    kinds = KINDS if kind == "both" else (kind,)
    if not set(kinds) <= set(KINDS):
        raise InputError(f"--kind must be {', '.join(KINDS)} or both, found {kind}")
    data, note = transitions.load(source)
    for key in ("split", "encoder"):
        if key not in note:
            raise InputError(
                f"{source} does not say of which {key} it is: `fuse collect` joins its parts into one"
            )
    writable_folder(out)
    if evaluate:
        _evaluate(data, note, source, out, kinds, weights, as_json)
        return
    if weights is not None:
        raise InputError(f"--weights {weights} is for --evaluate")
    for package in ("torch", "onnx"):
        require(package, "train", "training the planner")
    from fuse_grounding.training import planner as training

    console = Console(quiet=as_json, soft_wrap=True, highlight=False, markup=False)
    described = {"sha256": sha256([source]), "split": note["split"], "rows": len(data)}
    results: dict[str, Any] = {}
    for one in kinds:
        console.print(f"planner `{one}` from {len(data)} transitions")
        config = training.settings(one, seed)
        trained = training.train(data, config, console.print)
        path = out / shipped(one).name
        training.write(path, trained, config, note["encoder"], described)
        console.print(f"always the mean: {trained.constant:.5f}\n{path}: {path.stat().st_size / 1e6:.2f} MB")
        results[one] = json.loads(path.with_suffix(".json").read_text())
    if as_json:
        print_json(results)


def _evaluate(
    data: transitions.Transitions,
    note: dict[str, Any],
    source: Path,
    out: Path,
    kinds: tuple[str, ...],
    weights: Path | None,
    as_json: bool,
) -> None:
    from fuse_grounding.training import planner_score as scoring

    found, figures = {}, {}
    for kind in kinds:
        path = shipped(kind) if weights is None else weights / shipped(kind).name
        network = Network(path)
        if network.settings.encoder not in ({}, note["encoder"]):
            raise InputError(f"{path} and {source} are of different encoders: train the planner anew")
        if network.settings.transitions == sha256([source]):
            raise InputError(f"{path} was trained on {source}: judge it on others (fuse collect --split dev)")
        values = scoring.by_network(data, network)
        found[kind] = scoring.choices(data, values)
        seconds = scoring.decision_seconds(values)
        figures[kind] = {"weights": sha256([path]), **scoring.score(found[kind]), "decision_seconds": seconds}
    result = {"transitions": sha256([source]), "split": note["split"], "planners": figures}
    tensors.write(out / "evaluation.json", json.dumps(result, indent=1) + "\n")
    scoring.draw(found, out / "gate_calibration.png")
    if as_json:
        print_json(result)
        return
    console = Console(soft_wrap=True, highlight=False, markup=False)
    for kind, one in figures.items():
        ranks, regret = one["rank_correlation"], one["regret"]
        console.print(
            f"{kind}: {one['states']} states of {one['trajectories']} trajectories ({note['split']})"
        )
        console.print(
            f"  rank correlation  {ranks['within_states']} within states, {ranks['all_pairs']} over all"
        )
        for name in ("top", "random", "stay"):
            console.print(f"  regret of {name:<7} {_with_interval(regret[name])}")
        for name in ("random", "stay"):
            console.print(f"  better than {name:<7}{_with_interval(one[f'gained_on_{name}'])}")
        console.print(f"  entropy against regret: rank correlation {one['entropy_regret_correlation']}")
        console.print(f"  {1e3 * one['decision_seconds']:.2f} ms for all 15 actions")
        for side in one["gate"]:
            console.print(
                f"  eta {side['eta']}: trusted {side['trusted']:.0%}, regret {side['regret_trusted']} there, "
                f"{side['regret_left']} elsewhere"
            )
    console.print(f"{out / 'evaluation.json'}, {out / 'gate_calibration.png'}")


def _with_interval(value: dict[str, float]) -> str:
    return f"{value['mean']:.4f} [{value['low']:.4f}, {value['high']:.4f}]"
