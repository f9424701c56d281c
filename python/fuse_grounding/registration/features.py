"""SIFT features, their matches, and which earlier views a view is matched with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np

from fuse_grounding.environment.protocol import Observation

MAX_FEATURES = 1000
CONTRAST = 0.01
RATIO = 0.9
"""Largest angle to the best match over the angle to the second best (supplement, 3D Gaussian Splatting)."""
MAX_ANGLE = 0.8
"""Largest angle between matched descriptors, radians (supplement, 3D Gaussian Splatting)."""
NODES = 36
PITCH_WEIGHT = 0.5
"""Ring nodes that one step of pitch counts for: turning on the spot changes the picture less than moving."""

_NORM = 512.0
_NO_MATRIX = np.zeros((0, 0), np.float32)


@dataclass(frozen=True)
class Features:
    """Keypoints (N, 2) float64, pixels with centres at half-integers; descriptors (N, 128) float32.

    The descriptors are square roots of L1-normalised SIFT, times 512 and rounded: whole numbers whose
    dot products stay below 2^24, so that float32 products are exact and matching is the same on
    every machine, whatever the order of summation.
    """

    keypoints: np.ndarray
    descriptors: np.ndarray


@contextmanager
def _one_opencv_thread() -> Iterator[None]:
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def extract(rgb: np.ndarray, max_features: int = MAX_FEATURES, contrast: float = CONTRAST) -> Features:
    """The strongest `max_features` SIFT features of `rgb` (H, W, 3) uint8; none is a valid answer."""
    with _one_opencv_thread():
        sift = cv2.SIFT.create(nfeatures=max_features, contrastThreshold=contrast)
        found, raw = sift.detectAndCompute(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), None)
    if raw is None or not found:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    rows = np.array([(-k.response, k.pt[0], k.pt[1], k.angle, k.size) for k in found])
    order = np.lexsort(rows.T[::-1])[:max_features]
    share = raw[order] / np.maximum(raw[order].sum(axis=1, keepdims=True), 1e-12)
    # OpenCV counts pixel centres as whole numbers, COLMAP and FUSE as half-integers.
    return Features(rows[order, 1:3] + 0.5, np.rint(_NORM * np.sqrt(share)).astype(np.float32))


def match(first: Features, second: Features) -> np.ndarray:
    """Mutual nearest neighbours (M, 2) uint32 by angle, with the ratio and distance tests both ways."""
    if len(first.keypoints) < 2 or len(second.keypoints) < 2:
        return np.zeros((0, 2), np.uint32)
    with _one_opencv_thread():
        products = np.asarray(
            cv2.gemm(first.descriptors, second.descriptors, 1.0, _NO_MATRIX, 0.0, flags=cv2.GEMM_2_T)
        )
    forward, good = _nearest(products)
    rows = np.flatnonzero(good)
    # Only the columns that some row chose can be mutual.
    backward, good = _nearest(np.ascontiguousarray(products[:, forward[rows]].T))
    rows = rows[good & (backward == rows)]
    return np.stack([rows, forward[rows]], axis=1).astype(np.uint32)


def _nearest(products: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Per row the best column, and whether it passes the distance and ratio tests."""
    best = np.argmax(products, axis=1)
    rows = np.arange(len(best))
    top = products[rows, best]
    products[rows, best] = -1.0
    second = products.max(axis=1)
    products[rows, best] = top
    angle, next_angle = (np.arccos(np.minimum(p / (_NORM * _NORM), 1.0)) for p in (top, second))
    return best, (angle <= MAX_ANGLE) & (angle < RATIO * next_angle)


def nearest_views(view: Observation, earlier: Sequence[Observation], count: int) -> list[int]:
    """Indices into `earlier` of the `count` views to match `view` with, best first.

    Nearest on the ring when both have a node, then by the known camera centre; a view of which
    neither is known comes last. Ties go to the more recent view.
    """
    ranked = sorted(range(len(earlier)), key=lambda i: (*_distance(view, earlier[i]), -i))
    return ranked[:count]


def _distance(a: Observation, b: Observation) -> tuple[int, float]:
    if a.node is not None and b.node is not None:
        around = abs(a.node - b.node) % NODES
        tilt = abs((a.pitch_index or 0) - (b.pitch_index or 0))
        return 0, min(around, NODES - around) + PITCH_WEIGHT * tilt
    if a.camera is not None and b.camera is not None:
        return 0, float(np.linalg.norm(a.camera.center - b.camera.center))
    return 1, 0.0


def sample(rgb: np.ndarray, keypoints: np.ndarray) -> np.ndarray:
    """Colours (N, 3) uint8 of the pixels that hold `keypoints` (N, 2)."""
    height, width = rgb.shape[:2]
    column = np.clip(np.floor(keypoints[:, 0]).astype(int), 0, width - 1)
    row = np.clip(np.floor(keypoints[:, 1]).astype(int), 0, height - 1)
    return rgb[row, column]
