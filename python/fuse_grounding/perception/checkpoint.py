"""Checkpoint folders of others: local files only, checked before anything is built from them.

Nothing here reaches a network. Safetensors are preferred and their headers checked against the file's
size; a pickle is opened with `weights_only=True`, which builds tensors and plain containers and runs no code.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fuse_grounding.errors import InputError

TOKENIZERS = (("tokenizer.json",), ("vocab.json", "merges.txt"))
"""Files that make a tokenizer, either way."""

_SAFETENSORS, _INDEX, _PICKLE = "model.safetensors", "model.safetensors.index.json", "pytorch_model.bin"


def folder(weights: Path | None, setting: str, who: str) -> Path:
    """The folder that `setting` names. Raises InputError where there is none."""
    if weights is None:
        raise InputError(f"{who} needs a checkpoint folder on this machine, and `{setting}` names none")
    if not weights.exists():
        raise InputError(f"checkpoint folder {weights} (`{setting}`) does not exist")
    if not weights.is_dir():
        raise InputError(f"{weights} (`{setting}`) is a file, expected the folder of a checkpoint")
    return weights


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object. Raises InputError naming the file."""
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"checkpoint file {path} is missing") from None
    except (OSError, ValueError) as error:
        raise InputError(f"checkpoint file {path} is not readable JSON: {error}") from None
    if not isinstance(value, dict):
        raise InputError(f"checkpoint file {path} is not a JSON object")
    return value


def model_type(path: Path, expected: Iterable[str]) -> str:
    """The architecture that a `config.json` names. Raises InputError unless it is one of the expected."""
    found, wanted = read_json(path).get("model_type"), list(expected)
    if found not in wanted:
        raise InputError(
            f"{path} is of a model of type `{found}`, expected {' or '.join(f'`{w}`' for w in wanted)}"
        )
    return str(found)


def tokenizer_files(root: Path) -> list[Path]:
    """Files of the tokenizer in a checkpoint folder. Raises InputError naming what is missing."""
    for names in TOKENIZERS:
        if all((root / name).is_file() for name in names):
            return [root / name for name in names]
    raise InputError(
        f"checkpoint folder {root} has no tokenizer: expected tokenizer.json, or vocab.json with merges.txt"
    )


def weight_files(root: Path) -> list[Path]:
    """Files of the weights in a transformers folder, safetensors before a pickle, each found sound.

    Raises InputError naming the file that is missing or truncated.
    """
    if (root / _SAFETENSORS).is_file():
        check_safetensors(root / _SAFETENSORS)
        return [root / _SAFETENSORS]
    if (root / _INDEX).is_file():
        shards = read_json(root / _INDEX).get("weight_map")
        if not isinstance(shards, dict) or not all(
            isinstance(s, str) and Path(s).name == s for s in shards.values()
        ):
            raise InputError(f"checkpoint file {root / _INDEX} has no `weight_map` of files beside it")
        names = sorted(set(shards.values()))
        for name in names:
            check_safetensors(root / name)
        return [root / _INDEX, *(root / name for name in names)]
    if (root / _PICKLE).is_file():
        return [root / _PICKLE]
    raise InputError(
        f"checkpoint folder {root} has no weights: expected {_SAFETENSORS}, {_INDEX} or {_PICKLE}"
    )


def check_safetensors(path: Path) -> None:
    """Raises InputError unless the header is sound and the file as long as it says."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            length = int.from_bytes(file.read(8), "little")
            if size < 8 or length > size - 8:
                raise InputError(f"{path} is truncated or not a safetensors file: {size} bytes")
            header = json.loads(file.read(length))
        ends = [t["data_offsets"][1] for name, t in header.items() if name != "__metadata__"]
        expected = 8 + length + max(ends, default=0)
    except FileNotFoundError:
        raise InputError(f"checkpoint file {path} is missing") from None
    except OSError as error:
        raise InputError(f"checkpoint file {path} cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} is not a safetensors file: its header is broken") from None
    if size != expected:
        raise InputError(f"{path} is truncated or damaged: {size} bytes, expected {expected} by its header")


def load_pickle(path: Path, torch: Any) -> dict[str, Any]:
    """Named tensors of a PyTorch file, also those under `model` or `state_dict`. Raises InputError."""
    try:
        found = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise InputError(f"checkpoint file {path} cannot be read: {error}") from None
    except Exception as error:  # a zip, pickle or runtime error, or one of torch's own
        first = str(error).strip().split("\n")[0][:200]
        raise InputError(
            f"{path} is not a PyTorch file of tensors alone (weights_only=True): {first}"
        ) from None
    for key in ("model", "state_dict"):
        if isinstance(found, Mapping) and isinstance(found.get(key), Mapping):
            found = found[key]
    if not isinstance(found, Mapping) or not all(isinstance(v, torch.Tensor) for v in found.values()):
        raise InputError(f"{path} does not hold named tensors")
    return dict(found)


def check_fit(path: Path, what: str, missing: Iterable[str], foreign: Iterable[str]) -> None:
    """Raises InputError, with examples, when weights lack tensors of the model or have tensors of another.

    `missing`, `foreign`: names that only the model, only the file has, or whose shapes differ.
    """
    for names, how in (
        (sorted(missing), "lacks"),
        (sorted(foreign), "has tensors of another model or size:"),
    ):
        if names:
            more = f" and {len(names) - 3} more" if len(names) > 3 else ""
            raise InputError(f"{path} are not the weights of {what}: it {how} {', '.join(names[:3])}{more}")
