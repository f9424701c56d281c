"""Training of the classifier of crops, the second half of `fuse train segmenter`. Needs torch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

from fuse_grounding.perception.embedded import crops_path
from fuse_grounding.training.classifier_data import Crop, training_crops
from fuse_grounding.training.classifier_model import CropNet
from fuse_grounding.training.loop import NetworkRun, Recipe
from fuse_grounding.training.segmenter_data import Shards


@dataclass(frozen=True)
class ClassifierConfig(Recipe):
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
    start: str | None = None


class ClassifierTraining(NetworkRun[CropNet]):
    """A run as `loop.train` drives it. `weights`: an exported segmenter whose second network to start from,
    instead of ImageNet's; the configuration's `start` is that network's hash.
    """

    PER_LABEL = ("out.",)

    def __init__(
        self, labels: tuple[str, ...], config: ClassifierConfig, weights: Path | None = None
    ) -> None:
        self.config = config
        super().__init__(lambda: CropNet(len(labels)), labels, config)
        if weights is not None:
            self.start_from(crops_path(weights), weights.with_suffix(".json"))

    def advance(self, batch: list[Crop]) -> dict[str, float]:
        """One step of the optimiser; loss and share of right answers."""

        def work(replica: CropNet, mine: list[Crop]) -> dict[str, float]:
            share = len(mine) / len(batch)
            image = torch.from_numpy(np.stack([c.image for c in mine])).to(self.device)
            geometry = torch.from_numpy(np.stack([c.geometry for c in mine])).to(self.device)
            truth = torch.tensor([c.category for c in mine], device=self.device)
            logits = replica(image, geometry)
            loss = F.cross_entropy(logits, truth, label_smoothing=self.config.smoothing)
            (loss * share).backward()
            right = (logits.argmax(1) == truth).float().mean()
            return {"loss": share * float(loss.detach()), "right": share * float(right)}

        return self.optimise(work, [batch[i :: self.config.workers] for i in range(self.config.workers)])


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
