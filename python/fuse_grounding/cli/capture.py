"""`fuse capture`: folders of photos: look at one, make one; and what `fuse run --capture` does with one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from fuse_grounding.agent import Session
from fuse_grounding.cli.console import print_json
from fuse_grounding.config import Config
from fuse_grounding.environment import ReplayEnvironment, TabletopEnvironment, make_episode
from fuse_grounding.environment.capture import Scale, load_capture
from fuse_grounding.environment.frame import NODE_DEG, PITCH_DEG, ring
from fuse_grounding.environment.photograph import photograph
from fuse_grounding.errors import InputError
from fuse_grounding.grounding import Grounded
from fuse_grounding.record import StepEntry

app = typer.Typer(help="Your own photos as a world: check a folder, make one.", no_args_is_help=True)

WIDE_DEG = 20
"""Neighbouring photos further apart than this often do not register."""


@app.command()
def check(
    folder: Annotated[Path, typer.Argument(help="Folder of photos (docs/capture.md).")],
    scale: Annotated[str | None, typer.Option(help="As in `fuse run --capture`.")] = None,
    hfov: Annotated[float | None, typer.Option(help="As in `fuse run --capture`.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON only.")] = False,
) -> None:
    """Read a folder of photos, find its poses if it has none, and say where each photo stands."""
    capture = load_capture(folder, scale=parse_scale(scale), hfov_deg=hfov, told=_tell)
    places = ring(capture.cameras, capture.middle)
    around = np.sort(places.azimuth * NODE_DEG)
    gap = float(np.diff(np.append(around, around[0] + 360)).max())
    photos = [
        {
            "name": name,
            "azimuth_deg": round(float(a) * NODE_DEG, 1),
            "tilt_deg": round(float(t) * PITCH_DEG, 1),
        }
        for name, a, t in zip(capture.names, places.azimuth, places.tilt, strict=True)
    ]
    if as_json:
        size = {"width": capture.size[0], "height": capture.size[1], "hfov_deg": round(capture.hfov_deg, 2)}
        facts = {"metric": capture.metric, "widest_gap_deg": round(gap, 1), "notes": capture.notes}
        print_json({"photos": photos, **size, **facts, "points": len(capture.points)})
        return
    out = Console(soft_wrap=True, highlight=False, markup=False)
    width, height = capture.size
    out.print(
        f"photos      {len(photos)}, looked at as {width}x{height}, {capture.hfov_deg:.1f} degrees wide"
    )
    for photo in photos:
        out.print(f"  {photo['name']:<24} {photo['azimuth_deg']:6.1f} around, {photo['tilt_deg']:5.1f} down")
    out.print(f"widest gap  {gap:.0f} degrees around" + (f" (over {WIDE_DEG})" if gap > WIDE_DEG else ""))
    for note in capture.notes:
        out.print(f"note        {note}")


@app.command()
def make(
    out: Annotated[Path, typer.Option(help="New folder.")],
    verb: Annotated[str, typer.Option(help="What something on the table is good for.")] = "measure",
    scene: Annotated[str | None, typer.Option(help="Default: dev_kitchen.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same files.")] = 7,
    photos: Annotated[int, typer.Option(min=1, max=108, help="How many.")] = 18,
    arc: Annotated[float, typer.Option(help="How far around the table, degrees.")] = 360.0,
    exif: Annotated[bool, typer.Option(help="State the focal length as phones do.")] = True,
    poses: Annotated[bool, typer.Option("--poses", help="Also a transforms.json, in metres.")] = False,
    truth: Annotated[bool, typer.Option("--truth", help="Also depth and masks.")] = False,
) -> None:
    """Photograph a made table as with a phone: a folder to try `fuse run --capture` on."""
    world = TabletopEnvironment(make_episode(verb, scene, seed))
    names = photograph(world, out, photos, arc_deg=arc, exif=exif, poses=poses, truth=truth)
    size = sum(p.stat().st_size for p in out.rglob("*") if p.is_file())
    Console(soft_wrap=True, highlight=False).print(f"{len(names)} photos in {out}, {size / 1e6:.1f} MB")


def parse_scale(text: str | None) -> Scale:
    """Metres, or `poses`. Raises InputError."""
    if text is None:
        return None
    if text == "poses":
        return "poses"
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--scale {text}: expected metres, such as 0.8, or poses") from None


def open_capture(
    folder: Path, settings: Config, start: str | None, scale: str | None, hfov: float | None
) -> ReplayEnvironment:
    """The world of a folder of photos, telling on standard error what takes time."""
    capture = load_capture(folder, scale=parse_scale(scale), hfov_deg=hfov, told=_tell)
    return ReplayEnvironment(capture, start, settings.camera.seed_offsets)


def photographed(settings: Config, world: ReplayEnvironment) -> Config:
    """The settings, for pictures of the size and field of view of the photos."""
    width, height = world.capture.size
    return settings.with_(camera={"width": width, "height": height, "hfov_deg": world.capture.hfov_deg})


class PhotoNotes:
    """A watcher that puts into the record what a reader must know of a world of photos, and their names."""

    def __init__(self, world: ReplayEnvironment):
        self._world = world

    def started(self, session: Session) -> None:
        """Announces the world's notes."""
        for note in self._world.notes:
            session.announce(note)

    def stepped(self, session: Session, step: StepEntry) -> None:
        """Keeps the photos' names."""
        session.record.photos = list(self._world.visited)

    def finished(self, session: Session, grounded: Grounded) -> None:
        """Nothing more."""


def _tell(text: str) -> None:
    typer.echo(f"COLMAP: {text}", err=True)
