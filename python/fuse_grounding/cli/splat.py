"""`fuse splat`: Gaussian maps of anybody's photos: train, evaluate, render, convert."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from fuse_grounding import visualize
from fuse_grounding._core import Camera
from fuse_grounding.cli.console import print_json
from fuse_grounding.errors import InputError
from fuse_grounding.reconstruction import cameras, photos, training
from fuse_grounding.reconstruction.dataset import Dataset
from fuse_grounding.splat import Gaussians, map_format
from fuse_grounding.splat import render as render_map

app = typer.Typer(help="Gaussian maps of your own photos: train, evaluate, render.", no_args_is_help=True)

DataArgument = Annotated[Path, typer.Argument(help="COLMAP or nerfstudio folder, or its transforms.json.")]
MapArgument = Annotated[Path, typer.Argument(help="A map, .ply or .spz.")]
DownscaleOption = Annotated[
    int | None,
    typer.Option(min=1, help="Photos so many times smaller; default: until 1600 pixels a side suffice."),
]
HoldoutOption = Annotated[
    int, typer.Option(min=0, help="Every N-th view by file name is held out; 0: none.", metavar="N")
]
DeviceOption = Annotated[
    str, typer.Option(help="cpu, gpu, or auto: a real GPU if there is one, else the CPU.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON only.")]

_DEFAULTS = training.TrainOptions()


@app.command()
def train(
    data: DataArgument,
    out: Annotated[Path, typer.Option(help="Map to write, .ply or .spz.")],
    iterations: Annotated[int, typer.Option(min=1, max=1_000_000)] = _DEFAULTS.iterations,
    downscale: DownscaleOption = None,
    holdout: HoldoutOption = 8,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same map.")] = 0,
    max_gaussians: Annotated[
        int | None,
        typer.Option(
            min=1, help=f"No more are made; default: {training.MAX_GAUSSIANS}, with official no limit."
        ),
    ] = None,
    schedule: Annotated[
        str, typer.Option(help="fast, or official: every setting as in the original.")
    ] = _DEFAULTS.schedule,
    device: DeviceOption = _DEFAULTS.device,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue an interrupted training, bit for bit.")
    ] = False,
    preview: Annotated[Path | None, typer.Option(help="PNG, renewed on the way: photo | rendering.")] = None,
    checkpoint_every: Annotated[
        int, typer.Option(min=0, help="Iterations between checkpoints; 0: when interrupted only.")
    ] = _DEFAULTS.checkpoint_every,
    colmap: Annotated[
        bool, typer.Option("--colmap", help="Find the photos' poses with COLMAP first, where there are none.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Train a map on posed photos; on a folder of mere photos, COLMAP finds the poses first."""
    console = Console(stderr=True, soft_wrap=True, highlight=False, markup=False, quiet=as_json)
    if not photos.has_poses(data):
        _find_poses(data, colmap, console)
    options = training.TrainOptions(
        iterations=iterations,
        seed=seed,
        max_gaussians=max_gaussians,
        schedule=schedule,
        device=device,
        checkpoint_every=checkpoint_every,
        preview=preview,
    )
    options.config()  # refuses before photos are looked at
    dataset = Dataset(data, downscale, holdout)
    for note in dataset.notes:
        console.print(note)
    size = dataset.camera(0)
    console.print(
        f"{data}: {dataset.kind}, {len(dataset.train)} views to train on, {len(dataset.held_out)} held out, "
        f"{size.width}x{size.height} (downscale {dataset.downscale})"
    )
    run = training.Training(dataset, out, options, resume, console.print)
    with _bar(console) as bar:
        task = bar.add_task("train", total=iterations, loss="", count="", psnr="")

        def report(progress: training.Progress) -> None:
            at = progress.iteration
            loss, count = f"loss {progress.loss:.4f}", f"{progress.gaussians} Gaussians"
            psnr = "" if progress.psnr is None else f"held out {progress.psnr:.2f} dB"
            bar.update(task, completed=at, loss=loss, count=count, psnr=psnr)
            if not console.is_terminal and at % options.evaluate_every == 0:
                console.print(f"iteration {at}: {loss}, {count}, {psnr}".rstrip(", "))

        result = run.run(report)
    values = {
        "out": str(out),
        "iterations": result.iterations,
        "schedule": options.schedule,
        "device": result.device,
        "gaussians": result.gaussians,
        "psnr": training.finite(result.psnr),
        "ssim": result.ssim,
        "train_views": len(dataset.train),
        "held_out_views": len(dataset.held_out),
        "downscale": dataset.downscale,
        "train_seconds": result.train_seconds,
    }
    if as_json:
        print_json(values)
        return
    held_out = "" if result.psnr is None else f", held out {result.psnr:.2f} dB, SSIM {result.ssim:.4f}"
    typer.echo(f"{out}: {result.gaussians} Gaussians in {result.train_seconds:.1f} s{held_out}")


def _find_poses(data: Path, wanted: bool, console: Console) -> None:
    """COLMAP on a folder of photos, by flag or after asking on a terminal."""
    root, names = photos.find_photos(data)
    found = f"{data} has no poses (sparse/0/cameras.bin or .txt, transforms.json)"
    if not names:
        raise InputError(f"{found} and no photos (JPEG, PNG)")
    if not wanted and _asks():
        wanted = typer.confirm(f"{found}. Run COLMAP on the {len(names)} photos in {root}?", err=True)
    if not wanted:
        raise InputError(f"{found}; --colmap finds them for the {len(names)} photos in {root}")
    photos.find_poses(data, lambda text: console.print(f"COLMAP: {text}"))


def _asks() -> bool:
    """Whether somebody is there to answer."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def _bar(console: Console) -> Progress:
    fields = [TextColumn(f"{{task.fields[{name}]}}") for name in ("loss", "count", "psnr")]
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        *fields,
        TimeRemainingColumn(),
        console=console,
        disable=console.quiet or not console.is_terminal,
    )


@app.command("eval")
def evaluate(
    map_file: MapArgument,
    data: DataArgument,
    holdout: HoldoutOption = 8,
    downscale: DownscaleOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure PSNR and SSIM over the held-out views; with --holdout 0, over all."""
    gaussians = Gaussians.load(map_file)
    dataset = Dataset(data, downscale, holdout)
    indices = dataset.held_out or dataset.train
    found = training.evaluate(gaussians, [dataset.names[i] for i in indices], list(dataset.read(indices)))
    if as_json:
        views = [
            {"name": name, "psnr": training.finite(psnr), "ssim": ssim}
            for name, (psnr, ssim) in found.views.items()
        ]
        print_json(
            {
                "psnr": None if found.psnr is None else training.finite(found.psnr),
                "ssim": found.ssim,
                "gaussians": len(gaussians),
                "downscale": dataset.downscale,
                "views": views,
            }
        )
        return
    for name, (psnr, ssim) in found.views.items():
        typer.echo(f"{name:<32} {psnr:6.2f} dB  SSIM {ssim:.4f}")
    typer.echo(
        f"{len(indices)} views, {len(gaussians)} Gaussians: {found.psnr:.2f} dB, SSIM {found.ssim:.4f}"
    )


@app.command()
def render(
    map_file: MapArgument,
    out: Annotated[Path, typer.Option(help="A .png for one camera, a folder of frames for several.")],
    camera: Annotated[
        Path | None, typer.Option(help="JSON: one camera, or a list of them (see docs/splat.md).")
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Data set for --view and --orbit.")] = None,
    view: Annotated[str | None, typer.Option(help="The camera of this image of --data.")] = None,
    orbit: Annotated[
        int | None, typer.Option(min=1, help="So many frames on a circle around what --data shows.")
    ] = None,
    downscale: DownscaleOption = None,
) -> None:
    """Draw a map as PNG: one camera, a path, or an orbit."""
    chosen = _cameras(camera, data, view, orbit, downscale)
    gaussians = Gaussians.load(map_file)
    if len(chosen) == 1 and orbit is None:
        if out.suffix.lower() != ".png" or not out.resolve().parent.is_dir():
            raise InputError(f"--out must be a .png in a folder that exists for one camera, found {out}")
        _draw(gaussians, chosen[0], out)
        typer.echo(str(out))
        return
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make folder {out}: {error.strerror}") from None
    for number, one in enumerate(chosen):
        _draw(gaussians, one, out / f"{number:05d}.png")
    typer.echo(f"{out}: {len(chosen)} frames")


def _cameras(
    camera: Path | None, data: Path | None, view: str | None, orbit: int | None, downscale: int | None
) -> list[Camera]:
    if sum(x is not None for x in (camera, view, orbit)) != 1:
        raise InputError("one of --camera, --view and --orbit says where to render from")
    if camera is not None:
        return cameras.from_json(camera)
    if data is None:
        raise InputError("--view and --orbit need --data, the folder whose cameras are meant")
    dataset = Dataset(data, downscale, 0)
    if orbit is not None:
        return cameras.orbit(dataset, orbit)
    assert view is not None
    return [dataset.camera(dataset.index(view))]


def _draw(gaussians: Gaussians, camera: Camera, path: Path) -> None:
    image = np.rint(render_map(gaussians, camera)[0] * 255).astype(np.uint8)
    visualize.write(path, visualize.picture(image))


@app.command()
def convert(
    source: MapArgument, target: Annotated[Path, typer.Argument(help="The same map as .ply or .spz.")]
) -> None:
    """Convert between PLY and SPZ."""
    map_format(target)
    gaussians = Gaussians.load(source)
    gaussians.save(target)
    typer.echo(f"{target}: {len(gaussians)} Gaussians, {target.stat().st_size / 1e6:.2f} MB")
