"""Training on a data set by itself: progress, checkpoints, a preview; resumed, it ends in the same bits."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fuse_grounding import visualize
from fuse_grounding.errors import InputError
from fuse_grounding.reconstruction.dataset import Dataset, View
from fuse_grounding.splat import (
    Gaussians,
    Trainer,
    TrainerConfig,
    checkpoint_note,
    map_format,
    quality,
    render,
)

# Iterations between two looks at the loss.
TICK = 50
# Where an episode's map stays small to be refined within seconds, a photo set's may grow.
MAX_GAUSSIANS = 200_000
SCHEDULES = ("fast", "official")
# Held-out views that are looked at while it trains; all of them at the end.
WATCHED = 8


@dataclass(frozen=True)
class TrainOptions:
    """What a standalone training does."""

    iterations: int = 7000
    """The original's first milestone."""
    seed: int = 0
    max_gaussians: int | None = None
    """None: `MAX_GAUSSIANS`; under the schedule `official`, out of reach."""
    schedule: str = "fast"
    """`official`: every setting as in the original, whatever the number of iterations."""
    device: str = "cpu"
    """As `splat.Trainer`'s."""
    checkpoint_every: int = 500
    """Iterations between two checkpoints, 0: only when interrupted."""
    evaluate_every: int = 500
    """Iterations between two measurements on held-out views."""
    preview: Path | None = None
    """A picture, photo beside rendering, renewed at every measurement."""

    def config(self) -> TrainerConfig:
        """The trainer's settings; under `fast`, rates fall, and densification ends, with the training, a
        step stands for two iterations, and the first three fifths look at half the resolution
        (docs/performance.md says what that saves and costs).

        Raises InputError for a schedule that is not one of `SCHEDULES`.
        """
        if self.schedule not in SCHEDULES:
            raise InputError(f"schedule must be `fast` or `official`, found `{self.schedule}`")
        if self.schedule == "official":
            original = TrainerConfig.official()
            limit = original.max_gaussians if self.max_gaussians is None else self.max_gaussians
            return replace(original, seed=self.seed, max_gaussians=limit)
        return TrainerConfig(
            seed=self.seed,
            max_gaussians=MAX_GAUSSIANS if self.max_gaussians is None else self.max_gaussians,
            position_steps=max(self.iterations, 1),
            densify_end=min(15_000, self.iterations - self.iterations // 4),
            step_iterations=2,
            rate_gain=2.0,
            fine_iterations=self.iterations * 2 // 5,
            matched_low_pass=True,
        )


@dataclass(frozen=True)
class Progress:
    """Where a training is. PSNR (decibel) and SSIM are those of the last measurement."""

    iteration: int
    iterations: int
    loss: float
    gaussians: int
    psnr: float | None
    ssim: float | None


@dataclass(frozen=True)
class Result:
    """What came out, on all held-out views (None without any)."""

    iterations: int
    gaussians: int
    psnr: float | None
    ssim: float | None
    train_seconds: float
    device: str
    """What it was trained on; it is measured on the CPU."""


@dataclass(frozen=True)
class Evaluation:
    """Means over views, and each view's PSNR and SSIM."""

    psnr: float | None
    ssim: float | None
    views: dict[str, tuple[float, float]]


def evaluate(gaussians: Gaussians, names: list[str], views: list[View]) -> Evaluation:
    """PSNR (decibel) and SSIM of renderings in 8 bits, view by view."""
    each = {
        name: quality(gaussians, camera, image) for name, (image, camera) in zip(names, views, strict=True)
    }
    if not each:
        return Evaluation(None, None, {})
    mean = np.mean(list(each.values()), axis=0)
    return Evaluation(float(mean[0]), float(mean[1]), each)


def checkpoint_of(out: Path) -> Path:
    """Where the training that writes `out` keeps its state."""
    return out.with_name(f"{out.name}.checkpoint")


class Training:
    """A training of `dataset` that writes the map `out`.

    Raises InputError for an `out` that cannot be written, for too little memory, and, unless `resume`,
    for a checkpoint that is already there. `told` hears what is being done, in words.
    """

    def __init__(
        self,
        dataset: Dataset,
        out: Path,
        options: TrainOptions,
        resume: bool = False,
        told: Callable[[str], None] = lambda text: None,
    ):
        self.dataset, self.out, self.options = dataset, out, options
        self.checkpoint = checkpoint_of(out)
        settings = options.config()
        _check_outputs(out, options)
        if self.checkpoint.exists() and not resume:
            raise InputError(
                f"{self.checkpoint} is an interrupted training; --resume continues it, or remove the file"
            )
        dataset.check_memory()
        xyz, rgb = dataset.points()
        if len(xyz) > settings.max_gaussians:
            raise InputError(
                f"{dataset.folder} has {len(xyz)} points, more than --max-gaussians {settings.max_gaussians}"
            )
        self._trainer = Trainer(Gaussians.from_points(xyz, rgb), settings, options.device)
        told(f"schedule {options.schedule}, trains on {self._trainer.device}")
        for image, camera in dataset.read(
            dataset.train, lambda n: told(f"read {n} of {len(dataset.train)} photos")
        ):
            self._trainer.add_view(image, camera)
        self._held_out = list(dataset.read(dataset.held_out))
        self._names = [dataset.names[i] for i in dataset.held_out]
        if resume and self.checkpoint.exists():
            self._resume()
            told(f"continues after iteration {self._trainer.iteration}")
        elif resume:
            told(f"no checkpoint {self.checkpoint}, starts afresh")

    def _resume(self) -> None:
        again = "--resume needs the data and options of the first run"
        try:
            schedule = _schedule_of(checkpoint_note(self.checkpoint))
            if schedule not in (None, self.options.schedule):
                raise InputError(
                    f"{self.checkpoint}: written under --schedule {schedule}, "
                    f"this training has --schedule {self.options.schedule}"
                )
            self._trainer.load_checkpoint(self.checkpoint)
        except InputError as error:
            raise InputError(f"{error} ({again})") from None
        if self._trainer.iteration > self.options.iterations:
            raise InputError(
                f"{self.checkpoint} is at iteration {self._trainer.iteration}, beyond --iterations "
                f"{self.options.iterations}"
            )

    def run(self, report: Callable[[Progress], None] = lambda progress: None) -> Result:
        """Trains to the end and writes the map. Interrupted, it leaves a checkpoint and raises
        KeyboardInterrupt."""
        began, total = time.perf_counter(), self.options.iterations
        measured = Evaluation(None, None, {})
        try:
            while (at := self._trainer.iteration) < total:
                steps = min([_to_next(at, TICK), total - at, *self._stops(at)])
                stats = self._trainer.refine(steps, total - at - steps)
                now = at + steps
                if _due(now, self.options.evaluate_every) and now < total:
                    measured = self._measure(WATCHED)
                report(Progress(now, total, stats.loss, stats.gaussians, measured.psnr, measured.ssim))
                if _due(now, self.options.checkpoint_every) and now < total:
                    self._save_checkpoint()
        except KeyboardInterrupt:
            self._save_checkpoint()
            raise
        gaussians = self._trainer.gaussians
        gaussians.save(self.out)
        measured = self._measure(None)
        self.checkpoint.unlink(missing_ok=True)
        seconds = time.perf_counter() - began
        return Result(total, len(gaussians), measured.psnr, measured.ssim, seconds, self._trainer.device)

    def _save_checkpoint(self) -> None:
        self._trainer.save_checkpoint(self.checkpoint, json.dumps({"schedule": self.options.schedule}))

    def _stops(self, at: int) -> list[int]:
        """Iterations to the next checkpoint and measurement."""
        return [_to_next(at, n) for n in (self.options.checkpoint_every, self.options.evaluate_every) if n]

    def _measure(self, limit: int | None) -> Evaluation:
        gaussians = self._trainer.gaussians
        if self.options.preview is not None:
            view = self._held_out[0] if self._held_out else next(self.dataset.read(self.dataset.train[:1]))
            write_preview(self.options.preview, gaussians, view)
        return evaluate(gaussians, self._names[:limit], self._held_out[:limit])


def write_preview(path: Path, gaussians: Gaussians, view: View) -> None:
    """A photo and its rendering, side by side."""
    image, camera = view
    drawn = np.rint(render(gaussians, camera)[0] * 255).astype(np.uint8)
    visualize.write(path, visualize.picture(np.hstack([image, drawn])))


def _schedule_of(note: str) -> str | None:
    """The schedule that a checkpoint's note names; None for a note of somebody else's."""
    try:
        found = json.loads(note)
    except ValueError:
        return None
    return found.get("schedule") if isinstance(found, dict) else None


def _check_outputs(out: Path, options: TrainOptions) -> None:
    map_format(out)
    for name, path in (("--out", out), ("--preview", options.preview)):
        if path is not None and not path.resolve().parent.is_dir():
            raise InputError(f"the folder of {name} does not exist: {path.parent}")
        if path is not None and path.is_dir():
            raise InputError(f"{name} is a folder: {path}")
    if options.preview is not None and options.preview.suffix.lower() != ".png":
        raise InputError(f"--preview must end in .png, found {options.preview}")


def _to_next(at: int, every: int) -> int:
    return every - at % every


def _due(at: int, every: int) -> bool:
    return every > 0 and at % every == 0


def finite(value: float | None) -> float | None:
    """For JSON, which knows no infinity: equal images have an infinite PSNR."""
    return value if value is None or math.isfinite(value) else None
