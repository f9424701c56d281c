"""What becomes of candidates that the segmenter does not know: said, and kept for the record.

Every source proposes what it thinks; this is the one place that holds it against the segmenter's labels.
By default what is not known is left out; an open vocabulary takes the nearest known label instead.
"""

from __future__ import annotations

from collections.abc import Sequence

from fuse_grounding.knowledge.nearest import Nearest
from fuse_grounding.knowledge.protocol import (
    Candidate,
    Confidant,
    Hypotheses,
    KnowledgeSource,
    Query,
    Replacement,
)


def within(
    source: str,
    proposed: Sequence[Candidate],
    vocabulary: Sequence[str] | None,
    *,
    top_k: int | None = None,
    announcements: Sequence[str] = (),
) -> Hypotheses:
    """The first `top_k` of the `proposed` candidates that `vocabulary` has (None: it has all).

    The others are `unknown` to the segmenter, as far as they stand before the last one taken; that is
    announced.
    """
    known: list[Candidate] = []
    unknown: list[Candidate] = []
    for candidate in proposed:
        if top_k is not None and len(known) == top_k:
            break
        (known if vocabulary is None or candidate.label in vocabulary else unknown).append(candidate)
    return Hypotheses(source, tuple(known), (*announcements, *_left_out(source, unknown)), tuple(unknown))


def replaced(open_: Hypotheses, vocabulary: Sequence[str], nearest: Nearest) -> Hypotheses:
    """`open_`, proposed without a vocabulary, in the words of a closed one.

    What it has stays. The rest become their nearest known labels, each announced; a label that two
    candidates end at is taken once, for the better one. What nothing is near to is `unknown`.
    """
    taken: dict[str, Candidate] = {}
    unknown: list[Candidate] = []
    replacements: list[Replacement] = []
    for candidate in open_.candidates:
        if candidate.label in vocabulary:
            taken.setdefault(candidate.label, candidate)
            continue
        found = nearest.to(candidate.label, vocabulary)
        if found is None:
            unknown.append(candidate)
            continue
        reason = f"nearest known label to `{candidate.label}`: {candidate.reason}"
        taken.setdefault(found.label, Candidate(found.label, candidate.score, reason))
        replacements.append(found)
    notes = [
        f"{open_.source}: the segmenter has a closed set of labels: `{r.proposed}` is replaced by the "
        f"nearest one, `{r.label}` ({r.words!r}, {r.encoder} similarity {r.similarity:.2f})"
        for r in replacements
    ]
    return Hypotheses(
        open_.source,
        tuple(taken.values()),
        (*open_.announcements, *notes, *_left_out(open_.source, unknown)),
        tuple(unknown),
        tuple(replacements),
        open_.api_seconds,
    )


class OpenVocabulary:
    """A knowledge source whose proposals outside a closed set become the nearest labels in it."""

    def __init__(self, source: KnowledgeSource, nearest: Nearest):
        self._source, self._nearest = source, nearest

    @property
    def name(self) -> str:
        """The source's own."""
        return self._source.name

    def hypotheses(
        self, query: Query, vocabulary: Sequence[str] | None, world: Confidant | None
    ) -> Hypotheses:
        """See `KnowledgeSource.hypotheses`."""
        proposed = self._source.hypotheses(query, None, world)
        return proposed if vocabulary is None else replaced(proposed, vocabulary, self._nearest)


def _left_out(source: str, unknown: Sequence[Candidate]) -> list[str]:
    if not unknown:
        return []
    labels = ", ".join(f"`{c.label}`" for c in unknown)
    return [f"{source}: left out, because the segmenter does not know it: {labels}"]


def nothing_known(hypotheses: Hypotheses) -> str | None:
    """Why a search without candidates ends; None where there are some."""
    if hypotheses.candidates:
        return None
    if not hypotheses.unknown:
        return f"no candidate: {hypotheses.source} proposed nothing"
    labels = ", ".join(c.label for c in hypotheses.unknown)
    return f"no candidate: the segmenter knows none of the proposed labels ({labels})"
