"""Explicit evidence exploration: look where the evidence is, by half images.

    E = w_s S + w_g d U_geo,   Q(a) = mean of E over the region of a,   a* = argmax over the options

S is the semantic map of the candidates, U_geo the inverted SSNR between the picture and a rendering
of the map after it was refined with that picture (paper, Eq. for E; supplement, "Semantic and
Geometric Evidence"). d, ours, is each pixel's depth proximity; 1 with `evidence.within_reach = false`, as in
the paper, and without depth. `semantic_only` plans on S alone, `geometry_only` on d U_geo alone.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from fuse_grounding import evidence
from fuse_grounding.config import Config
from fuse_grounding.planning.options import options
from fuse_grounding.planning.protocol import Decision, EvidenceMaps, Rendering, Situation
from fuse_grounding.record import Stopwatch

Kind = Literal["explicit", "semantic_only", "geometry_only"]


class Explicit:
    """Plans on evidence maps; refines the map first unless only semantics count."""

    start: Literal["here"] = "here"
    planner = None

    def __init__(self, kind: Kind, config: Config):
        self._kind = kind
        self._config = config

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        """Refine, render, SSNR, fuse, score, choose."""
        maps = self._look(situation, clock)
        with clock("plan"):
            action, values = choose(maps.field, options(situation, self._config), self._config)
        return Decision(action, self._kind, values, maps=maps)

    def _look(self, situation: Situation, clock: Stopwatch) -> EvidenceMaps:
        """The evidence maps of this view, the map being refined on the way."""
        if self._kind == "semantic_only" or situation.scene is None:
            with clock("evidence"):
                semantic = semantic_map(situation, self._config)
            return EvidenceMaps(semantic, None, semantic)
        before = self._config.ssnr.render == "before"
        rendered = self._render(situation, clock) if before else None
        situation.scene.refine(clock)
        if not before:
            rendered = self._render(situation, clock)
        with clock("evidence"):
            return evidence_maps(
                situation, rendered, self._config, geometry_only=self._kind == "geometry_only"
            )

    def _render(self, situation: Situation, clock: Stopwatch) -> Rendering | None:
        assert situation.scene is not None
        with clock("render"):
            return situation.scene.render(situation.camera)


def choose(field: np.ndarray, considered: np.ndarray, config: Config) -> tuple[int, np.ndarray]:
    """The action whose region of `field` has the most evidence, and Q, NaN where not allowed; all (15,)."""
    explicit = config.explicit
    scores = evidence.action_scores(field, coupled=explicit.coupled)
    allowed = considered.copy()
    allowed[evidence.NOOP] &= explicit.noop
    action = evidence.choose_action(scores, allowed, stride=explicit.stride, noop=explicit.noop)
    return action, np.where(allowed, scores, np.nan)


def semantic_map(situation: Situation, config: Config) -> np.ndarray:
    """S: the best score over candidates and instances at each pixel, (H, W) float32."""
    height, width = situation.rgb.shape[:2]
    masks = np.zeros((len(situation.detections), height, width), bool)
    for i, detection in enumerate(situation.detections):
        masks[i] = detection.mask
    scores = np.array([d.score for d in situation.detections], np.float32)
    return evidence.semantic_map(masks, scores, normalize=config.evidence.normalize_semantic)


def evidence_maps(
    situation: Situation, rendered: Rendering | None, config: Config, geometry_only: bool = False
) -> EvidenceMaps:
    """S, U_geo, what scores the actions (w_s S + w_g d U_geo), and the mean of U_func = 1 - S + U_geo."""
    semantic = semantic_map(situation, config)
    ssnr = config.ssnr
    geometric = evidence.geometric_uncertainty(
        situation.rgb,
        None if rendered is None else rendered.rgb,
        alpha=ssnr.alpha,
        normalization=ssnr.normalization,
        gradient=ssnr.gradient,
        gray_range=float(ssnr.gray_range),
        missing_db=ssnr.missing_db,
        float_render=ssnr.float_render,
    )
    weights = (config.evidence.semantic_weight, config.evidence.geometric_weight)
    unresolved = evidence.functional_uncertainty(semantic, geometric)
    weighed = _within_reach(geometric, situation.depth, config)
    if geometry_only:
        field = weighed
    elif config.explicit.field == "uncertainty":
        field = evidence.fuse(1 - semantic, weighed, *weights)
    else:
        field = evidence.fuse(semantic, weighed, *weights)
    return EvidenceMaps(
        semantic,
        geometric,
        field,
        float(unresolved.mean(dtype=np.float64)),
        0.0 if rendered is None else rendered.coverage,
    )


def _within_reach(geometric: np.ndarray, depth: np.ndarray | None, config: Config) -> np.ndarray:
    """U_geo by how near each pixel is: what is too far to score needs no better look."""
    if depth is None or not config.evidence.within_reach:
        return geometric
    stopping = config.stopping
    return geometric * evidence.proximity_map(depth, near=stopping.near_m, far=stopping.far_m)
