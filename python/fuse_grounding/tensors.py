"""Files of arrays (safetensors) that say what they are: a kind, a version, and a note as JSON.

Data only: nothing in them is ever run. They are written whole or not at all.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save as to_bytes

from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.record import write_atomically

Arrays = dict[str, np.ndarray]


def encode(kind: str, version: int, arrays: Mapping[str, np.ndarray], note: Mapping[str, Any]) -> bytes:
    """The bytes of such a file; the same for the same content."""
    metadata = {"kind": kind, "schema_version": str(version), "note": json.dumps(note, sort_keys=True)}
    # An array that is a view of another would be written as it lies in memory.
    whole = {name: np.ascontiguousarray(array) for name, array in sorted(arrays.items())}
    return _in_one_order(to_bytes(whole, metadata))


def _in_one_order(content: bytes) -> bytes:
    """The same file with its header's keys sorted: the library writes them in any order."""
    length = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + length])
    header = {key: header[key] for key in sorted(header)}
    header["__metadata__"] = {k: header["__metadata__"][k] for k in sorted(header["__metadata__"])}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + content[8 + length :]


def save(
    path: Path, kind: str, version: int, arrays: Mapping[str, np.ndarray], note: Mapping[str, Any]
) -> None:
    """Replaces `path` in one step. Raises FuseError when the disk refuses."""
    write(path, encode(kind, version, arrays, note))


def write(path: Path, content: bytes | str) -> None:
    """Replaces `path` in one step. Raises FuseError when the disk refuses, with its reason."""
    try:
        write_atomically(path, content)
    except OSError as error:
        raise FuseError(f"{path} cannot be written: {error.strerror}") from None


def load(path: Path, kind: str, version: int) -> tuple[Arrays, dict[str, Any]]:
    """Arrays and note of a file. Raises InputError for one that is missing, damaged, or of another kind."""
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            if metadata.get("kind") != kind:
                found = metadata.get("kind", "none")
                raise InputError(f"{path} holds no {kind}: its kind is `{found}`")
            if metadata.get("schema_version") != str(version):
                found = metadata.get("schema_version", "none")
                raise InputError(f"{path} has schema version {found}, expected {version}")
            note = json.loads(metadata["note"])
            return {name: file.get_tensor(name) for name in file.keys()}, note  # noqa: SIM118  # no mapping
    except FileNotFoundError:
        raise InputError(f"{path} does not exist") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror or error}") from None
    except (SafetensorError, KeyError, ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} is not a sound safetensors file: {error}") from None


def expect(path: Path, arrays: Arrays, shapes: Mapping[str, tuple[str, tuple[int | str, ...]]]) -> None:
    """Checks names, dtypes and shapes; a word in a shape is any size, the same wherever it stands.

    Raises InputError that names the file, the array, what was found and what was expected.
    """
    sizes: dict[str, int] = {}
    for name, (dtype, shape) in shapes.items():
        if name not in arrays:
            raise InputError(f"{path} lacks the array `{name}`")
        array = arrays[name]
        fits = array.dtype == np.dtype(dtype) and array.ndim == len(shape)
        for size, wanted in zip(array.shape, shape, strict=False):
            fits &= size == (sizes.setdefault(wanted, size) if isinstance(wanted, str) else wanted)
        if not fits:
            expected = ", ".join(str(sizes.get(s, s) if isinstance(s, str) else s) for s in shape)
            raise InputError(
                f"{path}: `{name}` is {array.dtype} of shape {array.shape}, expected {dtype} of ({expected})"
            )
