"""Benchmark folders as `fuse bench` leaves them, with rows made by hand: what `fuse report` is tested on."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fuse_grounding.benchmark.identity import identity
from fuse_grounding.benchmark.runner import head
from fuse_grounding.benchmark.store import ResultStore
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode, load_episodes

PROVENANCE: dict[str, Any] = {
    "fuse_grounding": "0.1.0",
    "commit": "c0ffee" * 6 + "c0ff",
    "sha256": {"segmenter": "5e" * 32},
    "packages": {"numpy": "2.0.0", "onnxruntime": "1.20.0"},
    "simd_level": "avx2+fma",
    "device": "cpu (avx2+fma)",
    "render_device": "cpu (avx2+fma)",
    "perception": {"segmenter": "cpu (onnxruntime)"},
}

# Method -> (chance of success, actions, seconds an action, seed views).
_SHAPES = {
    "static": (0.3, 0, 0.0, 0),
    "canonical": (0.25, 1, 0.3, 0),
    "random": (0.45, 12, 0.3, 0),
    "sweep": (0.5, 8, 0.3, 0),
    "vlm": (0.5, 7, 2.0, 0),
    "semantic_only": (0.42, 7, 0.35, 0),
    "geometry_only": (0.5, 15, 2.5, 4),
    "explicit": (0.6, 8, 2.4, 4),
    "amortized": (0.55, 8, 0.4, 0),
    "fuse": (0.62, 9, 1.5, 4),
    "fuse_oracle": (0.68, 9, 1.5, 4),
}
_GATED = ("fuse", "fuse_oracle")


def make_row(
    method: str, episode: Episode, index: int, trace: bool = True, shift: float = 0.0
) -> dict[str, Any]:
    """A plausible row; the same arguments give the same one. `shift` moves the chance of success."""
    chance, actions, cost, seeds = _SHAPES.get(method, (0.5, 5, 1.0, 0))
    dice = random.Random(f"{method} {episode.episode_id} {shift}")
    hard = random.Random(episode.episode_id).random()
    won = 0.6 * hard + 0.4 * dice.random() < chance + shift
    count = 0 if actions == 0 else max(1, min(30, round(dice.gauss(actions, 2.5))))
    overlap = dice.uniform(0.55, 0.95) if won else dice.choice([0.0, 0.0, dice.uniform(0.0, 0.45)])
    steps, branches = _steps(method, count, overlap, dice)
    explicit = branches.get("explicit", count)
    timings = {
        "observe": round(0.05 * (count + 1), 3),
        "segment": round(0.28 * (count + 1), 3),
        "ground": 0.001 * (count + 1),
        "plan": 0.002 * count,
    }
    calls = {"observe": count + 1, "segment": count + 1, "ground": count + 1, "plan": count, "act": count}
    if method in (*_GATED, "amortized"):
        timings["predict"], calls["predict"] = 0.004 * count, count
    if seeds:
        timings |= {
            "register": round(0.4 * (count + 1), 3),
            "initialize": 1.6,
            "initialize_map": round(dice.uniform(2.5, 3.5), 3),
            "refine": round(cost * explicit, 3),
            "render": round(0.03 * explicit, 3),
            "evidence": round(0.05 * explicit, 3),
        }
        calls |= {"register": count + 1, "initialize": 1, "initialize_map": 1}
        calls |= {"refine": explicit, "render": explicit, "evidence": explicit}
    seconds = round(sum(timings.values()) + 0.01, 3)
    row = {
        **head(method, episode, index),
        "status": "ok",
        "success": won,
        "iou": overlap,
        "label": "knife",
        "target_pixels": int(3000 * overlap),
        "target_pixel_ratio": dice.uniform(0.2, 0.9),
        "target_pixel_ratio_90": dice.uniform(0.3, 1.0),
        "observed_pixel_ratio_90": dice.uniform(0.3, 1.0),
        "center_score": dice.uniform(0.2, 0.9),
        "distance_score": dice.uniform(0.2, 0.9),
        "position_error_m": dice.uniform(0.005, 0.05) if won else None,
        "final_score": dice.uniform(0.3, 0.95),
        "best_target_score": dice.uniform(0.3, 0.9),
        "instance_score": min(0.99, max(0.05, dice.gauss(0.75 if won else 0.5, 0.15))),
        "knowledge": "oracle" if method == "fuse_oracle" else "graph",
        "online_actions": count,
        "observations": count + 1,
        "seed_motions": seeds,
        "total_steps": count + seeds,
        "stop_reason": "patience",
        "branches": branches,
        "calls": calls,
        "concurrent": False,
        "timings": timings,
        "wall_seconds": seconds,
        "runtime_seconds": seconds + 0.28,
    }
    return {**row, "trace": steps} if trace else row


def _steps(
    method: str, count: int, overlap: float, dice: random.Random
) -> tuple[list[dict[str, Any]], dict[str, int]]:
    found = dice.randint(0, count)
    steps: list[dict[str, Any]] = []
    branches: dict[str, int] = {}
    ratio = dice.random()
    for k in range(count + 1):
        last = k == count
        branch = None if last else method
        entropy: float | None = None
        if method in _GATED and not last:
            entropy = min(1.0, max(0.0, dice.gauss(0.82 - 0.012 * k, 0.1)))
            branch = "explicit" if entropy >= 0.8 else "amortized"
        if branch is not None:
            branches[branch] = branches.get(branch, 0) + 1
        ratio = min(1.0, max(0.0, ratio + dice.gauss(0.02, 0.15)))
        steps.append(
            {
                "index": k,
                "node": k % 36,
                "pitch_deg": 30.0,
                "branch": branch,
                "entropy": entropy,
                "action": None if last else 12,
                "improved": k == found,
                "best_score": 0.5,
                "best_iou": overlap if k >= found else 0.1,
                "target_pixels": int(3000 * ratio),
                "target_pixel_ratio": ratio,
                "target_score": 0.5,
            }
        )
    return steps, branches


def write_folder(
    folder: Path,
    methods: Sequence[str] = ("static", "explicit", "fuse"),
    episodes: Sequence[Episode] | None = None,
    *,
    part: str | None = None,
    settings: Mapping[str, Any] | None = None,
    not_run: Sequence[tuple[str, str]] = (),
    errors: Sequence[tuple[str, str]] = (),
    without: Sequence[tuple[str, str]] = (),
    trace: bool = True,
    shift: float = 0.0,
    **changes: Any,
) -> Path:
    """A folder of `methods` on `episodes` (default: ten of `dev`).

    `errors` and `without` are pairs of method and episode id: rows that raised, and rows that are missing.
    `changes` are fields of every row.
    """
    chosen = load_episodes("dev")[:10] if episodes is None else episodes
    config = Config().with_(**(settings or {}))
    what = identity(config, chosen, dict.fromkeys(methods, PROVENANCE))
    notes: dict[str, Any] = {"not_run": [{"name": n, "reason": r} for n, r in not_run]} if not_run else {}
    if part is not None:
        notes["part"] = part
    with ResultStore(folder, what, PROVENANCE, resume=False, notes=notes) as store:
        for index, episode in enumerate(chosen):
            for method in methods:
                pair = method, episode.episode_id
                if pair in without:
                    continue
                row = {**make_row(method, episode, index, trace, shift), **changes}
                if pair in errors:
                    kept = ("index", "method", "episode_id", "scene", "query", "verb", "seed")
                    row = {k: row[k] for k in kept} | {
                        "status": "error",
                        "error": "RuntimeError: the map came apart <at step 3> & more_of_it",
                        "wall_seconds": 1.0,
                    }
                store.append(row)
    return folder
