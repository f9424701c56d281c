"""Encoders and planners of a few numbers, with files as the real ones have them."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fuse_grounding import tensors
from fuse_grounding.perception.embedded_encoder import SCHEMA_VERSION, STRIDE, TEXT_KIND
from fuse_grounding.planning.amortized import SCHEMA_VERSION as PLANNER_VERSION
from fuse_grounding.planning.summary import NAMES

SIZE = (96, 64)
"""Width and height of the tiny encoder's input."""
DIMENSIONS = 512
WORDS = ("[UNK]", "knife", "mug", "kitchen", "water", "bottle", "a", "##s", "water bottle", "background")


def write_encoder(folder: Path, dimensions: int = DIMENSIONS, seed: int = 0) -> Path:
    """encoder.onnx (patches are mean colours, turned at random) with its two files; the path."""
    onnx = pytest.importorskip("onnx")
    rng = np.random.default_rng(seed)
    turn = rng.standard_normal((3, dimensions)).astype(np.float32)
    helper = onnx.helper
    nodes = [
        helper.make_node("Cast", ["image"], ["float"], to=onnx.TensorProto.FLOAT),
        helper.make_node("Transpose", ["float"], ["planes"], perm=[0, 3, 1, 2]),
        helper.make_node(
            "AveragePool", ["planes"], ["pooled"], kernel_shape=[STRIDE] * 2, strides=[STRIDE] * 2
        ),
        helper.make_node("Transpose", ["pooled"], ["cells"], perm=[0, 2, 3, 1]),
        helper.make_node("MatMul", ["cells", "turn"], ["raw"]),
        helper.make_node("ReduceL2", ["raw"], ["length"], axes=[3], keepdims=1),
        helper.make_node("Div", ["raw", "length"], ["patches"]),
        helper.make_node("ReduceMean", ["patches"], ["mean"], axes=[1, 2], keepdims=0),
        helper.make_node("ReduceL2", ["mean"], ["mean_length"], axes=[1], keepdims=1),
        helper.make_node("Div", ["mean", "mean_length"], ["embedding"]),
    ]
    rows, columns = SIZE[1] // STRIDE, SIZE[0] // STRIDE
    weights = _model(
        nodes,
        {"image": (onnx.TensorProto.UINT8, [1, SIZE[1], SIZE[0], 3])},
        {"embedding": [1, dimensions], "patches": [1, rows, columns, dimensions]},
        {"turn": turn},
    )
    inner = rng.standard_normal((len(WORDS), 8))
    step = (np.abs(inner).max(1) / 127).astype(np.float16)
    text = tensors.encode(
        TEXT_KIND,
        SCHEMA_VERSION,
        {
            "vocabulary": np.frombuffer("\n".join(WORDS).encode(), np.uint8),
            "table": np.rint(inner / step[:, None].astype(float)).clip(-127, 127).astype(np.int8),
            "step": step,
            "projection": np.linalg.qr(rng.standard_normal((dimensions, 8)))[0].astype(np.float32),
        },
        {},
    )
    path = folder / "encoder.onnx"
    path.write_bytes(weights)
    path.with_suffix(".safetensors").write_bytes(text)
    settings = {
        "schema_version": SCHEMA_VERSION,
        "labels": ["knife", "mug", "water_bottle"],
        "background": "background",
        "input": {"width": SIZE[0], "height": SIZE[1]},
        "scale": 10.0,
        "sha256": {"network": _digest(weights), "text": _digest(text)},
    }
    path.with_suffix(".json").write_text(json.dumps(settings))
    return path


def write_planner(
    path: Path,
    encoder: Path,
    kind: str = "plain",
    values: np.ndarray | None = None,
    dimensions: int = DIMENSIONS,
) -> Path:
    """A planner that always answers `values`, for the encoder whose file is given."""
    onnx = pytest.importorskip("onnx")
    answer = np.arange(15, dtype=np.float32) if values is None else values.astype(np.float32)
    sizes = {"image": dimensions, "object": dimensions} if kind == "plain" else {"summary": len(NAMES)}
    nodes = [
        *(onnx.helper.make_node("ReduceSum", [name], [f"{name}_sum"], keepdims=0) for name in sizes),
        onnx.helper.make_node("Sum", [f"{name}_sum" for name in sizes], ["all"]),
        onnx.helper.make_node("Mul", ["all", "zero"], ["nothing"]),
        onnx.helper.make_node("Add", ["answer", "nothing"], ["values"]),
    ]
    inputs = {name: (onnx.TensorProto.FLOAT, [1, size]) for name, size in sizes.items()}
    weights = _model(nodes, inputs, {"values": [15]}, {"answer": answer, "zero": np.zeros((), np.float32)})
    path.write_bytes(weights)
    digests = json.loads(encoder.with_suffix(".json").read_text())["sha256"]
    settings = {
        "schema_version": PLANNER_VERSION,
        "kind": kind,
        "dimensions": dimensions,
        "sha256": _digest(weights),
        "encoder": digests,
        "transitions": {"sha256": "none"},
    }
    path.with_suffix(".json").write_text(json.dumps(settings))
    return path


def _model(
    nodes: list[Any], inputs: dict[str, Any], outputs: dict[str, Any], constants: dict[str, Any]
) -> bytes:
    import onnx
    from onnx import helper, numpy_helper

    graph = helper.make_graph(
        nodes,
        "tiny",
        [helper.make_tensor_value_info(name, kind, shape) for name, (kind, shape) in inputs.items()],
        [helper.make_tensor_value_info(n, onnx.TensorProto.FLOAT, shape) for n, shape in outputs.items()],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return model.SerializeToString()


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
