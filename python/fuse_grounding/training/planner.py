"""Training of the amortised planner: `fuse train planner`. Needs torch; takes seconds.

The paper's: [image 512, object 512, action 32] → 512 → 512 → 1, ReLU, mean squared error, Adam 1e-3 without
weight decay or clipping, 20 epochs, batch 64, a random 90/10 split, weights of the final epoch (supplement,
"Planner Training Targets"). `extended` reads `planning.summary`, too, standardised, and weighs less of what
it could learn by heart: dropout on the picture, weight decay.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fuse_grounding import tensors
from fuse_grounding.planning.amortized import SCHEMA_VERSION
from fuse_grounding.planning.summary import NAMES
from fuse_grounding.training.onnx_files import export
from fuse_grounding.training.transitions import Transitions

ACTIONS, EMBEDDING, HIDDEN = 15, 32, 512


@dataclass(frozen=True)
class TrainConfig:
    """What a training run depends on besides its transitions."""

    kind: str = "plain"
    epochs: int = 20
    batch: int = 64
    learning_rate: float = 1e-3
    weight_decay: float = 0.0
    dropout: float = 0.0
    held_out: float = 0.1
    seed: int = 0


def settings(kind: str, seed: int) -> TrainConfig:
    """The recipe of a kind."""
    if kind == "extended":
        return TrainConfig(kind, weight_decay=1e-2, dropout=0.5, seed=seed)
    return TrainConfig(kind, seed=seed)


class PlannerNet(nn.Module):
    """Q(x, a; o) of one action or of all."""

    mean: Tensor
    spread: Tensor

    def __init__(self, dimensions: int, extended: bool, dropout: float) -> None:
        super().__init__()
        self.actions = nn.Embedding(ACTIONS, EMBEDDING)
        extra = len(NAMES) if extended else 0
        self.mlp = nn.Sequential(
            nn.Linear(2 * dimensions + EMBEDDING + extra, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, HIDDEN),
            nn.ReLU(),
            nn.Linear(HIDDEN, 1),
        )
        self.dimensions = dimensions
        self.dropout = nn.Dropout(dropout)
        self.extended = extended
        self.register_buffer("mean", torch.zeros(extra))
        self.register_buffer("spread", torch.ones(extra))

    def forward(self, image: Tensor, context: Tensor, summary: Tensor, action: Tensor) -> Tensor:
        """(B, D), (B, D), (B, 29), (B,) → (B,)."""
        parts = [self.dropout(image), context, self.actions(action)]
        if self.extended:
            parts.append((summary - self.mean) / self.spread)
        return self.mlp(torch.cat(parts, 1))[:, 0]


class Exported(nn.Module):
    """What the ONNX file holds: (1, D), (1, D) and, extended, (1, 29) → values (15,)."""

    def __init__(self, net: PlannerNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, image: Tensor, context: Tensor, summary: Tensor | None = None) -> Tensor:
        """See the class."""
        every = torch.arange(ACTIONS)
        shape = (ACTIONS, -1)
        seen = torch.zeros(1, 0) if summary is None else summary
        return self.net(
            image.expand(shape), context.expand(shape), seen.expand(ACTIONS, seen.shape[1]), every
        )


@dataclass(frozen=True)
class Trained:
    """The final network and the mean squared errors of each epoch, training and held out."""

    net: PlannerNet
    training: list[float]
    held_out: list[float]
    constant: float
    """Held-out error of always predicting the training mean: what learning has to beat."""


def train(data: Transitions, config: TrainConfig, report: Callable[[str], None]) -> Trained:
    """Trains from the table alone. The same table and seed give the same bits: one thread."""
    torch.set_num_threads(1)
    torch.manual_seed(config.seed)
    rows = data.before
    columns = (
        torch.from_numpy(data.feature[rows].astype(np.float32)),
        torch.from_numpy(data.texts[data.context[rows]].astype(np.float32)),
        torch.from_numpy(data.summary[rows].astype(np.float32)),
        torch.from_numpy(data.action.astype(np.int64)),
        torch.from_numpy(data.utility),
    )
    rng = np.random.default_rng(config.seed)
    order = rng.permutation(len(data))
    held = torch.from_numpy(order[: max(1, round(config.held_out * len(data)))])
    kept = order[len(held) :] if len(data) > 1 else order
    net = PlannerNet(data.feature.shape[1], config.kind == "extended", config.dropout)
    if net.extended:
        net.mean.copy_(columns[2][kept].mean(0))
        net.spread.copy_(columns[2][kept].std(0).clamp_min(1e-2))
    optimizer = (
        torch.optim.AdamW(net.parameters(), config.learning_rate, weight_decay=config.weight_decay)
        if config.weight_decay
        else torch.optim.Adam(net.parameters(), config.learning_rate)
    )
    errors: tuple[list[float], list[float]] = ([], [])
    for epoch in range(config.epochs):
        net.train()
        total = 0.0
        for batch in torch.from_numpy(rng.permutation(kept)).split(config.batch):
            *inputs, target = (column[batch] for column in columns)
            loss = F.mse_loss(net(*inputs), target)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += float(loss.detach()) * len(batch)
        net.eval()
        with torch.no_grad():
            *inputs, target = (column[held] for column in columns)
            validation = float(F.mse_loss(net(*inputs), target))
        errors[0].append(round(total / len(kept), 6))
        errors[1].append(round(validation, 6))
        report(f"epoch {epoch + 1:2d}  training {errors[0][-1]:.5f}  held out {errors[1][-1]:.5f}")
    mean = data.utility[kept].mean()
    constant = float(((data.utility[held.numpy()] - mean) ** 2).mean())
    return Trained(net.eval(), *errors, constant=round(constant, 6))


def write(
    path: Path, trained: Trained, config: TrainConfig, encoder: dict[str, str], source: dict[str, Any]
) -> None:
    """Writes `path` (.onnx) and its .json. Raises FuseError when the disk refuses.

    `encoder`: SHA-256 of the encoder's `network` and `text`; `source`: where the transitions come from.
    """
    size = trained.net.dimensions
    example: tuple[Tensor, ...] = (torch.zeros(1, size), torch.zeros(1, size))
    names = ["image", "object"]
    if trained.net.extended:
        example, names = (*example, torch.zeros(1, len(NAMES))), [*names, "summary"]
    weights = export(Exported(trained.net), example, names, ["values"])
    described = {
        "schema_version": SCHEMA_VERSION,
        "kind": config.kind,
        "dimensions": size,
        "sha256": hashlib.sha256(weights).hexdigest(),
        "encoder": encoder,
        "transitions": source,
        "training": asdict(config),
        "errors": {
            "training": trained.training,
            "held_out": trained.held_out,
            "held_out_constant": trained.constant,
        },
    }
    tensors.write(path, weights)
    tensors.write(path.with_suffix(".json"), json.dumps(described, indent=1) + "\n")
