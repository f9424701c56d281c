"""Makes `gymnasium.make("fuse_grounding/Tabletop-v0")` work once both packages are imported, in either order.

Gymnasium 1.x finds no environments by itself: a package registers its own when it is imported. Importing
Gymnasium for that would slow down everybody who does not use it, so its own import is waited for.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

TABLETOP = "fuse_grounding/Tabletop-v0"
MAX_ACTIONS = 30
"""Actions until an episode is truncated: `budget.actions` of the configuration."""


def register() -> None:
    """Tells Gymnasium of the environment; once."""
    import gymnasium

    if TABLETOP not in gymnasium.registry:
        gymnasium.register(
            TABLETOP,
            entry_point="fuse_grounding.environment.gym:TabletopGym",
            max_episode_steps=MAX_ACTIONS,
        )


def register_when_imported() -> None:
    """Registers now if Gymnasium is there, otherwise right after it is imported."""
    if sys.modules.get("gymnasium") is not None:
        register()
    elif not any(isinstance(finder, _Waiting) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Waiting())


class _Waiting(MetaPathFinder):
    """Finds nothing itself: lets the others find Gymnasium, and adds a line to its loading."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """None for every other module."""
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is None or spec.loader is None:
            return spec
        load = spec.loader.exec_module

        def load_and_register(module: ModuleType) -> None:
            load(module)
            register()

        spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec
