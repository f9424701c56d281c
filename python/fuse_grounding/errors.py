"""Errors that FUSE raises: the compiled module's own types, so that Rust and Python raise the same."""

from __future__ import annotations

from fuse_grounding._core import FuseError, InputError

__all__ = ["FuseError", "InputError", "UnknownLabelError", "UnusableError"]


class UnknownLabelError(InputError):
    """A segmenter with a closed set of labels was asked for one that is not in it: `label`."""

    def __init__(self, message: str, label: str = "") -> None:
        super().__init__(message)
        self.label = label


class UnusableError(InputError):
    """Wrong input that no episode can run with, such as a key that is refused: a benchmark stops at once.

    Any other error in an episode is that episode's alone.
    """
