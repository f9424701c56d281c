"""Metrics that know the truth (supplement, "Metric Computation"; docs/metrics.md). An agent never sees
what they see."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.config import Config
from fuse_grounding.environment import Target
from fuse_grounding.grounding import Grounded
from fuse_grounding.perception.protocol import Segmenter
from fuse_grounding.record import HOSTED

_EPSILON = 1e-9
_PERCENTILE = 90.0

Value = bool | int | float | None


@dataclass(frozen=True)
class Metric:
    """A column of results: its name in a row, how people call it, its unit, and which way is better.

    An `optional` one may be None in an episode that ran through; docs/metrics.md says when.
    """

    name: str
    title: str
    unit: str
    better: Literal["higher", "lower", "neither"]
    optional: bool = False


METRICS = (
    Metric("success", "Success", "share of episodes", "higher"),
    Metric("iou", "IoU", "share", "higher"),
    Metric("online_actions", "Online actions", "actions", "lower"),
    Metric("observations", "Observations", "views", "lower"),
    Metric("total_steps", "Total steps", "actions and seed motions", "lower"),
    Metric("target_pixel_ratio", "Target pixel ratio", "share", "higher"),
    Metric("target_pixel_ratio_90", "Target pixel ratio (90)", "share", "higher"),
    Metric(
        "observed_pixel_ratio_90", "Observed pixel ratio, 90th percentile", "share", "higher", optional=True
    ),
    Metric("center_score", "Center", "share", "higher"),
    Metric("distance_score", "Distance", "share", "higher"),
    Metric("final_score", "Final segmenter score", "score", "higher", optional=True),
    Metric("best_target_score", "Best target score", "score", "higher"),
    Metric("position_error_m", "Position error", "m", "lower", optional=True),
    Metric("runtime_seconds", "Runtime", "s", "lower"),
)
"""Every metric of a row, `success` and `iou` first: these two count a failed episode as 0."""


class Truth(Protocol):
    """A world that knows: ids and camera of any returned view, and every valid object."""

    def true_instances(self, node: int | None, pitch_index: int | None) -> np.ndarray:
        """(H, W) uint32 ids at a viewpoint, of the canonical view for None."""
        ...

    def true_camera(self, node: int | None, pitch_index: int | None) -> Camera:
        """The exact camera at a viewpoint, of the canonical view for None."""
        ...

    def true_targets(self) -> Sequence[Target]:
        """The valid objects, the sampled target first."""
        ...


@dataclass(frozen=True)
class Match:
    """The valid object that a grounding is about: `mask` (H, W) bool is its true one, `iou` the overlap."""

    target: Target
    mask: np.ndarray
    iou: float


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two (H, W) masks; 0 when both are empty."""
    union = np.count_nonzero(a | b)
    return float(np.count_nonzero(a & b) / union) if union else 0.0


def pixel_ratio(pixels: float, least: float, most: float) -> float:
    """clip((P - P_min) / (P_max - P_min + eps), 0, 1)."""
    return float(np.clip((pixels - least) / (most - least + _EPSILON), 0, 1))


def robust_pixel_ratio(pixels: float, visible_px: np.ndarray) -> float:
    """clip((P - P_min) / (P_90 - P_min + eps), 0, 1), P_90 the 90th percentile of (36, 3) pixel counts.

    Where less than a tenth of the views shows more than P_min, P_90 = P_min: 1 for those, 0 for the rest.
    """
    return pixel_ratio(pixels, float(visible_px.min()), float(np.percentile(visible_px, _PERCENTILE)))


def observed_pixel_ratio(ratios: Sequence[float]) -> float | None:
    """90th percentile of the pixel ratios of the observed views, linear between ranks; None without any."""
    return float(np.percentile(ratios, _PERCENTILE)) if len(ratios) else None


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


def match(mask: np.ndarray | None, ids: np.ndarray, targets: Sequence[Target]) -> Match:
    """The valid object that a predicted `mask` (H, W) overlaps best; the first of equals.

    `ids` (H, W) are the view's true ones. Without a mask, or where nothing overlaps, it is the first of
    `targets` at IoU 0.
    """
    truths = [ids == target.instance for target in targets]
    overlaps = [0.0 if mask is None else iou(mask, truth) for truth in truths]
    best = int(np.argmax(overlaps))
    return Match(targets[best], truths[best], overlaps[best])


def evaluate(grounded: Grounded, truth: Truth, segmenter: Segmenter, config: Config) -> dict[str, Value]:
    """All metrics of a returned grounding but the counts, which its record has.

    `iou` is the best over the valid objects, `success` whether it reaches `metric.iou`. The others are
    about the object with the best IoU, the sampled target where none overlaps. What each means, and when
    it is None, is in docs/metrics.md.
    """
    result, view = grounded.record.result, grounded.viewpoint
    assert result is not None, "a grounding comes with its result"
    place = view.node, pitch_index(config, view.pitch_deg)
    found = match(grounded.mask, truth.true_instances(*place), list(truth.true_targets()))
    target, pixels = found.target, int(np.count_nonzero(found.mask))
    distance = float(np.linalg.norm(truth.true_camera(*place).center - target.position))
    began = time.perf_counter()
    final_score = _final_score(segmenter, grounded.rgb, target.label)
    seconds = time.perf_counter() - began
    return {
        "success": bool(found.iou >= config.metric.iou),
        "iou": found.iou,
        "target_pixels": pixels,
        "target_pixel_ratio": pixel_ratio(pixels, target.least_pixels, target.most_pixels),
        "target_pixel_ratio_90": robust_pixel_ratio(pixels, target.visible_px),
        "observed_pixel_ratio_90": observed_pixel_ratio(_observed_ratios(grounded, target, config)),
        "center_score": center_score(found.mask),
        "distance_score": distance_score(distance, target.least_distance, target.most_distance),
        "position_error_m": None
        if grounded.position is None
        else float(np.linalg.norm(grounded.position - target.position)),
        "final_score": final_score,
        "best_target_score": result.score or 0.0,
        "runtime_seconds": round(result.wall_seconds - result.timings.get(HOSTED, 0.0) + seconds, 6),
    }


def pitch_index(config: Config, pitch_deg: float | None) -> int | None:
    """Which of the configured pitches; None off the ring."""
    return None if pitch_deg is None else config.camera.pitches_deg.index(pitch_deg)


def _observed_ratios(grounded: Grounded, target: Target, config: Config) -> list[float]:
    """Pixel ratio of `target` in every online view on the ring, again where the camera came again."""
    places = ((s.node, pitch_index(config, s.pitch_deg)) for s in grounded.record.steps)
    return [
        pixel_ratio(target.visible_px[node, pitch], target.least_pixels, target.most_pixels)
        for node, pitch in places
        if node is not None and pitch is not None
    ]


def _final_score(segmenter: Segmenter, rgb: np.ndarray, label: str) -> float | None:
    """None when the segmenter's closed set lacks the label."""
    if segmenter.labels is not None and label not in segmenter.labels:
        return None
    return max((float(d.score) for d in segmenter.segment(rgb, [label])), default=0.0)
