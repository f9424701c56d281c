"""Training of the embedded encoder: `fuse train encoder`. Needs torch (extra `train`).

Contrastive against a locked text half: the loss of a picture is the cross-entropy between the softmax over
label phrases of its similarity with them and what is in the picture; the same for every patch, with
"background" as one more phrase; and the layout numbers have to tell which labels are in which of 4×3 cells.

What a step does depends on seed, step and pictures alone, and a checkpoint holds all the rest: a run that is
killed and resumed ends with the same bits, on any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from fuse_grounding.errors import InputError
from fuse_grounding.training import onnx_files
from fuse_grounding.training.encoder_data import IGNORED, Mixture, Sample, make_sample
from fuse_grounding.training.encoder_model import EncoderNet, Views
from fuse_grounding.training.loop import Average, NetworkRun, Recipe

PHRASES = ("{}", "a {}", "a photo of a {}", "a {} on a table", "the {} over there")
BACKGROUND = "background"
WEIGHTS = {"image": 1.0, "patch": 0.5, "layout": 0.5}
PLAIN_WEIGHT = 0.08
"""Of a background patch in the loss, relative to a patch of a thing: most patches are background."""


@dataclass(frozen=True)
class TrainConfig(Recipe):
    """What a training run depends on besides its pictures and texts."""

    steps: int = 2400
    batch: int = 16
    size: tuple[int, int] = (384, 288)
    learning_rate: float = 1.5e-3
    backbone_factor: float = 0.25
    weight_decay: float = 0.02
    warmup: int = 60
    ema: float = 0.996
    start: str | None = None


class Training(NetworkRun[EncoderNet]):
    """A run as `loop.train` drives it.

    `phrases` (P, labels + 1, inner): every label, then background, in each way of saying it, of unit length.
    `backbone`: an exported segmenter whose backbone to start from, instead of ImageNet's; the configuration's
    `start` is its hash. Raises InputError for a file without such a backbone.
    """

    def __init__(
        self,
        labels: tuple[str, ...],
        phrases: np.ndarray,
        config: TrainConfig,
        backbone: Path | None = None,
    ) -> None:
        self.config = config
        super().__init__(lambda: EncoderNet(len(labels)), labels, config)
        if backbone is not None:
            known = onnx_files.weights(backbone)
            with torch.no_grad():
                for name, own in self.net.backbone.state_dict().items():
                    other = known.get(f"backbone.{name}")
                    if other is None or other.shape != own.shape:
                        raise InputError(
                            f"{backbone} has no backbone of a segmenter: `{name}` is not as it should be"
                        )
                    own.copy_(other)
            self.average = Average(self.net, config.ema)
        self.phrases = torch.from_numpy(phrases).to(self.device)

    def advance(self, samples: list[Sample]) -> dict[str, float]:
        """One step of the optimiser; the parts of the loss."""
        if self.step == 0:
            self.net.standardize(_input(samples, self.device))
        texts, count = self._texts(), self.config.workers

        def work(replica: EncoderNet, mine: list[Sample]) -> dict[str, float]:
            found = losses(replica(_input(mine, self.device)), mine, texts, replica)
            total = sum((WEIGHTS[k] * v for k, v in found.items()), torch.zeros((), device=self.device))
            (total / count).backward()
            return {k: float(v.detach()) / count for k, v in found.items()}

        return self.optimise(work, [samples[i::count] for i in range(count)])

    def _texts(self) -> Tensor:
        """(labels + 1, inner): each label said in one way, drawn anew for every step."""
        count = self.phrases.shape[1]
        ways = np.random.default_rng([self.config.seed, self.step, 1]).integers(len(self.phrases), size=count)
        return self.phrases[torch.from_numpy(ways), torch.arange(count)]


def _input(samples: list[Sample], device: torch.device) -> Tensor:
    image = torch.from_numpy(np.stack([s.image for s in samples])).to(device).permute(0, 3, 1, 2)
    return ((image.float() - 127.0) / 128.0).contiguous(memory_format=torch.channels_last)


def losses(views: Views, samples: list[Sample], texts: Tensor, net: EncoderNet) -> dict[str, Tensor]:
    """The parts of the loss, each a scalar: image, patch, layout."""
    labels, device = len(texts) - 1, texts.device
    scale = net.scale()
    present = torch.from_numpy(np.stack([s.present for s in samples])).to(device)
    shares = F.log_softmax(scale * views.pooled @ texts[:labels].T, dim=1)
    image = -(present * shares).sum() / max(float(present.sum()), 1.0)
    patches = torch.from_numpy(np.stack([s.patches for s in samples])).to(device).flatten()
    logits = scale * views.semantic.permute(0, 2, 3, 1).flatten(0, 2) @ texts.T
    counted = patches != IGNORED
    weight = torch.ones(labels + 1, device=device)
    weight[labels] = PLAIN_WEIGHT
    patch = F.cross_entropy(logits[counted], patches[counted], weight)
    cells = torch.from_numpy(np.stack([s.cells for s in samples])).to(device).flatten(1)
    layout = F.binary_cross_entropy_with_logits(
        net.layout_reader(views.layout) * scale, cells, pos_weight=torch.tensor(4.0, device=device)
    )
    return {"image": image, "patch": patch, "layout": layout}


def batches(pictures: Mixture, labels: int, config: TrainConfig) -> Callable[[int], list[Sample]]:
    """What makes the batch of a step: it depends on the seed, the step and the pictures."""

    def make(step: int) -> list[Sample]:
        rng = np.random.default_rng([config.seed, step])
        chosen = [pictures[int(rng.integers(len(pictures)))] for _ in range(config.batch)]
        return [make_sample(p, table, labels, config.size, rng) for p, table in chosen]

    return make
