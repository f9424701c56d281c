"""Training of the embedded segmenter: `fuse train segmenter`. Needs torch (extra `train`)."""

from __future__ import annotations

import json
import math
import os
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from fuse_grounding.errors import InputError
from fuse_grounding.training.segmenter_data import Sample, Shards, make_sample
from fuse_grounding.training.segmenter_loss import losses
from fuse_grounding.training.segmenter_model import SegmenterNet

LOG_EVERY = 25
WEIGHTS = {"heat": 1.0, "mask": 2.0, "dense": 0.6, "verdict": 0.6}


@dataclass(frozen=True)
class TrainConfig:
    """What a training run depends on besides its pictures."""

    minutes: float = 60.0
    batch: int = 8
    part: int = 4
    crop: tuple[int, int] = (384, 288)
    learning_rate: float = 1.3e-3
    backbone_factor: float = 0.4
    weight_decay: float = 0.02
    warmup: int = 100
    ema: float = 0.996
    workers: int = 2
    seed: int = 0
    pretrained: bool = True


class _Loader(threading.Thread):
    """Makes batches ahead; the batch of a step depends on the seed, the step and the pictures there are."""

    def __init__(self, shards: Shards, config: TrainConfig, step: int) -> None:
        super().__init__(daemon=True)
        self.shards, self.config, self.step = shards, config, step
        self.batches: queue.Queue[list[Sample] | BaseException] = queue.Queue(3)
        self.stop = threading.Event()

    def run(self) -> None:
        try:
            while not self.stop.is_set():
                batch = self.make(self.step)
                self.step += 1
                while not self.stop.is_set():
                    try:
                        self.batches.put(batch, timeout=0.5)
                        break
                    except queue.Full:
                        continue
        except BaseException as e:  # handed to the training thread, which raises it
            self.batches.put(e)

    def make(self, step: int) -> list[Sample]:
        rng = np.random.default_rng([self.config.seed, step])
        if step % 100 == 0:
            self.shards.refresh()
        batch = []
        for _ in range(self.config.batch):
            picture = self.shards[int(rng.integers(len(self.shards)))]
            table = self.shards.category_of_id(picture[2])
            batch.append(make_sample(picture, table, self.config.crop, rng))
        return batch


def _input(samples: list[Sample]) -> Tensor:
    image = torch.from_numpy(np.stack([s.image for s in samples])).permute(0, 3, 1, 2)
    return ((image.float() - 127.0) / 128.0).contiguous(memory_format=torch.channels_last)


class Training:
    """Network, averaged network, optimiser and clock of one run; `save` and `resume` are exact."""

    def __init__(self, labels: tuple[str, ...], config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        self.labels, self.config = labels, config
        self.net = SegmenterNet(len(labels))
        if config.pretrained:
            self.net.backbone.load_imagenet()
        self.net.to(memory_format=torch.channels_last)
        self.average = {k: v.detach().clone() for k, v in self.net.state_dict().items()}
        trained = [p for p in self.net.backbone.parameters() if p.requires_grad]
        known = {id(p) for p in self.net.backbone.parameters()}
        heads = [p for p in self.net.parameters() if id(p) not in known]
        self.optimizer = torch.optim.AdamW(
            [
                {"params": heads, "factor": 1.0},
                {"params": trained, "factor": config.backbone_factor},
            ],
            lr=config.learning_rate,
            weight_decay=config.weight_decay,
        )
        self.step, self.seconds = 0, 0.0
        self.pool = ThreadPoolExecutor(config.workers)
        self.replicas = [self._replica() for _ in range(config.workers)]

    def _replica(self) -> SegmenterNet:
        """A network with the same parameters in memory and gradients of its own."""
        twin = SegmenterNet(len(self.labels))
        for own, shared in zip(twin.parameters(), self.net.parameters(), strict=True):
            own.data = shared.data
        return twin

    def learning_rate(self) -> float:
        """Linear warm-up, then half a cosine over the budget of time."""
        progress = min(self.seconds / (60.0 * self.config.minutes), 1.0)
        warm = min((self.step + 1) / self.config.warmup, 1.0)
        return self.config.learning_rate * warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))

    def advance(self, samples: list[Sample]) -> dict[str, float]:
        """One step of the optimiser; the parts of the loss."""
        rate = self.learning_rate()
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group["factor"]
        if self.step == 0:
            with torch.no_grad():
                self.net.standardize(_input(samples))
        size = self.config.part
        waiting = [samples[i : i + size] for i in range(0, len(samples), size)]
        share = 1.0 / len(waiting)
        parts: dict[str, float] = {}
        lock = threading.Lock()

        def work(replica: SegmenterNet) -> None:
            # One thread of its own per operation: threads that wait for one another inside an operation
            # lose most of a busy machine.
            torch.set_num_threads(1)
            while True:
                with lock:
                    if not waiting:
                        return
                    part = waiting.pop()
                with torch.autocast("cpu", torch.bfloat16):
                    dense = replica(_input(part))
                found = losses(replica, dense, part)
                total = sum((WEIGHTS[k] * v for k, v in found.items()), torch.zeros(()))
                (total * share).backward()
                with lock:
                    for k, v in found.items():
                        parts[k] = parts.get(k, 0.0) + share * float(v.detach())

        for future in [self.pool.submit(work, replica) for replica in self.replicas]:
            future.result()
        for p, *others in zip(*(n.parameters() for n in (self.net, *self.replicas)), strict=True):
            gradients = [q.grad for q in others if q.grad is not None]
            p.grad = sum(gradients[1:], gradients[0]) if gradients else None
            for q in others:
                q.grad = None
        norm = torch.nn.utils.clip_grad_norm_(self.net.parameters(), 8.0)
        if torch.isfinite(norm):
            self.optimizer.step()
        self._average()
        self.step += 1
        return parts | {"norm": float(norm)}

    @torch.no_grad()
    def _average(self) -> None:
        keep = min(self.config.ema, (1 + self.step) / (20 + self.step))
        for k, v in self.net.state_dict().items():
            self.average[k].lerp_(v, 1 - keep)

    def averaged(self) -> SegmenterNet:
        """The averaged network, for evaluation and export."""
        net = SegmenterNet(len(self.labels))
        net.load_state_dict(self.average)
        return net.eval()

    def save(self, path: Path) -> None:
        """Writes everything that `resume` needs, all or nothing."""
        part = path.with_suffix(".part")
        state = {
            "labels": list(self.labels),
            "config": asdict(self.config),
            "net": self.net.state_dict(),
            "average": self.average,
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
        }
        torch.save(state, part)
        os.replace(part, path)

    def resume(self, path: Path) -> None:
        """Takes up where `save` stopped; InputError for a file of another kind or other labels."""
        state = load_checkpoint(path)
        if tuple(state["labels"]) != self.labels:
            raise InputError(f"{path} was trained for other labels: {', '.join(state['labels'])}")
        self.net.load_state_dict(state["net"])
        self.average = state["average"]
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.seconds = state["step"], state["seconds"]


def load_checkpoint(path: Path) -> dict:
    """The state written by `Training.save`; InputError when it is not one."""
    try:
        state: dict[str, Tensor] = torch.load(path, weights_only=True)
    except Exception as e:
        raise InputError(f"{path} is not a checkpoint of the segmenter: {e}") from e
    missing = {"labels", "net", "average", "optimizer", "step", "seconds"} - state.keys()
    if missing:
        raise InputError(
            f"{path} is not a checkpoint of the segmenter: it lacks {', '.join(sorted(missing))}"
        )
    return state


def train(
    data: Path,
    labels: tuple[str, ...],
    out: Path,
    config: TrainConfig,
    report: Callable[[str], None],
    *,
    steps: int | None = None,
) -> Training:
    """Trains until the budget of minutes is spent (or `steps`), resuming `out/checkpoint.pt` if it is there.

    Leaves `checkpoint.pt` and `log.jsonl` in `out`.
    """
    out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    shards = Shards(data, labels)
    run = Training(labels, config)
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        run.resume(checkpoint)
        report(f"resumed at step {run.step}, {run.seconds / 60:.1f} min")
    loader = _Loader(shards, config, run.step)
    loader.start()
    sums: dict[str, float] = {}
    last = saved = time.monotonic()
    try:
        while run.seconds < 60.0 * config.minutes and (steps is None or run.step < steps):
            samples = loader.batches.get()
            if isinstance(samples, BaseException):
                raise samples
            for k, v in run.advance(samples).items():
                sums[k] = sums.get(k, 0.0) + v
            now = time.monotonic()
            run.seconds, last = run.seconds + now - last, now
            if run.step % LOG_EVERY == 0:
                line = {k: round(v / LOG_EVERY, 4) for k, v in sums.items()}
                line |= {"step": run.step, "minutes": round(run.seconds / 60, 2), "pictures": len(shards)}
                with (out / "log.jsonl").open("a") as log:
                    log.write(json.dumps(line) + "\n")
                report(" ".join(f"{k} {v}" for k, v in line.items()))
                sums = {}
            if now - saved > 120:
                run.save(checkpoint)
                saved = now
    finally:
        loader.stop.set()
    run.save(checkpoint)
    return run
