"""What a user names as `package.module:thing`, looked for where Python looks and in the working directory."""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from pathlib import Path
from typing import Any

from fuse_grounding.errors import InputError


def find(kind: str, name: str, expected: str) -> Any:
    """The thing that `name` names. `kind` and `expected` are for messages, as `method` and `factory`.

    Raises InputError unless its module can be imported and has it.
    """
    module_name, _, path = name.partition(":")
    who = f"{kind} `{name}`"
    if not module_name or not path:
        raise InputError(f"{who}: expected package.module:{expected}")
    here = os.getcwd()
    sys.path.insert(0, here)
    try:
        found: Any = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is not None and f"{module_name}.".startswith(f"{error.name}."):
            raise InputError(
                f"{who}: there is no module `{error.name}` here or among the installed packages"
            ) from None
        raise InputError(f"{who}: its module needs `{error.name}`, which is not installed") from error
    except Exception as error:
        raise InputError(f"{who}: its module cannot be imported: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(here)
    for part in path.split("."):
        if not hasattr(found, part):
            raise InputError(f"{who}: module `{module_name}` has no `{path}`")
        found = getattr(found, part)
    return found


def source_file(thing: Any) -> Path | None:
    """The file that a class or function is written in, where there is one."""
    file = inspect.getsourcefile(thing)
    return None if file is None else Path(file)
