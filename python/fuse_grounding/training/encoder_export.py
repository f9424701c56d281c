"""From a trained encoder to `encoder.onnx`, `encoder.safetensors` and `encoder.json`. Needs torch and
onnx."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from fuse_grounding import tensors
from fuse_grounding.perception.embedded_encoder import SCHEMA_VERSION, TEXT_KIND
from fuse_grounding.training.encoder_model import INNER, EncoderNet, Exported, rotation
from fuse_grounding.training.encoder_text import PACKAGE, quantize
from fuse_grounding.training.onnx_files import export


def text_table(pieces: Sequence[str], vectors: np.ndarray) -> bytes:
    """The safetensors file of the text half, from `encoder_text.distil`."""
    table, step = quantize(vectors)
    arrays = {
        "vocabulary": np.frombuffer("\n".join(pieces).encode(), np.uint8),
        "table": table,
        "step": step,
        "projection": rotation()[:, :INNER],
    }
    return tensors.encode(TEXT_KIND, SCHEMA_VERSION, arrays, {"distilled_from": PACKAGE})


def network(net: EncoderNet, size: tuple[int, int]) -> bytes:
    """The ONNX file of the picture half, for inputs of `size` (width, height)."""
    example = torch.zeros((1, size[1], size[0], 3), dtype=torch.uint8)
    return export(Exported(net).eval(), (example,), ["image"], ["embedding", "patches"])


def write(
    path: Path,
    net: EncoderNet,
    text: bytes,
    labels: Sequence[str],
    size: tuple[int, int],
    background: str,
    training: Mapping[str, Any],
) -> None:
    """Writes `path` (.onnx) and its .safetensors and .json. Raises FuseError when the disk refuses."""
    weights = network(net, size)
    settings = {
        "schema_version": SCHEMA_VERSION,
        "labels": list(labels),
        "background": background,
        "input": {"width": size[0], "height": size[1]},
        "scale": round(float(net.scale().detach()), 4),
        "sha256": {
            "network": hashlib.sha256(weights).hexdigest(),
            "text": hashlib.sha256(text).hexdigest(),
        },
        "training": dict(training),
    }
    tensors.write(path, weights)
    tensors.write(path.with_suffix(".safetensors"), text)
    tensors.write(path.with_suffix(".json"), json.dumps(settings, indent=1) + "\n")
