"""A segmenter and methods of a few lines, which the worker processes of benchmark tests import by name."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fuse_grounding.benchmark.methods import Method
from fuse_grounding.config import Config
from fuse_grounding.errors import InputError, UnusableError
from fuse_grounding.perception.protocol import Detection
from fuse_grounding.planning.protocol import Decision, Situation
from fuse_grounding.record import Stopwatch

EPISODE = 1
"""Index of the episode in which the troublesome methods make trouble."""


class Eye:
    """Sees the first label in what is brighter than the middle: the same picture, the same answer."""

    labels = None

    def __init__(self, config: Any):
        self._options = config.options

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        grey = rgb.mean(axis=2)
        mask = np.zeros(grey.shape, bool)
        mask[120:360, 160:480] = grey[120:360, 160:480] > grey.mean()
        return [Detection(labels[0], float(mask.mean()), mask)] if mask.any() else []


class Walk:
    """Around the ring, two nodes at a time; `trouble` is called in every decision."""

    start: Literal["here"] = "here"
    planner = None

    def __init__(self, trouble: Any = lambda: None):
        self._trouble = trouble

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        time.sleep(float(os.environ.get("BENCH_DOUBLES_SLEEP", "0")))
        with clock("plan"):
            self._trouble()
        return Decision(9, "walk")


def _only_in_one(trouble: Any) -> Any:
    return lambda config, episode: Walk(trouble if episode == EPISODE else lambda: None)


def _boom() -> None:
    raise ValueError("the arm is stuck")


def _wrong() -> None:
    raise InputError("no such view")


def _useless() -> None:
    raise UnusableError("the key was refused")


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _die_once(config: Config, episode: int) -> Walk:
    marker = Path(config.segmenter.options["marker"])

    def trouble() -> None:
        if not marker.exists():
            marker.touch()
            _die()

    return Walk(trouble if episode == EPISODE else lambda: None)


def walk() -> Method:
    return Method("walk", lambda config, episode: Walk())


def raising() -> Method:
    return Method("raising", _only_in_one(_boom))


def always() -> Method:
    return Method("always", lambda config, episode: Walk(_boom))


def wrong() -> Method:
    return Method("wrong", _only_in_one(_wrong))


def useless() -> Method:
    return Method("useless", _only_in_one(_useless))


def dying() -> Method:
    return Method("dying", _only_in_one(_die))


def dying_once() -> Method:
    return Method("dying_once", _die_once)


class Seldom(Walk):
    """Maps in every second decision."""

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        if situation.index % 2:
            assert situation.scene is not None
            situation.scene.refine(clock)
        return super().decide(situation, clock)


def seldom() -> Method:
    return Method("seldom", lambda config, episode: Seldom(), maps=True)


def taken() -> Method:
    return Method("static", lambda config, episode: Walk())


def unreadable() -> Method:
    return Method("a b", lambda config, episode: Walk())


def nothing() -> None:
    """Makes no method."""


PLAIN = 3
