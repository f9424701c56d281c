"""What every segmenter and encoder checks before it looks: pictures and words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fuse_grounding.errors import InputError, UnknownLabelError

SMALLEST = 32
"""Pixels that a picture must have in both directions."""


def check_picture(rgb: object) -> np.ndarray:
    """`rgb` in one piece of memory. Raises InputError unless it is (H, W, 3) uint8 and large enough."""
    if not isinstance(rgb, np.ndarray) or rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3:
        found = (
            f"{rgb.dtype} array of shape {rgb.shape}" if isinstance(rgb, np.ndarray) else type(rgb).__name__
        )
        raise InputError(f"rgb must be a (H, W, 3) uint8 array, found {found}")
    if min(rgb.shape[:2]) < SMALLEST:
        raise InputError(f"rgb must be at least {SMALLEST} pixels wide and high, found shape {rgb.shape}")
    return np.ascontiguousarray(rgb)


def check_texts(name: str, texts: object) -> list[str]:
    """`texts` as a list. Raises InputError, naming the argument, unless all are strings with words."""
    if isinstance(texts, str):
        raise InputError(f"{name} must be a sequence of {name}, found the string {quoted(texts)}")
    if not isinstance(texts, Sequence):
        raise InputError(f"{name} must be a sequence of strings, found {type(texts).__name__}")
    for text in texts:
        if not isinstance(text, str):
            raise InputError(f"{name} must be strings, found {type(text).__name__}")
        if not text.strip(" _\t\r\n"):
            raise InputError(f"{name} must not be empty, found {text!r}")
    return list(texts)


def check_labels(labels: object, known: tuple[str, ...] | None) -> list[str]:
    """`labels` without repetitions; `known` is the closed set, if there is one.

    Raises UnknownLabelError for what is not in it, InputError for what is no label.
    """
    wanted = list(dict.fromkeys(check_texts("labels", labels)))
    for label in wanted:
        if known is not None and label not in known:
            raise UnknownLabelError(
                f"the segmenter does not know the label {quoted(label)}; it knows: {', '.join(known)}", label
            )
    return wanted


def words(label: str) -> str:
    """A label as a person would write it: `water_bottle` is "water bottle"."""
    return " ".join(label.replace("_", " ").split())


def quoted(text: str) -> str:
    """A text for a message of one line: what is long is cut, and its length told."""
    flat = " ".join(text.split())
    return f"`{flat}`" if len(flat) <= 60 else f"`{flat[:50]}…` ({len(text)} characters)"
