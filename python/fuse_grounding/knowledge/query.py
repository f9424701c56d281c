"""A query in words becomes a verb.

The rule: the query is cut into lower-case words; words without content ("a", "something", "to")
are dropped; each word stands for itself and its simple base forms ("cutting" -> "cut"). Every
verb's name, synonyms and known phrasings are looked up as runs of consecutive words. The longest
run wins, then the earliest. A run that belongs to two verbs, or none at all, is an error.
"""

from __future__ import annotations

import re

from fuse_grounding.arguments import instance_of
from fuse_grounding.errors import InputError
from fuse_grounding.knowledge.affordances import Affordances
from fuse_grounding.knowledge.protocol import Query
from fuse_grounding.registry import unknown

_EMPTY_WORDS = (
    "a an the some any this that these those my your our something anything thing things to with for "
    "of i we you need want please find get bring me us can could would will object tool item piece"
)
_EMPTY = frozenset(_EMPTY_WORDS.split())
_IRREGULAR = {
    "wrote": "write", "written": "write", "drank": "drink", "drunk": "drink", "beaten": "beat",
    "struck": "strike", "drove": "drive", "driven": "drive", "drawn": "draw", "drew": "draw",
    "shone": "shine",
}  # fmt: skip


def base_forms(word: str) -> frozenset[str]:
    """A word and what it may be inflected from: -s, -es, -ies, -ed, -ing, doubled or dropped letters."""
    forms = {word, _IRREGULAR.get(word, word)}
    if len(word) > 3 and word.endswith("s") and not word.endswith("ss"):
        forms |= {word[:-1], word.removesuffix("es"), re.sub("ies$", "y", word)}
    for ending in ("ed", "ing"):
        stem = word.removesuffix(ending)
        if stem != word and len(stem) >= 2:
            forms |= {stem, stem + "e"}
            if len(stem) > 2 and stem[-1] == stem[-2]:
                forms.add(stem[:-1])
    return frozenset(forms)


def _content(text: str) -> list[str]:
    return [w for w in re.findall(r"[a-z]+", text.lower()) if w not in _EMPTY]


def _find(words: list[frozenset[str]], phrase: list[str]) -> int | None:
    """Position of the first run of `words` that reads as `phrase`."""
    for start in range(len(words) - len(phrase) + 1):
        if all(base_forms(p) & w for p, w in zip(phrase, words[start:], strict=False)):
            return start
    return None


def understand(text: str, graph: Affordances) -> Query:
    """The verb of a query. Raises InputError listing what is known when it is unknown or ambiguous."""
    instance_of("query", text, str)
    words = [base_forms(w) for w in _content(text)]
    matches: list[tuple[int, int, str, str]] = []
    for verb in graph.verbs.values():
        for phrase in (verb.name.replace("_", " "), *verb.synonyms, *verb.queries):
            content = _content(phrase)
            start = _find(words, content) if content else None
            if start is not None:
                matches.append((-len(content), start, verb.name, phrase))
    if not matches:
        if len(words) == 1 and text.strip():
            raise InputError(unknown("verb", text.strip(), list(graph.verbs)))
        raise InputError(f"no known verb in the query {text!r}; known: {', '.join(graph.verbs)}")
    matches.sort()
    best = [m for m in matches if m[:2] == matches[0][:2]]
    verbs = sorted({m[2] for m in best})
    if len(verbs) > 1:
        raise InputError(f"the query {text!r} may mean {' or '.join(verbs)}; name one of these verbs")
    return Query(text, verbs[0], because=best[0][3])
