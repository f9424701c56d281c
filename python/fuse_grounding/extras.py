"""Optional packages, imported where they are used, with an error that names the extra to install."""

from __future__ import annotations

import importlib
from types import ModuleType

from fuse_grounding.errors import InputError


def require(module: str, extra: str, what: str) -> ModuleType:
    """Imports an optional package. Raises InputError saying which extra brings it."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] != module.split(".")[0]:
            raise  # the package is there, and something inside it is broken
        raise InputError(
            f"{what} needs the optional package `{module.split('.')[0]}`\n"
            f"\nhint: pip install 'fuse-grounding[{extra}]'"
        ) from None
