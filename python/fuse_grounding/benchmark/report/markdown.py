"""A report as Markdown: text, tables, captions of plots; for pages and reviews that show no HTML."""

from __future__ import annotations

import re

from fuse_grounding.benchmark.report.model import (
    Block,
    Column,
    Facts,
    Figure,
    Gallery,
    Report,
    Row,
    Table,
    Text,
)


def render(report: Report) -> str:
    """The whole report. Plots and pictures are in the HTML page, and are named here."""
    parts = [f"# {report.title}", report.summary]
    for section in report.sections:
        parts.append(f"## {section.title}")
        parts += [_block(block) for block in section.blocks]
    return "\n\n".join(parts) + "\n"


def _block(block: Block) -> str:
    if isinstance(block, Table):
        return table(block)
    if isinstance(block, Figure):
        words = f"*{block.missing}*" if block.missing else f"{block.caption} (Plot in report.html.)"
        return f"**{block.title}.** {words}"
    if isinstance(block, Facts):
        return f"**{block.title}**\n\n" + "\n".join(f"- {escape(k)}: {escape(v)}" for k, v in block.pairs)
    if isinstance(block, Gallery):
        return f"{len(block.strips)} episodes, step by step, are in report.html."
    return f"> **Note.** {block.words}" if _warning(block) else block.words


def _warning(block: Text) -> bool:
    return block.kind == "warning"


def table(made: Table) -> str:
    """Caption, a pipe table, notes."""
    heads = " | ".join(escape(_head(c)) for c in made.columns)
    rule = " | ".join(":--" if c.word else "--:" for c in made.columns)
    lines = [f"| {heads} |", f"| {rule} |", *(_line(made, row) for row in made.rows)]
    parts = [f"### {made.title}", made.caption, "\n".join(lines), *(f"*{note}*" for note in made.notes)]
    return "\n\n".join(parts)


def _head(column: Column) -> str:
    unit = f" ({column.unit})" if column.unit else ""
    group = f"{column.group}, " if column.group else ""
    return f"{group}{column.title}{unit} {column.arrow}".rstrip()


def _line(made: Table, row: Row) -> str:
    cells = []
    for column, cell in zip(made.columns, row.cells, strict=False):
        interval = column.interval(cell)
        cells.append(escape(column.show(cell)) + (f" {escape(interval)}" if interval else ""))
    if row.note:
        cells.append(escape(row.note))
    cells += [""] * (len(made.columns) - len(cells))
    return "| " + " | ".join(cells) + " |"


def escape(words: str) -> str:
    """Text that Markdown shows as it is, on one line."""
    plain = re.sub(r"([\\|*_<>`\[\]])", r"\\\1", words)
    return " ".join(plain.split())
