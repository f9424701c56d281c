"""The picture half of the embedded encoder. Needs torch; running the shipped weights does not.

EfficientNet-Lite0 (as the segmenter's, ImageNet weights) → features at stride 16 → for every patch a vector s
in the space of the texts, how much it counts w, and L = 32 numbers for the layout. With Q = [Q_s Q_l]
orthonormal,

    patches = Q_s s / |s|
    image   = α Q_s ŝ + β Q_l l̂,   ŝ ∝ Σ softmax(w) s / |s|,   l̂ ∝ the L numbers averaged over 4×3 cells

so that ⟨image, text⟩ = α ⟨ŝ, t⟩: the layout is there for planners, and no text sees it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fuse_grounding.training.encoder_data import CELLS
from fuse_grounding.training.encoder_text import DIMENSIONS as INNER
from fuse_grounding.training.segmenter_model import Backbone

DIMENSIONS = 512
LAYOUT = (DIMENSIONS - INNER) // (CELLS[0] * CELLS[1])
SEMANTIC_SHARE = 0.6
"""α²: of the squared length of an image vector, what texts see."""
WIDTH = 192
ROTATION_SEED = 20260


def rotation() -> np.ndarray:
    """Q, (512, 512) float32: a fixed orthonormal matrix; its first columns carry the texts."""
    q, r = np.linalg.qr(np.random.default_rng(ROTATION_SEED).standard_normal((DIMENSIONS, DIMENSIONS)))
    return (q * np.sign(np.diag(r))).astype(np.float32)


@dataclass
class Views:
    """What the network says of a batch. B pictures, patches at stride 16."""

    semantic: Tensor  # (B, INNER, h, w), unit length over the channels
    pooled: Tensor  # (B, INNER), unit length
    layout: Tensor  # (B, LAYOUT * 12), unit length


def _conv(inputs: int, outputs: int, kernel: int = 1) -> nn.Conv2d:
    conv = nn.Conv2d(inputs, outputs, kernel, padding=kernel // 2)
    nn.init.kaiming_normal_(conv.weight, nonlinearity="relu")
    assert conv.bias is not None
    nn.init.zeros_(conv.bias)
    return conv


class EncoderNet(nn.Module):
    """Backbone, patch features, and the heads that only training needs (`layout_reader`)."""

    def __init__(self, labels: int) -> None:
        super().__init__()
        self.backbone = Backbone()
        _, _, c8, c16, c32 = Backbone.channels
        self.lateral = nn.ModuleList([_conv(c, WIDTH) for c in (c8, c16, c32)])
        self.mix = _conv(WIDTH, WIDTH, 3)
        self.semantic = _conv(WIDTH, INNER)
        self.weight = _conv(WIDTH, 1)
        self.layout = _conv(WIDTH, LAYOUT)
        self.layout_reader = nn.Linear(LAYOUT * CELLS[0] * CELLS[1], labels * CELLS[0] * CELLS[1])
        self.log_scale = nn.Parameter(torch.tensor(float(np.log(20.0))))
        for module in (self.backbone.stem, *self.backbone.blocks[: Backbone.FROZEN_BLOCKS]):
            module.requires_grad_(False)
        # Depthwise kernels transfer as they are, and their gradient is a third of a training step.
        for block in self.backbone.blocks:
            block.depthwise.requires_grad_(False)

    def features(self, x: Tensor) -> Tensor:
        """(B, 3, H, W) of (value - 127) / 128, H and W multiples of 32 → (B, WIDTH, H/16, W/16)."""
        _, _, f8, f16, f32 = self.backbone(x)
        fine = F.avg_pool2d(self.lateral[0](f8), 2)
        coarse = F.interpolate(self.lateral[2](f32), scale_factor=2.0, mode="bilinear", align_corners=False)
        return F.relu(self.mix(F.relu(fine + self.lateral[1](f16) + coarse)))

    def forward(self, x: Tensor) -> Views:
        """(B, 3, H, W) of (value - 127) / 128, H and W multiples of 32."""
        features = self.features(x)
        semantic = F.normalize(self.semantic(features), dim=1)
        weights = torch.softmax(self.weight(features).flatten(2), dim=2)
        pooled = F.normalize((semantic.flatten(2) * weights).sum(2), dim=1)
        cells = _cells(F.relu(self.layout(features)))
        return Views(semantic, pooled, F.normalize(cells.flatten(1), dim=1))

    def scale(self) -> Tensor:
        """What turns cosines in the inner space into logits; at most 100, as CLIP's."""
        return self.log_scale.exp().clamp(max=100.0)

    def standardize(self, x: Tensor) -> None:
        """Scales every fresh layer so that it answers `x` with unit variance.

        The heads have no normalisation; without this, the backbone's scale would blow up the first steps.
        """
        fresh = (*self.lateral, self.mix, self.semantic, self.weight, self.layout)

        def rescale(module: nn.Module, _: object, output: Tensor) -> Tensor:
            assert isinstance(module, nn.Conv2d)
            factor = 1.0 / float(output.std().clamp_min(1e-3))
            module.weight.data.mul_(factor)
            return output * factor

        handles = [m.register_forward_hook(rescale) for m in fresh]
        try:
            with torch.no_grad():
                self(x)
        finally:
            for handle in handles:
                handle.remove()


def _cells(x: Tensor) -> Tensor:
    """(B, C, h, w) → (B, C, 3, 4): means over the cells; h and w are multiples of 3 and 4."""
    # Whole numbers even while the network is traced: a pooling window is no input of it.
    return F.avg_pool2d(x, (int(x.shape[-2]) // CELLS[1], int(x.shape[-1]) // CELLS[0]))


class Exported(nn.Module):
    """What the ONNX file holds: (1, H, W, 3) uint8 → embedding (1, 512), patches (1, H/16, W/16, 512)."""

    def __init__(self, net: EncoderNet) -> None:
        super().__init__()
        self.net = net
        q = torch.from_numpy(rotation())
        self.register_buffer("q_semantic", q[:, :INNER].T.contiguous())
        self.register_buffer("q_layout", q[:, INNER:].T.contiguous())

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """See the class."""
        views = self.net((image.permute(0, 3, 1, 2).float() - 127.0) / 128.0)
        what = SEMANTIC_SHARE**0.5 * views.pooled @ self.q_semantic
        where = (1.0 - SEMANTIC_SHARE) ** 0.5 * views.layout @ self.q_layout
        patches = views.semantic.permute(0, 2, 3, 1) @ self.q_semantic
        return what + where, patches
