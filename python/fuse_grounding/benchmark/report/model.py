"""What a report is made of, before it is HTML, Markdown, LaTeX or CSV: tables, figures, text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

DASH = "–"


@dataclass(frozen=True)
class Cell:
    """One value with its interval, or a word. `value` sorts; `text` replaces what it would print as."""

    value: float | str | None = None
    low: float | None = None
    high: float | None = None
    text: str | None = None
    tint: float | None = None
    """0 to 1: how strongly the cell is shaded in the page."""


@dataclass(frozen=True)
class Column:
    """A column: `key` names it in CSV files, `unit` stands in its head, `scale` turns a value into the unit.

    `better` is "higher" or "lower" where one of them is; `group` is written over neighbours that share it.
    """

    key: str
    title: str
    unit: str = ""
    digits: int = 2
    scale: float = 1.0
    better: str = ""
    group: str = ""
    word: bool = False
    """Words, not numbers: set to the left."""

    @property
    def arrow(self) -> str:
        """Which way is better, as a sign."""
        return {"higher": "↑", "lower": "↓"}.get(self.better, "")

    def show(self, cell: Cell) -> str:
        """What is printed for a cell's value; a dash where there is none."""
        if cell.text is not None:
            return cell.text
        if cell.value is None:
            return DASH
        return cell.value if isinstance(cell.value, str) else self._number(cell.value)

    def interval(self, cell: Cell) -> str:
        """`[low, high]` in the column's unit; empty without an interval."""
        if cell.low is None or cell.high is None:
            return ""
        return f"[{self._number(cell.low)}, {self._number(cell.high)}]"

    def _number(self, value: float) -> str:
        shown = f"{value * self.scale:.{self.digits}f}"
        # No "-0.0", and a typographic minus.
        return shown.lstrip("-") if float(shown) == 0 else shown.replace("-", "\N{MINUS SIGN}")


@dataclass(frozen=True)
class Row:
    """Cells of one line; with `note`, cells are the first ones and the note stands across the rest."""

    cells: Sequence[Cell]
    note: str = ""


@dataclass(frozen=True)
class Table:
    """`name` is that of its .tex and .csv files. Captions are full sentences; notes stand below."""

    name: str
    title: str
    caption: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Figure:
    """A plot: inline SVG whose colours are the page's, or `missing`, the reason why there is none."""

    name: str
    title: str
    caption: str
    svg: str = ""
    legend: Sequence[tuple[int, str]] = ()
    """Style number and name of each series."""
    missing: str = ""


@dataclass(frozen=True)
class Facts:
    """Names and values, as of a run's provenance."""

    title: str
    pairs: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Text:
    """A paragraph. `kind` is "" or "warning"."""

    words: str
    kind: str = ""


@dataclass(frozen=True)
class Picture:
    """An embedded picture: a data URI, what it shows, its size in pixels."""

    uri: str
    name: str
    width: int
    height: int


@dataclass(frozen=True)
class Frame:
    """One step of an episode: its pictures, where the camera stood, what was decided."""

    title: str
    pictures: Sequence[Picture]
    facts: Sequence[tuple[str, str]]
    ring: str
    """SVG: the ring from above, where the camera was and where it goes."""


@dataclass(frozen=True)
class Strip:
    """An episode to step through."""

    title: str
    verdict: str
    method: str
    episode: str
    frames: Sequence[Frame]


@dataclass(frozen=True)
class Gallery:
    """Episodes with their pictures; only the HTML page shows them."""

    strips: Sequence[Strip]


Block = Table | Figure | Facts | Text | Gallery


@dataclass(frozen=True)
class Section:
    """A part of the page under one heading; `name` is its anchor."""

    name: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Report:
    """The whole page."""

    title: str
    summary: str
    sections: Sequence[Section] = field(default_factory=tuple)

    def tables(self) -> list[Table]:
        """Every table, in order."""
        return [b for s in self.sections for b in s.blocks if isinstance(b, Table)]
