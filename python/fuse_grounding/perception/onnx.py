"""ONNX Runtime on the CPU: sessions whose files are known to be what is expected before they are run."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import onnxruntime

from fuse_grounding.errors import InputError


def session(
    path: Path, inputs: Iterable[str], outputs: Iterable[str], threads: int = 2, content: bytes | None = None
) -> Any:
    """A session for `path` (or its `content`, if it was read before).

    Raises InputError, naming the file, unless it is an ONNX file that takes `inputs`, and no others, and
    gives at least `outputs`.
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
    takes, gives = [i.name for i in made.get_inputs()], [o.name for o in made.get_outputs()]
    wanted_in, wanted_out = list(inputs), list(outputs)
    if set(takes) != set(wanted_in) or not set(wanted_out) <= set(gives):
        raise InputError(
            f"{path} is another network: it takes {', '.join(takes)} and gives {', '.join(gives)}, "
            f"expected {', '.join(wanted_in)} and {', '.join(wanted_out)}"
        )
    return made
