"""Training of the amortised planner: `fuse train planner`. Needs torch; takes seconds.

The paper's, `plain`: [image 512, object 512, action 32] → 512 → 512 → 1, ReLU, mean squared error, Adam 1e-3
without weight decay or clipping, 20 epochs, batch 64, a random 90/10 split, weights of the final epoch
(supplement, "Planner Training Targets"). Ours, `summary`: [`planning.summary` 29 standardised, action 32] →
128 → 128 → 1, with dropout, weight decay, and every second transition seen in a mirror.
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
from fuse_grounding.planning.summary import NAMES, mirrored
from fuse_grounding.training.onnx_files import export
from fuse_grounding.training.transitions import Transitions

ACTIONS, EMBEDDING, RING = 15, 32, 5


@dataclass(frozen=True)
class TrainConfig:
    """What a training run depends on besides its transitions."""

    kind: str = "plain"
    hidden: int = 512
    epochs: int = 20
    batch: int = 64
    learning_rate: float = 1e-3
    weight_decay: float = 0.0
    dropout: float = 0.0
    """Of the two hidden layers."""
    mirror: float = 0.0
    """Chance that a transition is seen in a mirror, going right being going left there."""
    held_out: float = 0.1
    seed: int = 0


def settings(kind: str, seed: int) -> TrainConfig:
    """The recipe of a kind."""
    if kind == "summary":
        return TrainConfig(kind, hidden=128, weight_decay=1e-2, dropout=0.3, mirror=0.5, seed=seed)
    return TrainConfig(kind, seed=seed)


class PlannerNet(nn.Module):
    """Q of one action: what the network reads, `sizes` numbers by name, and the action's embedding."""

    mean: Tensor
    spread: Tensor

    def __init__(self, sizes: dict[str, int], hidden: int, dropout: float) -> None:
        super().__init__()
        self.sizes = sizes
        self.actions = nn.Embedding(ACTIONS, EMBEDDING)
        size = sum(sizes.values())
        layers: list[nn.Module] = []
        for inputs in (size + EMBEDDING, hidden):
            layers += [nn.Linear(inputs, hidden), nn.ReLU(), *([nn.Dropout(dropout)] if dropout else [])]
        self.mlp = nn.Sequential(*layers, nn.Linear(hidden, 1))
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("spread", torch.ones(size))

    def forward(self, read: Tensor, action: Tensor) -> Tensor:
        """(B, sum of sizes), (B,) → (B,)."""
        return self.mlp(torch.cat([(read - self.mean) / self.spread, self.actions(action)], 1))[:, 0]


class Exported(nn.Module):
    """What the ONNX file holds: each input (1, its size) → values (15,)."""

    def __init__(self, net: PlannerNet) -> None:
        super().__init__()
        self.net = net

    def forward(self, *inputs: Tensor) -> Tensor:
        """See the class."""
        return self.net(torch.cat(inputs, 1).expand(ACTIONS, -1), torch.arange(ACTIONS))


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
    rows, read, turned = data.before, _read(data, config.kind), None
    columns = (
        read[rows],
        torch.from_numpy(data.action.astype(np.int64)),
        torch.from_numpy(data.utility),
    )
    if config.mirror:
        turned = torch.from_numpy(mirrored(data.summary.astype(np.float32)))[rows]
    rng = np.random.default_rng(config.seed)
    order = rng.permutation(len(data))
    held = torch.from_numpy(order[: max(1, round(config.held_out * len(data)))])
    kept = order[len(held) :] if len(data) > 1 else order
    sizes = {"image": data.feature.shape[1], "object": data.texts.shape[1]}
    if config.kind == "summary":
        sizes = {"summary": len(NAMES)}
    net = PlannerNet(sizes, config.hidden, config.dropout)
    if config.kind == "summary":
        net.mean.copy_(columns[0][kept].mean(0))
        net.spread.copy_(columns[0][kept].std(0).clamp_min(1e-2))
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
            seen, action, target = (column[batch] for column in columns)
            if turned is not None:
                flip = torch.rand(len(batch)) < config.mirror
                seen = torch.where(flip[:, None], turned[batch], seen)
                action = torch.where(flip, _opposite(action), action)
            loss = F.mse_loss(net(seen, action), target)
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


def _read(data: Transitions, kind: str) -> Tensor:
    """What a kind reads of each state, (S, sum of sizes)."""
    if kind == "summary":
        return torch.from_numpy(data.summary.astype(np.float32))
    pictures, objects = data.feature, data.texts[data.context]
    return torch.from_numpy(np.concatenate((pictures, objects), 1).astype(np.float32))


def _opposite(action: Tensor) -> Tensor:
    """The same pitch, the other way round the ring."""
    return action - 2 * (action % RING) + RING - 1


def write(
    path: Path, trained: Trained, config: TrainConfig, encoder: dict[str, str], source: dict[str, Any]
) -> None:
    """Writes `path` (.onnx) and its .json. Raises FuseError when the disk refuses.

    `encoder`: SHA-256 of the encoder's `network` and `text`; `source`: where the transitions come from.
    """
    sizes = trained.net.sizes
    weights = export(
        Exported(trained.net), tuple(torch.zeros(1, n) for n in sizes.values()), [*sizes], ["values"]
    )
    described = {
        "schema_version": SCHEMA_VERSION,
        "kind": config.kind,
        "dimensions": sizes.get("image", 0),
        "sha256": hashlib.sha256(weights).hexdigest(),
        "encoder": encoder if "image" in sizes else {},
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
