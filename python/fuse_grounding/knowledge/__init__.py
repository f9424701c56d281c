"""From a functional query to candidate labels."""

from __future__ import annotations

from collections.abc import Callable

from fuse_grounding.config import KnowledgeConfig
from fuse_grounding.knowledge.affordances import shipped
from fuse_grounding.knowledge.direct import Direct
from fuse_grounding.knowledge.graph import Graph
from fuse_grounding.knowledge.oracle import Oracle
from fuse_grounding.knowledge.protocol import Candidate, Hypotheses, KnowledgeSource, Query
from fuse_grounding.knowledge.query import understand
from fuse_grounding.registry import Registry

__all__ = ["SOURCES", "Candidate", "Hypotheses", "KnowledgeSource", "Query", "make", "parse"]

SOURCES: Registry[Callable[[KnowledgeConfig], KnowledgeSource]] = Registry("knowledge source")
SOURCES.add("graph", lambda config: Graph(shipped(), config.top_k))
SOURCES.add("oracle", lambda config: Oracle(config.oracle))
SOURCES.add("direct", lambda config: Direct(shipped()))


def make(config: KnowledgeConfig) -> KnowledgeSource:
    """The configured source. Raises InputError for an unknown name."""
    return SOURCES.get(config.source)(config)


def parse(text: str) -> Query:
    """The verb of a query in words, by the rule of `knowledge.query`."""
    return understand(text, shipped())
