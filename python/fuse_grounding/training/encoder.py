"""Training of the embedded encoder: `fuse train encoder`. Needs torch (extra `train`).

Contrastive against a locked text half: the loss of a picture is the cross-entropy between the softmax over
label phrases of its similarity with them and what is in the picture; the same for every patch, with
"background" as one more phrase; and the layout numbers have to tell which labels are in which of 4×3 cells.

What a step does depends on seed, step and pictures alone, and a checkpoint holds all the rest: a run that is
killed and resumed ends with the same bits, on any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from fuse_grounding.training.encoder_data import IGNORED, Mixture, Sample, make_sample
from fuse_grounding.training.encoder_model import EncoderNet, Views
from fuse_grounding.training.loop import Average, learning_rate, same_run

PHRASES = ("{}", "a {}", "a photo of a {}", "a {} on a table", "the {} over there")
BACKGROUND = "background"
WEIGHTS = {"image": 1.0, "patch": 0.5, "layout": 0.5}
PLAIN_WEIGHT = 0.08
"""Of a background patch in the loss, relative to a patch of a thing: most patches are background."""


@dataclass(frozen=True)
class TrainConfig:
    """What a training run depends on besides its pictures and texts."""

    steps: int = 2400
    batch: int = 16
    size: tuple[int, int] = (384, 288)
    learning_rate: float = 1.5e-3
    backbone_factor: float = 0.25
    weight_decay: float = 0.02
    warmup: int = 60
    ema: float = 0.996
    parts: int = 2
    seed: int = 0
    pretrained: bool = True


class Training:
    """Network, averaged network and optimiser of one run, as `loop.train` drives it.

    `phrases` (P, labels + 1, inner): every label, then background, in each way of saying it, of unit length.
    """

    def __init__(self, labels: tuple[str, ...], phrases: np.ndarray, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        self.labels, self.config = labels, config
        self.phrases = torch.from_numpy(phrases)
        self.net = EncoderNet(len(labels))
        if config.pretrained:
            self.net.backbone.load_imagenet()
        self.net.to(memory_format=torch.channels_last)
        self.average = Average(self.net, config.ema)
        backbone = [p for p in self.net.backbone.parameters() if p.requires_grad]
        known = {id(p) for p in self.net.backbone.parameters()}
        heads = [p for p in self.net.parameters() if id(p) not in known]
        groups = [{"params": heads, "factor": 1.0}, {"params": backbone, "factor": config.backbone_factor}]
        self.optimizer = torch.optim.AdamW(groups, lr=config.learning_rate, weight_decay=config.weight_decay)
        self.step, self.seconds = 0, 0.0
        self.pool = ThreadPoolExecutor(config.parts)
        self.replicas = [self._replica() for _ in range(config.parts)]

    def _replica(self) -> EncoderNet:
        """A network with the same parameters in memory and gradients of its own."""
        twin = EncoderNet(len(self.labels))
        for own, shared in zip(twin.parameters(), self.net.parameters(), strict=True):
            own.data = shared.data
        return twin

    def advance(self, samples: list[Sample]) -> dict[str, float]:
        """One step of the optimiser; the parts of the loss."""
        rate = learning_rate(self.config.learning_rate, self.step, self.config.steps, self.config.warmup)
        for group in self.optimizer.param_groups:
            group["lr"] = rate * group["factor"]
        if self.step == 0:
            self.net.standardize(_input(samples))
        texts, count = self._texts(), self.config.parts

        def work(replica: EncoderNet, part: list[Sample]) -> dict[str, float]:
            # One thread of its own per operation: threads that wait for one another inside an operation lose
            # most of a busy machine.
            torch.set_num_threads(1)
            found = losses(replica(_input(part)), part, texts, replica)
            total = sum((WEIGHTS[k] * v for k, v in found.items()), torch.zeros(()))
            (total / count).backward()
            return {k: float(v.detach()) / count for k, v in found.items()}

        halves = [samples[i::count] for i in range(count)]
        found = list(self.pool.map(work, self.replicas, halves))
        parts = {k: sum(one[k] for one in found) for k in WEIGHTS}
        for p, *others in zip(*(n.parameters() for n in (self.net, *self.replicas)), strict=True):
            gradients = [q.grad for q in others if q.grad is not None]
            p.grad = sum(gradients[1:], gradients[0]) if gradients else None
            for q in others:
                q.grad = None
        norm = torch.nn.utils.clip_grad_norm_(self.net.parameters(), 5.0)
        if torch.isfinite(norm):
            self.optimizer.step()
        self.average.update(self.net, self.step)
        self.step += 1
        return parts | {"norm": float(norm)}

    def _texts(self) -> Tensor:
        """(labels + 1, inner): each label said in one way, drawn anew for every step."""
        count = self.phrases.shape[1]
        ways = np.random.default_rng([self.config.seed, self.step, 1]).integers(len(self.phrases), size=count)
        return self.phrases[torch.from_numpy(ways), torch.arange(count)]

    def averaged(self) -> EncoderNet:
        """The averaged network, for evaluation and export."""
        net = EncoderNet(len(self.labels))
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


def _input(samples: list[Sample]) -> Tensor:
    image = torch.from_numpy(np.stack([s.image for s in samples])).permute(0, 3, 1, 2)
    return ((image.float() - 127.0) / 128.0).contiguous(memory_format=torch.channels_last)


def losses(views: Views, samples: list[Sample], texts: Tensor, net: EncoderNet) -> dict[str, Tensor]:
    """The parts of the loss, each a scalar: image, patch, layout."""
    labels = len(texts) - 1
    scale = net.scale()
    present = torch.from_numpy(np.stack([s.present for s in samples]))
    shares = F.log_softmax(scale * views.pooled @ texts[:labels].T, dim=1)
    image = -(present * shares).sum() / max(float(present.sum()), 1.0)
    patches = torch.from_numpy(np.stack([s.patches for s in samples])).flatten()
    logits = scale * views.semantic.permute(0, 2, 3, 1).flatten(0, 2) @ texts.T
    counted = patches != IGNORED
    weight = torch.ones(labels + 1)
    weight[labels] = PLAIN_WEIGHT
    patch = F.cross_entropy(logits[counted], patches[counted], weight)
    cells = torch.from_numpy(np.stack([s.cells for s in samples])).flatten(1)
    layout = F.binary_cross_entropy_with_logits(
        net.layout_reader(views.layout) * scale, cells, pos_weight=torch.tensor(4.0)
    )
    return {"image": image, "patch": patch, "layout": layout}


def batches(pictures: Mixture, labels: int, config: TrainConfig) -> Callable[[int], list[Sample]]:
    """What makes the batch of a step: it depends on the seed, the step and the pictures."""

    def make(step: int) -> list[Sample]:
        rng = np.random.default_rng([config.seed, step])
        chosen = [pictures[int(rng.integers(len(pictures)))] for _ in range(config.batch)]
        return [make_sample(p, table, labels, config.size, rng) for p, table in chosen]

    return make
