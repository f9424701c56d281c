"""From a trained network to `segmenter.onnx` and `segmenter.json`. Needs torch and onnx."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch

from fuse_grounding.errors import InputError
from fuse_grounding.perception.embedded import SCHEMA_VERSION, EmbeddedSegmenter
from fuse_grounding.training.onnx_files import export
from fuse_grounding.training.segmenter_data import Picture
from fuse_grounding.training.segmenter_model import Exported, SegmenterNet
from fuse_grounding.training.segmenter_score import correct, isotonic

CANDIDATES = 40
MIN_HEAT = 0.05
# Scores below this are not worth a detection.
MIN_SCORE = 0.05


def to_onnx(net: SegmenterNet, size: tuple[int, int]) -> bytes:
    """The whole network for pictures of `size` (width, height), weights stored as float16."""
    model = Exported(net, CANDIDATES, MIN_HEAT).eval()
    example = torch.zeros((1, size[1], size[0], 3), dtype=torch.uint8)
    return export(model, (example,), ["image"], ["heat", "verdict", "masks"])


def write(path: Path, weights: bytes, labels: tuple[str, ...], size: tuple[int, int], training: dict) -> None:
    """Writes `path` (.onnx) and its .json with identity calibration; `calibrate` fills that in."""
    settings = {
        "schema_version": SCHEMA_VERSION,
        "labels": list(labels),
        "input": {"width": size[0], "height": size[1]},
        "sha256": hashlib.sha256(weights).hexdigest(),
        "temperature": 1.0,
        "calibration": {"raw": [0.0, 1.0], "score": [0.0, 1.0]},
        "thresholds": {"heat": MIN_HEAT, "score": MIN_SCORE, "pixels": 60, "nms_iou": 0.5, "nms_inside": 0.8},
        "training": training,
    }
    _replace(path, weights)
    _replace(path.with_suffix(".json"), (json.dumps(settings, indent=1) + "\n").encode())


def calibrate(path: Path, pictures: Iterable[Picture], described: str) -> int:
    """Fits the map from raw scores to the probability of being right, on pictures not trained on.

    Returns the number of (object, label) pairs that it was fitted to.
    """
    segmenter = EmbeddedSegmenter(path)
    raw, right = [], []
    for picture in pictures:
        found = segmenter.candidates(np.ascontiguousarray(picture[0]))
        _, correct_label, _ = correct(found, picture, segmenter.labels)
        raw.append(found.raw.reshape(-1))
        right.append(correct_label.reshape(-1))
    scores, truth = np.concatenate(raw), np.concatenate(right)
    # Nearly all pairs are hopeless; they would fill all knots.
    likely = scores > 0.005
    if likely.sum() < 20:
        raise InputError(
            f"{path} finds next to nothing on the pictures that calibrate it: train it for longer"
        )
    x, y = isotonic(scores[likely], truth[likely])
    settings_path = path.with_suffix(".json")
    settings = json.loads(settings_path.read_text())
    settings["calibration"] = {"raw": x, "score": y, "fitted_on": described, "pairs": int(likely.sum())}
    _replace(settings_path, (json.dumps(settings, indent=1) + "\n").encode())
    return int(likely.sum())


def _replace(path: Path, content: bytes) -> None:
    part = path.with_name(path.name + ".part")
    part.write_bytes(content)
    os.replace(part, path)
