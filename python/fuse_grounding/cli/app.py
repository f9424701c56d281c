"""`fuse`: an exit status for whatever happens, from the first moment on.

0 done, 1 ran but failed, 2 bad usage or input, 130 interrupted.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence


def execute(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line and returns its exit status."""
    try:
        # Loading takes a second, and must not answer an interrupt with a traceback.
        from fuse_grounding.cli.commands import attempt

        status = attempt(arguments)
    except KeyboardInterrupt:
        status = 130
    if status == 130:
        print("fuse: interrupted; what was finished is kept", file=sys.stderr)
    return status


def main() -> None:
    """The `fuse` command."""
    # Mesa's layer that sorts GPUs complains where there is no desktop; `fuse` sorts them itself.
    os.environ.setdefault("NODEVICE_SELECT", "1")
    sys.exit(execute())


if __name__ == "__main__":
    main()
