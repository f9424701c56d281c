"""Episodes to step through: what `fuse bench --gallery` kept of them, embedded within a limit of bytes."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2

from fuse_grounding.benchmark.report import labels
from fuse_grounding.benchmark.report.load import GALLERY, Folder, Results
from fuse_grounding.benchmark.report.model import Block, Frame, Gallery, Picture, Strip, Text
from fuse_grounding.errors import InputError
from fuse_grounding.record import EpisodeRecord, StepEntry

LIMIT_MB = 16.0
"""Embedded pictures of a page, megabytes."""

_WIDTH = 320
_QUALITY = 72
_PICTURES = (
    ("observation", "Input"),
    ("semantic", "Semantic evidence"),
    ("geometric", "Geometric uncertainty"),
    ("evidence", "Fused evidence"),
)


@dataclass(frozen=True)
class _Kept:
    """One episode's folder, with what it came to."""

    path: Path
    folder: Folder
    method: str
    episode: str


def blocks(results: Results, limit_mb: float = LIMIT_MB) -> list[Block]:
    """The gallery, and in words what of it is missing and why."""
    kept = [k for folder in results.folders for k in _kept(folder)]
    if not kept:
        return [Text("Not recorded: `fuse bench` kept no pictures of these runs.")]
    # Episode by episode, so that what fits compares methods on the same ones.
    kept.sort(key=lambda k: (k.episode, labels.place(k.method), k.folder.label))
    budget, strips, left_out = limit_mb * 1e6, [], 0
    words: list[Block] = []
    for one in kept:
        if left_out:
            left_out += 1
            continue
        try:
            strip = _strip(one)
        except InputError as error:
            # Without where it lies on this machine.
            reason = str(error).replace(str(one.folder.path), one.folder.label)
            words.append(Text(f"Cannot be shown: {reason}.", "warning"))
            continue
        size = sum(len(p.uri) for f in strip.frames for p in f.pictures)
        if size > budget:
            left_out += 1
            continue
        budget -= size
        strips.append(strip)
    if left_out:
        words.append(
            Text(
                f"{left_out} of {len(kept)} recorded episodes are left out, so that the pictures stay under "
                f"{limit_mb:g} MB; `--gallery-mb` raises the limit.",
                "warning",
            )
        )
    return [*words, Gallery(strips)] if strips else words


def _kept(folder: Folder) -> Iterator[_Kept]:
    for record in sorted((folder.path / GALLERY).glob("*/[!.]*/episode.json")):  # a dot: being written
        yield _Kept(record.parent, folder, record.parent.parent.name, record.parent.name)


def _strip(kept: _Kept) -> Strip:
    record = EpisodeRecord.load(kept.path / "episode.json")
    row = next(
        (r for r in kept.folder.rows if (r["method"], r["episode_id"]) == (kept.method, kept.episode)), None
    )
    verdict = "no result"
    if row is not None and row["status"] == "ok":
        verdict = f"{'success' if row['success'] else 'no success'}, IoU {row['iou']:.2f}"
    elif row is not None:
        verdict = "error"
    camera = record.config.get("camera", {})
    ring = _Ring(int(camera.get("nodes", 36)), list(camera.get("pitches_deg", [15.0, 30.0, 45.0])))
    frames = [
        Frame(
            _title(step, len(record.steps)),
            _pictures(kept.path / "steps" / f"{step.index:02d}"),
            _facts(step, camera),
            ring.draw(record.steps, step.index),
        )
        for step in record.steps
    ]
    return Strip(f"“{record.query}”", verdict, labels.method(kept.method), kept.episode, frames)


def _title(step: StepEntry, steps: int) -> str:
    where = "canonical view" if step.node is None else f"node {step.node}, {step.pitch_deg:.0f}° down"
    return f"View {step.index + 1} of {steps}: {where}"


def _facts(step: StepEntry, camera: dict[str, object]) -> list[tuple[str, str]]:
    facts = [("branch", step.branch or "search ends")]
    if step.entropy is not None:
        facts.append(("entropy", f"{step.entropy:.3f}"))
    if step.action is not None:
        facts.append(
            ("action", f"{_signed(step.action % 5 - 2)} nodes, {_signed(step.action // 5 - 1)} pitch")
        )
    here = max((s.fused for s in step.scores if s.fused is not None), default=None)
    facts.append(("score here", "–" if here is None else f"{here:.3f}"))
    best = "–" if step.best_score is None else f"{step.best_score:.3f}"
    facts.append(("best score", f"{best} (improved)" if step.improved else best))
    if step.reason:
        facts.append(("reason", step.reason))
    return facts


def _signed(number: int) -> str:
    return "0" if number == 0 else f"{number:+d}".replace("-", "\N{MINUS SIGN}")


def _pictures(folder: Path) -> list[Picture]:
    found = []
    for name, title in _PICTURES:
        path = folder / f"{name}.png"
        if path.is_file():
            found.append(_picture(path, title))
    return found


def _picture(path: Path, title: str) -> Picture:
    image = cv2.imread(str(path))
    if image is None:
        raise InputError(f"{path} is not a picture")
    height = round(image.shape[0] * _WIDTH / image.shape[1])
    small = cv2.resize(image, (_WIDTH, height), interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".webp", small, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    if not done:
        raise InputError(f"{path} cannot be encoded as WebP by this OpenCV")
    uri = "data:image/webp;base64," + base64.b64encode(data.tobytes()).decode()
    return Picture(uri, title, _WIDTH, height)


class _Ring:
    """The viewpoints from above: the steeper the pitch, the nearer to the middle."""

    def __init__(self, nodes: int, pitches_deg: Sequence[float]):
        self._nodes, self._pitches = nodes, [float(p) for p in pitches_deg]

    def _place(self, node: int, pitch_deg: float) -> tuple[float, float]:
        radius = 44 - 11 * self._pitches.index(pitch_deg)
        angle = 2 * math.pi * node / self._nodes
        return 50 + radius * math.cos(angle), 50 - radius * math.sin(angle)

    def draw(self, steps: Sequence[StepEntry], index: int) -> str:
        """Where the camera has been, is (filled) and goes next (open); empty off the ring."""
        path = [
            self._place(s.node, s.pitch_deg) for s in steps if s.node is not None and s.pitch_deg is not None
        ]
        if len(path) != len(steps):
            return ""
        rings = "".join(
            f'<circle class="orbit" cx="50" cy="50" r="{44 - 11 * k}"/>' for k in range(len(self._pitches))
        )
        been = " ".join(f"{x:.1f},{y:.1f}" for x, y in path[: index + 1])
        parts = [rings, f'<polyline class="been" points="{been}"/>']
        x, y = path[index]
        if index + 1 < len(path):
            nx, ny = path[index + 1]
            parts.append(f'<path class="goes" d="M{x:.1f} {y:.1f}L{nx:.1f} {ny:.1f}"/>')
            parts.append(f'<circle class="next" cx="{nx:.1f}" cy="{ny:.1f}" r="3.5"/>')
        parts.append(f'<circle class="here" cx="{x:.1f}" cy="{y:.1f}" r="4"/>')
        label = "Viewpoints from above: the path so far, the camera now (filled), the next view (open)"
        return (
            f'<svg class="ring" viewBox="0 0 100 100" role="img" aria-label="{label}">{"".join(parts)}</svg>'
        )
