"""Holds `RESULTS_VERSION` against what episodes come to (CONTRIBUTING.md, "Results")."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from fuse_grounding.benchmark.identity import RESULTS_VERSION

SCRIPT = Path(__file__).with_name("results_version.py")
RECORDED = SCRIPT.with_suffix(".json")
TOLERANCE = 2e-3
"""Of scores and shares; of a library's last bits nothing that large is left."""
ADVICE = (
    "episodes come to something else than they did. If that is meant, raise RESULTS_VERSION in "
    "python/fuse_grounding/benchmark/identity.py, so that results of before are not mixed with those of now, "
    "and record anew: python tests/python/results_version.py --record"
)


def first_difference(found: Any, recorded: Any, where: str = "") -> str | None:
    """The first value that differs, with both; None if none does."""
    if isinstance(found, dict) and isinstance(recorded, dict):
        keys = [*recorded, *(found.keys() - recorded.keys())]
        pairs = [(found.get(k), recorded.get(k), f"{where}.{k}" if where else k) for k in keys]
    elif isinstance(found, list) and isinstance(recorded, list) and len(found) == len(recorded):
        pairs = [(a, b, f"{where}[{i}]") for i, (a, b) in enumerate(zip(found, recorded, strict=True))]
    elif isinstance(found, float) and isinstance(recorded, float):
        return None if abs(found - recorded) <= TOLERANCE else f"{where}: {found}, recorded {recorded}"
    else:
        return None if found == recorded else f"{where}: {found!r}, recorded {recorded!r}"
    return next((d for a, b, place in pairs if (d := first_difference(a, b, place)) is not None), None)


def test_episodes_come_to_what_this_version_of_results_says():
    recorded = json.loads(RECORDED.read_text())
    assert recorded["results_version"] == RESULTS_VERSION, (
        f"results_version.json is of version {recorded['results_version']}, RESULTS_VERSION is "
        f"{RESULTS_VERSION}: record anew: python tests/python/results_version.py --record"
    )
    child = subprocess.run(
        [sys.executable, str(SCRIPT), "--print"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
    )
    assert child.returncode == 0, child.stderr
    found = first_difference(json.loads(child.stdout), recorded["came_to"])
    assert found is None, f"{found}: {ADVICE}"


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ({"a": [1, 0.5]}, None),
        ({"a": [1, 0.5015]}, None),
        ({"a": [1, 0.503]}, "a[1]: 0.503, recorded 0.5"),
        ({"a": [2, 0.5]}, "a[0]: 2, recorded 1"),
        ({"a": [1]}, "a: [1], recorded [1, 0.5]"),
        ({"a": [1, None]}, "a[1]: None, recorded 0.5"),
        ({"a": [1, 0.5], "b": 3}, "b: 3, recorded None"),
        ({}, "a: None, recorded [1, 0.5]"),
    ],
)
def test_a_difference_is_named(found: Any, message: str | None):
    assert first_difference(found, {"a": [1, 0.5]}) == message
