"""A report as one self-contained page: it loads nothing, and without scripts it is plain tables."""

from __future__ import annotations

import re
from html import escape
from itertools import groupby
from pathlib import Path
from string import Template

from fuse_grounding.benchmark.report.model import (
    Block,
    Cell,
    Column,
    Facts,
    Figure,
    Frame,
    Gallery,
    Report,
    Row,
    Section,
    Strip,
    Table,
    Text,
)
from fuse_grounding.benchmark.report.svg import swatch

_LINE = 28
"""Characters of a cell up to which its words stay on one line."""
_ASSETS = Path(__file__).parent / "assets"


def render(report: Report) -> str:
    """The page. Its policy forbids every request, so that a mistake here cannot make one."""
    page = Template((_ASSETS / "page.html").read_text(encoding="utf-8"))
    links = "".join(f'<li><a href="#{escape(s.name)}">{escape(s.title)}</a></li>' for s in report.sections)
    return page.substitute(
        title=escape(report.title),
        summary=words(report.summary),
        style=(_ASSETS / "page.css").read_text(encoding="utf-8"),
        script=(_ASSETS / "page.js").read_text(encoding="utf-8"),
        links=links,
        sections="\n".join(_section(s) for s in report.sections),
    )


def words(text: str) -> str:
    """Text as HTML; `code` between backticks."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", escape(text))


def _section(section: Section) -> str:
    parts = []
    for plots, blocks in groupby(section.blocks, key=lambda b: isinstance(b, Figure)):
        inner = "\n".join(_block(b) for b in blocks)
        parts.append(f'<div class="figures">{inner}</div>' if plots else inner)
    return (
        f'<section id="{escape(section.name)}"><h2>{escape(section.title)}</h2>\n'
        + "\n".join(parts)
        + "</section>"
    )


def _block(block: Block) -> str:
    if isinstance(block, Table):
        return _table(block)
    if isinstance(block, Figure):
        return _figure(block)
    if isinstance(block, Facts):
        pairs = "".join(f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in block.pairs)
        return f'<h3>{escape(block.title)}</h3><dl class="facts">{pairs}</dl>'
    if isinstance(block, Gallery):
        return "\n".join(_strip(strip) for strip in block.strips)
    assert isinstance(block, Text)
    return f'<p class="{escape(block.kind or "text")}">{words(block.words)}</p>'


def _table(made: Table) -> str:
    heads = "".join(_head(c) for c in made.columns)
    rows = "\n".join(_row(made, r) for r in made.rows)
    notes = "".join(f'<p class="note">{words(n)}</p>' for n in made.notes)
    return (
        f'<div class="table" id="{escape(made.name)}"><h3>{escape(made.title)}</h3>'
        f'<p class="caption">{words(made.caption)}</p>'
        f'<div class="scroll" role="region" tabindex="0" aria-label="{escape(made.title, quote=True)}">'
        f"<table><thead>{_groups(made)}<tr>{heads}</tr></thead><tbody>\n{rows}\n</tbody></table></div>{notes}</div>"
    )


def _groups(made: Table) -> str:
    if not any(c.group for c in made.columns):
        return ""
    cells = []
    for group, members in groupby(made.columns, key=lambda c: c.group):
        span = len(list(members))
        kind = ' class="group"' if group else ""
        cells.append(f'<th colspan="{span}" scope="colgroup"{kind}>{escape(group)}</th>')
    return f'<tr class="groups">{"".join(cells)}</tr>'


def _head(column: Column) -> str:
    arrow = f'&nbsp;<abbr title="{column.better} is better">{column.arrow}</abbr>' if column.better else ""
    unit = f'<span class="unit">{escape(column.unit)}</span>' if column.unit else ""
    kind = "word" if column.word else "number"
    return (
        f'<th scope="col" class="{kind}"><span class="name">{escape(column.title)}{arrow}</span>{unit}</th>'
    )


def _row(made: Table, row: Row) -> str:
    cells = [_cell(c, cell, i) for i, (c, cell) in enumerate(zip(made.columns, row.cells, strict=False))]
    rest = len(made.columns) - len(cells)
    if row.note:
        cells.append(f'<td class="rownote" colspan="{max(rest, 1)}">{words(row.note)}</td>')
        return f'<tr class="noted">{"".join(cells)}</tr>'
    return f"<tr>{''.join(cells)}</tr>"


def _cell(column: Column, cell: Cell, place: int) -> str:
    interval = column.interval(cell)
    ends = f'<span class="ends">{escape(interval)}</span>' if interval else ""
    value = "" if cell.value is None else f' data-v="{escape(str(cell.value), quote=True)}"'
    tint = "" if cell.tint is None else f' style="--tint:{100 * cell.tint:.0f}%"'
    kind = ("word" if column.word else "number") + (" tint" if tint else "")
    kind += " long" if len(column.show(cell)) > _LINE else ""
    shown = words(column.show(cell))
    if place == 0:
        return f'<th scope="row" class="{kind}"{value}>{shown}{ends}</th>'
    return f'<td class="{kind}"{value}{tint}>{shown}{ends}</td>'


def _figure(made: Figure) -> str:
    if made.missing:
        body, below = f'<p class="missing">{words(made.missing)}</p>', ""
    else:
        names = "".join(f"<li>{swatch(style)}{escape(name)}</li>" for style, name in made.legend)
        body = made.svg + (f'<ul class="legend">{names}</ul>' if names else "")
        below = f"<figcaption>{words(made.caption)}</figcaption>"
    return f'<figure id="{escape(made.name)}"><h3>{escape(made.title)}</h3>{body}{below}</figure>'


def _strip(strip: Strip) -> str:
    frames = "".join(_frame(f) for f in strip.frames)
    count = len(strip.frames)
    return (
        f'<details class="strip"><summary><span class="query">{escape(strip.title)}</span> '
        f'<span class="who">{escape(strip.method)} · {escape(strip.episode)}</span> '
        f'<span class="verdict">{escape(strip.verdict)} · {count} view{"s" * (count != 1)}</span>'
        "</summary>"
        f'<div class="frames">{frames}</div></details>'
    )


def _frame(frame: Frame) -> str:
    pictures = "".join(
        f'<figure><img src="{p.uri}" width="{p.width}" height="{p.height}" loading="lazy" '
        f'alt="{escape(p.name, quote=True)}"><figcaption>{escape(p.name)}</figcaption></figure>'
        for p in frame.pictures
    )
    facts = "".join(f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in frame.facts)
    return (
        f'<section class="frame"><h4>{escape(frame.title)}</h4><div class="pictures">{pictures}</div>'
        f'<div class="decision">{frame.ring}<dl class="facts">{facts}</dl></div></section>'
    )
