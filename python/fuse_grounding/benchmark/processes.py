"""The local engine: worker processes, each with its own agents.

One that dies takes only its episode with it, which is tried again once, in a fresh process, and then recorded
as an error. Only the parent writes results.
"""

from __future__ import annotations

import multiprocessing
import signal
import traceback
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from fuse_grounding.benchmark.worker import Done, Loaded, Setup, Task, Worker, dead
from fuse_grounding.child import settle, threads_each
from fuse_grounding.errors import FuseError, InputError

_ATTEMPTS = 2


class Processes:
    """`jobs` worker processes, started as there is work for them; see `worker.Engine`."""

    def __init__(self, setups: Sequence[Setup], jobs: int):
        self._setups, self._jobs = setups, jobs
        self._children: list[_Child] = []
        self._loaded: tuple[Loaded, ...] | None = None

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        for child in self._children:
            child.kill()
        self._children.clear()

    def load(self) -> tuple[Loaded, ...]:
        """What the first worker has. Raises InputError for what cannot be loaded, FuseError if it dies."""
        if self._loaded is None:
            if not self._children:
                self._children.append(_Child(self._setups, threads_each(self._jobs)))
            while self._loaded is None:
                self._hear(self._children[0])
        return self._loaded

    def run(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """Every task once, in the order in which they end; a worker keeps to an episode as long as there are
        tasks of it. Raises InputError for what concerns all of them, FuseError when a worker dies while it
        loads."""
        waiting, deaths = deque(tasks), Counter[tuple[int, int, str]]()
        while waiting or any(child.task for child in self._children):
            self._staff(waiting)
            for connection in wait([child.connection for child in self._children]):
                child = next(c for c in self._children if c.connection is connection)
                task = child.task
                try:
                    done = self._hear(child)
                except _DeadError as death:
                    assert task is not None
                    which = task.part, task.index, task.method
                    deaths[which] += 1
                    if deaths[which] < _ATTEMPTS:
                        waiting.appendleft(task)
                        continue
                    why = f"the process that ran it died {_ATTEMPTS} times ({_told(death.code)})"
                    done = dead(self._setups[task.part], task, why)
                if done is not None:
                    self._staff(waiting)  # nobody is idle while the row is written
                    yield done

    def _staff(self, waiting: deque[Task]) -> None:
        """Hands out work, and starts workers where there is more work than workers."""
        for child in self._children:
            if child.ready and child.task is None and waiting:
                child.give(self._chosen(child, waiting))
        unready = sum(not child.ready for child in self._children)
        for _ in range(min(self._jobs - len(self._children), len(waiting) - unready)):
            self._children.append(_Child(self._setups, threads_each(self._jobs)))

    def _chosen(self, child: _Child, waiting: deque[Task]) -> Task:
        """Takes a task of the child's episode, else of one that no other is at, else the first."""
        elsewhere = {c.episode for c in self._children if c is not child}
        mine = (i for i, task in enumerate(waiting) if task.index == child.episode)
        nobodys = (i for i, task in enumerate(waiting) if task.index not in elsewhere)
        place = next(mine, next(nobodys, 0))
        task = waiting[place]
        del waiting[place]
        return task

    def _hear(self, child: _Child) -> Done | None:
        """The next message of a worker; None where it is no row. Raises InputError, FuseError, _DeadError."""
        try:
            kind, content = child.connection.recv()
        except (EOFError, OSError):
            code = child.ended()
            self._children.remove(child)
            if child.task is not None:
                raise _DeadError(code) from None
            if child.ready:
                return None  # it had nothing to do
            raise FuseError(
                f"a worker process died while it was loading ({_told(code)}); results so far are kept"
            ) from None
        if kind == "done":
            child.task = None
            return content
        if kind == "loaded":
            child.ready = True
            self._loaded = self._loaded or content
            if content != self._loaded:
                raise InputError(
                    "a worker process loaded other weights than the first one: did a file change?"
                )
            return None
        raise InputError(content) if kind == "refused" else FuseError(content)


class _DeadError(Exception):
    """A worker died with a task."""

    def __init__(self, code: int | None):
        self.code = code


class _Child:
    """A worker process as its parent sees it."""

    def __init__(self, setups: Sequence[Setup], threads: int):
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, setups, threads))
        self.task: Task | None = None
        self.episode: int | None = None
        self.ready = False
        # An interrupt of the terminal reaches the whole group, also one that is still importing.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()

    def give(self, task: Task) -> None:
        """Hands over a task; that the worker is gone is noticed when it is heard."""
        self.task, self.episode = task, task.index
        with suppress(OSError):
            self.connection.send(task)

    def ended(self) -> int | None:
        """The exit code of a process that is gone or going."""
        self._process.join(5)
        self.kill()
        return self._process.exitcode

    def kill(self) -> None:
        """Ends the process."""
        self._process.kill()
        self._process.join()
        self.connection.close()


def _serve(connection: Connection, setups: Sequence[Setup], threads: int) -> None:
    """A worker's life: load, then a row for every task."""
    settle(threads)

    def tell(kind: str, content: Any) -> None:
        connection.send((kind, content))

    try:
        worker = Worker(setups)
        tell("loaded", worker.loaded)
        while True:
            tell("done", worker.run(connection.recv()))
    except (EOFError, BrokenPipeError):  # the parent has no more work
        return
    except InputError as error:
        tell("refused", str(error))
    except Exception as error:
        tell("broken", f"a worker process failed: {type(error).__name__}: {error}\n{traceback.format_exc()}")


def _told(code: int | None) -> str:
    """An exit code in words."""
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        return f"{name}, out of memory?" if name == "SIGKILL" else name
    return f"exit status {code}"
