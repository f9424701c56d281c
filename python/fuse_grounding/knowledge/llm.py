"""Knowledge of a language model: which kinds of objects serve a verb, by any OpenAI-compatible endpoint.

One question a verb, out of the cache from the second time on. A segmenter's closed set of labels is listed in
the question, and what is proposed beyond it is kept as unknown, as for every source.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict

from fuse_grounding.chat import Answer, Chat, Message
from fuse_grounding.config_chat import LlmConfig
from fuse_grounding.errors import FuseError
from fuse_grounding.knowledge.protocol import Candidate, Confidant, Hypotheses, Query
from fuse_grounding.knowledge.vocabulary import within
from fuse_grounding.record import HOSTED, Stopwatch

SYSTEM = """\
You know what everyday objects can be used for. You are given a function, and name kinds of objects that a \
reasonable person would use for it: objects whose shape and material let them serve the function as they are.

Reply in JSON: `candidates`, best first, each with
- `label`: the kind of object, in lower case; if labels are listed, one of those, letter by letter;
- `score`: from 0 to 1, how well objects of this kind serve the function;
- `reason`: the properties that make them serve it, in at most twelve words.
Leave out what does not serve the function, however few remain.
"""
LONGEST_LABEL, MOST = 60, 100


def _label(text: str) -> str:
    if not text.strip() or len(text) > LONGEST_LABEL or not text.isprintable():
        raise ValueError(f"a label has from 1 to {LONGEST_LABEL} printable characters")
    return text


def _share(value: float) -> float:
    if not 0 <= value <= 1:
        raise ValueError("a score is from 0 to 1")
    return value


# Limits are checked here and not in the schema, whose keywords for them many servers refuse.
class Proposal(BaseModel):
    """One kind of object."""

    model_config = ConfigDict(extra="forbid")

    label: Annotated[str, AfterValidator(_label)]
    score: Annotated[float, AfterValidator(_share)]
    reason: str


def _few(candidates: list[Proposal]) -> list[Proposal]:
    if len(candidates) > MOST:
        raise ValueError(f"more than {MOST} candidates")
    return candidates


class Proposals(BaseModel):
    """The reply."""

    model_config = ConfigDict(extra="forbid")

    candidates: Annotated[list[Proposal], AfterValidator(_few)]


class Llm:
    """Candidates by a language model, best first."""

    name = "llm"

    def __init__(self, chat: Chat, config: LlmConfig, top_k: int):
        self._chat, self._config, self._top_k = chat, config, top_k

    def hypotheses(
        self, query: Query, vocabulary: Sequence[str] | None, world: Confidant | None = None
    ) -> Hypotheses:
        """See `KnowledgeSource.hypotheses`: none where the model names none; ties keep its order.

        Raises FuseError where the model gives no reply, or none that fits the schema, and InputError where
        the endpoint cannot be asked.
        """
        clock = Stopwatch()
        answer, proposals = self._ask(self._question(query, vocabulary), clock)
        notes = [f"llm: candidates by the model `{self._config.model}`, reply {answer.key[:16]}"]
        if answer.constraint == "prompt" and self._config.constraint == "auto":
            notes.append("llm: the server takes no schema (response_format); it was put into the prompt")
        proposed = _candidates(proposals, vocabulary)
        found = within(self.name, proposed, vocabulary, top_k=self._top_k, announcements=notes)
        return replace(found, api_seconds=clock.seconds.get(HOSTED, 0.0))

    def _question(self, query: Query, vocabulary: Sequence[str] | None) -> str:
        verb = query.verb.replace("_", " ")
        lines = [f"Function: {verb}" if self._config.asks == "verb" else f"Function: {verb} ({query.text})"]
        if vocabulary is not None:
            lines.append(f"Labels: {', '.join(vocabulary)}")
        lines.append(f"At most {self._top_k} candidates.")
        return "\n".join(lines)

    def _ask(self, question: str, clock: Stopwatch) -> tuple[Answer[Proposals], list[Proposal]]:
        """An answer that fits, after as many corrections as are allowed, and what it proposes."""
        messages = [Message("system", (SYSTEM,)), Message("user", (question,))]
        corrections = 0
        while True:
            answer = self._chat.ask(messages, Proposals, lambda: clock(HOSTED))
            if answer.value is not None:
                return answer, answer.value.candidates
            if corrections == self._config.corrections:
                raise FuseError(
                    f"knowledge.llm: no reply of `{self._config.model}` fits the schema ({answer.fault}); "
                    f"the last one is {answer.key} in the cache"
                )
            corrections += 1
            wrong = f"That does not fit: {answer.fault}. Reply again, with the JSON object alone."
            messages += [Message("assistant", (answer.text,)), Message("user", (wrong,))]


def _candidates(proposals: Sequence[Proposal], vocabulary: Sequence[str] | None) -> list[Candidate]:
    """Best first, each label once, spelt as labels are."""
    taken: dict[str, Candidate] = {}
    for proposal in sorted(proposals, key=lambda p: -p.score):
        label = _spelt(proposal.label, vocabulary)
        taken.setdefault(label, Candidate(label, proposal.score, " ".join(proposal.reason.split())[:200]))
    return list(taken.values())


def _spelt(text: str, vocabulary: Sequence[str] | None) -> str:
    """`Butter knife` is `butter_knife`, unless a label is written otherwise in the vocabulary."""
    if vocabulary is not None and text in vocabulary:
        return text
    return re.sub(r"[\s_-]+", "_", text.strip().lower())
