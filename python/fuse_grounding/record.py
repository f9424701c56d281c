"""What an episode leaves behind: the schema of `episode.json`, written so that it is always readable.

Two runs of the same seed differ only in fields that are named `timings` or end in `_seconds`.
"""

from __future__ import annotations

import fcntl
import json
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fuse_grounding.errors import InputError

SCHEMA_VERSION = 1

Timings = dict[str, float]


HOSTED = "api"
"""The stage in which a search waits for a hosted model: no part of its runtime (supplement)."""


class Stopwatch:
    """Seconds by stage: `with clock("segment"): ...`. Stages add up; a nested stage is not counted twice.

    `calls` counts how often each stage was entered, from the beginning on.
    """

    def __init__(self) -> None:
        self.seconds: Timings = {}
        self.calls: dict[str, int] = {}
        self._inner: list[float] = []

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Adds the seconds spent inside to `stage`."""
        self._inner.append(0.0)
        start = time.perf_counter()
        try:
            yield
        finally:
            elapsed = time.perf_counter() - start
            own = elapsed - self._inner.pop()
            if self._inner:
                self._inner[-1] += elapsed
            self.add(stage, own)

    def add(self, stage: str, seconds: float) -> None:
        """One call of `stage` that took `seconds`."""
        self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds
        self.calls[stage] = self.calls.get(stage, 0) + 1

    def take(self) -> Timings:
        """What was measured since the last call, rounded to microseconds."""
        taken = {stage: round(seconds, 6) for stage, seconds in self.seconds.items()}
        self.seconds.clear()
        return taken


class Entry(BaseModel):
    """A part of the record; unknown fields are errors."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)


class CandidateEntry(Entry):
    """A candidate label with the reason it was proposed."""

    label: str
    score: float
    reason: str


class ReplacementEntry(Entry):
    """A proposed label that became the nearest one that the segmenter knows, by a text encoder."""

    proposed: str
    label: str
    words: str
    similarity: float
    encoder: str


class SeedEntry(Entry):
    """A seed view: where it was asked for and how its pose was found."""

    node: int | None
    pitch_deg: float | None
    registration: str


class InitializationEntry(Entry):
    """The seed views, before the first online step. `points`: sparse points after registering them."""

    seeds: list[SeedEntry]
    points: int
    timings: Timings


class ScoreEntry(Entry):
    """The best instance of one label in one view; `fused` is None for a region that is too small."""

    label: str
    score: float
    depth: float | None
    fused: float | None
    pixels: int
    instances: int


class MapEntry(Entry):
    """The Gaussian map after this step."""

    gaussians: int
    views: int
    refinements: int


class StepEntry(Entry):
    """One observation and the decision that followed it."""

    index: int
    node: int | None
    pitch_deg: float | None
    registration: Literal["colmap", "posed", "posed_fallback"] | None
    """How the view's pose was found; None for methods that do not register."""
    scores: list[ScoreEntry]
    best_score: float | None
    """Best grounding score of the episode so far; None before any region was large enough."""
    improved: bool
    branch: str | None = None
    """`explicit`, `amortized`, or the policy's name; None where the search ended before planning."""
    entropy: float | None = None
    """Normalised entropy of the planner's action values; None without a planner."""
    action_values: list[float | None] | None = None
    """One value an action; None where masked."""
    action: int | None = None
    """None where the search ended."""
    reason: str = ""
    functional_uncertainty: float | None = None
    """Mean of U_func = 1 - S + U_geo, a diagnostic of explicit decisions."""
    coverage: float | None = None
    """Mean opacity of the rendering behind the geometric uncertainty; 0 where there was none."""
    map: MapEntry | None = None
    timings: Timings = Field(default_factory=dict)


class ViewEntry(Entry):
    """The viewpoint of the returned grounding; `center_m` is the camera's centre in the world."""

    index: int
    node: int | None
    pitch_deg: float | None
    center_m: list[float] | None


class BoxEntry(Entry):
    """Axis-aligned box in the world, metres."""

    min: list[float]
    max: list[float]


class MaskEntry(Entry):
    """A mask as run lengths in row-major order, starting with background: `counts` sums to H * W."""

    size: tuple[int, int]
    counts: list[int]


class ResultEntry(Entry):
    """What the episode returned. Counts: observations = online actions + 1 (canonical: 1 each)."""

    status: Literal["grounded", "not_found"]
    stop_reason: str
    label: str | None
    fused_label: str | None
    """Label of the best fused score, which the mask's label may differ from."""
    score: float | None
    instance_score: float | None
    view: ViewEntry | None
    centroid_m: list[float] | None
    box_m: BoxEntry | None
    mask: MaskEntry | None
    online_actions: int
    observations: int
    seed_motions: int
    total_steps: int
    """Online actions with the seed motions."""
    branches: dict[str, int]
    registrations: dict[str, int]
    planner: str | None
    """Which amortised planner decided; `none` where a gated method ran without one."""
    metrics: dict[str, bool | int | float | None] | None = None
    """Against the ground truth, where it is known."""
    timings: Timings
    wall_seconds: float


class EpisodeRecord(Entry):
    """The whole episode."""

    schema_version: int = SCHEMA_VERSION
    query: str
    verb: str
    because: str
    method: str
    knowledge: str
    candidates: list[CandidateEntry]
    candidates_unknown: list[CandidateEntry] = Field(default_factory=list)
    """Proposed and left out, because the segmenter does not know these labels."""
    candidates_replaced: list[ReplacementEntry] = Field(default_factory=list)
    """Proposed in words that the segmenter does not know, and what was taken instead."""
    announcements: list[str]
    seed: int | None = None
    scene: str | None = None
    episode_id: str | None = None
    config: dict[str, Any]
    provenance: dict[str, Any]
    initialization: InitializationEntry | None = None
    steps: list[StepEntry] = Field(default_factory=list)
    photos: list[str] | None = None
    """File name of each online view, where the world is a folder of photos."""
    result: ResultEntry | None = None

    def write(self, path: Path) -> None:
        """Replaces `path` in one step: readers see the old record or the new one, never half of one."""
        write_atomically(path, json.dumps(self.model_dump(mode="json"), indent=1, allow_nan=False) + "\n")

    @classmethod
    def load(cls, path: Path) -> EpisodeRecord:
        """Reads a record. Raises InputError for a file that is missing, truncated or of another schema."""
        try:
            raw = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise InputError(f"episode record {path} does not exist") from None
        except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
            raise InputError(f"episode record {path} is not complete JSON: {error}") from None
        version = raw.get("schema_version") if isinstance(raw, dict) else None
        if version != SCHEMA_VERSION:
            raise InputError(f"episode record {path} has schema_version {version}, expected {SCHEMA_VERSION}")
        try:
            return cls.model_validate(raw)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(p) for p in first["loc"])
            raise InputError(f"episode record {path}: `{key}`: {first['msg']}") from None


def write_atomically(path: Path, content: str | bytes) -> None:
    """Writes beside `path`, flushes to disk, renames. Leaves nothing behind when interrupted."""
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def hold(folder: Path, who: str) -> int:
    """Locks `folder` for one writer, until the descriptor is closed or the process ends, however it ends.

    Raises InputError while another one, `who` by kind, holds it.
    """
    held = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(held)
        if not isinstance(error, BlockingIOError):
            raise
        raise InputError(f"another {who} is writing to {folder}; wait for it or end it") from None
    return held
