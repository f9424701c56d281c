"""ONNX Runtime on the CPU: sessions whose files are known to be what is expected before they are run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import onnxruntime

from fuse_grounding.errors import InputError

Names = Sequence[str] | Mapping[str, Sequence[int]]
"""Of inputs or outputs; with their shapes, where those are known."""


def session(path: Path, inputs: Names, outputs: Names, threads: int = 2, content: bytes | None = None) -> Any:
    """A session for `path` (or its `content`, if it was read before).

    Raises InputError, naming the file, unless it is an ONNX file that takes `inputs`, and no others, and
    gives at least `outputs`, of the shapes that are given.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    # Idle threads must not take the processor from the Gaussian map.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    try:
        made = onnxruntime.InferenceSession(
            str(path) if content is None else content, options, providers=["CPUExecutionProvider"]
        )
    except Exception as e:
        raise InputError(f"{path} is not a usable ONNX file: {' '.join(str(e).split())[:300]}") from None
    takes, gives = _shapes(made.get_inputs()), _shapes(made.get_outputs())
    if takes.keys() != set(inputs) or not (_fit(takes, inputs) and _fit(gives, outputs)):
        raise InputError(
            f"{path} is another network: it takes {_told(takes, inputs)} and gives {_told(gives, outputs)}, "
            f"expected {_told(inputs, inputs)} and {_told(outputs, outputs)}"
        )
    return made


def _shapes(values: Any) -> dict[str, list[Any]]:
    return {value.name: list(value.shape) for value in values}


def _fit(found: dict[str, list[Any]], wanted: Names) -> bool:
    """Whether all `wanted` are there, with their shapes."""
    if isinstance(wanted, Mapping):
        return all(found.get(name) == list(shape) for name, shape in wanted.items())
    return set(wanted) <= found.keys()


def _told(values: Names, wanted: Names) -> str:
    """Names, with their shapes where shapes are wanted."""
    if isinstance(values, Mapping) and isinstance(wanted, Mapping):
        return ", ".join(f"{name} {list(shape)}" for name, shape in values.items())
    return ", ".join(values)
