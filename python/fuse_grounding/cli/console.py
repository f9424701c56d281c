"""What the command line says while an episode runs: one line a step, progress where there is a terminal."""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.status import Status

from fuse_grounding.agent import Session
from fuse_grounding.errors import InputError
from fuse_grounding.grounding import Grounded
from fuse_grounding.record import ResultEntry, StepEntry


class Interrupted(Exception):
    """An interrupt of a command that can say better than `execute` what is kept."""


def print_json(value: Any) -> None:
    """JSON on standard output, nothing else."""
    print(json.dumps(value, indent=1, allow_nan=False))


def writable_folder(folder: Path) -> None:
    """Makes a folder where there is none. Raises InputError when nothing can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise InputError(f"folder {folder} cannot be written: {error.strerror}") from None


@contextmanager
def interruptible(kept: str = "nothing was written") -> Iterator[None]:
    """Within it an interrupt ends the process at once, with 130 (being told to end: 143), even in native code
    that does not listen.

    `kept` says what is left.

    For the main thread, and for work that writes nothing before it is done.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)

    def listen() -> None:
        while number := os.read(reading, 1):
            if number[0] in (signal.SIGINT, signal.SIGTERM):
                print(f"fuse: interrupted; {kept}", file=sys.stderr, flush=True)
                os._exit(128 + number[0])

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    before = signal.set_wakeup_fd(writing)
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(writing)
        listener.join()
        os.close(reading)


class Narrator:
    """A watcher that tells an episode on the console; silent on standard output when `quiet`."""

    def __init__(self, quiet: bool = False):
        self._out = Console(quiet=quiet, soft_wrap=True, highlight=False, markup=False)
        self._err = Console(stderr=True, soft_wrap=True)
        self._status: Status | None = None
        self._told = 0

    def started(self, session: Session) -> None:
        """The query, what was understood, the candidates with their reasons."""
        query = session.query
        self._out.print(f'query       "{query.text}" -> {query.verb} (by "{query.because}")')
        self._out.print(f"candidates  from {session.hypotheses.source}:")
        for candidate in session.hypotheses.candidates:
            self._out.print(f"  {candidate.label:<14} {candidate.score:.2f}  {candidate.reason}")
        self._announce(session)
        self._work("seed views" if session.seed_requests else "first view")

    def stepped(self, session: Session, step: StepEntry) -> None:
        """One line: viewpoint, branch, score, time."""
        self._rest()
        self._announce(session)
        self._out.print(step_line(step))
        if session.grounded is None and step.action is not None:
            self._work(f"step {step.index + 1}")

    def finished(self, session: Session, grounded: Grounded) -> None:
        """Nothing yet: the verdict may follow from the ground truth."""
        self._rest()
        self._announce(session)

    def close(self) -> None:
        """Stops the progress display, whatever happened."""
        self._rest()

    def result(self, result: ResultEntry, folder: str | None) -> None:
        """The result, where the time went, where the pictures are."""
        for line in result_lines(result):
            self._out.print(line)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # Linux counts in KiB
        self._out.print(f"memory      {peak:.0f} MiB at most")
        if folder is not None:
            self._out.print(f"pictures    {folder}/overview.png, {folder}/grounding.png, {folder}/steps/")
            self._out.print(f"record      {folder}/episode.json")

    def say(self, sentence: str) -> None:
        """One line on standard output."""
        self._out.print(sentence)

    def _announce(self, session: Session) -> None:
        for sentence in session.record.announcements[self._told :]:
            self._out.print(f"note        {sentence}")
        self._told = len(session.record.announcements)

    def _work(self, what: str) -> None:
        if self._err.is_terminal:
            self._status = self._err.status(f"{what} ...")
            self._status.start()

    def _rest(self) -> None:
        if self._status is not None:
            self._status.stop()
            self._status = None


def step_line(step: StepEntry) -> str:
    """A step in one line."""
    where = "canonical view" if step.node is None else f"node {step.node:2d} {step.pitch_deg:.0f}°"
    top = max((s.fused for s in step.scores if s.fused is not None), default=None)
    score = "  -  " if top is None else f"{top:.3f}"
    best = "  -  " if step.best_score is None else f"{step.best_score:.3f}"
    branch = step.branch or "stop"
    action = "" if step.action is None else f"{step.action % 5 - 2:+d} nodes {step.action // 5 - 1:+d} pitch"
    how = "" if step.registration is None else f"  {step.registration}"
    seconds = sum(step.timings.values())
    mark = "*" if step.improved else " "
    return (
        f"step {step.index:2d}     {where:<14}{how}  score {score}{mark} best {best}  "
        f"{branch:<13} {action:<17} {seconds:6.2f} s"
    )


def result_lines(result: ResultEntry) -> list[str]:
    """The result in a few lines."""
    lines = [f"stopped     {result.stop_reason}"]
    view = result.view
    if result.label is None or view is None:
        lines.append("result      nothing was found")
    else:
        where = "canonical view" if view.node is None else f"node {view.node}, {view.pitch_deg:.0f}° down"
        score = "" if result.score is None else f", grounding score {result.score:.3f}"
        lines.append(f"result      {result.label} in view {view.index} ({where}){score}")
    if result.centroid_m is not None and result.box_m is not None:
        centroid = ", ".join(f"{x:.3f}" for x in result.centroid_m)
        size = " x ".join(
            f"{100 * (b - a):.0f}" for a, b in zip(result.box_m.min, result.box_m.max, strict=True)
        )
        lines.append(f"where       ({centroid}) m, box {size} cm")
    if result.metrics is not None:
        verdict = "success" if result.metrics["success"] else "no success"
        lines.append(f"truth       {verdict}, IoU {result.metrics['iou']:.3f}")
    branches = ", ".join(f"{n} {name}" for name, n in result.branches.items()) or "none"
    lines.append(
        f"actions     {result.online_actions} online, {result.seed_motions} for seed views; "
        f"branches: {branches}"
    )
    stages = sorted(result.timings.items(), key=lambda item: -item[1])
    spent = ", ".join(f"{stage} {seconds:.1f}" for stage, seconds in stages if seconds >= 0.05)
    lines.append(f"seconds     {result.wall_seconds:.1f} ({spent})")
    return lines
