"""Metrics that know the truth (supplement, "Metric Computation"). An agent never sees what they see."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from fuse_grounding.config import Config
from fuse_grounding.environment import Target
from fuse_grounding.grounding import Grounded
from fuse_grounding.perception.protocol import Segmenter

_EPSILON = 1e-9


class Truth(Protocol):
    """A world that knows: ids in any returned view, and every valid object, the sampled target first."""

    def true_instances(self, node: int | None, pitch_index: int | None) -> np.ndarray:
        """(H, W) uint32 ids at a viewpoint, of the canonical view for None."""
        ...

    def true_targets(self) -> Sequence[Target]:
        """The valid objects, the sampled target first."""
        ...


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two (H, W) masks; 0 when both are empty."""
    union = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / union) if union else 0.0


def pixel_ratio(pixels: float, least: float, most: float) -> float:
    """clip((P - P_min) / (P_max - P_min + eps), 0, 1)."""
    return float(np.clip((pixels - least) / (most - least + _EPSILON), 0, 1))


def distance_score(distance: float, least: float, most: float) -> float:
    """clip((D_max - D) / (D_max - D_min + eps), 0, 1)."""
    return float(np.clip((most - distance) / (most - least + _EPSILON), 0, 1))


def center_score(mask: np.ndarray) -> float:
    """One minus the centroid's distance to the image centre over centre to corner; 0 for an empty mask."""
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return 0.0
    cy, cx = mask.shape[0] / 2, mask.shape[1] / 2
    off = np.hypot(columns.mean() + 0.5 - cx, rows.mean() + 0.5 - cy)
    return float(1 - off / np.hypot(cx, cy))


def evaluate(
    grounded: Grounded, truth: Truth, segmenter: Segmenter, config: Config
) -> dict[str, bool | int | float | None]:
    """All metrics of a returned grounding.

    `iou` is the best over the valid objects, `success` whether it reaches `metric.iou`. The others are
    about the object with the best IoU, the sampled target where none overlaps. `final_score` is the
    segmenter's surest instance of the sampled target's label in the returned view.
    """
    view = grounded.viewpoint
    pitch = None if view.node is None else _pitch_index(config, view.pitch_deg)
    ids = truth.true_instances(view.node, pitch)
    targets = list(truth.true_targets())
    overlaps = [
        0.0 if grounded.mask is None else iou(grounded.mask, ids == target.instance) for target in targets
    ]
    best = int(np.argmax(overlaps))
    target, mask = targets[best], ids == targets[best].instance
    pixels = int(np.count_nonzero(mask))
    center = None if view.camera is None else view.camera.center
    distance = None if center is None else float(np.linalg.norm(center - target.position))
    return {
        "success": bool(overlaps[best] >= config.metric.iou),
        "iou": overlaps[best],
        "target_pixels": pixels,
        "target_pixel_ratio": pixel_ratio(pixels, target.least_pixels, target.most_pixels),
        "center_score": center_score(mask),
        "distance_score": None
        if distance is None
        else distance_score(distance, target.least_distance, target.most_distance),
        "position_error_m": None
        if grounded.position is None
        else float(np.linalg.norm(grounded.position - target.position)),
        "final_score": _final_score(segmenter, grounded.rgb, targets[0].label),
    }


def _pitch_index(config: Config, pitch_deg: float | None) -> int | None:
    return None if pitch_deg is None else config.camera.pitches_deg.index(pitch_deg)


def _final_score(segmenter: Segmenter, rgb: np.ndarray, label: str) -> float | None:
    """None when the segmenter's closed set lacks the label."""
    if segmenter.labels is not None and label not in segmenter.labels:
        return None
    return max((float(d.score) for d in segmenter.segment(rgb, [label])), default=0.0)
