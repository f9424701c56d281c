"""Patch-level evidence, the paper's ablation of the segmenter: an encoder's patches against a label's text.

The paper says no more than "CLIP (Patch-level)"; the rest is ours. Each label l is held against what a table
is full of anyway (`BACKGROUND`), by itself, as SAM3 is:

    p_l(u) = exp(100 f_u . t_l) / (exp(100 f_u . t_l) + sum_b exp(100 f_u . t_b))

with unit vectors f_u of the patches and t of the texts, 100 the scale at which CLIP was trained. The grid is
enlarged bilinearly; each connected region with p_l at least the threshold is an instance, its score the mean
of p_l there.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from fuse_grounding.perception.prompts import check_labels, check_picture, words
from fuse_grounding.perception.protocol import Detection, Encoder

THRESHOLD = 0.5
SCALE = 100.0
PROMPT = "a photo of a {}"
BACKGROUND = ("a photo of a table", "a photo of a wall", "a photo of a floor", "a photo of an object")


class PatchSegmenter:
    """Regions of patches that look like a label, by any `Encoder`; implements `Segmenter`."""

    labels = None

    def __init__(self, encoder: Encoder, threshold: float = THRESHOLD) -> None:
        self._encoder, self._threshold = encoder, threshold
        self._background = encoder.text(BACKGROUND)

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        """See `Segmenter`. Raises InputError also for a label that the encoder cannot read."""
        rgb = check_picture(rgb)
        wanted = check_labels(labels, None)
        if not wanted:
            return []
        maps = self.maps(rgb, wanted)
        detections = []
        for label, small in zip(wanted, maps, strict=True):
            likely = cv2.resize(small, rgb.shape[1::-1], interpolation=cv2.INTER_LINEAR)
            count, regions = cv2.connectedComponents((likely >= self._threshold).astype(np.uint8))
            for region in range(1, count):
                mask = regions == region
                detections.append(Detection(label, float(likely[mask].mean()), mask))
        # Stable: equal scores stay in the order of labels, then of regions.
        return sorted(detections, key=lambda d: -d.score)

    def maps(self, rgb: np.ndarray, labels: Sequence[str]) -> np.ndarray:
        """(N, h, w) float32 in [0, 1]: how much each patch looks like each label."""
        patches = self._encoder.patches(rgb)
        texts = self._encoder.text([PROMPT.format(words(label)) for label in labels])
        like = SCALE * np.moveaxis(patches @ texts.T, -1, 0)
        other = SCALE * (patches @ self._background.T)
        # log sum exp, about its largest: e^100 is beyond float32.
        most = other.max(-1, keepdims=True)
        rest = most[..., 0] + np.log(np.exp(other - most).sum(-1))
        return (1 / (1 + np.exp(np.clip(rest - like, -80, 80)))).astype(np.float32)
