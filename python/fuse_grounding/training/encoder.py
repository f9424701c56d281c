"""Training of the embedded encoder: `fuse train encoder`. Needs torch (extra `train`).

Contrastive against a locked text half: the loss of a picture is the cross-entropy between the softmax over
label phrases of its similarity with them and what is in the picture; the same for every patch, with
"background" as one more phrase; and the layout numbers have to tell which labels are in which of 4×3 cells.

What a step does depends on seed, step and pictures alone, and a checkpoint holds all the rest: a run that is
killed and resumed ends with the same bits, on any number of threads.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from fuse_grounding import tensors
from fuse_grounding.errors import InputError
from fuse_grounding.training.encoder_data import IGNORED, Mixture, Sample, make_sample
from fuse_grounding.training.encoder_model import EncoderNet, Views

LOG_EVERY, SAVE_EVERY = 25, 100
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
    """Network, averaged network and optimiser of one run; `save` and `resume` are exact.

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
        self.average = {k: v.detach().clone() for k, v in self.net.state_dict().items()}
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

    def learning_rate(self) -> float:
        """Linear warm-up, then half a cosine over the steps."""
        warm = min((self.step + 1) / self.config.warmup, 1.0)
        half = 0.5 * (1 + math.cos(math.pi * self.step / self.config.steps))
        return self.config.learning_rate * warm * (0.01 + 0.99 * half)

    def advance(self, samples: list[Sample]) -> dict[str, float]:
        """One step of the optimiser; the parts of the loss."""
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate() * group["factor"]
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
        keep = min(self.config.ema, (1 + self.step) / (20 + self.step))
        with torch.no_grad():
            for k, v in self.net.state_dict().items():
                self.average[k].lerp_(v, 1 - keep)
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
        net.load_state_dict(self.average)
        return net.eval()

    def save(self, path: Path) -> None:
        """Writes everything that `resume` needs, all or nothing. Raises FuseError when the disk refuses."""
        state = {
            "kind": "encoder checkpoint",
            "labels": list(self.labels),
            "config": asdict(self.config),
            "net": self.net.state_dict(),
            "average": self.average,
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
        }
        content = BytesIO()
        torch.save(state, content)
        tensors.write(path, content.getvalue())

    def resume(self, path: Path) -> None:
        """Takes up where `save` stopped. Raises InputError for another kind of file, or another run's."""
        try:
            state = torch.load(path, weights_only=True)
            there, labels = state["config"], tuple(state["labels"])
            if state["kind"] != "encoder checkpoint":
                raise KeyError("kind")
        except Exception as error:
            raise InputError(f"{path} is not a checkpoint of the encoder: {error}") from None
        if labels != self.labels:
            raise InputError(f"{path} was trained for other labels: {', '.join(labels)}")
        for key, value in asdict(self.config).items():
            if there.get(key) != value:
                raise InputError(
                    f"{path} was trained with {key} = {there.get(key)}, here it is {value}: "
                    "repeat that run's options or take another folder"
                )
        self.net.load_state_dict(state["net"])
        self.average = state["average"]
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.seconds = state["step"], state["seconds"]


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


def train(
    pictures: Mixture,
    labels: tuple[str, ...],
    phrases: np.ndarray,
    out: Path,
    config: TrainConfig,
    report: Callable[[str], None],
    *,
    stop_at: int | None = None,
) -> Training:
    """Trains `config.steps` steps (or until `stop_at`), resuming `out/checkpoint.pt` if it is there.

    Leaves `checkpoint.pt` and `log.jsonl` in `out`.
    """
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    run = Training(labels, phrases, config)
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        run.resume(checkpoint)
        report(f"resumed at step {run.step}, {run.seconds / 60:.1f} min")
    end = config.steps if stop_at is None else min(stop_at, config.steps)

    def make(step: int) -> list[Sample]:
        rng = np.random.default_rng([config.seed, step])
        chosen = [pictures[int(rng.integers(len(pictures)))] for _ in range(config.batch)]
        return [make_sample(p, table, len(labels), config.size, rng) for p, table in chosen]

    sums: dict[str, float] = {}
    with ThreadPoolExecutor(1) as ahead:
        waiting = ahead.submit(make, run.step)
        while run.step < end:
            began = time.monotonic()
            samples = waiting.result()
            waiting = ahead.submit(make, run.step + 1)
            for k, v in run.advance(samples).items():
                sums[k] = sums.get(k, 0.0) + v
            run.seconds += time.monotonic() - began
            if run.step % LOG_EVERY == 0:
                line = {k: round(v / LOG_EVERY, 4) for k, v in sums.items()}
                left = run.seconds / run.step * (config.steps - run.step)
                line |= {"step": run.step, "minutes": round(run.seconds / 60, 2)}
                with (out / "log.jsonl").open("a") as log:
                    log.write(json.dumps(line) + "\n")
                told = " ".join(f"{k} {v}" for k, v in line.items())
                report(f"{told} of {config.steps}, {left / 60:.0f} min left")
                sums = {}
            if run.step % SAVE_EVERY == 0:
                run.save(checkpoint)
    run.save(checkpoint)
    return run
