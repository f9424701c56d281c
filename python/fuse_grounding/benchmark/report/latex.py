"""A table as LaTeX: booktabs, every character escaped, nothing but `booktabs` and `graphicx` needed."""

from __future__ import annotations

from itertools import groupby

from fuse_grounding.benchmark.report.model import Cell, Column, Table

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "`": r"\textasciigrave{}",
    "\N{MINUS SIGN}": r"$-$",
    "±": r"$\pm$",
    "×": r"$\times$",
    "·": r"$\cdot$",
    "°": r"$^\circ$",
    "Δ": r"$\Delta$",
    "η": r"$\eta$",
    "≥": r"$\geq$",
    "≤": r"$\leq$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "–": "--",
    "“": "``",
    "”": "''",
    "’": "'",
    "…": r"\ldots{}",
}


def escape(words: str) -> str:
    """Text that LaTeX typesets as it is; what pdfLaTeX has no letter for becomes `?`."""
    return " ".join("".join(_letter(c) for c in words).split())


def _prose(words: str) -> str:
    """The same of a caption: what stands between backticks is code."""
    parts = words.split("`")
    closed = parts if len(parts) % 2 else [words]
    return "".join(rf"\texttt{{{escape(p)}}}" if i % 2 else _spaced(p) for i, p in enumerate(closed))


def _spaced(words: str) -> str:
    """Escaped, with the spaces at its ends."""
    before, after = (" " if words[at : at + 1].isspace() else "" for at in (0, len(words) - 1))
    return f"{before}{escape(words)}{after}" if words.strip() else before


def _letter(character: str) -> str:
    if character in _SPECIAL:
        return _SPECIAL[character]
    if character.isascii():
        return character
    return character if "\N{LATIN CAPITAL LETTER A WITH GRAVE}" <= character <= "ſ" else "?"


def table(made: Table) -> str:
    """A `table` environment: caption, label `tab:NAME`, groups of columns, intervals small."""
    spec = "".join("l" if c.word else "r" for c in made.columns)
    lines = [
        r"% \usepackage{booktabs,graphicx}",
        r"\begin{table}[t]",
        r"\centering\small",
        rf"\caption{{{_prose(' '.join([made.caption, *made.notes]))}}}",
        rf"\label{{tab:{made.name.replace('_', '-')}}}",
        r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%",
        rf"\begin{{tabular}}{{{spec}}}",
        r"\toprule",
        *_groups(made),
        " & ".join(_head(c) for c in made.columns) + r" \\",
        r"\midrule",
    ]
    for row in made.rows:
        cells = [_cell(column, cell) for column, cell in zip(made.columns, row.cells, strict=False)]
        rest = len(made.columns) - len(cells)
        if row.note and rest > 0:
            cells.append(rf"\multicolumn{{{rest}}}{{l}}{{\emph{{{_prose(row.note)}}}}}")
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}}", r"\end{table}", ""])


def _head(column: Column) -> str:
    unit = rf" (\mbox{{{escape(column.unit)}}})" if column.unit else ""
    return rf"\textbf{{{escape(column.title)}}}{unit}{escape(column.arrow)}"


def _cell(column: Column, cell: Cell) -> str:
    interval = column.interval(cell)
    # A "[" at the start of a line would be read as an argument of the line break before it.
    shown = escape(column.show(cell))
    shown = f"{{{shown}}}" if shown.startswith(("[", "*")) else shown
    return shown + (rf" {{\scriptsize {escape(interval)}}}" if interval else "")


def _groups(made: Table) -> list[str]:
    """A line of group names with rules under them; none where no column has a group."""
    if not any(c.group for c in made.columns):
        return []
    names, rules, at = [], [], 1
    for group, members in groupby(made.columns, key=lambda c: c.group):
        width = len(list(members))
        names.append(rf"\multicolumn{{{width}}}{{c}}{{{escape(group)}}}" if group else "&".join([""] * width))
        if group:
            rules.append(rf"\cmidrule(lr){{{at}-{at + width - 1}}}")
        at += width
    return [" & ".join(names) + r" \\", "".join(rules)]
