"""What things are called in a report, and in which order they stand."""

from __future__ import annotations

from collections.abc import Iterable

METHODS = {
    "static": "Static",
    "canonical": "Canonical View",
    "random": "Random Active",
    "sweep": "Blind Sweep",
    "vlm": "VLM Active",
    "semantic_only": "Semantic Only",
    "geometry_only": "Geometry Only",
    "explicit": "Explicit Exploration",
    "amortized": "Amortized Planner",
    "fuse": "FUSE",
    "fuse_oracle": "Oracle-Label FUSE",
}
"""The paper's methods in the paper's order, and `sweep`, ours; each has its place's style in every plot."""

PARTS = {
    "main": "Methods",
    "knowledge": "Knowledge sources",
    "stopping": "Stopping",
    "evidence": "Semantic evidence",
    "planner": "Learned planner",
    "revisit": "Views seen before",
    "reach": "Reach of geometric evidence",
    "eta": "Gate threshold",
    "weights": "Evidence weights",
    "search": "Readings of explicit search",
}
"""Parts of the suite in the order of the page; others follow under their own names."""


def method(name: str) -> str:
    """A method's name for people."""
    return METHODS.get(name, name)


def part(name: str) -> str:
    """A part's heading."""
    return PARTS.get(name, name.replace("_", " ").capitalize())


def place(name: str, known: Iterable[str] = METHODS) -> tuple[int, str]:
    """Sorts names in the order of `known`, by name after those."""
    order = list(known)
    return (order.index(name) if name in order else len(order)), name


def component(name: str) -> str:
    """A component of the latency table for people: `map_refinement` as `Map refinement`."""
    return name.replace("_", " ").capitalize()


def ordered(names: Iterable[str], known: Iterable[str]) -> list[str]:
    """Names in the order of `known`, the others after them by name."""
    order = list(known)
    return sorted(names, key=lambda name: place(name, order))
