"""Where the learned planner's weights come in.

This version ships no weights and knows no format for them: asking for a planner is an error, and
having none is a fact that the gate announces.
"""

from __future__ import annotations

from pathlib import Path

from fuse_grounding.errors import InputError
from fuse_grounding.planning.protocol import Planner


def load_planner(path: Path | None) -> Planner | None:
    """None when no weights are configured. Raises InputError when some are: they cannot be read yet."""
    if path is None:
        return None
    if not path.exists():
        raise InputError(f"planner weights {path} (gate.planner) do not exist")
    raise InputError(
        f"planner weights {path} (gate.planner) cannot be used: this version has no amortised planner; "
        "leave gate.planner unset and every decision is explicit"
    )
