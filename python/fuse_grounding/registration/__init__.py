"""Placing views: live COLMAP registration, or poses that are known."""

from fuse_grounding.registration.colmap import ColmapRegistrar
from fuse_grounding.registration.posed import PosedRegistrar
from fuse_grounding.registration.protocol import RegisteredView, Registrar, RegistrationError

__all__ = ["ColmapRegistrar", "PosedRegistrar", "RegisteredView", "Registrar", "RegistrationError"]
