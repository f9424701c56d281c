"""`fuse`: an exit status for whatever happens, from the first moment on.

0 done, 1 ran but failed, 2 bad usage or input, 130 interrupted, 143 told to end.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from typing import Any


def execute(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line and returns its exit status."""
    try:
        # Loading takes a second, and must not answer an interrupt with a traceback.
        from fuse_grounding.cli.commands import attempt

        # After loading: COLMAP's handler would dump its stack.
        signal.signal(signal.SIGTERM, _end)
        status = attempt(arguments)
    except KeyboardInterrupt:
        print("fuse: interrupted; what was finished is kept", file=sys.stderr)
        status = 130
    return 143 if status == 130 and _ended else status


_ended: list[int] = []
"""The signal that told this process to end, once it came."""


def _end(number: int, _frame: Any) -> None:
    """What a scheduler asks for is an interrupt, too."""
    _ended.append(number)
    raise KeyboardInterrupt


def main() -> None:
    """The `fuse` command."""
    # Mesa's layer that sorts GPUs complains where there is no desktop; `fuse` sorts them itself.
    os.environ.setdefault("NODEVICE_SELECT", "1")
    sys.exit(execute())


if __name__ == "__main__":
    main()
