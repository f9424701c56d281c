"""Training of the classifier of crops, the second half of `fuse train segmenter`. Needs torch."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F

from fuse_grounding.training.classifier_data import Crop, training_crops
from fuse_grounding.training.classifier_model import CropNet
from fuse_grounding.training.loop import Average, learning_rate, same_run
from fuse_grounding.training.segmenter_data import Shards


@dataclass(frozen=True)
class ClassifierConfig:
    """What a run depends on besides its pictures."""

    steps: int = 4000
    batch: int = 64
    per_picture: int = 5
    learning_rate: float = 1.5e-3
    backbone_factor: float = 0.35
    weight_decay: float = 0.03
    warmup: int = 150
    ema: float = 0.997
    smoothing: float = 0.05
    workers: int = 2
    seed: int = 0
    pretrained: bool = True


class ClassifierTraining:
    """Network, averaged network and optimiser of one run."""

    def __init__(self, labels: tuple[str, ...], config: ClassifierConfig) -> None:
        torch.manual_seed(config.seed)
        self.labels, self.config = labels, config
        self.net = CropNet(len(labels))
        if config.pretrained:
            self.net.backbone.load_imagenet()
        self.average = Average(self.net, config.ema)
        own = {id(p) for p in self.net.backbone.parameters()}
        groups = [
            {"params": [p for p in self.net.parameters() if id(p) not in own], "factor": 1.0},
            {
                "params": [p for p in self.net.backbone.parameters() if p.requires_grad],
                "factor": config.backbone_factor,
            },
        ]
        self.optimizer = torch.optim.AdamW(groups, lr=config.learning_rate, weight_decay=config.weight_decay)
        self.step, self.seconds = 0, 0.0
        self.pool = ThreadPoolExecutor(config.workers)
        self.replicas = [self._replica() for _ in range(config.workers)]

    def _replica(self) -> CropNet:
        twin = CropNet(len(self.labels))
        for own, shared in zip(twin.parameters(), self.net.parameters(), strict=True):
            own.data = shared.data
        return twin.train()

    def advance(self, batch: list[Crop]) -> dict[str, float]:
        """One step of the optimiser; loss and share of right answers."""
        rate = learning_rate(self.config.learning_rate, self.step, self.config.steps, self.config.warmup)
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group["factor"]
        workers = len(self.replicas)
        totals = {"loss": 0.0, "right": 0.0}
        lock = threading.Lock()

        def work(replica: CropNet, mine: list[Crop]) -> None:
            torch.set_num_threads(1)
            image = torch.from_numpy(np.stack([c.image for c in mine]))
            geometry = torch.from_numpy(np.stack([c.geometry for c in mine]))
            truth = torch.tensor([c.category for c in mine])
            logits = replica(image, geometry)
            loss = F.cross_entropy(logits, truth, label_smoothing=self.config.smoothing)
            (loss * (len(mine) / len(batch))).backward()
            with lock:
                totals["loss"] += float(loss.detach()) * len(mine) / len(batch)
                totals["right"] += float((logits.argmax(1) == truth).float().mean()) * len(mine) / len(batch)

        futures = [self.pool.submit(work, r, batch[i::workers]) for i, r in enumerate(self.replicas)]
        for future in futures:
            future.result()
        for p, *others in zip(*(n.parameters() for n in (self.net, *self.replicas)), strict=True):
            gradients = [q.grad for q in others if q.grad is not None]
            p.grad = sum(gradients[1:], gradients[0]) if gradients else None
            for q in others:
                q.grad = None
        torch.nn.utils.clip_grad_norm_(self.net.parameters(), 5.0)
        self.optimizer.step()
        self.average.update(self.net, self.step)
        self.step += 1
        return totals

    def averaged(self) -> CropNet:
        """The averaged network, for evaluation and export."""
        net = CropNet(len(self.labels))
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


def batches(shards: Shards, config: ClassifierConfig) -> Callable[[int], list[Crop]]:
    """What makes the batch of a step: it depends on the seed, the step and the pictures."""

    def make(step: int) -> list[Crop]:
        rng = np.random.default_rng([config.seed, 7, step])
        batch: list[Crop] = []
        while len(batch) < config.batch:
            picture = shards[int(rng.integers(len(shards)))]
            batch += training_crops(picture, shards.category_of_id(picture[2]), rng, config.per_picture)
        return batch[: config.batch]

    return make
