"""The property graph as shipped: verbs, the properties they require, the objects that have them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PATH = Path(__file__).parent.parent / "data" / "affordances.json"


@dataclass(frozen=True)
class Verb:
    """A function: all of `requires` and one of each `any_of` group are needed."""

    name: str
    synonyms: tuple[str, ...]
    queries: tuple[str, ...]
    requires: tuple[str, ...]
    any_of: tuple[tuple[str, ...], ...]
    rationale: str


@dataclass(frozen=True)
class Thing:
    """A kind of object: degrees in [0, 1] of its properties."""

    name: str
    label: str
    functional_part: str
    synonyms: tuple[str, ...]
    properties: dict[str, float]


@dataclass(frozen=True)
class Affordances:
    """The graph. `meanings` says in words what each property is."""

    version: int
    threshold: float
    meanings: dict[str, str]
    verbs: dict[str, Verb]
    things: dict[str, Thing]


@cache
def shipped() -> Affordances:
    """The graph that comes with the package."""
    raw = json.loads(PATH.read_text(encoding="utf-8"))
    return Affordances(
        version=raw["version"],
        threshold=raw["threshold"],
        meanings=raw["properties"],
        verbs={
            name: Verb(
                name,
                tuple(v["synonyms"]),
                tuple(v["queries"]),
                tuple(v["requires"]),
                tuple(tuple(group) for group in v["any_of"]),
                v["rationale"],
            )
            for name, v in raw["verbs"].items()
        },
        things={
            name: Thing(name, t["label"], t["functional_part"], tuple(t["synonyms"]), t["properties"])
            for name, t in raw["objects"].items()
        },
    )
