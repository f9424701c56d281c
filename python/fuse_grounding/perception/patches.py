"""Patch-level evidence, the paper's ablation of the segmenter: an encoder's patches against a label's text.

The paper says no more than "CLIP (Patch-level)"; the rest is ours. Each label l is held, by itself, as SAM3
does, against a contrast C: what a patch may be instead.

    p_l(u) = exp(k f_u . t_l) / (exp(k f_u . t_l) + sum over c in C, c != l, of exp(k f_u . t_c))

with unit vectors f_u of the patches and t of the texts, k the encoder's scale. The grid is enlarged
bilinearly; each connected region with p_l at least the threshold is an instance, its score the mean of p_l
there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fuse_grounding.errors import InputError
from fuse_grounding.perception.prompts import check_labels, check_picture, words
from fuse_grounding.perception.protocol import Detection, Encoder

MIN_PIXELS = 60
"""Smaller regions are left out, as the embedded segmenter's are."""


@dataclass(frozen=True)
class Manner:
    """How an encoder is asked: what a label is said as, the texts of the contrast, scale and threshold."""

    prompt: str
    contrast: tuple[str, ...]
    scale: float
    threshold: float


CLIP = Manner(
    "a photo of a {}",
    ("a photo of a table", "a photo of a wall", "a photo of a floor", "a photo of an object"),
    100.0,  # at which CLIP was trained
    0.5,
)


class PatchSegmenter:
    """Regions of patches that look like a label, by any `Encoder`; implements `Segmenter` for any label."""

    labels: tuple[str, ...] | None = None

    def __init__(self, encoder: Encoder, manner: Manner = CLIP) -> None:
        if not manner.contrast:
            raise InputError("contrast is empty: every patch would be every label")
        self._encoder, self._manner = encoder, manner
        self._contrast = encoder.text(manner.contrast)

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        """See `Segmenter`; masks are read-only. Raises InputError also for what the encoder cannot read."""
        rgb = check_picture(rgb)
        wanted = check_labels(labels, None)
        if not wanted:
            return []
        detections = []
        for label, coarse in zip(wanted, self.maps(rgb, wanted), strict=True):
            likely = cv2.resize(coarse, rgb.shape[1::-1], interpolation=cv2.INTER_LINEAR)
            count, regions = cv2.connectedComponents((likely >= self._manner.threshold).astype(np.uint8))
            for region in range(1, count):
                mask = regions == region
                if np.count_nonzero(mask) >= MIN_PIXELS:
                    mask.setflags(write=False)
                    detections.append(Detection(label, float(likely[mask].mean()), mask))
        # Stable: equal scores stay in the order of labels, then of regions.
        return sorted(detections, key=lambda d: -d.score)

    def maps(self, rgb: np.ndarray, labels: Sequence[str]) -> np.ndarray:
        """(N, h, w) float32 in [0, 1]: how much each patch looks like each label."""
        patches = self._encoder.patches(rgb)
        said = [self._manner.prompt.format(words(label)) for label in labels]
        like = self._manner.scale * np.moveaxis(patches @ self._encoder.text(said).T, -1, 0)
        other = self._manner.scale * (patches @ self._contrast.T)
        maps = np.empty(like.shape, np.float32)
        for text, own, made in zip(said, like, maps, strict=True):
            rivals = other[..., [c != text for c in self._manner.contrast]]
            # log sum exp, about its largest: e^100 is beyond float32.
            most = rivals.max(-1, keepdims=True)
            rest = most[..., 0] + np.log(np.exp(rivals - most).sum(-1))
            made[:] = 1 / (1 + np.exp(np.clip(rest - own, -80, 80)))
        return maps
