"""From a torch module to the bytes of an ONNX file with weights in half precision, and back to its weights.

Needs torch and onnx.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from fuse_grounding.errors import InputError

OPSET = 17


def export(
    model: torch.nn.Module,
    example: tuple[torch.Tensor, ...],
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    any_number_of: str | None = None,
) -> bytes:
    """The whole network for inputs of the example's shapes, large weights stored as float16.

    `any_number_of`: what the first axis of all inputs and outputs counts, where it is not the example's.
    """
    free = {} if any_number_of is None else {name: {0: any_number_of} for name in (*inputs, *outputs)}
    # In memory, whatever torch's annotations say: no disk can be full.
    exported: Any = BytesIO()
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            model,
            example,
            exported,
            opset_version=OPSET,
            input_names=list(inputs),
            output_names=list(outputs),
            dynamic_axes=free,
            dynamo=False,
        )
    graph = onnx.load_from_string(exported.getvalue())
    _pad_within_convolutions(graph)
    _halve(graph.graph)
    onnx.checker.check_model(graph)
    return graph.SerializeToString()


def weights(path: Path) -> dict[str, torch.Tensor]:
    """The named weights of a file that `export` wrote of a network held as `net`, float32.

    Raises InputError for a file that cannot be read as ONNX.
    """
    try:
        graph = onnx.load(path).graph
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except Exception as error:  # protobuf's own errors
        raise InputError(f"{path} is not an ONNX file: {error}") from None
    return {
        t.name.removesuffix("_half").removeprefix("net."): torch.from_numpy(
            numpy_helper.to_array(t).astype(np.float32)
        )
        for t in graph.initializer
    }


def _pad_within_convolutions(model: onnx.ModelProto) -> None:
    """Gives the zeros around an input to the convolution that takes it: torch's own convolutions know no
    asymmetric padding, and a node that pads copies the largest maps at every run.
    """
    graph = model.graph
    # The extractor wants a type for what it gives.
    extractor = onnx.utils.Extractor(onnx.shape_inference.infer_shapes(model))
    takers: dict[str, list[onnx.NodeProto]] = {}
    for node in graph.node:
        for name in node.input:
            takers.setdefault(name, []).append(node)
    for pad in [node for node in graph.node if node.op_type == "Pad"]:
        conv = takers[pad.output[0]][0]
        alone = len(takers[pad.output[0]]) == 1 and conv.op_type == "Conv"
        mode = {a.name: helper.get_attribute_value(a) for a in pad.attribute}.get("mode", b"constant")
        if not alone or mode != b"constant" or any(pad.input[2:]):
            continue
        (amounts,) = ReferenceEvaluator(extractor.extract_model([], [pad.input[1]])).run(None, {})
        around = np.asarray(amounts).reshape(2, -1)
        if around[:, :2].any():
            continue
        (own,) = (a for a in conv.attribute if a.name == "pads")
        own.ints[:] = [int(v) for v in around[:, 2:].reshape(-1) + np.array(own.ints)]
        conv.input[0] = pad.input[0]
        graph.node.remove(pad)


def _halve(graph: onnx.GraphProto) -> None:
    """Stores large float32 weights as float16 behind a cast, which the runtime folds when it loads."""
    casts = []
    for tensor in graph.initializer:
        if tensor.data_type != TensorProto.FLOAT or np.prod(tensor.dims) < 256:
            continue
        name = tensor.name
        half = numpy_helper.from_array(numpy_helper.to_array(tensor).astype(np.float16), name + "_half")
        tensor.CopyFrom(half)
        casts.append(
            helper.make_node("Cast", [name + "_half"], [name], name=name + "_cast", to=TensorProto.FLOAT)
        )
    nodes = [*casts, *graph.node]
    del graph.node[:]
    graph.node.extend(nodes)
