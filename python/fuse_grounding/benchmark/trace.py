"""What happened step by step, judged against the truth once the search is over.

While it runs, a `Trace` keeps references to masks that exist anyway; all that knows the truth happens in
`judge`, after the clocks have stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fuse_grounding import grounding
from fuse_grounding._core import Camera
from fuse_grounding.benchmark.metrics import Truth, Value, evaluate, match, pitch_index, pixel_ratio
from fuse_grounding.config import Config
from fuse_grounding.environment import Target
from fuse_grounding.grounding import Grounded, Viewpoint
from fuse_grounding.perception.protocol import Segmenter
from fuse_grounding.record import StepEntry

if TYPE_CHECKING:
    from fuse_grounding.agent import Session


@dataclass(frozen=True)
class StepTrace:
    """One observation, the decision that followed it, and how well the search stood then."""

    index: int
    node: int | None
    pitch_deg: float | None
    branch: str | None
    entropy: float | None
    action: int | None
    improved: bool
    best_score: float | None
    """Best grounding score so far; None before any region was large enough."""
    best_iou: float
    """Best IoU with a valid object of the mask that would be returned if the search ended here."""
    target_pixels: int
    """Pixels of this view that show the object that the metrics are about."""
    target_pixel_ratio: float
    """The same as a ratio (docs/metrics.md)."""
    target_score: float | None
    """Segmenter's surest instance of that object's label in this view, 0 without one; None where the label
    was no candidate and so not asked for."""


@dataclass(frozen=True)
class Judgement:
    """What the truth says of a grounding: `metrics` as of `evaluate`, and every step."""

    metrics: dict[str, Value]
    steps: tuple[StepTrace, ...]

    def step_rows(self) -> list[dict[str, Any]]:
        """The steps as JSON values."""
        return [asdict(step) for step in self.steps]


@dataclass(frozen=True)
class _Moment:
    """After one step: the mask and view that were ahead, and the surest score of every label seen."""

    step: StepEntry
    mask: np.ndarray | None
    leading: Viewpoint
    surest: dict[str, float]


class Trace:
    """A watcher of one search, who keeps what judging its steps takes: some microseconds a step."""

    def __init__(self, config: Config):
        """`config` is the agent's: it says which mask of a view is returned."""
        self._config = config
        self._asked: tuple[str, ...] = ()
        self._moments: list[_Moment] = []

    def started(self, session: Session) -> None:
        """Begins anew: a trace is of the last search that it watched."""
        self._asked, self._moments = tuple(session.hypotheses.labels), []

    def stepped(self, session: Session, step: StepEntry) -> None:
        """Keeps what was ahead after this step."""
        leading, glance = session.leading, session.glance
        assert leading is not None, "a step has a view"
        assert glance is not None, "a step has a view"
        chosen = grounding.choose(leading.scored, self._config.metric)
        surest: dict[str, float] = {}
        for seen in glance.detections:
            surest[seen.label] = max(float(seen.score), surest.get(seen.label, 0.0))
        mask = None if chosen is None else chosen.detection.mask
        self._moments.append(_Moment(step, mask, leading.viewpoint, surest))

    def finished(self, session: Session, grounded: Grounded) -> None:
        """Nothing more to keep: the last step was told already."""

    def judge(self, grounded: Grounded, truth: Truth, segmenter: Segmenter) -> Judgement:
        """Metrics and steps of the search that `grounded` ended.

        Renders the truth once for each view that was ahead at some time (4 to 8 ms each), and asks the
        segmenter once more for the final score.
        """
        remembered = _Remembered(truth)
        place = grounded.viewpoint.node, pitch_index(self._config, grounded.viewpoint.pitch_deg)
        ids = remembered.true_instances(*place)
        target = match(grounded.mask, ids, remembered.true_targets()).target
        return Judgement(
            evaluate(grounded, remembered, segmenter, self._config),
            tuple(self._judged(moment, remembered, target) for moment in self._moments),
        )

    def _judged(self, moment: _Moment, truth: _Remembered, target: Target) -> StepTrace:
        step, ahead = moment.step, moment.leading
        ids = truth.true_instances(ahead.node, pitch_index(self._config, ahead.pitch_deg))
        pitch = pitch_index(self._config, step.pitch_deg)
        if step.node is None or pitch is None:
            seen = truth.true_instances(step.node, pitch)
            pixels = int(np.count_nonzero(seen == target.instance))
        else:
            pixels = int(target.visible_px[step.node, pitch])
        asked = target.label in self._asked
        return StepTrace(
            index=step.index,
            node=step.node,
            pitch_deg=step.pitch_deg,
            branch=step.branch,
            entropy=step.entropy,
            action=step.action,
            improved=step.improved,
            best_score=step.best_score,
            best_iou=match(moment.mask, ids, truth.true_targets()).iou,
            target_pixels=pixels,
            target_pixel_ratio=pixel_ratio(pixels, target.least_pixels, target.most_pixels),
            target_score=moment.surest.get(target.label, 0.0) if asked else None,
        )


class _Remembered:
    """A truth that renders each viewpoint once."""

    def __init__(self, truth: Truth):
        self._truth = truth
        self._targets = list(truth.true_targets())
        self._ids: dict[tuple[int | None, int | None], np.ndarray] = {}

    def true_instances(self, node: int | None, pitch_index: int | None) -> np.ndarray:
        place = node, pitch_index
        if place not in self._ids:
            self._ids[place] = self._truth.true_instances(*place)
        return self._ids[place]

    def true_camera(self, node: int | None, pitch_index: int | None) -> Camera:
        return self._truth.true_camera(node, pitch_index)

    def true_targets(self) -> Sequence[Target]:
        return self._targets
