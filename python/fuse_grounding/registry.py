"""Named variants: a variant is a file plus a registration; collisions raise, near names are suggested."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from typing import Generic, TypeVar

from fuse_grounding.errors import FuseError, InputError

T = TypeVar("T")


class Registry(Generic[T]):
    """A mapping from names to variants of one kind, in the order of registration."""

    def __init__(self, kind: str):
        self.kind = kind
        self._entries: dict[str, T] = {}

    def add(self, name: str, entry: T) -> T:
        """Registers `entry`. Raises FuseError when the name is taken."""
        if name in self._entries:
            raise FuseError(f"{self.kind} `{name}` is registered twice")
        self._entries[name] = entry
        return entry

    def get(self, name: str) -> T:
        """The entry of that name. Raises InputError that suggests a near name and lists all."""
        if name not in self._entries:
            raise InputError(unknown(self.kind, name, list(self._entries)))
        return self._entries[name]

    def names(self) -> list[str]:
        """Registered names."""
        return list(self._entries)

    def __iter__(self) -> Iterator[T]:
        return iter(self._entries.values())


def unknown(kind: str, name: str, known: list[str]) -> str:
    """The sentence for a name that is not known."""
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean `{near[0]}`? " if near else ""
    return f"unknown {kind} `{name}`; {hint}known: {', '.join(known)}"
