"""How good a segmenter is on pictures whose truth is known, and the calibration of its scores."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import cv2
import numpy as np

from fuse_grounding.perception.embedded import Candidates, EmbeddedSegmenter
from fuse_grounding.training.segmenter_data import Picture

GOOD_IOU = 0.5


@dataclass
class Found:
    """One true object and what was made of it."""

    category: str
    pixels: int
    width: float  # of the visible part where it is widest, pixels: twice the greatest distance to its edge
    visible: float  # share of the object that other things leave in sight; NaN when not known
    returned_iou: float  # best mask that is returned for its label; 0 when none is
    first_iou: float  # highest scored mask of its label that no other object of the label explains better
    object_iou: float  # best mask of all, whatever its label
    first_label: str  # most likely label of that best mask, "" when no mask overlaps by 0.5


@dataclass
class Score:
    """Results over pictures: true objects, and every returned detection as (score, right or wrong)."""

    objects: list[Found] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)
    right: list[bool] = field(default_factory=list)
    pictures: int = 0

    def select(self, visible: float = 0.0, pixels: int = 0, below: int = 1 << 30) -> list[Found]:
        """Objects at least so visible and of `pixels` ≤ size < `below`."""
        return [o for o in self.objects if o.visible >= visible and pixels <= o.pixels < below]

    def calibration_error(self, bins: int = 10) -> float:
        """Expected calibration error of the returned scores."""
        return calibration_error(np.array(self.scores), np.array(self.right), bins)


def calibration_error(scores: np.ndarray, right: np.ndarray, bins: int = 10) -> float:
    """Mean of |mean score − share right| over equal bins of the score, weighted by their counts."""
    which = np.minimum((scores * bins).astype(int), bins - 1)
    total = 0.0
    for b in range(bins):
        inside = which == b
        if inside.any():
            total += inside.sum() * abs(float(scores[inside].mean()) - float(right[inside].mean()))
    return total / max(len(scores), 1)


def overlaps(masks: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(N, M) intersection over union of (N, H, W) and (M, H, W) bool masks."""
    pixels = masks.shape[1] * masks.shape[2]
    a = masks.reshape(len(masks), pixels).astype(np.float32)
    b = truth.reshape(len(truth), pixels).astype(np.float32)
    both = a @ b.T
    return both / np.maximum(a.sum(1)[:, None] + b.sum(1)[None] - both, 1.0)


def correct(
    found: Candidates, picture: Picture, labels: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray, list[dict]]:
    """Overlap (N, M) with the true objects, and (N, labels) whether a mask is that label with IoU ≥ 0.5."""
    _, ids, objects = picture
    truth = ids[None] == np.array([o["id"] for o in objects]).reshape(-1, 1, 1)
    iou = overlaps(found.masks, truth)
    right = np.zeros((len(found.masks), len(labels)), bool)
    for j, o in enumerate(objects):
        right[:, labels.index(o["category"])] |= iou[:, j] >= GOOD_IOU
    return iou, right, objects


def evaluate(segmenter: EmbeddedSegmenter, pictures: Iterable[Picture], min_score: float) -> Score:
    """Runs the segmenter with every label prompted and compares with the truth."""
    score, labels = Score(), segmenter.labels
    for picture in pictures:
        found = segmenter.candidates(np.ascontiguousarray(picture[0]))
        iou, right, objects = correct(found, picture, labels)
        returned = found.scores >= min_score
        score.scores += found.scores[returned].tolist()
        score.right += right[returned].tolist()
        score.pictures += 1
        for j, o in enumerate(objects):
            width = 2.0 * float(
                cv2.distanceTransform((picture[1] == o["id"]).astype(np.uint8), cv2.DIST_L2, 5).max()
            )
            score.objects.append(_found(j, o, width, found, iou, returned, objects, labels))
    return score


def _found(
    j: int,
    o: dict,
    width: float,
    found: Candidates,
    iou: np.ndarray,
    returned: np.ndarray,
    objects: list[dict],
    labels: tuple[str, ...],
) -> Found:
    column = labels.index(o["category"])
    mine = np.nonzero(returned[:, column])[0]
    same = [k for k, other in enumerate(objects) if other["category"] == o["category"]]
    # With two mugs in sight, the mask of the one does not count against the other.
    first = next(
        (
            i
            for i in mine[np.argsort(-found.scores[mine, column], kind="stable")]
            if iou[i, same].max(initial=0.0) < GOOD_IOU or iou[i, j] == iou[i, same].max()
        ),
        None,
    )
    best = int(iou[:, j].argmax()) if len(iou) else -1
    best_iou = float(iou[best, j]) if len(iou) else 0.0
    return Found(
        category=o["category"],
        pixels=o["visible_px"],
        width=width,
        visible=o["visible_px"] / o["unoccluded_px"] if o["unoccluded_px"] else float("nan"),
        returned_iou=float(iou[mine, j].max(initial=0.0)),
        first_iou=0.0 if first is None else float(iou[first, j]),
        object_iou=best_iou,
        first_label=labels[int(found.scores[best].argmax())] if best_iou >= GOOD_IOU else "",
    )


def isotonic(raw: np.ndarray, right: np.ndarray, knots: int = 24) -> tuple[list[float], list[float]]:
    """A rising piecewise linear map raw → probability: pool adjacent violators, then few knots.

    Equal-count groups keep the tails from being fitted to single samples.
    """
    order = np.argsort(raw, kind="stable")
    groups = np.array_split(order, min(200, max(1, len(order) // 20)))
    x = [float(raw[g].mean()) for g in groups]
    blocks: list[list[float]] = []
    for g in groups:
        blocks.append([float(right[g].mean()), float(len(g)), 1.0])
        while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
            value, weight, count = blocks.pop()
            a = blocks[-1]
            a[0] = (a[0] * a[1] + value * weight) / (a[1] + weight)
            a[1], a[2] = a[1] + weight, a[2] + count
    y = np.repeat([b[0] for b in blocks], [int(b[2]) for b in blocks])
    at = np.unique(np.linspace(0, len(x) - 1, knots).round().astype(int))
    xs, ys = [0.0, *(x[i] for i in at), 1.0], [0.0, *(float(y[i]) for i in at), float(y[-1])]
    return [round(v, 6) for v in xs], [round(v, 6) for v in ys]
