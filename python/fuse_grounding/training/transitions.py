"""Transitions that planners are trained on: what is in `transitions.safetensors`, and their utility.

For a transition t → t+1 (supplement, "Planner Training Targets")

    y = clip(1.0 Δs + 0.5 Δu + 1.0 Δq + 0.2 Δv + 1.0 Δg, -1, 1)

    s  score of the surest detection of the candidates, 0 without one
    u  mean U_geo over the pixels with semantic evidence, over all pixels without any; Δu = u_t - u_{t+1}
    q  IoU of the surest detection with the true target, 0 without one
    v  visible pixels of the target over the most that any of the 108 viewpoints shows
    g  (1/D - 1/D_max) / (1/D_min - 1/D_max), clipped to [0, 1], of the camera's distance D to the target

A file has tables of states, transitions and trajectories, and the text vectors of the labels: a planner is
trained and judged from it alone. Nothing here needs torch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding import tensors
from fuse_grounding.errors import InputError
from fuse_grounding.planning.summary import NAMES

KIND, SCHEMA_VERSION = "planner transitions", 1
TERMS = ("semantic", "uncertainty", "iou", "visibility", "geometric")
UTILITY_WEIGHTS = (1.0, 0.5, 1.0, 0.2, 1.0)
SIGNS = (1.0, -1.0, 1.0, 1.0, 1.0)
"""Of the change that counts as a gain: uncertainty is to fall."""

_COLUMNS: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "texts": ("float16", ("labels", "dimensions")),
    "number": ("int32", ("trajectories",)),
    "feature": ("float16", ("states", "dimensions")),
    "summary": ("float16", ("states", len(NAMES))),
    "levels": ("float32", ("states", len(TERMS))),
    "feasible": ("bool", ("states", 15)),
    "context": ("int32", ("states",)),
    "candidates": ("bool", ("states", "labels")),
    "viewpoint": ("int32", ("states", 2)),
    "trajectory": ("int32", ("states",)),
    "step": ("int32", ("states",)),
    "before": ("int32", ("transitions",)),
    "after": ("int32", ("transitions",)),
    "action": ("int32", ("transitions",)),
    "terms": ("float32", ("transitions", len(TERMS))),
    "utility": ("float32", ("transitions",)),
}


@dataclass(frozen=True)
class Transitions:
    """The tables. `before`, `after` and `context` are rows of states and of `texts`.

    `texts` (L, D) and `feature` (S, D): unit vectors of labels and pictures; `summary` (S, 29):
    `planning.summary`; `levels` (S, 5): s, u, q, v, g; `feasible` (S, 15); `candidates` (S, L): what the
    query may mean, `context` the one that is most like the picture; `viewpoint` (S, 2): node and pitch index;
    `trajectory` and `step` (S,); `number` (T,): of each trajectory in its collection; `terms` (N, 5): gains,
    unweighted; `utility` (N,): y.
    """

    texts: np.ndarray
    number: np.ndarray
    feature: np.ndarray
    summary: np.ndarray
    levels: np.ndarray
    feasible: np.ndarray
    context: np.ndarray
    candidates: np.ndarray
    viewpoint: np.ndarray
    trajectory: np.ndarray
    step: np.ndarray
    before: np.ndarray
    after: np.ndarray
    action: np.ndarray
    terms: np.ndarray
    utility: np.ndarray

    def __len__(self) -> int:
        return len(self.action)

    def arrays(self) -> dict[str, np.ndarray]:
        """By name, in the dtypes of the file."""
        return {f.name: np.asarray(getattr(self, f.name), _COLUMNS[f.name][0]) for f in fields(self)}

    def encode(self, note: Mapping[str, Any]) -> bytes:
        """The bytes of the file; the same for the same content."""
        return tensors.encode(KIND, SCHEMA_VERSION, self.arrays(), note)


def gains(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(..., 5) float32: the change of each level, positive for the better."""
    return ((after - before) * np.array(SIGNS)).astype(np.float32)


def utility(terms: np.ndarray) -> np.ndarray:
    """(...,) float32: y of (..., 5) gains."""
    return np.clip(terms @ np.array(UTILITY_WEIGHTS), -1.0, 1.0).astype(np.float32)


def load(path: Path) -> tuple[Transitions, dict[str, Any]]:
    """Reads and checks a file; its note too.

    Raises InputError that names the file for one that is missing, damaged, of another kind or version, or
    whose tables do not fit together.
    """
    arrays, note = tensors.load(path, KIND, SCHEMA_VERSION)
    tensors.expect(path, arrays, _COLUMNS)
    found = Transitions(**{name: arrays[name] for name in _COLUMNS})
    if len(found) == 0:
        raise InputError(f"{path} has no transitions")
    bounds = (
        ("before", len(found.feature)),
        ("after", len(found.feature)),
        ("action", 15),
        ("context", len(found.texts)),
        ("trajectory", len(found.number)),
    )
    for name, count in bounds:
        values = arrays[name]
        if values.size and not (values.min() >= 0 and values.max() < count):
            raise InputError(
                f"{path}: `{name}` must be from 0 to {count - 1}, found {values.min()} to {values.max()}"
            )
    for name in ("feature", "texts", "summary", "levels", "terms", "utility"):
        if not np.isfinite(arrays[name]).all():
            raise InputError(f"{path}: `{name}` has values that are not finite")
    if not found.feasible[found.before, found.action].all():
        raise InputError(f"{path}: an `action` is not `feasible` where it was taken")
    if np.abs(utility(found.terms) - found.utility).max() > 1e-5:
        raise InputError(f"{path}: `utility` is not the weighted sum of `terms`")
    return found, note


def joined(parts: list[Transitions]) -> Transitions:
    """One set of tables from several with the same texts, in their order."""
    states = np.cumsum([0, *(len(p.feature) for p in parts)])
    trajectories = np.cumsum([0, *(len(p.number) for p in parts)])
    shift = {"before": states, "after": states, "trajectory": trajectories}
    columns = {
        name: np.concatenate(
            [
                getattr(p, name) + shift[name][i] if name in shift else getattr(p, name)
                for i, p in enumerate(parts)
            ]
        )
        for name in _COLUMNS
        if name != "texts"
    }
    return Transitions(texts=parts[0].texts, **columns)
