"""Settings of language models: where an endpoint is, how it is asked, what it may take.

There is no default endpoint: nothing is ever asked that was not named. docs/language-models.md has examples.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from fuse_grounding.arguments import Count, Flag, Natural, Positive, Section

RESERVED = ("messages", "model", "n", "response_format", "stream", "temperature")
"""Fields of a request that are made from other settings."""


def _address(text: str) -> str:
    """An address without anything that must not be written down; the last slash is dropped."""
    try:
        parts = urlsplit(text)
        fine = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        fine = False
    if text and not (
        fine and "@" not in parts.netloc and not (parts.query or parts.fragment) and text.isprintable()
    ):
        raise PydanticCustomError(
            "address",
            "an address such as http://127.0.0.1:8080/v1, without a name, password or query in it",
        )
    return text.rstrip("/")


def _variable(text: str) -> str:
    if text and not re.fullmatch(r"[A-Z_][A-Z0-9_]*", text):
        raise PydanticCustomError(
            "variable", "the name of an environment variable in capitals, never the key itself"
        )
    return text


def _options(options: dict[str, Any]) -> dict[str, Any]:
    if taken := sorted(options.keys() & set(RESERVED)):
        raise PydanticCustomError(
            "options", "options without `{name}`, which other settings decide", {"name": taken[0]}
        )
    return options


class ChatConfig(Section):
    """An OpenAI-compatible chat-completions endpoint. Whatever is not marked otherwise is ours."""

    base_url: Annotated[str, AfterValidator(_address)] = ""
    """What `/chat/completions` is appended to, mostly ending in /v1; empty: no endpoint. Decides answers: the
    same name can be another model elsewhere."""
    model: str = ""
    """Its name there. The paper's: Gemini-3.1-Flash-Lite for `vlm`, five others for `knowledge.llm`."""
    key_env: Annotated[str, AfterValidator(_variable)] = ""
    """Environment variable with the key, which is sent as `Authorization: Bearer` and written nowhere; empty:
    none is sent."""
    temperature: Annotated[float, Field(ge=0, le=2)] | Literal["default"] = 0.0
    """Supplement, "VLM Active"; `default`: not sent, for models that accept none."""
    constraint: Literal["auto", "json_schema", "prompt"] = "auto"
    """How the reply is held to its schema: by the server (`response_format`), or by words in the prompt;
    `auto`: by words where the server refuses the first, announced and recorded."""
    options: Annotated[dict[str, Any], AfterValidator(_options)] = Field(default_factory=dict)
    """Further fields of the request, such as `seed` or `max_tokens`."""
    timeout_s: Positive = 60.0
    """For one attempt."""
    total_s: Positive = 180.0
    """For one question with all its attempts and waits."""
    retries: Natural = 5
    """Attempts after the first, where the server is busy, broken or too slow."""
    backoff_s: Positive = 1.0
    """First wait between attempts; it doubles, up to 30 s. A server's Retry-After counts instead."""
    max_reply_bytes: Count = 1_000_000
    """A reply that is longer is not read to its end."""
    cache: Path | None = None
    """Folder of the replies; none: `fuse-grounding/chat` in the user's cache folder (XDG_CACHE_HOME)."""
    offline: Flag = False
    """Answer from the cache alone: what is not there is an error that names its key."""


class LlmConfig(ChatConfig):
    """The language model of the knowledge source `llm`."""

    asks: Literal["verb", "query"] = "verb"
    """What it is told: the verb, as `graph` is, which takes one question a verb; or the whole query. Ours."""
    corrections: Natural = 1
    """How often it may correct a reply that does not fit the schema, told what is wrong with it. Ours."""


class VlmConfig(ChatConfig):
    """The vision-language model of the method `vlm`."""

    labels: Literal["candidates", "oracle"] = "candidates"
    """What it is told to look for: the candidates (supplement, "VLM Active"), or the target's label (footnote
    of the main table); masks are of the candidates either way."""
    history: Natural = 6
    """Latest decisions that it is told. Supplement, "VLM Active"."""
    near_m: Positive = 0.3
    """Depth that is white in the depth picture, and nearer. As `stopping.near_m`; not in the paper."""
    far_m: Positive = 2.0
    """Depth that is darkest, and farther: about the far edge of the table from the ring. Not in the paper."""
    failures: Count = 3
    """Questions in a row without any reply that end an episode with an error. Ours."""

    @model_validator(mode="after")
    def _range(self) -> VlmConfig:
        if self.near_m >= self.far_m:
            raise PydanticCustomError("range", "`near_m` below `far_m`")
        return self
