"""Asks a model, out of the cache where the question was asked before, and checks that the reply fits."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cache
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError

from fuse_grounding.chat.cache import Cache, Entry, default_folder, key_of
from fuse_grounding.chat.endpoint import Endpoint, NoReply, Refused
from fuse_grounding.chat.messages import Message, canonical, wire
from fuse_grounding.config_chat import ChatConfig, LlmConfig, VlmConfig
from fuse_grounding.errors import InputError, UnusableError

T = TypeVar("T", bound=BaseModel)
Waiting = Callable[[], AbstractContextManager[object]]

_CUT = "length"
"""What `finish_reason` is where the model was not done, but had no more tokens."""
_LONGEST_FAULT = 200


@dataclass(frozen=True)
class Answer(Generic[T]):
    """A reply: its `text`, and `value` where it fits the schema; else None, and `fault` says why.

    `key` names it in the cache; `constraint` is `json_schema` or `prompt`, what held it to the schema.
    """

    key: str
    text: str
    constraint: str
    value: T | None
    fault: str = ""


@dataclass(frozen=True)
class _Question:
    messages: Sequence[Message]
    name: str
    shape: dict[str, Any]


class _Words(BaseModel):
    content: str | None = None
    refusal: str | None = None


class _Choice(BaseModel):
    message: _Words
    finish_reason: Any = None


class _Completion(BaseModel):
    """The part of a completion that is read."""

    choices: list[_Choice]
    model: Any = None
    usage: Any = None


class Chat:
    """Questions to one model at one endpoint."""

    def __init__(self, config: ChatConfig, section: str):
        """`section` is where the settings stand. Raises InputError where no endpoint is named, and where
        the environment variable with its key is missing.

        Nothing is sent before the first question.
        """
        for name, example in (("base_url", "http://127.0.0.1:8080/v1"), ("model", "qwen2.5-vl")):
            if not getattr(config, name):
                raise UnusableError(
                    f"`{section}.{name}` is not set, such as {example}: no language model is configured "
                    "(docs/language-models.md)"
                )
        self._config, self._section = config, section
        self._cache = Cache(config.cache or default_folder())
        # Offline, neither urllib3 nor a key is wanted.
        self._endpoint = None if config.offline else Endpoint(config, section)
        self._refuses_schema = config.constraint == "prompt"

    def ask(self, messages: Sequence[Message], schema: type[T], waiting: Waiting = nullcontext) -> Answer[T]:
        """The reply to `messages`, held to `schema`; the endpoint is waited for within `waiting`.

        A reply that does not fit is an answer, too (`Answer.fault`), and kept. Raises NoReply where there is
        none, and InputError where no question can be answered as things are, or, offline, was not before.
        """
        config = self._config
        shape = schema.model_json_schema()
        request = {
            "base_url": config.base_url,
            "model": config.model,
            "temperature": config.temperature,
            "options": config.model_dump(mode="json")["options"],
            "constraint": config.constraint,
            "schema": shape,
            "messages": canonical(messages),
        }
        key = key_of(request)
        entry = self._cache.read(key)
        if entry is None and config.offline:
            raise InputError(
                f"`{self._section}.offline`: the reply {key} is not in {self._cache.folder}; ask online "
                f"once, or name the folder that has it by `{self._section}.cache`"
            )
        if entry is None or (entry.failure is not None and not config.offline):
            question = _Question(messages, schema.__name__.strip("_").lower(), shape)
            entry = self._fetch(key, request, question, waiting)
        if entry.text is None:
            raise NoReply(entry.failure or "")
        try:
            value = schema.model_validate_json(_unfenced(entry.text), strict=True)
        except ValidationError as error:
            cut = "cut off at the limit of tokens (`max_tokens`): " if entry.finish_reason == _CUT else ""
            return Answer(key, entry.text, entry.constraint, None, (cut + _fault(error))[:_LONGEST_FAULT])
        return Answer(key, entry.text, entry.constraint, value)

    def _fetch(self, key: str, request: dict[str, Any], question: _Question, waiting: Waiting) -> Entry:
        """Asks the endpoint, and keeps what came of it."""
        try:
            text, completion = self._read(self._post(question, waiting))
        except NoReply as error:
            entry = Entry(request=request, failure=str(error))
            self._cache.write(key, entry)
            return entry
        stopped = completion.choices[0].finish_reason
        entry = Entry(
            request=request,
            text=text,
            constraint="prompt" if self._refuses_schema else "json_schema",
            model=completion.model if isinstance(completion.model, str) else None,
            usage=completion.usage,
            finish_reason=stopped if isinstance(stopped, str) else None,
        )
        self._cache.write(key, entry)
        return entry

    def _post(self, question: _Question, waiting: Waiting) -> bytes:
        """One question; where the server takes no schema, the schema goes into the prompt from now on."""
        try:
            return self._send(question, waiting)
        except Refused as refusal:
            if self._refuses_schema or self._config.constraint == "json_schema":
                raise
            self._refuses_schema = True
            try:
                return self._send(question, waiting)
            except Refused:
                self._refuses_schema = False
                raise refusal from None  # not because of the schema

    def _send(self, question: _Question, waiting: Waiting) -> bytes:
        assert self._endpoint is not None, "offline, nothing is fetched"
        config, messages = self._config, question.messages
        body: dict[str, Any] = {"model": config.model}
        if config.temperature != "default":
            body["temperature"] = config.temperature
        if self._refuses_schema:
            body["messages"] = wire([*messages[:-1], _with_schema(messages[-1], question.shape)])
        else:
            body["messages"] = wire(messages)
            held = {"name": question.name, "strict": True, "schema": question.shape}
            body["response_format"] = {"type": "json_schema", "json_schema": held}
        body |= config.model_dump(mode="json")["options"]
        packed = json.dumps(body).encode()
        with waiting():
            return self._endpoint.post(packed)

    def _read(self, raw: bytes) -> tuple[str, _Completion]:
        """The reply's text, which may be empty. Raises NoReply for a body that is no completion."""
        where = f"{self._section} at {self._config.base_url}"
        try:
            completion = _Completion.model_validate_json(raw)
        except ValidationError as error:
            raise NoReply(f"{where}: the reply is not a chat completion ({_fault(error)})") from None
        if not completion.choices:
            raise NoReply(f"{where}: the reply has no choices")
        words = completion.choices[0].message
        return words.content or words.refusal or "", completion


def opened(config: LlmConfig | VlmConfig, section: str) -> Chat:
    """A chat that is opened once in a process: connections and what the server takes are remembered."""
    return _opened(type(config), config.model_dump_json(), section, os.getpid())


@cache
def _opened(kind: type[ChatConfig], settings: str, section: str, process: int) -> Chat:
    return Chat(kind.model_validate_json(settings), section)


def _with_schema(message: Message, shape: dict[str, Any]) -> Message:
    words = (
        f"Reply with one JSON object that fits this JSON Schema, and with nothing else: {json.dumps(shape)}"
    )
    return Message(message.role, (*message.parts, words))


def _unfenced(text: str) -> str:
    """The text without thoughts before it and a Markdown fence around it, which models like to put there."""
    inner = re.sub(r"\A\s*<think>.*?</think>", "", text, flags=re.DOTALL).strip()
    if inner.startswith("```") and inner.endswith("```") and "\n" in inner:
        inner = inner.split("\n", 1)[1].removesuffix("```").strip()
    return inner


def _fault(error: ValidationError) -> str:
    """What is wrong with a reply, short: it may be anything."""
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    message = first["msg"]
    return (f"`{where}`: {message}" if where else message)[:_LONGEST_FAULT]
