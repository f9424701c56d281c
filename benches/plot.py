"""Line plots as PNG, with OpenCV, which the package needs anyway."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 640, 460
LEFT, RIGHT, TOP, BOTTOM = 76, 20, 44, 62
INK, GRID = (40, 40, 40), (225, 225, 225)
COLOURS = [(180, 90, 30), (30, 120, 220), (70, 150, 50), (150, 60, 150), (60, 60, 200)]
"""Blue, orange, green, violet, red; BGR."""

Points = list[tuple[float, float]]


@dataclass
class Panel:
    """One pair of axes."""

    title: str
    x: str
    y: str
    lines: dict[str, Points]
    logarithmic: bool = False
    """Both axes; otherwise both are linear and the y axis begins where the data do."""
    dashed: set[str] = field(default_factory=set)
    """Names of lines without marks: guides, not measurements."""


def save(path: Path, panels: list[Panel]) -> None:
    """Draws the panels side by side."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), np.hstack([_draw(panel) for panel in panels])):
        raise OSError(f"{path} cannot be written")


def _ticks(low: float, high: float, logarithmic: bool) -> list[float]:
    if logarithmic:
        decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
        return [m * 10.0**d for d in decades for m in (1, 2, 5) if low <= m * 10.0**d <= high]
    raw = (high - low) / 6
    step = next(m for m in (1, 2, 5, 10) if m >= raw / 10 ** np.floor(np.log10(raw))) * 10 ** np.floor(
        np.log10(raw)
    )
    return list(np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step)


def _range(values: list[float], logarithmic: bool) -> tuple[float, float]:
    low, high = min(values), max(values)
    if logarithmic:
        return low / 1.15, high * 1.15
    margin = 0.05 * (high - low or 1.0)
    return low - margin, high + margin


def _label(value: float) -> str:
    if value >= 1e6:
        return f"{value / 1e6:g}M"
    return f"{value / 1e3:g}k" if value >= 1e4 else f"{value + 0:g}"  # no minus before a zero


def _scale(low: float, high: float, logarithmic: bool) -> Callable[[float], float]:
    """Value → place in [0, 1]."""
    f: Callable[[float], float] = np.log if logarithmic else float
    return lambda v: (f(v) - f(low)) / (f(high) - f(low))


def _text(image: np.ndarray, text: str, at: tuple[int, int], size: float = 0.45, anchor: float = 0.5) -> None:
    width = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0]
    place = (int(at[0] - anchor * width), at[1])
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA)


def _draw(panel: Panel) -> np.ndarray:
    image = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
    points = [p for line in panel.lines.values() for p in line]
    (x0, x1), (y0, y1) = (_range([p[k] for p in points], panel.logarithmic) for k in (0, 1))
    sx, sy = _scale(x0, x1, panel.logarithmic), _scale(y0, y1, panel.logarithmic)

    def at(x: float, y: float) -> tuple[int, int]:
        across, down = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
        return round(LEFT + across * sx(x)), round(HEIGHT - BOTTOM - down * sy(y))

    for value in _ticks(x0, x1, panel.logarithmic):
        cv2.line(image, at(value, y0), at(value, y1), GRID, 1)
        _text(image, _label(value), (at(value, y0)[0], HEIGHT - BOTTOM + 18))
    for value in _ticks(y0, y1, panel.logarithmic):
        cv2.line(image, at(x0, value), at(x1, value), GRID, 1)
        _text(image, _label(value), (LEFT - 8, at(x0, value)[1] + 5), anchor=1)
    cv2.rectangle(image, at(x0, y1), at(x1, y0), INK, 1)
    _text(image, panel.title, (WIDTH // 2, 26), 0.55)
    _text(image, panel.x, ((LEFT + WIDTH - RIGHT) // 2, HEIGHT - 14))
    _text(image, panel.y, (8, TOP - 8), anchor=0)

    for k, (name, line) in enumerate(panel.lines.items()):
        colour = COLOURS[k % len(COLOURS)]
        track = [at(*p) for p in sorted(line)]
        for a, b in pairwise(track):
            _segment(image, a, b, colour, name in panel.dashed)
        if name not in panel.dashed:
            for p in track:
                cv2.circle(image, p, 4, colour, -1, cv2.LINE_AA)
        y = TOP + 20 + 18 * k
        _segment(image, (LEFT + 12, y - 4), (LEFT + 40, y - 4), colour, name in panel.dashed)
        _text(image, name, (LEFT + 48, y), anchor=0)
    return image


def _segment(
    image: np.ndarray, a: tuple[int, int], b: tuple[int, int], colour: tuple[int, int, int], dashed: bool
) -> None:
    if not dashed:
        cv2.line(image, a, b, colour, 2, cv2.LINE_AA)
        return
    start, end = np.array(a, float), np.array(b, float)
    count = max(1, int(np.hypot(*(end - start)) // 10))
    for i in range(count):
        p, q = (start + (end - start) * t / count for t in (i, i + 0.5))
        cv2.line(image, (int(p[0]), int(p[1])), (int(q[0]), int(q[1])), colour, 1, cv2.LINE_AA)
