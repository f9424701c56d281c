"""What becomes of candidates that the segmenter does not know: left out, said, and kept for the record.

Every source proposes what it thinks; this is the one place that holds it against the segmenter's labels.
"""

from __future__ import annotations

from collections.abc import Sequence

from fuse_grounding.knowledge.protocol import Candidate, Hypotheses


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
    notes = list(announcements)
    if unknown:
        left_out = ", ".join(f"`{c.label}`" for c in unknown)
        notes.append(f"{source}: left out, because the segmenter does not know it: {left_out}")
    return Hypotheses(source, tuple(known), tuple(notes), tuple(unknown))


def nothing_known(hypotheses: Hypotheses) -> str | None:
    """Why a search without candidates ends; None where there are some."""
    if hypotheses.candidates:
        return None
    labels = ", ".join(c.label for c in hypotheses.unknown)
    return f"no candidate: the segmenter knows none of the proposed labels ({labels})"
