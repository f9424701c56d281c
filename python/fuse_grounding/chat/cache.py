"""Replies on disk, one file each, named by the hash of everything that decides the answer.

That is: the address and the name of the model, temperature and further options, how the reply is
constrained, its schema, and the messages with the pixels of their pictures. Keys, time limits and the folder
decide nothing.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.record import write_atomically

CACHE_VERSION = 1
"""Raised when the same question would be put otherwise; part of every key."""


class Entry(BaseModel):
    """What was asked, and the reply's text; or, in `failure`, why there was none.

    A failure is remembered for offline replay alone: online, the question is asked again.
    """

    model_config = ConfigDict(extra="forbid")

    version: int = CACHE_VERSION
    request: dict[str, Any]
    text: str | None = None
    constraint: str = ""
    """`json_schema`, or `prompt`: how this reply was held to the schema."""
    model: str | None = None
    """Name of the model by the server's own account."""
    usage: Any = None
    """Tokens by the server's own account."""
    finish_reason: str | None = None
    """Why the model stopped, by the server's own account."""
    failure: str | None = None


def key_of(request: dict[str, Any]) -> str:
    """SHA-256 of a request as canonical JSON, hexadecimal."""
    text = json.dumps({"version": CACHE_VERSION, **request}, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def default_folder() -> Path:
    """The user's cache folder for replies."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "fuse-grounding" / "chat"


class Cache:
    """Entries by key, in `folder`/ab/abcd….json; several processes may share it."""

    def __init__(self, folder: Path):
        self.folder = folder

    def path(self, key: str) -> Path:
        """Where the entry of a key lies."""
        return self.folder / key[:2] / f"{key}.json"

    def read(self, key: str) -> Entry | None:
        """The entry, None where there is none. Raises InputError for one that is damaged."""
        path = self.path(key)
        try:
            entry = Entry.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"cached reply {path} cannot be read: {error.strerror}") from None
        except ValidationError as error:
            raise InputError(
                f"cached reply {path} is damaged ({error.errors()[0]['msg']}); delete it"
            ) from None
        if (entry.text is None) == (entry.failure is None) or key_of(entry.request) != key:
            raise InputError(f"cached reply {path} is not the answer to its question; delete it")
        return entry

    def write(self, key: str, entry: Entry) -> None:
        """Keeps an entry. Raises FuseError when the disk refuses."""
        path = self.path(key)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, json.dumps(entry.model_dump(), indent=1) + "\n")
        except OSError as error:
            raise FuseError(f"the reply could not be kept in {path}: {error.strerror}") from None
