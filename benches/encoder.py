"""The encoder on pictures of development objects and scenes, which it never saw.

For every object with at least 500 visible pixels: the rank of its label among the 45 by the similarity of its
crop with the label's text. For whole pictures: the best rank of a label that is in it, and, among five labels
at random of which one is there, whether the most similar one is (what a planner's object context asks).
Milliseconds of an image and of a text.

    python benches/encoder.py [--pictures 128] [--scene-pictures 128] [--seed 2000000] [--threads 2]
                              [--weights encoder.onnx] [--json]

Evaluation objects and scenes take no part.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from fuse_grounding import _core
from fuse_grounding.environment import TabletopEnvironment, load_episodes
from fuse_grounding.perception.embedded_encoder import EmbeddedEncoder
from fuse_grounding.training.encoder_score import Score, evaluate
from fuse_grounding.training.segmenter_data import Picture

SHARD = 64
GOAL_MS = 40.0


def rendered(count: int, seed: int) -> Iterator[Picture]:
    """Randomised pictures of development objects."""
    for shard in range((count + SHARD - 1) // SHARD):
        yield from _core.randomized_pictures(seed + shard, min(SHARD, count - shard * SHARD), split="dev")


def scenes(count: int, seed: int) -> Iterator[Picture]:
    """Views of the shipped development episodes, from anywhere."""
    rng, episodes = np.random.default_rng(seed), load_episodes("dev")
    each = -(-count // len(episodes))
    for k in range(count):
        if k % each == 0:
            world = TabletopEnvironment(episodes[k // each])
        seen = world.render_at(int(rng.integers(36)), int(rng.integers(3)))
        pixels = np.bincount(seen.instance.reshape(-1), minlength=256)
        kinds = world.episode.categories.items()
        objects = [{"id": i, "category": c, "visible_px": int(pixels[i])} for i, c in kinds if pixels[i]]
        yield seen.rgb, seen.instance, objects


def figures(score: Score) -> dict[str, Any]:
    """As JSON values."""
    by_label: dict[str, list[int]] = {}
    for label, rank in score.crops:
        by_label.setdefault(label, []).append(rank)
    worst = sorted(by_label, key=lambda label: -float(np.mean(by_label[label])))[:5]
    return {
        "objects": len(score.crops),
        "top1": round(score.top(1), 4),
        "top5": round(score.top(5), 4),
        "mean_rank": round(score.mean_rank(), 2),
        "worst_mean_rank": {label: round(float(np.mean(by_label[label])), 1) for label in worst},
        "pictures": len(score.scenes),
        "scene_top1": round(float(np.mean([rank == 1 for rank in score.scenes])), 4),
        "context_right": round(float(np.mean([right for right, _ in score.contexts])), 4),
        "context_by_chance": round(float(np.mean([chance for _, chance in score.contexts])), 4),
    }


def milliseconds(encoder: EmbeddedEncoder, repeats: int = 20) -> dict[str, float]:
    """Medians of an image and of the 45 labels' texts, each never seen before."""
    rng = np.random.default_rng(0)
    spent = []
    for _ in range(repeats):
        rgb = rng.integers(0, 255, (480, 640, 3), np.uint8)
        began = time.perf_counter()
        encoder.image(rgb)
        spent.append(1e3 * (time.perf_counter() - began))
    began = time.perf_counter()
    encoder.text([f"{name} {k}" for k, (name, _) in enumerate(_core.object_categories())])
    return {
        "image": round(float(np.median(spent)), 1),
        "texts": round(1e3 * (time.perf_counter() - began), 1),
    }


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pictures", type=int, default=128)
    parser.add_argument("--scene-pictures", type=int, default=128)
    parser.add_argument("--seed", type=int, default=2_000_000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--weights")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    encoder = EmbeddedEncoder(options.weights, threads=options.threads)
    labels = [name for name, _ in _core.object_categories()]
    result: dict[str, Any] = {"milliseconds": milliseconds(encoder), "threads": options.threads}
    for name, count, make in (
        ("randomised", options.pictures, rendered),
        ("scenes", options.scene_pictures, scenes),
    ):
        if count:
            result[name] = figures(evaluate(encoder, make(count, options.seed), labels))
    if options.json:
        print(json.dumps(result, indent=1))
        return
    print(f"{result['milliseconds']['image']} ms an image on {options.threads} threads (goal {GOAL_MS})")
    for name in ("randomised", "scenes"):
        if name not in result:
            continue
        one = result[name]
        print(
            f"{name}: {one['objects']} crops, label first {one['top1']:.0%}, among five {one['top5']:.0%}, "
            f"mean rank {one['mean_rank']} of {len(labels)}; worst {one['worst_mean_rank']}"
        )
        print(
            f"  {one['pictures']} whole pictures: a label of the picture first {one['scene_top1']:.0%}; "
            f"of five candidates {one['context_right']:.0%} (chance {one['context_by_chance']:.0%})"
        )


if __name__ == "__main__":
    main()
