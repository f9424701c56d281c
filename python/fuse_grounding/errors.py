"""Errors that FUSE raises. Both come from the compiled module, so that Rust and Python raise the same types."""

from fuse_grounding._core import FuseError, InputError

__all__ = ["FuseError", "InputError"]
