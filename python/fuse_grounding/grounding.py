"""What a search hands back: a move to make, or the grounded object and where it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from fuse_grounding import evidence
from fuse_grounding.config import MetricConfig, StoppingConfig
from fuse_grounding.perception.protocol import Detection
from fuse_grounding.planning.protocol import Decision
from fuse_grounding.record import EpisodeRecord, MaskEntry, ScoreEntry

_BOX_PERCENTILES = (1.0, 99.0)


@dataclass(frozen=True)
class Move:
    """Go there and look again. `action` indexes the 15 actions; `ring` nodes, positive to the
    camera's right; `pitch` levels, positive further down."""

    action: int
    ring: int
    pitch: int
    decision: Decision = field(repr=False)


@dataclass(frozen=True)
class Viewpoint:
    """Where a picture was taken: its place in the episode, on the ring, and its camera."""

    index: int
    node: int | None
    pitch_deg: float | None
    camera: Any | None


@dataclass(frozen=True)
class Place:
    """Where the object is, world frame, metres: centroid (3,) and box (2, 3), minimum then maximum."""

    centroid: np.ndarray
    box: np.ndarray


@dataclass(frozen=True)
class Grounded:
    """The end of a search. `label` and `mask` are None when no candidate was seen anywhere.

    `mask` (H, W) bool over `rgb`, the picture of `viewpoint`; `score` the best grounding score, None
    when no region was large enough; `instance_score` the segmenter's; `place` None without depth
    or camera; `record` the whole episode.
    """

    label: str | None
    mask: np.ndarray | None
    rgb: np.ndarray = field(repr=False)
    viewpoint: Viewpoint
    score: float | None
    instance_score: float | None
    place: Place | None
    record: EpisodeRecord = field(repr=False)

    @property
    def found(self) -> bool:
        """Whether anything was grounded."""
        return self.mask is not None

    @property
    def position(self) -> np.ndarray | None:
        """The object's centroid in the world, (3,) metres."""
        return None if self.place is None else self.place.centroid


@dataclass(frozen=True)
class Scored:
    """A detection with its depth proximity `depth` (None without a depth picture) and its grounding
    score `fused` (None for a region that is too small)."""

    detection: Detection
    pixels: int
    depth: float | None
    fused: float | None


def score(
    detections: Sequence[Detection], depth: np.ndarray | None, stopping: StoppingConfig
) -> list[Scored]:
    """r = w_s s + w_d d for every detection (supplement, "Depth-Proximity Stopping Rule").

    Without a depth picture the depth term is off: r = w_s s.
    """
    scored = []
    for detection in detections:
        pixels = int(np.count_nonzero(detection.mask))
        proximity = None
        if depth is not None:
            proximity = evidence.depth_proximity(
                depth,
                detection.mask,
                near=stopping.near_m,
                far=stopping.far_m,
                min_pixels=stopping.min_region_px,
            )
        fused = evidence.grounding_score(
            detection.score,
            proximity,
            pixels,
            weights=stopping.weights,
            min_pixels=stopping.min_region_px,
        )
        scored.append(Scored(detection, pixels, proximity, fused))
    return scored


def best_fused(scored: Sequence[Scored]) -> Scored | None:
    """The detection with the highest grounding score; the first of equals."""
    return max((s for s in scored if s.fused is not None), key=lambda s: s.fused or 0.0, default=None)


def best_instance(scored: Sequence[Scored]) -> Scored | None:
    """The detection with the highest segmentation score, however small; the first of equals."""
    return max(scored, key=lambda s: s.detection.score, default=None)


def choose(scored: Sequence[Scored], metric: MetricConfig) -> Scored | None:
    """The detection whose mask is returned, as `metric.select` says; None without detections."""
    surest = best_instance(scored)
    return best_fused(scored) or surest if metric.select == "fused" else surest


def score_entries(scored: Sequence[Scored]) -> list[ScoreEntry]:
    """One entry a label: its best instance by grounding score, then by segmentation score."""
    by_label: dict[str, list[Scored]] = {}
    for s in scored:
        by_label.setdefault(s.detection.label, []).append(s)
    entries = []
    for label, instances in by_label.items():
        best = best_fused(instances) or best_instance(instances)
        assert best is not None
        entries.append(
            ScoreEntry(
                label=label,
                score=float(best.detection.score),
                depth=best.depth,
                fused=best.fused,
                pixels=best.pixels,
                instances=len(instances),
            )
        )
    return entries


def locate(mask: np.ndarray, depth: np.ndarray | None, camera: Any | None) -> Place | None:
    """Centroid and box of the visible surface: mask pixels with depth, lifted into the world.

    x_world = R^T (z K^-1 (u + 1/2, v + 1/2, 1) - t) with planar depth z. The mask loses its border
    where it can, since border pixels often carry the depth of what lies behind; the centroid is
    the median and the box spans the 1st to 99th percentile of each coordinate.
    """
    if depth is None or camera is None:
        return None
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    region = inner if np.count_nonzero(inner) >= 50 else mask
    rows, columns = np.nonzero(region & np.isfinite(depth) & (depth > 0))
    if len(rows) == 0:
        return None
    z = depth[rows, columns].astype(np.float64)
    x = (columns + 0.5 - camera.cx) / camera.fx * z
    y = (rows + 0.5 - camera.cy) / camera.fy * z
    world = (np.stack([x, y, z], axis=1) - camera.translation) @ camera.rotation
    return Place(np.median(world, axis=0), np.percentile(world, _BOX_PERCENTILES, axis=0))


def encode_mask(mask: np.ndarray) -> MaskEntry:
    """Row-major run lengths, background first."""
    flat = np.concatenate([[False], mask.ravel(), [not mask.ravel()[-1]]])
    edges = np.flatnonzero(flat[1:] != flat[:-1])
    counts = np.diff(np.concatenate([[0], edges]))
    return MaskEntry(size=(mask.shape[0], mask.shape[1]), counts=[int(c) for c in counts])


def decode_mask(entry: MaskEntry) -> np.ndarray:
    """The inverse of `encode_mask`: (H, W) bool."""
    values = np.arange(len(entry.counts)) % 2 == 1
    return np.repeat(values, entry.counts).reshape(entry.size)
