"""From a functional query to candidate labels."""

from __future__ import annotations

from collections.abc import Callable

from fuse_grounding import chat
from fuse_grounding.config import KnowledgeConfig
from fuse_grounding.knowledge.affordances import shipped
from fuse_grounding.knowledge.direct import Direct
from fuse_grounding.knowledge.graph import Graph
from fuse_grounding.knowledge.llm import Llm
from fuse_grounding.knowledge.nearest import Nearest
from fuse_grounding.knowledge.oracle import Oracle
from fuse_grounding.knowledge.plain import Plain
from fuse_grounding.knowledge.protocol import Candidate, Hypotheses, KnowledgeSource, Query
from fuse_grounding.knowledge.query import understand
from fuse_grounding.knowledge.vocabulary import OpenVocabulary
from fuse_grounding.perception.lexical import Lexical
from fuse_grounding.perception.protocol import TextEncoder
from fuse_grounding.registry import Registry

__all__ = ["SOURCES", "Candidate", "Hypotheses", "KnowledgeSource", "Query", "compares", "make", "parse"]

SOURCES: Registry[Callable[[KnowledgeConfig, Nearest], KnowledgeSource]] = Registry("knowledge source")
SOURCES.add("graph", lambda config, nearest: Graph(shipped(), config.top_k))
SOURCES.add("plain", lambda config, nearest: Plain(nearest.encoder, list(shipped().things), config.top_k))
SOURCES.add("oracle", lambda config, nearest: Oracle(config.oracle))
SOURCES.add("direct", lambda config, nearest: Direct(nearest))
SOURCES.add(
    "llm",
    lambda config, nearest: Llm(chat.opened(config.llm, "knowledge.llm"), config.llm, config.top_k),
)


def compares(config: KnowledgeConfig) -> bool:
    """Whether a text encoder decides about labels: which is near to a verb, or to an unknown label."""
    return config.source in ("direct", "plain") or config.open_vocabulary == "nearest"


def make(config: KnowledgeConfig, encoder: TextEncoder | None = None) -> KnowledgeSource:
    """The configured source. Raises InputError for an unknown name.

    Where labels are compared with words (`compares`), `encoder` says what is near; without one, `Lexical`.
    """
    nearest = Nearest(shipped(), encoder or Lexical())
    source = SOURCES.get(config.source)(config, nearest)
    return OpenVocabulary(source, nearest) if config.open_vocabulary == "nearest" else source


def parse(text: str) -> Query:
    """The verb of a query in words, by the rule of `knowledge.query`."""
    return understand(text, shipped())
