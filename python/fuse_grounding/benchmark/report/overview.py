"""What was run: folders, versions, and the settings in which they differ."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from fuse_grounding.benchmark.report import labels
from fuse_grounding.benchmark.report.load import Folder, Results, flat, set_name, setting
from fuse_grounding.benchmark.report.model import Block, Cell, Column, Facts, Row, Table, Text

_ORDER = (
    *("fuse grounding", "commit", "uncommitted changes", "results version"),
    *("python", "system", "processor", "cores"),
)
_DIGEST = 12
"""Characters of a SHA-256 that are shown."""


def blocks(results: Results) -> list[Block]:
    """What is missing, folders with the settings that differ, provenance."""
    found: list[Block] = [Text(f"Incomplete: {sentence}.", "warning") for sentence in results.incomplete]
    if found:
        words = "Lines of a table may be over different episodes; paired tables are over those that all have."
        found.append(Text(words, "warning"))
    return [*found, _folders(results), Facts("Versions", _provenance(results.folders))]


def _folders(results: Results) -> Table:
    differing = _differing(results.folders)
    columns = [
        Column("folder", "Folder", word=True),
        Column("part", "Part", word=True),
        Column("set", "Episodes of", word=True),
        Column("methods", "Methods", word=True),
        Column("episodes", "Episodes", "", 0),
        Column("results", "Results", "", 0),
        Column("errors", "Errors", "", 0),
        *(Column(key, key, word=True) for key in differing),
    ]
    lines: list[Row] = []
    for f in results.folders:
        words = [
            f.label,
            labels.part(f.part),
            set_name(sorted(f.episodes)),
            ", ".join(labels.ordered(f.methods, labels.METHODS)) or "none",
        ]
        counts = [len(f.episodes), len(f.rows), sum(r["status"] != "ok" for r in f.rows)]
        settings = [_setting(f.settings, key) for key in differing]
        lines.append(Row([*map(Cell, words), *map(Cell, counts), *settings]))
    entries = dict.fromkeys((f.part, *entry) for f in results.folders for entry in f.not_run)
    lines += [
        Row([Cell(name), Cell(labels.part(part))], note=f"not run: {reason}")
        for part, name, reason in entries
    ]
    caption = (
        "A result is one method on one episode. Settings that differ between folders have a column; all "
        "others are the same in each of them."
    )
    return Table("folders", "Folders", caption, columns, lines)


def _provenance(folders: Sequence[Folder]) -> list[tuple[str, str]]:
    """Each fact once; where folders differ, every value with its folders (many are counted)."""
    values: dict[str, dict[str, list[str]]] = {}
    for folder in folders:
        for key, value in _facts(folder).items():
            values.setdefault(key, {}).setdefault(value, []).append(folder.label)
    pairs = []
    for key in labels.ordered(values, _ORDER):
        found = values[key]
        commonest = max(found, key=lambda value: len(found[value]))
        words = []
        for value, where in found.items():
            if len(where) == len(folders):
                words.append(value)
            elif value == commonest and len(where) > 3:
                words.append(f"{value} ({len(where)} of {len(folders)} folders)")
            else:
                words.append(f"{value} ({', '.join(where)})")
        pairs.append((key, "; ".join(words)))
    return pairs


def _facts(folder: Folder) -> dict[str, str]:
    """What the header says, without nesting; digests shortened."""
    decisive = {k: v for k, v in folder.identity.items() if k in ("results_version", "data")}
    facts = {**_of_methods(folder), **flat({**folder.provenance, **decisive})}
    return {_name(key): _word(value) for key, value in facts.items()}


def _of_methods(folder: Folder) -> dict[str, Any]:
    """Weights and devices of all methods; where they differ, each value with its methods."""
    values: dict[str, dict[str, list[str]]] = {}
    for method, parts in folder.identity.get("methods", {}).items():
        for key, value in flat({k: v for k, v in parts.items() if k != "packages"}).items():
            values.setdefault(key, {}).setdefault(_word(value), []).append(method)
    return {
        key: "; ".join(v if len(found) == 1 else f"{v} ({', '.join(who)})" for v, who in found.items())
        for key, found in values.items()
    }


def _name(key: str) -> str:
    """`packages.numpy` as `numpy`, `sha256.segmenter` as `weights of segmenter`."""
    for prefix, words in (
        ("packages.", ""),
        ("sha256.", "weights of "),
        ("weights.", "weights of "),
        ("machine.", ""),
        ("perception.", ""),
        ("dirty", "uncommitted changes"),
    ):
        if prefix in key:
            key = words + key.split(prefix, 1)[1] + (" on" if prefix == "perception." else "")
    return key.replace("_", " ").replace(".", " ")


def _word(value: Any) -> str:
    if isinstance(value, str):
        hexadecimal = len(value) in (40, 64) and all(c in "0123456789abcdef" for c in value)
        return value[:_DIGEST] if hexadecimal else value
    return ("yes" if value else "no") if isinstance(value, bool) else setting(value)


def _differing(folders: Sequence[Folder]) -> list[str]:
    keys = sorted({k for f in folders for k in f.settings})
    return [k for k in keys if len({json.dumps(f.settings.get(k)) for f in folders}) > 1]


def _setting(settings: Mapping[str, Any], key: str) -> Cell:
    return Cell(setting(settings[key])) if key in settings else Cell()


def errors(results: Results) -> list[Block]:
    """Every episode that raised, with what it said."""
    columns = [
        Column("folder", "Folder", word=True),
        Column("method", "Method", word=True),
        Column("episode", "Episode", word=True),
        Column("error", "Error", word=True),
    ]
    lines = [
        Row(
            [
                Cell(f.label),
                Cell(labels.method(r["method"])),
                Cell(r["episode_id"]),
                Cell(str(r.get("error", ""))),
            ]
        )
        for f in results.folders
        for r in f.rows
        if r["status"] != "ok"
    ]
    if not lines:
        return [Text("No episode ended in an error.")]
    caption = f"{len(lines)} results are errors. Each counts as a failure in every table above."
    return [Table("errors", "Results that are errors", caption, columns, lines)]
