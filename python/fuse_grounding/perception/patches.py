"""Evidence from patches, as in the paper's ablation that replaces the segmenter: coarse, from any encoder.

    p(label | patch) = softmax over labels and contrast of scale · ⟨patch, text⟩

The map of a prompted label is enlarged to the picture; each connected region above the threshold is a
detection, its score the mean of the map over it.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from fuse_grounding.errors import InputError
from fuse_grounding.perception.encoder import Encoder
from fuse_grounding.perception.pictures import check_rgb
from fuse_grounding.perception.protocol import Detection

THRESHOLD = 0.35
MIN_PIXELS = 60


class PatchSegmenter:
    """Regions where patches look like a label; implements `Segmenter` for any label.

    `contrast`: what a patch may be instead, background included; prompted labels are added to it. `scale`
    turns cosines into logits.
    """

    labels: tuple[str, ...] | None = None

    def __init__(self, encoder: Encoder, contrast: Sequence[str], scale: float) -> None:
        if not contrast:
            raise InputError("contrast is empty: a softmax over the prompted label alone is always 1")
        self._encoder, self._contrast, self._scale = encoder, tuple(contrast), scale

    def maps(self, rgb: np.ndarray, labels: Sequence[str]) -> np.ndarray:
        """(N, h, w) float32: how likely each patch is each label."""
        everything = list(dict.fromkeys([*labels, *self._contrast]))
        logits = self._scale * self._encoder.patches(rgb) @ self._encoder.text(everything).T
        e = np.exp(logits - logits.max(2, keepdims=True))
        shares = e / e.sum(2, keepdims=True)
        return np.moveaxis(shares[..., [everything.index(label) for label in labels]], 2, 0)

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        """See `Segmenter.segment`; regions of fewer than 60 pixels are left out."""
        rgb = check_rgb(rgb)
        if isinstance(labels, str):
            raise InputError(f"labels must be a sequence of labels, found the string `{labels}`")
        wanted = list(dict.fromkeys(labels))
        if not wanted:
            return []
        detections = []
        for label, coarse in zip(wanted, self.maps(rgb, wanted), strict=True):
            fine = cv2.resize(coarse, rgb.shape[1::-1], interpolation=cv2.INTER_LINEAR)
            count, regions = cv2.connectedComponents((fine > THRESHOLD).astype(np.uint8), connectivity=4)
            for region in range(1, count):
                mask = regions == region
                if np.count_nonzero(mask) >= MIN_PIXELS:
                    mask.setflags(write=False)
                    detections.append(Detection(label, float(fine[mask].mean()), mask))
        return sorted(detections, key=lambda d: -d.score)
