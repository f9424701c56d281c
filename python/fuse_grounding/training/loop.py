"""What training runs share: batches made ahead, averages, a schedule, exact checkpoints. Needs torch."""

from __future__ import annotations

import json
import math
import queue
import threading
import time
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import cv2
import torch
from torch import Tensor, nn

from fuse_grounding import tensors
from fuse_grounding.errors import InputError

LOG_EVERY = 25
SAVE_EVERY_SECONDS = 120
Batch = TypeVar("Batch")


class Loader(threading.Thread, Generic[Batch]):
    """Makes batches ahead by `make(step)`, which must depend on nothing but the step."""

    def __init__(self, make: Callable[[int], Batch], step: int) -> None:
        super().__init__(daemon=True)
        self._make, self._step = make, step
        self._batches: queue.Queue[Batch | BaseException] = queue.Queue(3)
        self._stop_wish = threading.Event()

    def run(self) -> None:
        """The thread's work."""
        try:
            while not self._stop_wish.is_set():
                self._put(self._make(self._step))
                self._step += 1
        except BaseException as e:  # handed to the training thread, which raises it
            self._put(e)

    def _put(self, batch: Batch | BaseException) -> None:
        while not self._stop_wish.is_set():
            try:
                self._batches.put(batch, timeout=0.5)
                return
            except queue.Full:
                continue

    def get(self) -> Batch:
        """The next step's batch; raises what went wrong while it was made."""
        batch = self._batches.get()
        if isinstance(batch, BaseException):
            raise batch
        return batch

    def stop(self) -> None:
        """Ends the thread."""
        self._stop_wish.set()


def learning_rate(base: float, step: int, steps: int, warmup: int) -> float:
    """Linear warm-up, then half a cosine over all steps down to a hundredth."""
    warm = min((step + 1) / warmup, 1.0)
    return base * warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(step / steps, 1.0))))


class Average:
    """Exponential average of a network's weights: what is evaluated and exported."""

    def __init__(self, net: nn.Module, keep: float) -> None:
        self.keep = keep
        self.weights = {k: v.detach().clone() for k, v in net.state_dict().items()}

    @torch.no_grad()
    def update(self, net: nn.Module, step: int) -> None:
        """Takes the weights in after `step` + 1 steps; early ones count for little."""
        keep = min(self.keep, (1 + step) / (20 + step))
        for k, v in net.state_dict().items():
            self.weights[k].lerp_(v, 1 - keep)


class Run(Protocol):
    """A training run as `train` drives it."""

    step: int
    seconds: float

    def advance(self, batch: Any) -> dict[str, float]:
        """One step of the optimiser; the parts of the loss."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything `restore` needs."""
        ...

    def restore(self, state: dict[str, Any], path: Path) -> None:
        """Takes up a state read from `path`; InputError when it is another run's."""
        ...


def save(run: Run, path: Path) -> None:
    """Writes the run's state, all or nothing. Raises FuseError when the disk refuses."""
    content = BytesIO()
    torch.save(run.state() | {"step": run.step, "seconds": run.seconds}, content)
    tensors.write(path, content.getvalue())


def load(path: Path, expected: set[str]) -> dict[str, Any]:
    """A state that `save` wrote with at least the keys `expected`; InputError when it is not one."""
    try:
        state: dict[str, Tensor] = torch.load(path, weights_only=True)
    except Exception as e:
        raise InputError(f"{path} is not a checkpoint: {e}") from e
    missing = expected - state.keys()
    if missing:
        raise InputError(
            f"{path} is not a checkpoint of this training: it lacks {', '.join(sorted(missing))}"
        )
    return state


def same_run(state: dict[str, Any], labels: tuple[str, ...], config: dict[str, Any], path: Path) -> None:
    """Raises InputError unless `state` is that of a run with these labels and this configuration."""
    if list(state["labels"]) != list(labels):
        raise InputError(f"{path} was trained for other labels: {', '.join(state['labels'])}")
    ours, theirs = json.loads(json.dumps(config)), json.loads(json.dumps(state["config"]))
    for key, value in ours.items():
        if theirs.get(key) != value:
            raise InputError(
                f"{path} was trained with {key} {theirs.get(key)}, not {value}: use another --out"
            )


def train(
    run: Run, make: Callable[[int], Any], steps: int, out: Path, name: str, report: Callable[[str], None]
) -> None:
    """Steps until there are `steps`, resuming `out/NAME.pt`; leaves it and `out/NAME.jsonl` (losses)."""
    out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    checkpoint = out / f"{name}.pt"
    if checkpoint.exists():
        state = load(checkpoint, {"step", "seconds"})
        run.restore(state, checkpoint)
        run.step, run.seconds = int(state["step"]), float(state["seconds"])
        report(f"{name}: resumed at step {run.step} of {steps}, after {run.seconds / 60:.1f} min")
    loader = Loader(make, run.step)
    loader.start()
    sums: dict[str, float] = {}
    last = saved = time.monotonic()
    try:
        while run.step < steps:
            for k, v in run.advance(loader.get()).items():
                sums[k] = sums.get(k, 0.0) + v
            now = time.monotonic()
            run.seconds, last = run.seconds + now - last, now
            if run.step % LOG_EVERY == 0:
                line = {k: round(v / LOG_EVERY, 4) for k, v in sums.items()}
                line |= {"step": run.step, "minutes": round(run.seconds / 60, 2)}
                with (out / f"{name}.jsonl").open("a") as log:
                    log.write(json.dumps(line) + "\n")
                left = run.seconds / run.step * (steps - run.step) / 60
                report(f"{name}: " + " ".join(f"{k} {v}" for k, v in line.items()) + f", {left:.0f} min left")
                sums = {}
            if now - saved > SAVE_EVERY_SECONDS:
                save(run, checkpoint)
                saved = now
    finally:
        loader.stop()
    save(run, checkpoint)
