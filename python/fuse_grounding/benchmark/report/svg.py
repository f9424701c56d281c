"""Plots as small SVG pictures without colours of their own: classes that the page's style sheet fills.

A plot is drawn in units of its view box, which are CSS pixels at its natural width.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape

STYLES = 11
"""Number of series styles (colour and marker) that the style sheet knows."""

_SMALL = 7.4
"""Mean width of a character of a label at 14 px, its size on a phone."""


@dataclass(frozen=True)
class Axis:
    """One axis from `low` to `high`; `label` carries the unit. `ticks` replaces round numbers."""

    label: str
    low: float
    high: float
    log: bool = False
    ticks: Sequence[float] | None = None
    names: Sequence[str] | None = None

    def place(self, value: float) -> float:
        """0 at `low`, 1 at `high`."""
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def marks(self) -> list[tuple[float, str]]:
        """Values and words of the ticks within the axis."""
        if self.ticks is not None:
            names = self.names or [_short(t) for t in self.ticks]
            return list(zip(self.ticks, names, strict=True))
        values = _log_ticks(self.low, self.high) if self.log else _round_ticks(self.low, self.high)
        return [(v, _short(v)) for v in values]


def _short(value: float) -> str:
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def _round_ticks(low: float, high: float, wanted: int = 5) -> list[float]:
    raw = (high - low) / wanted
    power = 10 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 10) for k in range(first, math.floor(high / step + 1e-9) + 1)]


def _log_ticks(low: float, high: float) -> list[float]:
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1,), (1, 3), (1, 2, 5)):
        ticks = [round(s * 10.0**d, 10) for d in decades for s in steps]
        inside = [t for t in ticks if low <= t <= high]
        if len(inside) >= 3:
            return inside
    return inside


_Box = tuple[float, float, float, float]
"""Left, top, right and bottom, px."""


class Plot:
    """A field with two axes. Values outside an axis are the caller's mistake."""

    def __init__(self, x: Axis, y: Axis, width: int = 520, height: int = 320, left: int = 52):
        self.x, self.y = x, y
        self.width, self.height = width, height
        self._box = (left, 12, width - 14, height - 44)
        self._over: list[str] = []
        self._marks: list[_Box] = []  # and names: what must not be hidden
        self._taken: list[_Box] = []

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Where a value lies in the picture."""
        left, top, right, bottom = self._box
        return left + self.x.place(x) * (right - left), bottom - self.y.place(y) * (bottom - top)

    def line(
        self, points: Sequence[tuple[float, float]], style: int, *, steps: bool = False, thin: bool = False
    ) -> None:
        """A line through points, or stairs that rise at each of them."""
        if not points:
            return
        path: list[str] = []
        for i, (px, py) in enumerate(self.at(*p) for p in points):
            if i and steps:
                path.append(f"H{px:.1f}V{py:.1f}")
            else:
                path.append(f"{'L' if i else 'M'}{px:.1f} {py:.1f}")
        kind = "front" if thin else "line"
        self._over.append(f'<path class="{kind} s{style % STYLES}" d="{"".join(path)}"/>')

    def band(self, points: Sequence[tuple[float, float, float]], style: int) -> None:
        """The area between `low` and `high` over x: (x, low, high)."""
        there = [self.at(x, high) for x, _, high in points]
        back = [self.at(x, low) for x, low, _ in reversed(points)]
        corners = " ".join(f"{px:.1f},{py:.1f}" for px, py in there + back)
        self._over.append(f'<polygon class="band s{style % STYLES}" points="{corners}"/>')

    def mark(self, x: float, y: float, style: int, tip: str, *, size: float = 5) -> None:
        """A marker whose shape goes with its style; `tip` is shown on hovering."""
        px, py = self.at(x, y)
        self._marks.append((px - size, py - size, px + size, py + size))
        self._over.append(f"<g><title>{escape(tip)}</title>{marker(px, py, style, size)}</g>")

    def whisker(self, x: float, low: float, high: float, style: int) -> None:
        """A vertical interval."""
        (px, top), (_, bottom) = self.at(x, high), self.at(x, low)
        d = f"M{px:.1f} {top:.1f}V{bottom:.1f}M{px - 3:.1f} {top:.1f}h6M{px - 3:.1f} {bottom:.1f}h6"
        self._over.append(f'<path class="whisker s{style % STYLES}" d="{d}"/>')

    def bar(self, x: float, low: float, high: float, wide: float, style: int, tip: str) -> None:
        """A rectangle around x from `low` to `high`."""
        (left, top), (right, bottom) = self.at(x - wide / 2, high), self.at(x + wide / 2, low)
        self._over.append(_rectangle(left, top, right, bottom, style, tip))

    def flat_bar(self, y: float, low: float, high: float, wide: float, style: int, tip: str) -> None:
        """A lying rectangle around y from `low` to `high`."""
        (left, top), (right, bottom) = self.at(low, y + wide / 2), self.at(high, y - wide / 2)
        self._over.append(_rectangle(left, top, right, bottom, style, tip))

    def rule(self, words: str, *, x: float | None = None, y: float | None = None) -> None:
        """A dashed line across the field, with its name."""
        left, top, right, bottom = self._box
        if x is not None:
            px, _ = self.at(x, self.y.low)
            d, tx, ty = f"M{px:.1f} {top}V{bottom}", px + 4, top + 11.0
            anchor = "start" if px < right - 90 else "end"
            tx = tx if anchor == "start" else px - 4
        else:
            _, py = self.at(self.x.low, self.y.low if y is None else y)
            d, tx, ty, anchor = f"M{left} {py:.1f}H{right}", right, py - 4, "end"
        self._over.append(f'<path class="rule" d="{d}"/>{_text(tx, ty, words, anchor, "small")}')

    def avoid(self, points: Sequence[tuple[float, float]]) -> None:
        """Keeps names off the stairs through points."""
        places = [self.at(*p) for p in points]
        for (x0, y0), (x1, y1) in itertools.pairwise(places):
            self._taken.append((x0 - 2, y0 - 2, x1 + 2, y0 + 2))
            self._taken.append((x1 - 2, min(y0, y1) - 2, x1 + 2, max(y0, y1) + 2))

    def word(
        self, x: float, y: float, words: str, dx: float = 0, dy: float = 0, anchor: str = "middle"
    ) -> None:
        """Small words at a value, moved by pixels."""
        px, py = self.at(x, y)
        self._over.append(_text(px + dx, py + dy, words, anchor, "small"))

    def name(self, x: float, y: float, words: str) -> None:
        """A name beside a marker, where it hides least of what is drawn so far and of other names."""
        px, py = self.at(x, y)
        length = _SMALL * len(words)
        left, top, right, bottom = self._box
        best: tuple[tuple[bool, float], str] | None = None
        for rank, (dx, dy, anchor) in enumerate(_AROUND):
            x0 = px + dx - {"start": 0.0, "middle": length / 2, "end": length}[anchor]
            box = (x0, py + dy - 10, x0 + length, py + dy + 3)
            outside = box[0] < left or box[2] > right + 6 or box[1] < top - 8 or box[3] > bottom
            hidden = sum(_overlap(box, mark) for mark in self._marks)
            cost = (outside, rank + 100 * hidden + 10 * sum(_overlap(box, other) for other in self._taken))
            if best is None or cost < best[0]:
                best, chosen = (cost, _text(px + dx, py + dy, words, anchor, "name")), box
        assert best is not None
        self._marks.append(chosen)
        self._over.append(best[1])

    def svg(self, title: str) -> str:
        """The picture; `title` is read to those who do not see it."""
        left, top, right, bottom = self._box
        parts = [
            f'<svg class="plot" style="max-width:{self.width * 1.15:.0f}px" '
            f'viewBox="0 0 {self.width} {self.height}" role="img" '
            f'aria-label="{escape(title, quote=True)}">'
        ]
        for value, words in self.x.marks():
            px, _ = self.at(value, self.y.low)
            parts.append(f'<path class="tick" d="M{px:.1f} {bottom}v4"/>')
            if self.y.names is not None:
                parts.append(f'<path class="grid" d="M{px:.1f} {top}V{bottom}"/>')
            parts.append(_text(px, bottom + 17, words, "middle", "tickname"))
        for value, words in self.y.marks():
            _, py = self.at(self.x.low, value)
            if self.y.names is None:
                parts.append(f'<path class="grid" d="M{left} {py:.1f}H{right}"/>')
            parts.append(_text(left - 7, py + 4, words, "end", "tickname"))
        parts.append(f'<path class="axis" d="M{left} {bottom}H{right}"/>')
        parts.append(_text((left + right) / 2, self.height - 6, self.x.label, "middle", "axisname"))
        middle = (top + bottom) / 2
        parts.append(
            f'<text class="axisname" text-anchor="middle" '
            f'transform="translate(12 {middle:.0f}) rotate(-90)">{escape(self.y.label)}</text>'
        )
        return "".join([*parts, *self._over, "</svg>"])


_AROUND = (
    (9, 4, "start"),
    (-9, 4, "end"),
    (0, -10, "middle"),
    (0, 18, "middle"),
    (8, -8, "start"),
    (-8, -8, "end"),
    (8, 16, "start"),
    (-8, 16, "end"),
    (8, -22, "start"),
    (-8, -22, "end"),
    (8, 30, "start"),
    (-8, 30, "end"),
    *((0, dy, "middle") for dy in (-24, 32, -38, 46, -52, 60)),
)


def _overlap(a: _Box, b: _Box) -> float:
    """Shared area, px²."""
    wide = min(a[2], b[2]) - max(a[0], b[0])
    high = min(a[3], b[3]) - max(a[1], b[1])
    return max(wide, 0.0) * max(high, 0.0)


def _text(x: float, y: float, words: str, anchor: str, kind: str) -> str:
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'


def _rectangle(left: float, top: float, right: float, bottom: float, style: int, tip: str) -> str:
    return (
        f'<rect class="bar s{style % STYLES}" x="{left:.1f}" y="{top:.1f}" '
        f'width="{max(right - left, 0):.1f}" height="{max(bottom - top, 0):.1f}">'
        f"<title>{escape(tip)}</title></rect>"
    )


def _polygon(corners: int, turn: float) -> Callable[[float, float, float], str]:
    def draw(x: float, y: float, size: float) -> str:
        angles = [turn + 2 * math.pi * k / corners for k in range(corners)]
        points = " ".join(f"{x + size * math.sin(a):.1f},{y - size * math.cos(a):.1f}" for a in angles)
        return f'<polygon points="{points}"/>'

    return draw


def _cross(x: float, y: float, size: float) -> str:
    s = size * 0.8
    d = 2 * s
    return f'<path d="M{x - s:.1f} {y - s:.1f}l{d:.1f} {d:.1f}m0 {-d:.1f}l{-d:.1f} {d:.1f}"/>'


def _plus(x: float, y: float, size: float) -> str:
    return f'<path d="M{x - size:.1f} {y:.1f}h{2 * size:.1f}M{x:.1f} {y - size:.1f}v{2 * size:.1f}"/>'


def _hollow_square(x: float, y: float, size: float) -> str:
    s = size * 0.75
    return f'<rect class="hollow" x="{x - s:.1f}" y="{y - s:.1f}" width="{2 * s:.1f}" height="{2 * s:.1f}"/>'


_SHAPES: Sequence[Callable[[float, float, float], str]] = (
    lambda x, y, size: f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size * 0.9:.1f}"/>',
    _polygon(4, math.pi / 4),
    _polygon(3, 0),
    _hollow_square,
    _polygon(4, 0),
    _polygon(3, math.pi),
    _cross,
    _plus,
    _polygon(5, 0),
    _polygon(6, 0),
    lambda x, y, size: f'<circle class="hollow" cx="{x:.1f}" cy="{y:.1f}" r="{size * 0.8:.1f}"/>',
)


def marker(x: float, y: float, style: int, size: float = 5) -> str:
    """The marker of a style: another colour and another shape, for those who see no colours."""
    return f'<g class="marker s{style % STYLES}">{_SHAPES[style % STYLES](x, y, size)}</g>'


def swatch(style: int) -> str:
    """A marker for a legend."""
    return f'<svg class="swatch" viewBox="0 0 14 14" aria-hidden="true">{marker(7, 7, style)}</svg>'
