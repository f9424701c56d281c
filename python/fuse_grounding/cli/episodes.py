"""`fuse episodes`: make sets of episodes, check them, look at them."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from fuse_grounding.cli.console import interruptible, print_json
from fuse_grounding.environment import (
    Episode,
    TabletopEnvironment,
    Target,
    load_episodes,
    make_episodes,
    save_episodes,
)
from fuse_grounding.environment.episodes import stage
from fuse_grounding.errors import InputError

app = typer.Typer(help="Make, check and look at episodes.", no_args_is_help=True)


@app.command()
def generate(
    split: Annotated[str, typer.Option(help="train, dev or eval: which scenes and objects.")],
    out: Annotated[Path, typer.Option(help="File to write, ending in .json.gz.")],
    count: Annotated[int, typer.Option(min=1, help="Number of episodes.")] = 10,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the set.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """Make a set of episodes; the same arguments give the same file."""
    if not out.name.endswith(".json.gz"):
        raise InputError(f"--out must end in .json.gz, found {out}")
    if not out.parent.is_dir():
        raise InputError(f"the folder of --out does not exist: {out.parent}")
    try:
        if out.is_dir():
            raise InputError(f"--out {out} is a folder")
        tempfile.TemporaryFile(dir=out.parent).close()  # before minutes are spent
    except OSError as error:
        raise InputError(f"--out {out} cannot be written: {error.strerror}") from None
    began = time.perf_counter()
    with interruptible():
        episodes, rejected = make_episodes(split, count, seed)
    seconds = time.perf_counter() - began
    save_episodes(out, episodes)
    if as_json:
        print_json(
            {"out": str(out), "episodes": len(episodes), "rejected": rejected, "generate_seconds": seconds}
        )
        return
    typer.echo(f"{out}: {len(episodes)} episodes in {seconds:.1f} s, {out.stat().st_size / 1e3:.0f} kB")
    for reason, times in sorted(rejected.items()):
        typer.echo(f"  {times} layouts thrown away: {reason}")


@app.command()
def validate(
    file: Annotated[str, typer.Argument(help="A .json.gz file, or the name of a shipped set.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """Check every episode of a file; exit status 2 names what is wrong."""
    episodes = load_episodes(file)
    if as_json:
        print_json({"file": file, "episodes": [e.episode_id for e in episodes]})
    else:
        typer.echo(f"{file}: {len(episodes)} episodes, all sound")


@app.command()
def scenes(as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False) -> None:
    """List the scene configurations."""
    rows = stage().scenes()
    if as_json:
        keys = ("name", "split", "weak_texture", "description")
        print_json([dict(zip(keys, row, strict=True)) for row in rows])
        return
    for name, split, _, description in rows:
        typer.echo(f"{name:<18} {split:<6} {description}")


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
    first, index = data["statistics"][0], 3 * node + pitch
    seen, whole = first["visible_px"][index], first["unoccluded_px"][index]
    typer.echo(
        f"  start at node {node}, {15 * (pitch + 1)} degrees down: {seen} of {whole} pixels of the target "
        f"({seen / whole:.0%}); at best {first['pixels_max']} pixels"
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
