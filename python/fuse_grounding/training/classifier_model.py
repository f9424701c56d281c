"""The network that names single objects from crops of them. Needs torch; running the weights does not."""

from __future__ import annotations

from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fuse_grounding.perception.crops import GEOMETRY
from fuse_grounding.training.segmenter_model import Backbone

FEATURES = 160
HIDDEN = 256
# The stages up to 112 channels at stride 16.
BLOCKS = 11
# How much of what is not the object stays in sight.
BACKGROUND = 0.35


class CropNet(nn.Module):
    """Logits over the categories and "none of them" for crops of `perception.crops`."""

    def __init__(self, categories: int) -> None:
        super().__init__()
        self.categories = categories
        self.backbone = Backbone(BLOCKS)
        frozen = Backbone.FROZEN_BLOCKS
        seen = cast(nn.Conv2d, self.backbone.get_submodule(f"blocks.{frozen - 1}.project.conv"))
        self.mask_in = nn.Conv2d(1, seen.out_channels, 1)
        nn.init.zeros_(self.mask_in.weight)
        assert self.mask_in.bias is not None
        nn.init.zeros_(self.mask_in.bias)
        fine, coarse = 40, 112
        self.fine = nn.Conv2d(fine, 64, 1)
        self.coarse = nn.Conv2d(coarse, FEATURES, 1)
        self.head = nn.Sequential(
            nn.Linear(2 * FEATURES + 64 + GEOMETRY, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU()
        )
        self.out = nn.Linear(HIDDEN, categories + 1)
        self.backbone.freeze()

    def forward(self, crops: Tensor, geometry: Tensor) -> Tensor:
        """crops (B, 96, 128, 4) uint8, geometry (B, GEOMETRY) → (B, categories + 1) logits."""
        x = crops.permute(0, 3, 1, 2).float()
        mask = x[:, 3:] / 255.0
        x = (x[:, :3] - 127.0) / 128.0 * (BACKGROUND + (1.0 - BACKGROUND) * mask)
        fine, coarse = self._features(x.contiguous(memory_format=torch.channels_last), mask)
        pooled = torch.cat(
            [
                _under(F.relu(self.fine(fine)), F.avg_pool2d(mask, 8)),
                _under(F.relu(self.coarse(coarse)), F.avg_pool2d(mask, 16)),
                F.relu(self.coarse(coarse)).float().mean((2, 3)),
                geometry,
            ],
            1,
        )
        return self.out(self.head(pooled.float()))

    def _features(self, x: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        with torch.no_grad():
            x = F.relu6(self.backbone.stem(x))
            for block in self.backbone.blocks[: Backbone.FROZEN_BLOCKS]:
                x = block(x)
        x = x + self.mask_in(F.avg_pool2d(mask, 4))
        fine = x
        for i, block in enumerate(self.backbone.blocks[Backbone.FROZEN_BLOCKS :], Backbone.FROZEN_BLOCKS):
            x = block(x)
            if i == Backbone.FROZEN_BLOCKS + 1:
                fine = x
        return fine, x


def _under(features: Tensor, mask: Tensor) -> Tensor:
    """(B, C): mean of (B, C, h, w) features under (B, 1, h, w) masks."""
    weight = mask + 1e-4
    return (features.float() * weight).sum((2, 3)) / weight.sum((2, 3))
