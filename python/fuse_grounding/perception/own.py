"""Segmenters and encoders of a user's own: `package.module:Class`, or the name of an entry point.

The class is called with its section of the configuration (`SegmenterConfig`, `EncoderConfig`) alone. What a
segmenter of a user's own returns is held against the protocol, so that a mistake is told where it is made.
"""

from __future__ import annotations

import importlib.metadata as metadata
import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding import user_code
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.perception.prompts import check_picture
from fuse_grounding.perception.protocol import Detection, Segmenter


def entry_points(group: str) -> dict[str, str]:
    """`module:Class` by name of everything that installed packages register under `group`."""
    return {point.name: point.value for point in metadata.entry_points(group=group)}


_NEEDS = {"segmenter": ("segment", "labels"), "encoder": ("text", "name")}
"""The method that a class of each kind has, and what an instance has besides."""


def load(kind: str, name: str) -> Any:
    """The class `package.module:Class`. Raises InputError unless it is there and is of that kind."""
    who, found = f"{kind} `{name}`", user_code.find(kind, name, "Class")
    if not inspect.isclass(found):
        raise InputError(f"{who} is a {type(found).__name__}, expected a class")
    if not callable(getattr(found, _NEEDS[kind][0], None)):
        raise InputError(f"{who} has no method `{_NEEDS[kind][0]}`: it is no {kind} (perception/protocol.py)")
    return found


def make(kind: str, name: str, config: Any) -> Any:
    """An instance of a loaded class. Raises InputError where it cannot be made."""
    recipe = load(kind, name)
    try:
        made = recipe(config)
    except FuseError:
        raise
    except Exception as error:
        raise InputError(f"{kind} `{name}` cannot be made: {type(error).__name__}: {error}") from error
    if not hasattr(made, _NEEDS[kind][1]):
        raise InputError(
            f"{kind} `{name}` has no `{_NEEDS[kind][1]}`: it is no {kind} (perception/protocol.py)"
        )
    return made


def sources(thing: Any) -> tuple[list[Path], list[str]]:
    """The file of an instance's class, and the distribution that brought it, if one did."""
    file = user_code.source_file(type(thing))
    top = type(thing).__module__.split(".")[0]
    return ([] if file is None else [file], metadata.packages_distributions().get(top, [])[:1])


class CheckedSegmenter:
    """Another segmenter whose detections are held against the protocol; implements `Segmenter`."""

    def __init__(self, segmenter: Segmenter, name: str) -> None:
        self._segmenter, self._name = segmenter, name

    @property
    def labels(self) -> tuple[str, ...] | None:
        """The other's."""
        return self._segmenter.labels

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        """The other's detections, best first. Raises FuseError for what is no detection."""
        rgb = check_picture(rgb)
        found = list(self._segmenter.segment(rgb, labels))
        for detection in found:
            self._check(detection, rgb.shape[:2], labels)
        return sorted(found, key=lambda d: -d.score)

    def _check(self, detection: Any, shape: tuple[int, ...], labels: Sequence[str]) -> None:
        who = f"segmenter `{self._name}` returned"
        if not isinstance(detection, Detection):
            raise FuseError(f"{who} a {type(detection).__name__}, expected a Detection")
        mask, score = detection.mask, detection.score
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != shape:
            what = (
                f"{mask.dtype} array of shape {mask.shape}"
                if isinstance(mask, np.ndarray)
                else type(mask).__name__
            )
            raise FuseError(f"{who} a mask that is a {what}, expected a bool array of shape {tuple(shape)}")
        if isinstance(score, bool) or not isinstance(score, (int, float, np.floating)) or not 0 <= score <= 1:
            raise FuseError(f"{who} a score of {score!r}, expected a number from 0 to 1")
        if detection.label not in labels:
            raise FuseError(f"{who} the label `{detection.label}`, which was not asked for")
