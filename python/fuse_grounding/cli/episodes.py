"""`fuse episodes`: make sets of episodes, check them, look at them."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from fuse_grounding._core import statistics_path
from fuse_grounding.cli.console import interruptible, print_json
from fuse_grounding.environment import (
    SETS,
    Episode,
    TabletopEnvironment,
    Target,
    episodes_path,
    generate_set,
    load_episodes,
)
from fuse_grounding.environment.episodes import stage
from fuse_grounding.environment.sets import plan_of
from fuse_grounding.errors import InputError

app = typer.Typer(help="Make, check and look at episodes.", no_args_is_help=True)

_EVERY_SET = "all"


def _knobs(pairs: list[str]) -> dict[str, Any]:
    """`name=value` pairs, values in JSON. Raises InputError."""
    knobs: dict[str, Any] = {}
    for pair in pairs:
        name, separator, value = pair.partition("=")
        try:
            if not separator:
                raise ValueError("there is no `=`")
            knobs[name] = json.loads(value)
        except ValueError as error:
            raise InputError(
                f"--knob must be name=value with a value in JSON, such as near_misses=5, "
                f"found `{pair}`: {error}"
            ) from None
    return knobs


def _outputs(split: str, out: Path) -> dict[str, Path]:
    """The file of each set to make; tried before minutes are spent. Raises InputError."""
    if split == _EVERY_SET:
        if not out.is_dir():
            raise InputError(f"--out must be a folder that exists with --split all, found {out}")
        paths = {name: out / f"{name}.json.gz" for name in SETS}
    else:
        paths = {plan_of(split).name: out}
    for path in paths.values():
        if not path.name.endswith(".json.gz"):
            raise InputError(f"--out must end in .json.gz, found {path}")
        if not path.parent.is_dir():
            raise InputError(f"the folder of --out does not exist: {path.parent}")
        if path.is_dir():
            raise InputError(f"--out {path} is a folder")
        try:
            tempfile.TemporaryFile(dir=path.parent).close()
        except OSError as error:
            raise InputError(f"--out {path} cannot be written: {error.strerror}") from None
    return paths


@app.command()
def generate(
    split: Annotated[str, typer.Option(help="train, dev, eval or large; all: each of them.")],
    out: Annotated[Path, typer.Option(help="File to write, ending in .json.gz; with all, a folder.")],
    count: Annotated[
        int | None, typer.Option(min=1, help="Number of episodes; default: 416, 25, 100, 1000.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of the set; default: its recorded one.")
    ] = None,
    knob: Annotated[
        list[str] | None,
        typer.Option(help="Difficulty: name=value, such as near_misses=5 (docs/world.md). Repeatable."),
    ] = None,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads; default: one for each core.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """Make a set of episodes; the same arguments give the same file, on any number of threads.

    Interrupted, it keeps finished parts in OUT.parts, and the same command goes on from there.
    """
    difficulty, told = _knobs(knob or []), []
    for name, path in _outputs(split, out).items():
        with _progress(name) as progress:
            task = progress.add_task(name, total=None)

            def tell(done: int, total: int, progress: Progress = progress, task: Any = task) -> None:
                progress.update(task, completed=done, total=total)

            kept = f"finished parts are kept in {path.name}.parts; the same command goes on"
            with interruptible(kept):
                made = generate_set(
                    name, path, count=count, seed=seed, difficulty=difficulty, threads=threads, tell=tell
                )
        row = {
            "out": str(path),
            "episodes": made.episodes,
            "rejected": made.rejected,
            "generate_seconds": made.seconds,
        }
        told.append(row)
        if as_json:
            continue
        typer.echo(
            f"{path}: {made.episodes} episodes in {made.seconds:.1f} s "
            f"({made.seconds / made.episodes:.2f} s each), {path.stat().st_size / 1e3:.0f} kB and "
            f"{statistics_path(path).stat().st_size / 1e3:.0f} kB of statistics"
        )
        for reason, times in sorted(made.rejected.items()):
            typer.echo(f"  {times} layouts thrown away: {reason}")
    if as_json:
        print_json(told if split == _EVERY_SET else told[0])


def _progress(name: str) -> Progress:
    """A bar on the terminal's error stream, nothing elsewhere."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=console, disable=not console.is_terminal, transient=True)


@app.command()
def validate(
    file: Annotated[str, typer.Argument(help="A .json.gz file, or the name of a shipped set.")],
    statistics: Annotated[
        Path | None, typer.Option(help="Its statistics; default: FILE.statistics.json.gz beside it.")
    ] = None,
    render: Annotated[
        bool, typer.Option("--render", help="Count all pixels anew and compare: about a second an episode.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """Check every episode of a file, that it can be won, and its statistics.

    Exit status 2 names what is wrong.
    """
    episodes = load_episodes(file, statistics=statistics)
    path = episodes_path(file)
    if not render and any(e.statistics_text is None for e in episodes):
        raise InputError(
            f"{path} has no statistics {statistics_path(path).name} beside it, so that what its episodes "
            "promise cannot be checked; --render counts the pixels anew"
        )
    with _progress(file) as progress:
        for episode in progress.track(episodes, description="rendering") if render else ():
            with interruptible():
                counted = stage().statistics(episode.text)
            try:
                stage().validate(episode.text, counted)
            except InputError as error:
                raise InputError(f"{path}: rendered anew: {error}") from None
            if episode.statistics is not None and json.loads(counted) != episode.statistics:
                raise InputError(f"{path}: episode `{episode.episode_id}`: rendered anew, other statistics")
    if as_json:
        print_json({"file": file, "episodes": [e.episode_id for e in episodes], "rendered": render})
    else:
        how = ", counted anew" if render else ""
        typer.echo(f"{file}: {len(episodes)} episodes, all sound{how}")


@app.command()
def scenes(
    sheets: Annotated[
        Path | None,
        typer.Option(help="Folder for pictures of each scene and of the sensor."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """List the scene configurations; with --sheets, draw each from six viewpoints, and the sensor."""
    rows = stage().scenes()
    drawn = {}
    if sheets is not None:
        from fuse_grounding.cli.sheets import scene_sheet, sensor_sheet, write_sheet

        with interruptible():
            for name, _, _, _ in rows:
                drawn[name] = str(write_sheet(sheets, name, scene_sheet(name)))
            drawn["sensor"] = str(write_sheet(sheets, "sensor", sensor_sheet()))
    if as_json:
        keys = ("name", "split", "weak_texture", "description")
        print_json([{**dict(zip(keys, row, strict=True)), "sheet": drawn.get(row[0])} for row in rows])
        return
    for name, split, _, description in rows:
        typer.echo(f"{name:<18} {split:<6} {description}")
    for path in drawn.values():
        typer.echo(path)


@app.command()
def card(
    file: Annotated[str, typer.Argument(help="A .json.gz file, or the name of a shipped set.")],
    out: Annotated[Path, typer.Option(help="Folder for NAME.md and its plots.")] = Path("docs/episodes"),
    knobs: Annotated[
        int, typer.Option(min=0, help="Episodes to make for each setting of a knob; 0 leaves the table out.")
    ] = 0,
) -> None:
    """Write a set's dataset card: what is in it, how hard it is, how it was made, with plots."""
    from fuse_grounding.cli.card import write_card

    with interruptible():
        typer.echo(str(write_card(file, out, knobs)))


@app.command()
def show(
    file: Annotated[str, typer.Argument(help="A .json.gz file, or the name of a shipped set.")],
    episode: Annotated[str | None, typer.Option(help="Only this episode; default: all.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for pictures; default: none are drawn.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """Tell what an episode is; with --out, draw its start and the three views that show most."""
    chosen = [e for e in load_episodes(file) if episode in (None, e.episode_id)]
    if not chosen:
        raise InputError(f"{file} has no episode `{episode}`")
    if as_json:
        print_json([e.data for e in chosen])
    if out is not None:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"cannot make folder {out}: {error.strerror}") from error
    for one in chosen:
        if not as_json:
            _tell(one)
        if out is not None:
            path = out / f"{one.episode_id}.png"
            if not cv2.imwrite(str(path), cv2.cvtColor(strip(one), cv2.COLOR_RGB2BGR)):
                raise InputError(f"cannot write {path}")


def _tell(episode: Episode) -> None:
    data, names = episode.data, episode.categories
    node, pitch = episode.start
    typer.echo(
        f'{episode.episode_id}  {episode.scene_id}  "{episode.query}" ({episode.verb}), seed {episode.seed}'
    )
    typer.echo(f"  target {names[data['target']]}; " + ", ".join(names[i] for i in data["distractor_ids"]))
    typer.echo(
        f"  start at node {node}, {15 * (pitch + 1)} degrees down: {data['start_px']} pixels of the target "
        f"({data['start_fraction']:.0%}); at best, node {data['best_node']}, "
        f"{15 * (data['best_pitch'] + 1)} degrees: {data['best_px']} ({data['best_fraction']:.0%}); "
        f"seen well after {data['moves_to_good_view']} moves"
    )


def strip(episode: Episode) -> np.ndarray:
    """(480, 4 * 640, 3) uint8: the start view, then the three views that show most of the target."""
    environment = TabletopEnvironment(episode)
    target: Target = environment.true_targets()[0]
    order = np.argsort(-target.visible_px.ravel(), kind="stable")
    best: list[int] = []
    for view in order.tolist():
        # Neighbours look alike: keep views four nodes apart.
        if all(min((view // 3 - b // 3) % 36, (b // 3 - view // 3) % 36) >= 4 for b in best):
            best.append(view)
        if len(best) == 3:
            break
    pictures = []
    for node, pitch in [episode.start, *(divmod(view, 3) for view in best)]:
        seen = environment.render_at(node, pitch)
        assert seen.instance is not None
        rgb = np.ascontiguousarray(seen.rgb)
        mask = (seen.instance == target.instance).astype(np.uint8)
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(rgb, outlines, -1, (0, 255, 0), 1)
        share = target.fraction[node, pitch]
        label = f"node {node}, {15 * (pitch + 1)} deg: {int(mask.sum())} px, {share:.0%}"
        cv2.rectangle(rgb, (0, 0), (8 * len(label) + 12, 22), (0, 0, 0), -1)
        cv2.putText(rgb, label, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA)
        pictures.append(rgb)
    return np.concatenate(pictures, axis=1)
