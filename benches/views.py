"""How much looking from elsewhere is worth to the segmenter: the start view against all 108 of an episode.

For every episode and view: is the surest instance, of the graph's candidates or of the target's own label,
a valid object (IoU of at least 0.5)? Counted at the start view, at the view with the most pixels of a valid
object, at the view with the best grounding score (what an agent that looked everywhere would return), and
in any view at all; then the share of views that are right, of all and by pitch, and the canonical view. A
large step from the first to the others is what active perception lives on.

    python benches/views.py [--episodes dev] [--limit N] [--weights F.onnx] [--json]
"""

from __future__ import annotations

import argparse
import json
from typing import Any

import numpy as np

from fuse_grounding import Config, grounding, knowledge
from fuse_grounding.benchmark.metrics import iou
from fuse_grounding.environment import Episode, Observation, TabletopEnvironment, load_episodes
from fuse_grounding.perception.embedded import EmbeddedSegmenter
from fuse_grounding.perception.protocol import Detection

PROMPTS = ("candidates", "target label")
PITCHES = tuple(f"views at {pitch:g} degrees" for pitch in Config().camera.pitches_deg)
READINGS = ("start", "most pixels", "best score", "any view", "share of views", *PITCHES, "canonical view")


def judged(
    detections: list[Detection], depth: np.ndarray, ids: np.ndarray, valid: list[int], config: Config
) -> tuple[bool, float]:
    """Whether the surest instance is valid, and the view's best grounding score."""
    scored = grounding.score(detections, depth, config.stopping)
    surest, best = grounding.best_instance(scored), grounding.best_fused(scored)
    right = (
        surest is not None and max(iou(surest.detection.mask, ids == i) for i in valid) >= config.metric.iou
    )
    return right, -1.0 if best is None or best.fused is None else best.fused


def episode_views(
    episode: Episode, segmenter: EmbeddedSegmenter, config: Config
) -> dict[str, dict[str, float]]:
    """Each reading as 0, 1 or a share of views, for each way of prompting."""
    environment = TabletopEnvironment(episode)
    source, query = knowledge.make(config.knowledge), knowledge.parse(episode.query)
    labels = source.hypotheses(query, segmenter.labels, None).labels
    target = environment.oracle_target()
    prompts = {"candidates": labels, "target label": (target,) if target in segmenter.labels else ()}
    valid = list(episode.data["valid_target_ids"])
    right = {name: np.zeros((36, 3), bool) for name in PROMPTS}
    score = {name: np.zeros((36, 3)) for name in PROMPTS}
    pixels = np.zeros((36, 3), int)

    def judge(seen: Observation, name: str) -> tuple[bool, float]:
        assert seen.instance is not None
        assert seen.depth is not None
        detections = segmenter.segment(seen.rgb, prompts[name]) if prompts[name] else []
        return judged(detections, seen.depth, seen.instance, valid, config)

    for view in np.ndindex(36, 3):
        seen = environment.render_at(*view)
        pixels[view] = max(np.count_nonzero(seen.instance == i) for i in valid)
        for name in PROMPTS:
            right[name][view], score[name][view] = judge(seen, name)
    above = environment.canonical_observation()
    return {
        name: {
            "start": float(right[name][episode.start]),
            "most pixels": float(right[name].flat[pixels.argmax()]),
            "best score": float(right[name].flat[score[name].argmax()]),
            "any view": float(right[name].any()),
            "share of views": float(right[name].mean()),
            **dict(zip(PITCHES, right[name].mean(0).tolist(), strict=True)),
            "canonical view": float(judge(above, name)[0]),
        }
        for name in PROMPTS
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", default="dev")
    parser.add_argument("--limit", type=int)
    parser.add_argument("--weights")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    segmenter, config = EmbeddedSegmenter(arguments.weights), Config()
    found: list[dict[str, Any]] = []
    for episode in load_episodes(arguments.episodes)[: arguments.limit]:
        found.append(episode_views(episode, segmenter, config))
        if not arguments.json:
            told = "  ".join(f"{k} {v:.2f}" for k, v in found[-1]["candidates"].items())
            print(f"{episode.episode_id:12} {episode.query:40.40} {told}", flush=True)
    means = {p: {r: float(np.mean([f[p][r] for f in found])) for r in READINGS} for p in PROMPTS}
    if arguments.json:
        print(json.dumps({"episodes": len(found), "right": means}, indent=1))
        return
    for name in PROMPTS:
        told = ", ".join(f"{k} {v:.0%}" for k, v in means[name].items())
        print(f"{len(found)} episodes, prompted with the {name}: right from {told}")


if __name__ == "__main__":
    main()
