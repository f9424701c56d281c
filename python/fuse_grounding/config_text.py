"""Settings as text: TOML files, `--set` overrides, and what is wrong with them in one sentence."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from fuse_grounding.errors import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


_NOT_SHOWN = ("base_url", "key_env")
"""Settings where a key may stand by mistake."""


def read(path: Path) -> dict[str, Any]:
    """A TOML file's values. Raises InputError naming it."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"config file {path} does not exist") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"config file {path} cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"config file {path} is not valid TOML: {error}") from None


def parse_override(text: str) -> dict[str, Any]:
    """`section.key=value` as nested values. Raises InputError naming it."""
    key, equals, value = text.partition("=")
    parts = [p.strip() for p in key.split(".")]
    if not equals or not all(parts):
        raise InputError(f"--set {text}: expected section.key=value, such as gate.eta=0.7")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()  # a bare word, such as graph
    for part in reversed(parts):
        parsed = {part: parsed}
    return parsed


def merge(into: dict[str, Any], values: Mapping[str, Any]) -> None:
    """Puts `values` into `into`, table by table."""
    for key, value in values.items():
        if isinstance(value, Mapping) and isinstance(into.get(key), dict):
            merge(into[key], value)
        else:
            into[key] = dict(value) if isinstance(value, Mapping) else value


def explain(error: ValidationError, model: type[BaseModel]) -> str:
    """The first complaint as one sentence: key, found, expected."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        known = _keys_beside(model, first["loc"])
        near = difflib.get_close_matches(str(first["loc"][-1]), known, n=1)
        return f"unknown key `{key}`; " + (
            f"did you mean `{near[0]}`?" if near else f"known here: {', '.join(known)}"
        )
    expected = (first["msg"][0].lower() + first["msg"][1:]).removeprefix("input should be ")
    if first["type"] == "model_type":
        expected = "a table of settings"
    found = "a text that is not shown" if first["loc"][-1] in _NOT_SHOWN else repr(first["input"])
    return f"`{key}`: found {found}, expected: {expected}"


def _keys_beside(root: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Keys that the section of a wrong key knows."""
    model: Any = root
    for part in loc[:-1]:
        fields = {(f.alias or name): f for name, f in model.model_fields.items()}
        if part not in fields:
            return []
        kind = fields[str(part)].annotation
        model = next((t for t in (kind, *get_args(kind)) if isinstance(t, type)), kind)
    return [f.alias or name for name, f in model.model_fields.items()]
