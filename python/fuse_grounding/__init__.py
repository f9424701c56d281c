"""Active functional affordance grounding: which object can do it, and where should the camera look next?

```python
import fuse_grounding as fuse

env = fuse.TabletopEnvironment(episode)
grounded = fuse.Agent(fuse.Config()).run(env, "cut a piece of rope")
```

Public names are imported on first use, so that the command line starts fast; the arrays' functions
live in `fuse_grounding.evidence` and `fuse_grounding.splat`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from fuse_grounding.gymnasium_hook import register_when_imported

if TYPE_CHECKING:
    from fuse_grounding._core import Camera, __version__
    from fuse_grounding.agent import Agent, Session
    from fuse_grounding.config import Config
    from fuse_grounding.environment import ReplayEnvironment, TabletopEnvironment
    from fuse_grounding.errors import FuseError, InputError
    from fuse_grounding.grounding import Grounded, Move
    from fuse_grounding.record import EpisodeRecord

__all__ = [
    "Agent",
    "Camera",
    "Config",
    "EpisodeRecord",
    "FuseError",
    "Grounded",
    "InputError",
    "Move",
    "ReplayEnvironment",
    "Session",
    "TabletopEnvironment",
    "__version__",
]

_HOMES = {
    "Agent": "agent",
    "Camera": "_core",
    "Config": "config",
    "EpisodeRecord": "record",
    "FuseError": "errors",
    "Grounded": "grounding",
    "InputError": "errors",
    "Move": "grounding",
    "ReplayEnvironment": "environment",
    "Session": "agent",
    "TabletopEnvironment": "environment",
    "__version__": "_core",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)


register_when_imported()
