"""What a view says about where the candidates are, in a few numbers: what the planner `summary` reads.

    pitch (one of 3) | S averaged over 4×3 cells | best detection | second best | how many

S is the semantic map of the candidates. The best detection is described by its score, its middle, its size,
its depth, its grounding score and which borders of the picture it touches; absent things are zeros.
`mirrored` is what the same scene would give seen in a mirror: going left is then going right.
"""

from __future__ import annotations

import cv2
import numpy as np

from fuse_grounding import grounding
from fuse_grounding.config import Config
from fuse_grounding.perception.protocol import Detection
from fuse_grounding.planning.explicit import semantic_map
from fuse_grounding.planning.protocol import Situation

PITCHES, CELLS = 3, (4, 3)
NAMES = (
    *(f"pitch_{i}" for i in range(PITCHES)),
    *(f"semantic_{row}{column}" for row in range(CELLS[1]) for column in range(CELLS[0])),
    *(f"best_{name}" for name in ("score", "x", "y", "size", "depth_m", "fused")),
    *(f"best_touches_{side}" for side in ("left", "right", "top", "bottom")),
    *(f"second_{name}" for name in ("score", "x", "y")),
    "detections_of_10",
)
BORDER = 3
"""Pixels from the edge of the picture that count as touching it."""


def summarize(situation: Situation, config: Config) -> np.ndarray:
    """(29,) float32, in the order of `NAMES`; no truth and no map enter."""
    pitch = np.zeros(PITCHES)
    if situation.pitch_index is not None:
        pitch[situation.pitch_index] = 1.0
    cells = cv2.resize(semantic_map(situation, config), CELLS, interpolation=cv2.INTER_AREA)
    best, second = np.zeros(10), np.zeros(3)
    order = sorted(situation.detections, key=lambda d: -d.score)
    if order:
        best[:] = _described(order[0], situation, config)
    if len(order) > 1:
        second[:] = (order[1].score, *_middle(order[1].mask))
    parts = (pitch, cells.reshape(-1), best, second, [len(order) / 10.0])
    return np.concatenate(parts).astype(np.float32)


def mirrored(summaries: np.ndarray) -> np.ndarray:
    """(N, 29) → (N, 29): left and right exchanged, in cells, borders and where a detection's middle is."""
    at = {name: i for i, name in enumerate(NAMES)}
    source = np.arange(len(NAMES))
    for row in range(CELLS[1]):
        for column in range(CELLS[0]):
            source[at[f"semantic_{row}{column}"]] = at[f"semantic_{row}{CELLS[0] - 1 - column}"]
    source[at["best_touches_left"]], source[at["best_touches_right"]] = (
        at["best_touches_right"],
        at["best_touches_left"],
    )
    turned = summaries[:, source]
    for which in ("best", "second"):
        there, x = summaries[:, at[f"{which}_score"]] > 0, at[f"{which}_x"]
        turned[there, x] = 1.0 - summaries[there, x]
    return turned


def _described(detection: Detection, situation: Situation, config: Config) -> list[float]:
    mask = detection.mask
    (scored,) = grounding.score([detection], situation.depth, config.stopping)
    seen = situation.depth[mask] if situation.depth is not None else np.zeros(0)
    seen = seen[np.isfinite(seen) & (seen > 0)]
    depth = float(seen.mean(dtype=np.float64)) if len(seen) else 0.0
    sides = (mask[:, :BORDER], mask[:, -BORDER:], mask[:BORDER], mask[-BORDER:])
    size = float(np.sqrt(scored.pixels / mask.size))
    middle = _middle(mask)
    return [
        detection.score,
        *middle,
        size,
        depth,
        scored.fused or 0.0,
        *(float(side.any()) for side in sides),
    ]


def _middle(mask: np.ndarray) -> tuple[float, float]:
    """Centroid of a mask as shares of width and height; the picture's middle for an empty one."""
    rows, columns = np.nonzero(mask)
    if len(rows) == 0:
        return 0.5, 0.5
    return (float(columns.mean()) + 0.5) / mask.shape[1], (float(rows.mean()) + 0.5) / mask.shape[0]
