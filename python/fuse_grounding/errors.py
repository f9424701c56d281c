"""Errors that FUSE raises: the compiled module's own types, so that Rust and Python raise the same."""

from fuse_grounding._core import FuseError, InputError

__all__ = ["FuseError", "InputError"]
