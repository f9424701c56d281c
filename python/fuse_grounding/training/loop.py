"""What training runs share: batches made ahead, averages, a schedule, exact checkpoints. Needs torch."""

from __future__ import annotations

import json
import math
import queue
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import cv2
import torch
from torch import Tensor, nn

from fuse_grounding import tensors
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.perception import torch_models
from fuse_grounding.training import onnx_files

LOG_EVERY = 25
SAVE_EVERY_SECONDS = 120
Batch = TypeVar("Batch")
Net = TypeVar("Net", bound=nn.Module)


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


@dataclass(frozen=True)
class Recipe:
    """What every network's training is configured by."""

    steps: int
    learning_rate: float
    backbone_factor: float
    """Share of the learning rate for what starts from ImageNet's weights."""
    weight_decay: float = 0.02
    warmup: int = 100
    """Steps over which the learning rate rises."""
    ema: float = 0.996
    workers: int = 2
    seed: int = 0
    pretrained: bool = True
    device: str = "cpu"
    """`cpu` or `cuda`: other bits, and on `cuda` not promised to repeat."""


def choose_device(wish: str) -> str:
    """`cpu` or `cuda` for what `--device` says. Raises InputError for no device's name, and for `cuda` where
    torch finds none.
    """
    if wish not in ("cpu", "cuda", "auto"):
        raise InputError(f"--device must be cpu, cuda or auto, found {wish}")
    return torch_models.choose(wish, "--device")


class NetworkRun(Generic[Net]):
    """Network, averaged network and optimiser of a run as `train` drives it, but for what a step computes.

    `make()` gives a network with a `backbone` (`segmenter_model.Backbone`); its weights start from ImageNet's
    where the recipe says `pretrained`. As many threads as the recipe has `workers` share a step, on its
    `device`.
    """

    LARGEST_GRADIENT = 5.0
    """Norm to which gradients are cut."""
    PER_LABEL: tuple[str, ...] = ()
    """Beginnings of the names of layers with a row a label; other rows may follow."""

    def __init__(self, make: Callable[[], Net], labels: tuple[str, ...], recipe: Recipe) -> None:
        torch.manual_seed(recipe.seed)
        self.labels, self.recipe, self._make = labels, recipe, make
        self.device = torch.device(recipe.device)
        self.net = make()
        backbone: Any = self.net.backbone
        if recipe.pretrained:
            backbone.load_imagenet()
        self.net.to(self.device).to(memory_format=torch.channels_last)
        self.average = Average(self.net, recipe.ema)
        known = {id(p) for p in backbone.parameters()}
        heads = [p for p in self.net.parameters() if id(p) not in known]
        tuned = [p for p in backbone.parameters() if p.requires_grad]
        self.optimizer = torch.optim.AdamW(
            [{"params": heads, "factor": 1.0}, {"params": tuned, "factor": recipe.backbone_factor}],
            lr=recipe.learning_rate,
            weight_decay=recipe.weight_decay,
        )
        self.step, self.seconds = 0, 0.0
        self.fresh: list[str] = []
        """Names of the tensors for which weights to start from had none."""
        self._pool = ThreadPoolExecutor(recipe.workers)
        self._replicas = [self._replica() for _ in range(recipe.workers)]

    def start_from(self, weights: Path, settings: Path) -> None:
        """Takes the weights of an exported network over, wherever a tensor has the same shape, and the rows
        of the labels that both know; `settings` names its labels. Raises InputError.
        """
        known = onnx_files.weights(weights)
        try:
            before = json.loads(settings.read_text())["labels"]
            rows = [before.index(x) if x in before else -1 for x in self.labels]
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{settings} must name the labels of {weights}: {error}") from None
        with torch.no_grad():
            for name, own in self.net.state_dict().items():
                other = known.get(name)
                if other is not None and other.shape == own.shape:
                    own.copy_(other)
                elif other is not None and name.startswith(self.PER_LABEL):
                    for i, k in enumerate(rows):
                        if k >= 0:
                            own[i] = other[k]
                    own[len(rows) :] = other[len(before) :]
                else:
                    self.fresh.append(name)
        self.average = Average(self.net, self.recipe.ema)

    def _replica(self) -> Net:
        """A network with the same parameters in memory and gradients of its own."""
        twin = self._make().to(self.device)
        for own, shared in zip(twin.parameters(), self.net.parameters(), strict=True):
            own.data = shared.data
        return twin

    def optimise(
        self, work: Callable[[Net, Any], dict[str, float]], shares: Sequence[Any]
    ) -> dict[str, float]:
        """One step. `work(replica, share)` leaves gradients and returns parts of the loss, for each of up to
        `workers` shares; returns the parts' sums and `norm`, the gradient's. A step without finite gradients
        changes no weight.
        """
        recipe = self.recipe
        rate = learning_rate(recipe.learning_rate, self.step, recipe.steps, recipe.warmup)
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group["factor"]

        def alone(replica: Net, share: Any) -> dict[str, float]:
            # One thread of its own per operation: threads that wait for one another inside an operation lose
            # most of a busy machine.
            torch.set_num_threads(1)
            return work(replica, share)

        # Whose share is whose is fixed: sums in another order would be another run.
        parts: dict[str, float] = {}
        for found in self._pool.map(alone, self._replicas, shares):
            for k, v in found.items():
                parts[k] = parts.get(k, 0.0) + v
        for p, *others in zip(*(n.parameters() for n in (self.net, *self._replicas)), strict=True):
            gradients = [q.grad for q in others if q.grad is not None]
            p.grad = sum(gradients[1:], gradients[0]) if gradients else None
            for q in others:
                q.grad = None
        norm = torch.nn.utils.clip_grad_norm_(self.net.parameters(), self.LARGEST_GRADIENT)
        if torch.isfinite(norm):
            self.optimizer.step()
        self.average.update(self.net, self.step)
        self.step += 1
        return parts | {"norm": float(norm)}

    def averaged(self) -> Net:
        """The averaged network on the CPU, for evaluation and export."""
        net = self._make()
        net.load_state_dict(self.average.weights)
        return net.eval()

    def state(self) -> dict[str, Any]:
        """Everything `restore` needs."""
        return {
            "labels": list(self.labels),
            "config": asdict(self.recipe),
            "net": self.net.state_dict(),
            "average": self.average.weights,
            "optimizer": self.optimizer.state_dict(),
        }

    def restore(self, state: dict[str, Any], path: Path) -> None:
        """Takes up a state read from `path`; InputError when it is another run's."""
        same_run(state, self.labels, asdict(self.recipe), path)
        self.net.load_state_dict(state["net"])
        self.average.weights = {k: v.to(self.device) for k, v in state["average"].items()}
        self.optimizer.load_state_dict(state["optimizer"])


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
        state: dict[str, Tensor] = torch.load(path, map_location="cpu", weights_only=True)
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
    # A checkpoint from before there was a choice of the device is the CPU's.
    ours, theirs = json.loads(json.dumps(config)), {"device": "cpu"} | json.loads(json.dumps(state["config"]))
    for key, value in ours.items():
        if theirs.get(key) != value:
            raise InputError(
                f"{path} was trained with {key} {theirs.get(key)}, not {value}: use another --out"
            )


def _log(path: Path, line: dict[str, float]) -> None:
    try:
        with path.open("a") as log:
            log.write(json.dumps(line) + "\n")
    except OSError as error:
        raise FuseError(f"{path} cannot be written: {error.strerror}") from None


def train(
    run: Run, make: Callable[[int], Any], steps: int, out: Path, name: str, report: Callable[[str], None]
) -> None:
    """Steps until there are `steps`, resuming `out/NAME.pt`; leaves it and `out/NAME.jsonl` (losses).

    Raises FuseError when the disk refuses; the checkpoint before stays.
    """
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
    summed = 0
    last = saved = time.monotonic()
    try:
        while run.step < steps:
            for k, v in run.advance(loader.get()).items():
                sums[k] = sums.get(k, 0.0) + v
            summed += 1
            now = time.monotonic()
            run.seconds, last = run.seconds + now - last, now
            if run.step % LOG_EVERY == 0:
                line = {k: round(v / summed, 4) for k, v in sums.items()}
                line |= {"step": run.step, "minutes": round(run.seconds / 60, 2)}
                _log(out / f"{name}.jsonl", line)
                left = run.seconds / run.step * (steps - run.step) / 60
                report(f"{name}: " + " ".join(f"{k} {v}" for k, v in line.items()) + f", {left:.0f} min left")
                sums, summed = {}, 0
            if now - saved > SAVE_EVERY_SECONDS:
                save(run, checkpoint)
                saved = now
    finally:
        loader.stop()
    save(run, checkpoint)
