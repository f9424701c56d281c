"""Training of the embedded segmenter: `fuse train segmenter`. Needs torch (extra `train`)."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fuse_grounding.training.loop import Average, learning_rate, same_run
from fuse_grounding.training.segmenter_data import Sample, Shards, make_sample
from fuse_grounding.training.segmenter_loss import losses
from fuse_grounding.training.segmenter_model import SegmenterNet

WEIGHTS = {"heat": 1.0, "mask": 2.0, "dense": 0.6, "verdict": 0.6}


@dataclass(frozen=True)
class TrainConfig:
    """What a training run depends on besides its pictures."""

    steps: int = 4000
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
        self.average = Average(self.net, config.ema)
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
        self.step, self.seconds, self.warm = 0, 0.0, False
        self.pool = ThreadPoolExecutor(config.workers)
        self.replicas = [self._replica() for _ in range(config.workers)]

    def _replica(self) -> SegmenterNet:
        """A network with the same parameters in memory and gradients of its own."""
        twin = SegmenterNet(len(self.labels))
        for own, shared in zip(twin.parameters(), self.net.parameters(), strict=True):
            own.data = shared.data
        return twin

    def advance(self, samples: list[Sample]) -> dict[str, float]:
        """One step of the optimiser; the parts of the loss."""
        rate = learning_rate(self.config.learning_rate, self.step, self.config.steps, self.config.warmup)
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group["factor"]
        if self.step == 0 and not self.warm:
            with torch.no_grad():
                self.net.standardize(_input(samples))
        size = self.config.part
        batches = [samples[i : i + size] for i in range(0, len(samples), size)]
        share = 1.0 / len(batches)
        parts: dict[str, float] = {}
        lock = threading.Lock()

        def work(replica: SegmenterNet, mine: list[list[Sample]]) -> None:
            # One thread of its own per operation: threads that wait for one another inside an operation
            # lose most of a busy machine.
            torch.set_num_threads(1)
            for part in mine:
                dense = replica(_input(part))
                found = losses(replica, dense, part)
                total = sum((WEIGHTS[k] * v for k, v in found.items()), torch.zeros(()))
                (total * share).backward()
                with lock:
                    for k, v in found.items():
                        parts[k] = parts.get(k, 0.0) + share * float(v.detach())

        # Whose part is whose is fixed: sums in another order would be another run.
        workers = len(self.replicas)
        futures = [self.pool.submit(work, r, batches[i::workers]) for i, r in enumerate(self.replicas)]
        for future in futures:
            future.result()
        for p, *others in zip(*(n.parameters() for n in (self.net, *self.replicas)), strict=True):
            gradients = [q.grad for q in others if q.grad is not None]
            p.grad = sum(gradients[1:], gradients[0]) if gradients else None
            for q in others:
                q.grad = None
        norm = torch.nn.utils.clip_grad_norm_(self.net.parameters(), 8.0)
        if torch.isfinite(norm):
            self.optimizer.step()
        self.average.update(self.net, self.step)
        self.step += 1
        return parts | {"norm": float(norm)}

    def averaged(self) -> SegmenterNet:
        """The averaged network, for evaluation and export."""
        net = SegmenterNet(len(self.labels))
        net.load_state_dict(self.average.weights)
        return net.eval()

    def state(self) -> dict[str, Any]:
        """Everything `restore` needs."""
        return {
            "labels": list(self.labels),
            "config": asdict(self.config),
            "net": self.net.state_dict(),
            "average": self.average.weights,
            "optimizer": self.optimizer.state_dict(),
        }

    def restore(self, state: dict[str, Any], path: Path) -> None:
        """Takes up a state read from `path`; InputError when it is another run's."""
        same_run(state, self.labels, asdict(self.config), path)
        self.net.load_state_dict(state["net"])
        self.average.weights = state["average"]
        self.optimizer.load_state_dict(state["optimizer"])

    def warm_start(self, weights: Path) -> list[str]:
        """Takes the weights of an exported network over, wherever a tensor has the same shape, and the rows
        of the categories that both know. Returns the names of what starts afresh.
        """
        known = exported_weights(weights)
        settings = json.loads(weights.with_suffix(".json").read_text())
        rows = [settings["labels"].index(x) if x in settings["labels"] else -1 for x in self.labels]
        fresh = carry_over(self.net, known, rows, len(settings["labels"]))
        self.average = Average(self.net, self.config.ema)
        self.warm = True
        return fresh


def batches(shards: Shards, config: TrainConfig) -> Callable[[int], list[Sample]]:
    """What makes the batch of a step: it depends on the seed, the step and the pictures."""

    def make(step: int) -> list[Sample]:
        rng = np.random.default_rng([config.seed, step])
        batch = []
        for _ in range(config.batch):
            picture = shards[int(rng.integers(len(shards)))]
            batch.append(make_sample(picture, shards.category_of_id(picture[2]), config.crop, rng))
        return batch

    return make


def exported_weights(path: Path) -> dict[str, Tensor]:
    """The named weights of an ONNX file that `to_onnx` wrote."""
    import onnx
    from onnx import numpy_helper

    graph = onnx.load(path).graph
    return {
        t.name.removesuffix("_half").removeprefix("net."): torch.from_numpy(
            numpy_helper.to_array(t).astype(np.float32)
        )
        for t in graph.initializer
    }


@torch.no_grad()
def carry_over(net: SegmenterNet, known: dict[str, Tensor], rows: list[int], before: int) -> list[str]:
    """Copies what fits; rows of `dense_class` and `verdict_out` by category, -1 being new."""
    fresh = []
    for name, own in net.state_dict().items():
        other = known.get(name)
        if other is not None and other.shape == own.shape:
            own.copy_(other)
        elif other is not None and name.startswith(("dense_class.", "verdict_out.")):
            for i, k in enumerate(rows):
                if k >= 0:
                    own[i] = other[k]
            own[len(rows) :] = other[before:]
        else:
            fresh.append(name)
    return fresh
