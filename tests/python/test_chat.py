"""The client of language models against a server that behaves in every way that servers do."""

from __future__ import annotations

import json
import logging
import socket
import sys
import time
from email.utils import formatdate
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chat_server import (
    HUGE,
    ChatServer,
    Turn,
    completion,
    good,
    hang_up,
    huge,
    no_schema,
    packed,
    raw,
    slow,
    status,
    trickle,
    truncated,
    wants_key,
)
from pydantic import BaseModel, ConfigDict, TypeAdapter

from fuse_grounding.chat import Chat, Message, NoReply
from fuse_grounding.chat.cache import Cache, default_folder
from fuse_grounding.config import Config
from fuse_grounding.config_chat import ChatConfig
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.knowledge.llm import Proposals
from fuse_grounding.planning.vlm import Reply

KEY = "sk-secret-0123456789"
PICTURE = np.random.default_rng(0).integers(0, 255, (20, 30, 3), np.uint8)
DEPTH = np.arange(600, dtype=np.uint8).reshape(20, 30)


class Word(BaseModel):
    """A word."""

    model_config = ConfigDict(extra="forbid")
    word: str


def settings(server: ChatServer | str, folder: Path, **changed: Any) -> ChatConfig:
    url = server if isinstance(server, str) else server.url
    given = {"base_url": url, "model": "m", "cache": folder, "backoff_s": 0.01, "timeout_s": 5.0}
    return ChatConfig.model_validate({**given, **changed})


def chat(server: ChatServer | str, folder: Path, **changed: Any) -> Chat:
    return Chat(settings(server, folder, **changed), "vlm")


def question(*parts: Any) -> list[Message]:
    return [Message("system", ("Say a word.",)), Message("user", parts or ("Now.",))]


def test_a_question_is_sent_as_the_protocol_wants_it(tmp_path: Path):
    with ChatServer(good({"word": "mug"})) as server:
        asked = chat(server, tmp_path, options={"seed": 3})
        answer = asked.ask(question("Look:", PICTURE, DEPTH), Word)
    assert answer.value == Word(word="mug")
    assert (answer.fault, answer.constraint) == ("", "json_schema")
    (got,) = server.got
    assert got.path == "/v1/chat/completions"
    assert (got.body["model"], got.body["temperature"], got.body["seed"]) == ("m", 0.0, 3)
    assert got.body["messages"][0] == {"role": "system", "content": "Say a word."}
    assert [p["type"] for p in got.body["messages"][1]["content"]] == ["text", "image_url", "image_url"]
    rgb, depth = got.pictures
    np.testing.assert_array_equal(rgb, PICTURE)
    np.testing.assert_array_equal(depth, DEPTH)
    form = got.body["response_format"]
    assert (form["type"], form["json_schema"]["name"], form["json_schema"]["strict"]) == (
        "json_schema",
        "word",
        True,
    )
    assert form["json_schema"]["schema"]["additionalProperties"] is False
    assert form["json_schema"]["schema"]["required"] == ["word"]
    assert "Authorization" not in got.headers


def test_the_key_goes_into_one_header_and_nowhere_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    monkeypatch.setenv("MY_KEY", f"{KEY}\n")
    caplog.set_level(logging.DEBUG)
    with ChatServer(wants_key(KEY, good({"word": "mug"}))) as server:
        assert chat(server, tmp_path, key_env="MY_KEY").ask(question(), Word).value is not None
        monkeypatch.setenv("MY_KEY", KEY[:-1])
        with pytest.raises(InputError, match=r"the key in MY_KEY is refused \(401") as wrong:
            chat(server, tmp_path, key_env="MY_KEY").ask(question("other"), Word)
        with pytest.raises(InputError, match=r"a key is wanted, and none was sent .*`vlm.key_env` names"):
            chat(server, tmp_path).ask(question("other"), Word)
    assert KEY[:-1] not in str(wrong.value)
    assert "[key]" in str(wrong.value)
    first = server.got[0]
    assert first.headers.pop("Authorization") == f"Bearer {KEY}"
    assert KEY not in json.dumps([first.headers, first.body, first.path])
    written = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert written
    assert not [p for p in written if KEY[:-1] in p.read_text()]
    assert KEY[:-1] not in caplog.text
    monkeypatch.delenv("MY_KEY")
    with pytest.raises(InputError, match=r"`vlm.key_env`: the environment variable MY_KEY is not set"):
        chat("http://127.0.0.1:1/v1", tmp_path, key_env="MY_KEY")
    monkeypatch.setenv("MY_KEY", "sk-\r\nEvil: 1")
    with pytest.raises(InputError, match="MY_KEY holds characters that no key has"):
        chat("http://127.0.0.1:1/v1", tmp_path, key_env="MY_KEY")


def test_a_key_in_place_of_a_setting_is_refused_unseen():
    for bad in (f"vlm.key_env={KEY}", f"vlm.base_url=http://u:{KEY}@h/v1", f"vlm.base_url=http://h/?k={KEY}"):
        with pytest.raises(InputError, match="a text that is not shown, expected: ") as refused:
            Config.load(None, [bad])
        assert KEY not in str(refused.value).removeprefix(f"--set {bad}")


@pytest.mark.parametrize(
    ("turns", "sent"),
    [
        ([status(429, Retry_After="0"), good({"word": "mug"})], 2),
        ([status(500), status(503), good({"word": "mug"})], 3),
        ([slow, good({"word": "mug"})], 2),
        ([trickle, good({"word": "mug"})], 2),
        ([truncated, good({"word": "mug"})], 2),
        ([hang_up, good({"word": "mug"})], 2),
    ],
    ids=["429", "500 503", "slow", "trickle", "truncated", "hang up"],
)
def test_what_may_pass_is_tried_again(tmp_path: Path, turns: list[Turn], sent: int):
    with ChatServer(turns) as server:
        asked = chat(server, tmp_path, timeout_s=0.3)
        assert asked.ask(question(), Word).value == Word(word="mug")
        assert len(server.got) == sent


def test_retry_after_is_waited_for_as_seconds_and_as_a_date(tmp_path: Path):
    for dated in (False, True):
        wait = formatdate(time.time() + 3, usegmt=True) if dated else "1"
        with ChatServer([status(429, Retry_After=wait), good({"word": "mug"})]) as server:
            began = time.monotonic()
            chat(server, tmp_path).ask(question(wait), Word)
            assert time.monotonic() - began > 0.5  # our own wait would be a hundredth
    with ChatServer([status(429, Retry_After="soon"), good({"word": "mug"})]) as server:
        assert chat(server, tmp_path).ask(question(), Word).value is not None  # unreadable: our own wait


@pytest.mark.parametrize(
    ("turn", "changed", "message"),
    [
        (
            status(500),
            {"retries": 2},
            r"vlm at http.*: the server says 500: .*busy.*, at the last of 3 attempts",
        ),
        (status(429, Retry_After="9000"), {}, "says 429.*asks to wait 9000 s; `vlm.total_s` is 180"),
        (slow, {"timeout_s": 0.2, "retries": 1}, r"no reply within 0\.2 s, at the last of 2 attempts"),
        (slow, {"timeout_s": 0.2, "total_s": 0.5, "backoff_s": 0.2}, r"no reply.*`vlm.total_s` is 0\.5"),
        (trickle, {"timeout_s": 0.3, "retries": 0}, r"no whole reply within 0\.3 s"),
        (truncated, {"retries": 1}, "the reply broke off"),
        (raw(b"<html>"), {}, "the reply is not a chat completion"),
        (raw(b"[" * 100_000), {}, "the reply is not a chat completion"),
        (raw(b'{"choices": []}'), {}, "the reply has no choices"),
        (raw(completion("{}")[:-9]), {}, "the reply is not a chat completion"),
    ],
    ids=["500", "wait", "slow", "total", "trickle", "truncated", "html", "deep", "no choice", "half"],
)
def test_a_question_without_a_reply_says_why(
    tmp_path: Path, turn: Turn, changed: dict[str, Any], message: str
):
    with ChatServer(turn) as server:
        began = time.monotonic()
        with pytest.raises(NoReply, match=message):
            chat(server, tmp_path, **changed).ask(question(), Word)
        assert time.monotonic() - began < 3


def test_ten_megabytes_are_not_read(tmp_path: Path):
    with ChatServer(huge) as server:
        with pytest.raises(NoReply, match="longer than 1000000 bytes; the rest was not read"):
            chat(server, tmp_path).ask(question(), Word)
        assert len(server.got) == 1  # and not asked again
        time.sleep(0.1)
        assert server.written < HUGE
    with ChatServer(packed(b"x" * HUGE)) as server, pytest.raises(NoReply, match="longer than 1000000 bytes"):
        chat(server, tmp_path).ask(question(), Word)
    with ChatServer(packed(completion('{"word": "mug"}'))) as server:  # in itself, packing is fine
        assert chat(server, tmp_path).ask(question(), Word).value == Word(word="mug")
    with ChatServer(status(500, b"x" * HUGE)) as server, pytest.raises(NoReply, match="the server says 500"):
        chat(server, tmp_path, retries=0).ask(question(), Word)


@pytest.mark.parametrize(
    ("turn", "message"),
    [
        (status(403, "no access"), "a key is wanted"),
        (status(404, "no such model"), r"no such address or model `m` \(404: .*no such model.*end in /v1"),
        (status(400, "no pictures"), r"does not take the request \(400: .*no pictures"),
        (status(402, "pay"), "the server says 402: .*pay"),
        (status(308, "", Location="http://elsewhere/v1"), "redirects to http://elsewhere/v1; name that"),
    ],
    ids=["403", "404", "400", "402", "308"],
)
def test_what_no_attempt_can_mend_is_the_callers_to_mend(tmp_path: Path, turn: Turn, message: str):
    with ChatServer(turn) as server, pytest.raises(InputError, match=message):
        chat(server, tmp_path).ask(question(), Word)
    assert len(server.got) <= 2  # the schema alone is tried without
    assert not list(tmp_path.rglob("*.json"))


def unused_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_nobody_there_is_said_at_once(tmp_path: Path):
    url = f"http://127.0.0.1:{unused_port()}/v1"
    began = time.monotonic()
    with pytest.raises(InputError, match=r"nobody answers \(.*refused\); is the server running") as error:
        chat(url, tmp_path, backoff_s=5.0).ask(question(), Word)
    assert time.monotonic() - began < 3
    assert "0x" not in str(error.value)
    with pytest.raises(InputError, match="nobody answers"):
        chat("http://no-such-host.invalid/v1", tmp_path).ask(question(), Word)


def test_a_server_that_goes_away_is_waited_for(tmp_path: Path):
    with ChatServer(good({"word": "mug"})) as server:
        asked = chat(server, tmp_path, retries=1)
        asked.ask(question(), Word)
    with pytest.raises(InputError, match=r"nobody answers any more .* at the last of 2 attempts"):
        asked.ask(question("again"), Word)


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ("mug", "Invalid JSON"),
        ("", "Invalid JSON"),
        ('{"word": "mug"', "Invalid JSON"),
        ({"word": 3}, "`word`: "),
        ({"word": "mug", "more": 1}, "`more`: "),
        ({}, "`word`: "),
        ("[" * 50_000, "Invalid JSON"),
    ],
    ids=["no JSON", "empty", "half", "wrong type", "more", "less", "deep"],
)
def test_a_reply_that_does_not_fit_is_kept_with_what_is_wrong(tmp_path: Path, content: Any, fault: str):
    with ChatServer(good(content)) as server:
        first, second = (chat(server, tmp_path).ask(question(), Word) for _ in range(2))
    assert len(server.got) == 1
    assert first.value is None
    assert fault in first.fault
    assert len(first.fault) <= 200
    assert first == second


def test_a_reply_that_was_cut_off_is_told_as_that(tmp_path: Path):
    half, cut = '{"word": "m', "cut off at the limit of tokens (`max_tokens`): Invalid JSON"
    with ChatServer(raw(completion(half, "length"))) as server:
        asked = chat(server, tmp_path, options={"max_tokens": 4}).ask(question(), Word)
        replayed = chat(server, tmp_path, options={"max_tokens": 4}, offline=True).ask(question(), Word)
    assert asked.value is None
    assert asked.fault.startswith(cut)
    assert len(asked.fault) <= 200
    assert replayed == asked
    for finish in ("stop", None, 3):
        with ChatServer(raw(completion(half, finish))) as server:
            assert chat(server, tmp_path / str(finish)).ask(question(), Word).fault.startswith("Invalid JSON")
    with ChatServer(raw(completion('{"word": "mug"}', "length"))) as server:  # it was just enough
        assert chat(server, tmp_path / "fits").ask(question(), Word).value == Word(word="mug")


@pytest.mark.parametrize(
    "text",
    [
        '```json\n{"word": "mug"}\n```',
        '<think>\nA cup? {"word": "cup"}\n</think>\n\n{"word": "mug"}',
        ' \n<think></think>```\n{"word": "mug"}```\n',
    ],
)
def test_a_fence_around_the_reply_and_thoughts_before_it_are_taken_off(tmp_path: Path, text: str):
    with ChatServer(good(text)) as server:
        assert chat(server, tmp_path).ask(question(), Word).value == Word(word="mug")


def test_an_empty_choice_is_an_empty_reply(tmp_path: Path):
    with ChatServer(raw(completion(None))) as server:
        answer = chat(server, tmp_path).ask(question(), Word)
    assert (answer.text, answer.value) == ("", None)


def test_where_the_server_takes_no_schema_the_prompt_has_it(tmp_path: Path):
    with ChatServer(no_schema(good({"word": "mug"}))) as server:
        asked = chat(server, tmp_path)
        first = asked.ask(question(), Word)
        assert (first.constraint, first.value) == ("prompt", Word(word="mug"))
        assert asked.ask(question("again"), Word).constraint == "prompt"
        assert ["response_format" in got.body for got in server.got] == [True, False, False]
        assert '"additionalProperties": false' in server.got[1].texts[-1]
        with pytest.raises(InputError, match="Unknown parameter: response_format"):
            chat(server, tmp_path, constraint="json_schema").ask(question(), Word)
        assert chat(server, tmp_path).ask(question(), Word) == first  # from the cache, still said
        worded = chat(server, tmp_path, constraint="prompt").ask(question(), Word)
        assert "response_format" not in server.got[-1].body
        assert worded.key != first.key


def test_the_second_time_nothing_is_sent(tmp_path: Path):
    with ChatServer([good({"word": "mug"}), good({"word": "cup"})]) as server:
        first = chat(server, tmp_path).ask(question(PICTURE), Word)
        again = chat(server, tmp_path)
        assert again.ask(question(PICTURE.copy()), Word) == first
        assert len(server.got) == 1
    offline = chat(server, tmp_path, offline=True, key_env="NOT_SET", timeout_s=9.0)
    assert offline.ask(question(PICTURE), Word) == first
    entry = Cache(tmp_path).read(first.key)
    assert entry is not None
    assert (entry.model, entry.usage["total_tokens"]) == ("served", 12)
    assert entry.request["messages"][1]["content"][0]["image_url"]["url"].startswith("20x30x3 sha256 ")


def test_everything_that_decides_the_answer_is_in_the_key(tmp_path: Path):
    other = PICTURE.copy()
    other[0, 0, 0] ^= 1
    with ChatServer(good({"word": "mug"})) as server:

        def key(messages: list[Message], schema: type[BaseModel] = Word, **changed: Any) -> str:
            return chat(server, tmp_path, **changed).ask(messages, schema).key

        class Longer(Word):
            more: str = ""

        base = question("Look:", PICTURE)
        keys = [
            key(base),
            key(question("Look:", other)),
            key(question("See:", PICTURE)),
            key(question("Look:", PICTURE.reshape(30, 20, 3))),
            key(base[1:]),
            key(base, Longer),
            key(base, model="n"),
            key(base, temperature=0.5),
            key(base, temperature="default"),
            key(base, options={"seed": 1}),
            key(base, constraint="prompt"),
            key(base, base_url=server.url.replace("127.0.0.1", "localhost")),
        ]
        assert len(set(keys)) == len(keys) == len(server.got)
        assert key(base, retries=9, total_s=9.0, timeout_s=3.0, max_reply_bytes=9999) == keys[0]
        assert len(server.got) == len(keys)


def test_offline_what_is_not_there_is_named(tmp_path: Path):
    nowhere = f"http://127.0.0.1:{unused_port()}/v1"
    offline = chat(nowhere, tmp_path, offline=True)
    with pytest.raises(
        InputError, match=r"`vlm.offline`: the reply [0-9a-f]{64} is not in .*ask online once"
    ):
        offline.ask(question(), Word)
    with ChatServer([status(500), good({"word": "mug"})]) as server:
        online = chat(server, tmp_path, retries=0)
        with pytest.raises(NoReply) as failed:
            online.ask(question(), Word)
        replay = chat(server, tmp_path, offline=True)
        with pytest.raises(NoReply) as replayed:  # as it was
            replay.ask(question(), Word)
        assert str(replayed.value) == str(failed.value)
        assert online.ask(question(), Word).value == Word(word="mug")  # online it is asked again
        assert replay.ask(question(), Word).value == Word(word="mug")


@pytest.mark.parametrize("damage", ["{", "[]", '{"version": 1, "request": {}, "text": "x"}', ""])
def test_a_damaged_reply_is_named(tmp_path: Path, damage: str):
    with ChatServer(good({"word": "mug"})) as server:
        asked = chat(server, tmp_path)
        path = Cache(tmp_path).path(asked.ask(question(), Word).key)
        path.write_text(damage)
        with pytest.raises(InputError, match=rf"cached reply .*{path.name} is .*; delete it"):
            asked.ask(question(), Word)


def test_a_reply_that_cannot_be_kept_is_an_error(tmp_path: Path):
    (tmp_path / "cache").write_text("a file")
    with ChatServer(good({"word": "mug"})) as server, pytest.raises(FuseError, match=r"cache.*"):
        chat(server, tmp_path / "cache").ask(question(), Word)


def test_nothing_is_configured_by_default(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    for config, section in ((Config().vlm, "vlm"), (Config().knowledge.llm, "knowledge.llm")):
        assert (config.base_url, config.key_env, config.model) == ("", "", "")
        with pytest.raises(InputError, match=f"`{section}.base_url` is not set, such as http"):
            Chat(config, section)
    with pytest.raises(InputError, match=r"`vlm.model` is not set"):
        chat("http://h/v1", tmp_path, model="")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "fuse-grounding" / "chat"


def test_proxies_of_the_environment_are_for_other_machines(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    with ChatServer(status(418, "proxied")) as proxy, ChatServer(good({"word": "mug"})) as server:
        monkeypatch.setenv("http_proxy", proxy.url.removesuffix("/v1"))
        monkeypatch.setenv("no_proxy", "")
        assert chat(server, tmp_path).ask(question(), Word).value is not None
        with pytest.raises(InputError, match=r"418: .*proxied"):
            chat("http://models.invalid/v1", tmp_path).ask(question(), Word)
        assert proxy.got[0].path == "http://models.invalid/v1/chat/completions"


def test_another_client_agrees_about_the_protocol(tmp_path: Path):
    """OpenAI's own package reads what the server of these tests says; our request and schemas suit it."""
    openai = pytest.importorskip("openai", reason="another client of the protocol is not installed")
    params = pytest.importorskip("openai.types.chat.completion_create_params")
    strict = pytest.importorskip("openai.lib._pydantic").to_strict_json_schema
    with ChatServer(good({"word": "mug"})) as server:
        chat(server, tmp_path).ask(question("Look:", PICTURE, DEPTH), Word)
        theirs = openai.OpenAI(base_url=server.url, api_key="x").chat.completions.parse(
            model="m", messages=[{"role": "user", "content": "Now."}], response_format=Word
        )
    assert theirs.choices[0].message.parsed == Word(word="mug")
    TypeAdapter(params.CompletionCreateParamsNonStreaming).validate_python(server.got[0].body)
    for schema in (Word, Reply, Proposals):
        assert strict(schema) == schema.model_json_schema()


def test_without_the_package_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "urllib3", None)
    with pytest.raises(InputError, match=r"`vlm` \(a language model\) needs .*`urllib3`\n\nhint: .*\[llm\]"):
        chat("http://127.0.0.1:9/v1", tmp_path)
    chat("http://127.0.0.1:9/v1", tmp_path, offline=True)  # the cache alone needs none
