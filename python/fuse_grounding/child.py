"""What every process that does work for another one begins with."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading


def settle(threads: int) -> None:
    """For a process that `multiprocessing` spawned: it leaves interrupts to its parent, ends when that ends
    or when it is told to, and gives native code `threads` threads, which start at first use, after this."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # COLMAP's handler would dump its stack
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ["RAYON_NUM_THREADS"] = str(threads)


def threads_each(jobs: int) -> int:
    """Native threads of each of `jobs` processes of this machine."""
    return max(1, (os.cpu_count() or 1) // jobs)


def _end_with_parent() -> None:
    """A process whose parent was killed would wait for work for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os.kill(os.getpid(), signal.SIGKILL)
