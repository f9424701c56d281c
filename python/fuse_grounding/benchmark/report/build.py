"""A report from results: its sections in the order they are read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fuse_grounding.benchmark.metrics import METRICS
from fuse_grounding.benchmark.report import (
    breakdown,
    endings,
    gallery,
    labels,
    overview,
    paired,
    paper,
    plots,
    reliability,
    summary,
    timing,
    travel,
)
from fuse_grounding.benchmark.report.episodes import natures
from fuse_grounding.benchmark.report.load import MAIN, Part, Results
from fuse_grounding.benchmark.report.model import Block, Facts, Report, Section, Text
from fuse_grounding.errors import InputError
from fuse_grounding.registry import unknown


@dataclass(frozen=True)
class Options:
    """`reference` is what others are compared with; `episodes` are files beside the shipped sets."""

    reference: str | None = None
    episodes: Sequence[Path] = ()
    gallery_mb: float = gallery.LIMIT_MB


def build(results: Results, options: Options = Options()) -> Report:
    """The whole report. Raises InputError for a reference that is not there, and for broken pictures."""
    if options.reference is not None and not any(
        paired.has(p, options.reference) for p in results.part(MAIN)
    ):
        raise InputError(unknown("method", options.reference, paired.names(results.part(MAIN))))
    sections = [Section("run", "What was run", overview.blocks(results))]
    sets = list(dict.fromkeys(p.set_name for p in results.parts))
    for set_name in sets:
        over = f" · {set_name}" if len(sets) > 1 else ""
        for part in (p for p in results.parts if p.set_name == set_name):
            title = labels.part(part.name) + over
            sections.append(Section(f"{part.name}-{set_name}", title, _part(part, options)))
            if part.name == MAIN and part.arms:
                sections += _main(part, options, over)
    sections.append(Section("gallery", "Episodes step by step", gallery.blocks(results, options.gallery_mb)))
    sections.append(Section("failed", "Errors", overview.errors(results)))
    sections.append(Section("reading", "How to read this", _reading()))
    return Report("FUSE benchmark", _summary(results), sections)


def _summary(results: Results) -> str:
    rows = sum(len(f.rows) for f in results.folders)
    methods = {m for f in results.folders for m in f.methods}
    sets = sorted({p.set_name for p in results.parts})
    return (
        f"{rows} results of {len(methods)} method{'s' * (len(methods) != 1)} on episodes of "
        f"{', '.join(f'`{s}`' for s in sets)}."
    )


def _part(part: Part, options: Options) -> list[Block]:
    found = summary.summaries(part)
    blocks: list[Block] = [summary.table(part, found)]
    blocks += [t for t in (summary.more(part, found), paper.beside(part, found)) if t is not None]
    if part.name != MAIN and part.arms:  # of the main part it has a section, with what explains it
        blocks.append(endings.table(part))
    reference = options.reference if part.name == MAIN and paired.has(part, options.reference) else None
    return blocks + list(paired.tables(part, reference))


def _main(part: Part, options: Options, over: str) -> list[Section]:
    wanted = {e: d for a in part.arms for f in a.folders for e, d in f.episodes.items()}
    known, why_not = natures(wanted, part.set_name, [str(p) for p in options.episodes])
    curves: list[Block] = [
        plots.pareto(part),
        plots.over_steps(part),
        plots.entropy(part),
        plots.branches(part),
    ]
    return [
        Section(f"curves-{part.set_name}", "Success against time and steps" + over, curves),
        Section(f"time-{part.set_name}", "Runtime" + over, timing.blocks(part)),
        Section(
            f"where-{part.set_name}",
            "Where it succeeds and how it fails" + over,
            [
                endings.table(part),
                breakdown.visibility(part, known, why_not),
                *breakdown.tables(part, known),
                *filter(None, [travel.table(part)]),
            ],
        ),
        Section(f"reliability-{part.set_name}", "Reliability" + over, reliability.figures(part)),
    ]


def _reading() -> list[Block]:
    words = (
        "Every method ran on the same episodes. An episode is a success when the returned mask overlaps a "
        "valid object with an IoU of at least 0.5. Arrows in the heads of tables say which way is better. "
        "Formulas of all metrics and the conventions of the statistics: docs/metrics.md."
    )
    units = [(m.title, m.unit) for m in METRICS]
    return [Text(words), Facts("Units of metrics", units)]
