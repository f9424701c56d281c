"""Suites: named lists of parts, each a benchmark folder with its own settings. A part is a line.

What a part needs and does not ship with FUSE (a hosted model, gated weights) is optional: where it is
missing, it is listed with the reason under `not_run` of the group's folders, never left out silently.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fuse_grounding.benchmark import store
from fuse_grounding.benchmark.driver import Plan
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode
from fuse_grounding.errors import InputError
from fuse_grounding.planning.amortized import KINDS
from fuse_grounding.registry import unknown


@dataclass(frozen=True)
class Part:
    """A folder's methods and what they change of the settings; `optional` ones need what does not ship.

    `most` is how many episodes it has, the first ones; None: all.
    """

    name: str
    methods: tuple[str, ...]
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    optional: tuple[str, ...] = ()
    most: int | None = None


_LADDER = ("static", "canonical", "random", "sweep", "semantic_only", "geometry_only", "explicit")
_FUSE = ("fuse",)
_ITS_OWN = {"weights": None, "threshold": None}
"""What is configured of the segmenter is for another one."""
_HALF = 50
"""Episodes of what no table of the paper has: choices of ours, and settings that it has one value of."""


def _fuse(name: str, most: int | None = None, **settings: Mapping[str, Any]) -> Part:
    return Part(name, _FUSE, settings, most=most)


def _if_there(name: str, **settings: Mapping[str, Any]) -> Part:
    return Part(name, _FUSE, settings, optional=_FUSE)


_PARTS: dict[str, tuple[Part, ...]] = {
    "main": (Part("main", (*_LADDER, "amortized", "fuse", "fuse_oracle", "vlm"), optional=("vlm",)),),
    "knowledge": (
        _fuse("knowledge_graph", knowledge={"source": "graph"}),
        _if_there("knowledge_plain", knowledge={"source": "plain"}),
        _fuse("knowledge_direct", knowledge={"source": "direct"}),
        Part("knowledge_oracle", ("fuse_oracle",)),
        _if_there("knowledge_llm", knowledge={"source": "llm"}),
    ),
    "stopping": (
        _fuse("stopping_k5_depth", stopping={"patience": 5}),
        _fuse("stopping_k3_depth", stopping={"patience": 3}),
        _fuse("stopping_k5", stopping={"patience": 5, "weights": [0.7, 0.0]}),
        _fuse("stopping_k3", stopping={"patience": 3, "weights": [0.7, 0.0]}),
    ),
    "evidence": (
        _fuse("evidence_pixel"),  # with the configured segmenter
        _if_there("evidence_embedded_patches", segmenter={"name": "embedded_patches", **_ITS_OWN}),
        _if_there("evidence_clip_patches", segmenter={"name": "clip_patches", **_ITS_OWN}),
    ),
    "planner": tuple(
        Part(
            f"planner_{kind}",
            ("amortized", "fuse"),
            {"planner": {"name": kind, "weights": None}},
            most=_HALF,
        )
        for kind in KINDS
    ),
    "revisit": tuple(
        Part(
            f"revisit_{word}",
            ("explicit", "amortized", "fuse"),
            {"search": {"revisit": word == "allowed"}},
            most=_HALF,
        )
        for word in ("left_out", "allowed")
    ),
    "reach": tuple(
        Part(
            f"reach_{word}",
            ("geometry_only", "explicit"),
            {"evidence": {"within_reach": word == "weighed"}},
            most=_HALF,
        )
        for word in ("weighed", "not_weighed")
    ),
    "eta": tuple(_fuse(f"eta_{eta}", most=_HALF, gate={"eta": eta}) for eta in (0.6, 0.7, 0.8, 0.9)),
    "weights": tuple(
        Part(
            f"weights_{s:g}_{g:g}",
            ("explicit",),  # which uses them at every decision; of 1, 0 and 0, 1 there are methods
            {"evidence": {"semantic_weight": s, "geometric_weight": g}},
            most=_HALF,
        )
        for s, g in ((1.0, 1.0), (2.0, 1.0), (1.0, 2.0))
    ),
    "search": tuple(
        Part(
            f"search_{coupled}_{stride}", ("explicit",), {"explicit": {"coupled": coupled, "stride": stride}}
        )
        for coupled in ("union", "quadrant")
        for stride in ("one", "two")
    ),
}

_NOT_THE_PAPERS = ("search",)
SUITES: dict[str, tuple[str, ...]] = {
    **{name: (name,) for name in _PARTS},
    "paper": tuple(name for name in _PARTS if name not in _NOT_THE_PAPERS),
}
"""Suite → groups of parts: the paper's main table, its ablations each for itself, or all of it. `search` has
readings of explicit search that the paper leaves open, to choose among on development episodes."""


def plans(
    suite: str,
    out: Path,
    settings: Config,
    episodes: Sequence[Episode],
    *,
    gallery: int = 0,
    resume: bool = False,
) -> list[Plan]:
    """A plan for every part, in `out`/PART; `suite` is a name, or several with commas between.

    `settings` are changed as each part says. Pictures are kept of the group `main` alone. Raises InputError
    for an unknown suite, and for a folder in use without `resume`.
    """
    groups: dict[str, None] = {}  # a set in order
    for name in map(str.strip, suite.split(",")):
        if name not in SUITES:
            raise InputError(unknown("suite", name, list(SUITES)))
        groups.update(dict.fromkeys(SUITES[name]))
    store.check(out, resume)
    grouped = [(group, part) for group in groups for part in _PARTS[group]]
    return [
        Plan(
            out=out / part.name,
            settings=settings.with_(**part.settings),
            episodes=episodes[: part.most],
            methods=part.methods,
            optional=part.optional,
            notes={"suite": suite, "part": part.name, "group": group},
            gallery=gallery if group == "main" else 0,
            resume=resume,
        )
        for group, part in grouped
    ]


def group_of(part: str) -> str | None:
    """The group that a part of this name is compared within; None for a name of no part."""
    return next((group for group, parts in _PARTS.items() if part in (p.name for p in parts)), None)
