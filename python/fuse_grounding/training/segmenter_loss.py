"""Losses of the segmenter over one batch of samples. Needs torch."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from fuse_grounding.training.segmenter_data import Sample
from fuse_grounding.training.segmenter_model import KERNEL_SIZE, MASK_CHANNELS, PYRAMID, Dense, SegmenterNet

PEAKS = 14


def heat_loss(logits: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Focal loss of CenterNet (exponents 2 and 4), a mean over the middles of objects."""
    p = torch.sigmoid(logits).clamp(1e-4, 1 - 1e-4)
    hit = (target == 1.0).float()
    positive = hit * (1 - p) ** 2 * torch.log(p)
    negative = (1 - hit) * (1 - target) ** 4 * p**2 * torch.log(1 - p)
    return -((positive + negative) * weight).sum() / hit.sum().clamp_min(1.0)


def mask_loss(logits: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Dice + cross-entropy (N,) from pixels drawn with chance 1 / weight; logits, target (N, P)."""
    p = torch.sigmoid(logits)
    overlap = (weight * p * target).sum(1)
    dice = 1 - (2 * overlap + 1) / ((weight * p * p).sum(1) + (weight * target * target).sum(1) + 1)
    area = (weight * target).sum(1)
    cross = F.binary_cross_entropy_with_logits(
        logits, target, weight.expand_as(logits), reduction="none"
    ).sum(1)
    # Relative to the instance, so that a thin spoon weighs as much as a bowl.
    return dice + 0.25 * cross / (area + 30.0)


def _iou(masks: Tensor, truth: Tensor) -> Tensor:
    """(N, M) intersection over union of bool masks (N, P) and (M, P)."""
    a, b = masks.float(), truth.float()
    both = a @ b.t()
    return both / (a.sum(1)[:, None] + b.sum(1)[None] - both).clamp_min(1.0)


def _verdict_loss(net: SegmenterNet, dense: Dense, b: int, sample: Sample, cells: Tensor) -> Tensor:
    """Category (or none) and quality of the masks at true and at predicted middles."""
    h, w = dense.heat.shape[-2:]
    device = dense.heat.device
    with torch.no_grad():
        heat = dense.heat[b]
        peak = torch.where(F.max_pool2d(heat, 3, 1, 1) == heat, heat, -1e4).reshape(-1)
        index = torch.cat([peak.topk(PEAKS).indices, cells[:, 1] * w + cells[:, 0]])
        chosen = torch.stack([index % w, index // w], 1)
        kernels = dense.kernels[b].reshape(KERNEL_SIZE, -1).t()[index].float()
        features = dense.masks[b].float()[:, ::2, ::2].reshape(MASK_CHANNELS, -1)
        positions = net.positions(h * 4, w * 4, device).view(2, h * 4, w * 4)[:, ::2, ::2].reshape(2, -1)
        masks = torch.sigmoid(net.masks_at(features, positions, kernels, chosen))
        truth = torch.from_numpy(sample.mask4).to(device).flatten(1)
        iou = _iou(masks > 0.5, truth) if len(truth) else torch.zeros(len(masks), 1, device=device)
        best, which = iou.max(1)
        target = torch.full((len(masks),), net.categories, device=device)
        if len(truth):
            kinds = torch.from_numpy(sample.category).to(device)
            target = torch.where(best >= 0.5, kinds[which], target)
        coarse = F.avg_pool2d(masks.view(1, -1, h * 2, w * 2), 2)[0]
        # Neither right nor wrong: says nothing about the category.
        certain = ((best >= 0.5) | (best < 0.3)).float()
        # Peaks of almost no heat are easy and many.
        certain[:PEAKS] *= (torch.sigmoid(heat.reshape(-1)[index[:PEAKS]]) > 0.03).float() * 0.9 + 0.1
    points = dense.point[b].reshape(PYRAMID, -1).t()[index]
    logits = net.classify(dense.tower[b].float(), dense.classes[b].float(), points.float(), coarse)
    category = F.cross_entropy(logits[:, :-1], target, reduction="none", label_smoothing=0.03)
    quality = F.binary_cross_entropy_with_logits(logits[:, -1], best, reduction="none")
    return (category * certain).sum() / certain.sum().clamp_min(1.0) + 0.3 * quality.mean()


def losses(net: SegmenterNet, dense: Dense, samples: list[Sample]) -> dict[str, Tensor]:
    """The four parts, each a scalar: heat, mask, dense, verdict."""
    device = dense.heat.device

    def stack(name: str) -> Tensor:
        return torch.from_numpy(np.stack([getattr(s, name) for s in samples])).to(device)

    heat = heat_loss(dense.heat.float()[:, 0], stack("heat"), stack("heat_weight"))
    weight = stack("dense_weight")
    dense_loss = F.cross_entropy(
        dense.classes.float(), stack("dense"), reduction="none", label_smoothing=0.02
    )
    h, w = dense.heat.shape[-2:]
    positions = net.positions(h * 4, w * 4, device)
    mask, verdict, count = dense_loss.new_zeros(()), dense_loss.new_zeros(()), 0
    for b, sample in enumerate(samples):
        cells = torch.from_numpy(sample.cells).to(device)
        if len(cells):
            points = torch.from_numpy(sample.points).to(device)
            features = dense.masks[b].reshape(MASK_CHANNELS, -1)[:, points].float()
            kernels = dense.kernels[b][:, cells[:, 1], cells[:, 0]].t().float()
            logits = net.masks_at(features, positions[:, points], kernels, cells)
            truth = torch.from_numpy(sample.point_mask).to(device)
            per = mask_loss(logits, truth, torch.from_numpy(sample.point_weight).to(device))
            mask, count = mask + per.sum(), count + len(cells)
        verdict = verdict + _verdict_loss(net, dense, b, sample, cells)
    return {
        "heat": heat,
        "mask": mask / max(count, 1),
        "dense": (dense_loss * weight).sum() / weight.sum(),
        "verdict": verdict / len(samples),
    }
