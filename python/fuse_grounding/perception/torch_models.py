"""Models of torch and transformers from local folders: loading that cannot reach a network and hides nothing.

Torch is imported by those who need it, through `extras.require`; this module meets it only where it is there.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from fuse_grounding.errors import InputError
from fuse_grounding.perception import checkpoint

_COMPUTED = ("position_ids", "rope_embeddings")
"""Buffers that older files have and models compute by themselves."""


def choose(wish: str, setting: str) -> str:
    """`cpu` or `cuda` for a wish that may be `auto`. Raises InputError where `cuda` is wished for in vain."""
    there = bool(import_module("torch").cuda.is_available())
    if wish == "cuda" and not there:
        raise InputError(f"`{setting}` is `cuda`, and torch finds no CUDA device here; use `auto` or `cpu`")
    return "cuda" if there and wish != "cpu" else "cpu"


def describe(device: str) -> str:
    """A device for the record."""
    if device != "cuda":
        return f"{device} (torch)"
    return f"cuda ({import_module('torch').cuda.get_device_name()}, torch)"


@contextmanager
def quietly() -> Iterator[None]:
    """Within it, transformers neither draws progress bars nor warns: what matters becomes an error."""
    logging = import_module("transformers").utils.logging
    verbosity, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(verbosity)
        if bars:
            logging.enable_progress_bar()


def loaded(kind: Any, root: Path, what: str) -> Any:
    """`kind.from_pretrained` of a local folder. Raises InputError naming the folder and `what` in it."""
    try:
        return kind.from_pretrained(str(root), local_files_only=True)
    except Exception as error:  # the libraries below raise whatever they meet
        raise InputError(f"{what} in {root} cannot be used: {type(error).__name__}: {_line(error)}") from None


def pretrained(kind: Any, root: Path, what: str) -> Any:
    """A model with all its weights from a folder, in evaluation mode, float32.

    Raises InputError where a tensor is missing, has another shape, or is another model's.
    """
    files = checkpoint.weight_files(root)
    try:
        model, report = kind.from_pretrained(
            str(root),
            local_files_only=True,
            use_safetensors=".safetensors" in files[0].name,
            weights_only=True,
            output_loading_info=True,
            ignore_mismatched_sizes=True,
            dtype=import_module("torch").float32,
        )
    except Exception as error:
        raise InputError(f"{files[0]} cannot be loaded: {type(error).__name__}: {_line(error)}") from None
    mismatched = [m[0] if isinstance(m, tuple) else m for m in report["mismatched_keys"]]
    foreign = [k for k in report["unexpected_keys"] if not k.endswith(_COMPUTED)]
    checkpoint.check_fit(files[0], what, report["missing_keys"], [*mismatched, *foreign])
    return _settled(model)


def of_tensors(kind: Any, config: Any, tensors: Mapping[str, Any]) -> Any:
    """A model of a configuration with these tensors, which are all that it has, in evaluation mode."""
    model = kind.from_pretrained(
        None, config=config, state_dict=dict(tensors), dtype=import_module("torch").float32
    )
    return _settled(model)


def _settled(model: Any) -> Any:
    """In evaluation mode, with every tensor in memory of its own: how a file's bytes happen to be aligned
    decides the order in which kernels add, and so the last bits."""
    for tensor in (*model.parameters(), *model.buffers()):
        tensor.data = tensor.data.clone()
    return model.eval()


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:300]
