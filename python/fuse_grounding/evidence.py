"""Semantic and geometric evidence, and what is decided from it.

Constants and formulas are the supplement's ("Semantic and Geometric Evidence", "Depth-Proximity
Stopping Rule", "Confidence Gate"). Arrays are taken without a copy where they are contiguous and
are never written to; but for `proximity_map`, the work runs in native code without the GIL, on all cores,
with the same bits for any number of threads. Whatever the caller can put right raises `InputError`, which
names the argument, what was found and what was expected.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fuse_grounding import _core
from fuse_grounding._core import Patience
from fuse_grounding.arguments import whole
from fuse_grounding.errors import InputError

__all__ = [
    "ACTIONS",
    "NOOP",
    "Patience",
    "action_entropy",
    "action_scores",
    "choose_action",
    "depth_proximity",
    "functional_uncertainty",
    "fuse",
    "geometric_uncertainty",
    "grounding_score",
    "proximity_map",
    "regions",
    "semantic_map",
    "ssnr",
]

Coupled = Literal["union", "quadrant", "mean"]
Gradient = Literal["magnitude", "vector"]

ACTIONS: tuple[tuple[int, int], ...] = tuple((p, r) for r in (-1, 0, 1) for p in (-2, -1, 0, 1, 2))
"""The sensing actions by index, each (nodes along the ring, right positive; pitch levels, down positive)."""
NOOP = ACTIONS.index((0, 0))
"""Index of the action that stays."""


def ssnr(
    observed: np.ndarray,
    rendered: np.ndarray | None,
    *,
    gradient: Gradient = "magnitude",
    gray_range: float = 1.0,
    missing_db: float = 0.0,
    float_render: bool = False,
) -> NDArray[np.float32]:
    """Structural signal-to-noise ratio, (H, W) float32 in decibels, clipped to [-30, 30].

    10 log10((A + 1e-8) / (B + 1e-8)), where A sums the squared Sobel gradient magnitude of the
    observation over an 11x11 window and B the squared difference of the two images' magnitudes.
    Grey is 0.299 R + 0.587 G + 0.114 B; borders are reflected without repeating the edge.

    `observed`: (H, W, 3) uint8. `rendered`: the same, or (H, W, 3) float32 in [0, 1], or None when
    there is no rendering: `missing_db` everywhere. A float rendering is clipped and rounded to
    8 bits like the observation unless `float_render`. `gradient="vector"` takes the difference of
    gradient vectors. `gray_range` is the grey of white; it matters against 1e-8 only.
    """
    return _core.ssnr(observed, rendered, gradient, gray_range, missing_db, float_render)


def geometric_uncertainty(
    observed: np.ndarray,
    rendered: np.ndarray | None,
    *,
    alpha: float = 0.8,
    normalization: Literal["decibel", "spatial"] = "decibel",
    gradient: Gradient = "magnitude",
    gray_range: float = 1.0,
    missing_db: float = 0.0,
    float_render: bool = False,
) -> NDArray[np.float32]:
    """How badly the map explains the observation, (H, W) float32 in [0, alpha].

    `normalization="decibel"` (supplement): alpha (1 - (SSNR + 30) / 60); 0.4 everywhere without a
    rendering. `"spatial"` (paper, the evidence map's equation): alpha (1 - Norm(A / (B + 1e-8))),
    where Norm maps the image's smallest value to 0 and its largest to 1; alpha / 2 where all are
    alike. The other arguments are those of `ssnr`.
    """
    return _core.geometric_uncertainty(
        observed, rendered, alpha, normalization, gradient, gray_range, missing_db, float_render
    )


def semantic_map(masks: np.ndarray, scores: ArrayLike, *, normalize: bool = False) -> NDArray[np.float32]:
    """The strongest detection at each pixel, (H, W) float32 in [0, 1]; 0 where there is none.

    `masks`: (N, H, W) bool, N may be 0. `scores`: (N,) in [0, 1]. `normalize` divides by the
    largest value (paper, "Functional Uncertainty").
    """
    return _core.semantic_map(masks, _vector("scores", scores), normalize)


def fuse(
    semantic: np.ndarray, geometric: np.ndarray, semantic_weight: float = 1.0, geometric_weight: float = 1.0
) -> NDArray[np.float32]:
    """E = w_s S + w_g U_geo, (H, W) float32, of two such maps."""
    return _core.fuse_maps(semantic, geometric, semantic_weight, geometric_weight)


def proximity_map(depth: np.ndarray, *, near: float = 0.3, far: float = 1.2) -> NDArray[np.float32]:
    """1 - clip((depth - near) / (far - near), 0, 1) at each pixel, (H, W) float32; 0 where there is no depth.

    `depth`: (H, W) float32 in metres; no depth is one that is not positive and finite. Of one pixel it is
    `depth_proximity`; of a region, that takes the mean depth first.
    """
    if not isinstance(depth, np.ndarray) or depth.ndim != 2 or depth.dtype != np.float32 or not depth.size:
        found = f"{depth.dtype} {depth.shape}" if isinstance(depth, np.ndarray) else type(depth).__name__
        raise InputError(f"depth must be a float32 array (H, W), found {found}")
    if not 0 <= near < far:
        raise InputError(f"near must be at least 0 and below far, found {near} and {far}")
    known = np.isfinite(depth) & (depth > 0)
    proximity = 1.0 - np.clip((np.where(known, depth, far) - near) / (far - near), 0.0, 1.0)
    return proximity.astype(np.float32)


def functional_uncertainty(semantic: np.ndarray, geometric: np.ndarray) -> NDArray[np.float32]:
    """U_func = (1 - S) + U_geo (paper, "Functional Uncertainty"), (H, W) float32."""
    return _core.functional_uncertainty(semantic, geometric)


def regions(height: int, width: int, *, coupled: Coupled = "union") -> NDArray[np.bool_]:
    """The image region of every action, (15, height, width) bool.

    Moving right stands for the right half, pitching down for the lower half, and so on; staying
    for the whole image. An action that does both stands for the union of its halves or for the
    quadrant; under "mean" the scores of two halves are averaged, and their union is drawn. Of an
    odd size, the middle belongs to the right and lower half.
    """
    return _core.action_regions(whole("height", height), whole("width", width), coupled)


def action_scores(
    evidence: np.ndarray, actions: Sequence[int] | None = None, *, coupled: Coupled = "union"
) -> NDArray[np.float32]:
    """Q(a): the mean of the evidence over each action's region, (len(actions),) float32.

    `evidence`: (H, W) float32, finite, at least 2x2. `actions`: indices 0 to 14, all by default.
    """
    scores = _core.action_scores(evidence, coupled)
    if actions is None:
        return scores
    indices = np.asarray(actions)
    if indices.ndim != 1 or (indices.size and not np.issubdtype(indices.dtype, np.integer)):
        raise InputError(f"actions must be a list of action indices, found {actions!r}")
    wrong = indices[(indices < 0) | (indices >= len(ACTIONS))]
    if wrong.size:
        raise InputError(f"actions must be indices from 0 to {len(ACTIONS) - 1}, found {wrong[0]}")
    return scores[indices.astype(np.intp)]


def choose_action(
    scores: ArrayLike, mask: ArrayLike, *, stride: Literal["one", "two"] = "one", noop: bool = False
) -> int:
    """Index of the best feasible action.

    `scores`: (15,). `mask`: (15,) bool, which actions are feasible. One- and two-node moves share
    a region and tie: `stride` says which wins; then the lowest index. `noop` allows staying.
    Raises InputError when nothing is feasible.
    """
    return _core.choose_action(_vector("scores", scores), _flags("mask", mask), stride, noop)


def action_entropy(values: ArrayLike, temperature: float = 0.1, mask: ArrayLike | None = None) -> float:
    """Entropy of softmax(values / temperature) over feasible actions, over the log of their number.

    0 when one action stands out (or only one is feasible), 1 when all are alike. `values`: (N,);
    `mask`: (N,) bool, all feasible by default. Raises InputError when none is feasible and for NaN
    among the feasible values; infeasible ones are not looked at.
    """
    flags = None if mask is None else _flags("mask", mask)
    return _core.action_entropy(_vector("values", values), temperature, flags)


def depth_proximity(
    depth: np.ndarray, mask: np.ndarray, *, near: float = 0.3, far: float = 1.2, min_pixels: int = 500
) -> float:
    """1 - clip((mean depth - near) / (far - near), 0, 1) of a region; 1 is near.

    `depth`: (H, W) float32 in metres; depths that are not positive and finite are left out.
    `mask`: (H, W) bool. 0 when no valid depth is left, or for a region of fewer than `min_pixels`
    pixels, which is not a valid candidate.
    """
    return _core.depth_proximity(depth, mask, near, far, whole("min_pixels", min_pixels))


def grounding_score(
    score: float,
    proximity: float | None,
    pixels: int,
    *,
    weights: tuple[float, float] = (0.7, 0.3),
    min_pixels: int = 500,
) -> float | None:
    """r = w_s s + w_d d of a region, None when it has fewer than `min_pixels` pixels.

    `score` s and `proximity` d are in [0, 1]; without a depth picture (None) the depth term is off.
    """
    return _core.grounding_score(
        score, proximity, whole("pixels", pixels), weights, whole("min_pixels", min_pixels)
    )


def _vector(name: str, values: ArrayLike) -> np.ndarray[Any, np.dtype[np.float32]]:
    """A list or array of real numbers as contiguous float32."""
    array = np.asarray(values)
    if array.size == 0:
        array = array.astype(np.float32)
    if array.ndim != 1 or array.dtype.kind not in "fiu":
        raise InputError(
            f"{name} must be a list of numbers, found {array.dtype} array of shape {array.shape}"
        )
    return np.ascontiguousarray(array, np.float32)


def _flags(name: str, values: ArrayLike) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """A list or array of booleans; numbers are refused, since indices would pass for flags."""
    array = np.asarray(values)
    if array.ndim != 1 or array.dtype != np.bool_:
        raise InputError(
            f"{name} must be a list of booleans, found {array.dtype} array of shape {array.shape}"
        )
    return np.ascontiguousarray(array)
