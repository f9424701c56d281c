"""Judges a knowledge source against the validity table: would a reasonable person accept the object?

This file alone reads `data/validity.json`; no source may see what judges it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fuse_grounding.errors import InputError
from fuse_grounding.knowledge.affordances import shipped
from fuse_grounding.knowledge.protocol import KnowledgeSource, NothingProposed, Query

PATH = Path(__file__).parent.parent / "data" / "validity.json"


@dataclass(frozen=True)
class Judgement:
    """One verb's candidates against the table. `missed` are valid and not proposed, `wrong` the reverse."""

    source: str
    verb: str
    proposed: tuple[str, ...]
    right: tuple[str, ...]
    wrong: tuple[str, ...]
    missed: tuple[str, ...]

    @property
    def precision(self) -> float | None:
        """Right over proposed; None when nothing was proposed."""
        return len(self.right) / len(self.proposed) if self.proposed else None

    @property
    def recall(self) -> float | None:
        """Right over valid; None when nothing is valid."""
        valid = len(self.right) + len(self.missed)
        return len(self.right) / valid if valid else None


def validity(path: Path = PATH) -> dict[str, dict[str, bool]]:
    """Verb -> category -> whether a reasonable person would accept it."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        verbs = table.get("verbs", table)
        return {
            verb: {category: bool(entry["valid"]) for category, entry in row.items()}
            for verb, row in verbs.items()
            if isinstance(row, dict)
        }
    except FileNotFoundError:
        raise InputError(f"validity table {path} does not exist") from None
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"validity table {path} is not verb -> category -> valid: {error!r}") from None


def judge(source: KnowledgeSource, table: Mapping[str, Mapping[str, bool]]) -> list[Judgement]:
    """Precision and recall of a source for every verb of the table, over the table's categories."""
    graph = shipped()
    return [_judge_verb(source, verb, row) for verb, row in table.items() if verb in graph.verbs]


def _judge_verb(source: KnowledgeSource, verb: str, row: Mapping[str, bool]) -> Judgement:
    try:
        proposed = source.hypotheses(Query(verb, verb, verb), tuple(row), None).labels
    except NothingProposed:
        proposed = ()  # the source has nothing to propose: recall pays for it
    right = tuple(x for x in proposed if row.get(x, False))
    wrong = tuple(x for x in proposed if not row.get(x, False))
    missed = tuple(x for x, valid in row.items() if valid and x not in proposed)
    return Judgement(source.name, verb, proposed, right, wrong, missed)


def pooled(judgements: Sequence[Judgement]) -> tuple[float, float]:
    """Precision and recall over all verbs together (micro average)."""
    right = sum(len(j.right) for j in judgements)
    proposed = sum(len(j.proposed) for j in judgements)
    valid = right + sum(len(j.missed) for j in judgements)
    return (right / proposed if proposed else 0.0, right / valid if valid else 0.0)
