"""Training of the embedded segmenter: `fuse train segmenter`. Needs torch (extra `train`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from fuse_grounding.training.loop import NetworkRun, Recipe
from fuse_grounding.training.segmenter_data import Sample, Shards, make_sample
from fuse_grounding.training.segmenter_loss import losses
from fuse_grounding.training.segmenter_model import SegmenterNet

WEIGHTS = {"heat": 1.0, "mask": 2.0, "dense": 0.6, "verdict": 0.6}


@dataclass(frozen=True)
class TrainConfig(Recipe):
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
    start: str | None = None


def _input(samples: list[Sample], device: torch.device) -> Tensor:
    image = torch.from_numpy(np.stack([s.image for s in samples])).to(device).permute(0, 3, 1, 2)
    return ((image.float() - 127.0) / 128.0).contiguous(memory_format=torch.channels_last)


class Training(NetworkRun[SegmenterNet]):
    """A run as `loop.train` drives it. `weights`: an exported network to start from, instead of ImageNet's;
    the configuration's `start` is its hash.
    """

    LARGEST_GRADIENT = 8.0
    PER_LABEL = ("dense_class.", "verdict_out.")

    def __init__(self, labels: tuple[str, ...], config: TrainConfig, weights: Path | None = None) -> None:
        self.config = config
        super().__init__(lambda: SegmenterNet(len(labels)), labels, config)
        if weights is not None:
            self.start_from(weights, weights.with_suffix(".json"))

    def advance(self, samples: list[Sample]) -> dict[str, float]:
        """One step of the optimiser; the parts of the loss."""
        if self.step == 0 and self.config.start is None:
            with torch.no_grad():
                self.net.standardize(_input(samples, self.device))
        size, workers = self.config.part, self.config.workers
        batches = [samples[i : i + size] for i in range(0, len(samples), size)]
        share = 1.0 / len(batches)

        def work(replica: SegmenterNet, mine: list[list[Sample]]) -> dict[str, float]:
            parts: dict[str, float] = {}
            for part in mine:
                found = losses(replica, replica(_input(part, self.device)), part)
                total = sum((WEIGHTS[k] * v for k, v in found.items()), torch.zeros((), device=self.device))
                (total * share).backward()
                for k, v in found.items():
                    parts[k] = parts.get(k, 0.0) + share * float(v.detach())
            return parts

        return self.optimise(work, [batches[i::workers] for i in range(workers)])


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
