"""From trained networks to the three files that `EmbeddedSegmenter` reads. Needs torch and onnx."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch

from fuse_grounding import tensors
from fuse_grounding.errors import InputError
from fuse_grounding.perception import crops
from fuse_grounding.perception.embedded import SCHEMA_VERSION, EmbeddedSegmenter, crops_path, mixed
from fuse_grounding.training.classifier_model import CropNet
from fuse_grounding.training.onnx_files import export
from fuse_grounding.training.segmenter_data import Picture
from fuse_grounding.training.segmenter_model import Exported, SegmenterNet
from fuse_grounding.training.segmenter_score import correct, isotonic

CANDIDATES = 40
MIN_HEAT = 0.05
# Scores below this are not worth a detection.
MIN_SCORE = 0.05


def to_onnx(net: SegmenterNet, size: tuple[int, int]) -> bytes:
    """The whole first network for pictures of `size` (width, height), weights stored as float16."""
    model = Exported(net, CANDIDATES, MIN_HEAT).eval()
    example = torch.zeros((1, size[1], size[0], 3), dtype=torch.uint8)
    return export(model, (example,), ["image"], ["heat", "verdict", "masks"])


def crops_to_onnx(net: CropNet) -> bytes:
    """The second network, for any number of crops."""
    example = torch.zeros((2, crops.SIZE[1], crops.SIZE[0], 4), dtype=torch.uint8)
    names = ["crops", "geometry"]
    return export(
        net.eval(), (example, torch.zeros(2, crops.GEOMETRY)), names, ["logits"], any_number_of="objects"
    )


def write(
    path: Path,
    weights: bytes,
    second: bytes,
    labels: tuple[str, ...],
    size: tuple[int, int],
    training: dict,
) -> None:
    """Writes `path` (.onnx), the second network and the .json; `calibrate` fills its calibration in.

    Raises FuseError when the disk refuses.
    """
    settings = {
        "schema_version": SCHEMA_VERSION,
        "labels": list(labels),
        "input": {"width": size[0], "height": size[1]},
        "sha256": {
            "network": hashlib.sha256(weights).hexdigest(),
            "crops": hashlib.sha256(second).hexdigest(),
        },
        "mixture": [0.5, 0.5],
        "calibration": {"raw": [0.0, 1.0], "score": [0.0, 1.0]},
        "thresholds": {"heat": MIN_HEAT, "score": MIN_SCORE, "pixels": 60, "nms_iou": 0.5, "nms_inside": 0.8},
        "training": training,
    }
    tensors.write(path, weights)
    tensors.write(crops_path(path), second)
    tensors.write(path.with_suffix(".json"), json.dumps(settings, indent=1) + "\n")


def calibrate(path: Path, pictures: Iterable[Picture], described: str) -> int:
    """Fits how both networks are mixed, and the map from raw scores to the probability of being right, on
    pictures not trained on.

    Returns the number of (object, label) pairs that the map was fitted to.
    """
    segmenter = EmbeddedSegmenter(path)
    found, right = [], []
    for picture in pictures:
        candidates = segmenter.candidates(np.ascontiguousarray(picture[0]))
        found.append(candidates)
        right.append(correct(candidates, picture, segmenter.labels)[1])
    first, second, quality = (
        np.concatenate([getattr(c, k) for c in found]) for k in ("first", "second", "quality")
    )
    truth = np.concatenate(right)
    if not truth.any():
        raise InputError(f"{path} finds nothing on the pictures that calibrate it: train it for longer")
    mixture = fit_mixture(first, second, quality, truth)
    scores, flat = mixed(first, second, quality, mixture).reshape(-1), truth.reshape(-1)
    # Nearly all pairs are hopeless; they would fill all knots.
    likely = scores > 0.005
    if likely.sum() < 20:
        raise InputError(
            f"{path} finds next to nothing on the pictures that calibrate it: train it for longer"
        )
    x, y = isotonic(scores[likely], flat[likely])
    settings_path = path.with_suffix(".json")
    settings = json.loads(settings_path.read_text())
    settings["mixture"] = list(mixture)
    settings["calibration"] = {"raw": x, "score": y, "fitted_on": described, "pairs": int(likely.sum())}
    tensors.write(settings_path, json.dumps(settings, indent=1) + "\n")
    return int(likely.sum())


def fit_mixture(
    first: np.ndarray, second: np.ndarray, quality: np.ndarray, right: np.ndarray
) -> tuple[float, float]:
    """Weights of the two networks' logits for which the right labels (N, labels) are the least surprise."""
    some = right.any(1)
    truth = right[some].argmax(1)
    grid = np.round(np.arange(0.0, 1.55, 0.05), 2)

    def surprise(a: float, b: float) -> float:
        p = mixed(first[some], second[some], quality[some] * 0 + 30.0, (a, b))
        return -float(np.log(np.maximum(p[np.arange(len(truth)), truth], 1e-9)).mean())

    return min(((float(a), float(b)) for a in grid for b in grid if a + b > 0), key=lambda m: surprise(*m))
