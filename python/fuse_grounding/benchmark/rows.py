"""What every line of `results.jsonl` has: no table is made of a damaged one, and its field is named.

Fields that only describe a run, such as `candidates`, are not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from fuse_grounding.benchmark.metrics import METRICS
from fuse_grounding.config_text import explain

_SHOWN = 200


class _Line(BaseModel):
    """What a row has, however its episode ended; a boolean is no number, and a text is none."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)

    identity: str
    index: int
    method: str
    episode_id: str
    scene: str
    verb: str
    status: Literal["ok", "error"]


class _Failed(_Line):
    error: str
    success: Literal[False] = False
    iou: float = 0.0


class _Step(BaseModel):
    model_config = _Line.model_config

    branch: str | None
    entropy: float | None
    action: int | None
    best_iou: float
    best_score: float | None
    target_pixel_ratio: float


class _Measured(_Line):
    success: bool
    seed_motions: int
    branches: dict[str, int]
    calls: dict[str, int]
    timings: dict[str, float]
    wall_seconds: float
    concurrent: bool
    trace: list[_Step] = []


_metrics: dict[str, Any] = {
    metric.name: (float | None if metric.optional else float, ...)
    for metric in METRICS
    if metric.name != "success"
}
_Done = create_model("_Done", __base__=_Measured, **_metrics)


def fault(row: Any, places: Mapping[str, int]) -> str | None:
    """What is wrong with the row of a line, None if nothing is: the field, what was found and expected.

    `places` are the indices of episodes by id; one that is not among them is the caller's to refuse.
    """
    if not isinstance(row, dict):
        return f"found {repr(row)[:_SHOWN]}, expected an object"
    try:
        line = _Line.model_validate(row)
        (_Done if line.status == "ok" else _Failed).model_validate(row)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        return f"`{name}` is missing" if first["type"] == "missing" else explain(error, _Line)[:_SHOWN]
    place = places.get(line.episode_id, line.index)
    if line.index != place:
        return f"`index`: found {line.index}, expected: {place}, the place of `{line.episode_id}`"
    return None
