"""What a network made of the last picture, for whoever asks of it again."""

from __future__ import annotations

import hashlib
import weakref
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np

Seen = TypeVar("Seen")

_all: weakref.WeakSet[LastPicture[Any]] = weakref.WeakSet()


class LastPicture(Generic[Seen]):
    """`look` at a picture (any array), run again only when another one comes."""

    def __init__(self, look: Callable[[np.ndarray], Seen]) -> None:
        self._look = look
        self._last: tuple[bytes, Seen] | None = None
        _all.add(self)

    def __call__(self, picture: np.ndarray) -> Seen:
        """What `look` gives, or gave of the same bytes in the same shape."""
        key = hashlib.blake2b(picture.tobytes(), key=str(picture.shape).encode()).digest()
        if self._last is None or self._last[0] != key:
            self._last = (key, self._look(picture))
        return self._last[1]

    def forget(self) -> None:
        """Drops it."""
        self._last = None


def forget() -> None:
    """Drops what every network of this process remembers, so that a search pays for all that it looks at."""
    for one in _all:
        one.forget()
