"""The knowledge source `llm` against a server on this machine."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from agent_doubles import CONFIG, Kit, World
from chat_server import ChatServer, Got, good, no_schema, status
from typer.testing import CliRunner

from fuse_grounding import knowledge
from fuse_grounding.agent import Agent
from fuse_grounding.cli.app import execute
from fuse_grounding.cli.commands import app
from fuse_grounding.config import Config
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.knowledge.protocol import Hypotheses, KnowledgeSource
from fuse_grounding.knowledge.vocabulary import nothing_known

LABELS = ("knife", "butter_knife", "scissors", "mug", "ruler")


def proposal(label: str, score: float = 0.9, reason: str = "sharp  edge") -> dict[str, Any]:
    return {"label": label, "score": score, "reason": reason}


def reply(*proposals: dict[str, Any]) -> dict[str, Any]:
    return {"candidates": list(proposals)}


def config(server: ChatServer, folder: Path, top_k: int = 5, open_: str = "leave_out", **llm: Any) -> Config:
    given = {"base_url": server.url, "model": "m", "cache": str(folder), "backoff_s": 0.01, **llm}
    return CONFIG.with_(knowledge={"source": "llm", "top_k": top_k, "open_vocabulary": open_, "llm": given})


def source(server: ChatServer, folder: Path, **changed: Any) -> KnowledgeSource:
    return knowledge.make(config(server, folder, **changed).knowledge)


def cut(made: KnowledgeSource, vocabulary: tuple[str, ...] | None = LABELS, text: str = "cut") -> Hypotheses:
    return made.hypotheses(knowledge.parse(text), vocabulary, None)


def test_candidates_are_what_the_model_proposes_best_first(tmp_path: Path):
    proposals = reply(
        proposal("scissors", 0.7),
        proposal("Butter Knife", 0.8),
        proposal("knife", 1.0),
        proposal("knife", 0.1),
    )
    with ChatServer(good(proposals)) as server:
        found = cut(source(server, tmp_path))
    assert [(c.label, c.score) for c in found.candidates] == [
        ("knife", 1.0),
        ("butter_knife", 0.8),
        ("scissors", 0.7),
    ]
    assert found.candidates[0].reason == "sharp edge"
    assert found.announcements[0].startswith("llm: candidates by the model `m`, reply ")
    assert found.api_seconds > 0
    (got,) = server.got
    assert got.texts[1] == f"Function: cut\nLabels: {', '.join(LABELS)}\nAt most 5 candidates."
    schema = got.body["response_format"]["json_schema"]["schema"]
    assert schema["$defs"]["Proposal"]["required"] == ["label", "score", "reason"]
    assert schema["$defs"]["Proposal"]["additionalProperties"] is False


def test_labels_beyond_the_segmenters_are_left_out_and_said(tmp_path: Path):
    with ChatServer(good(reply(proposal("laser"), proposal("knife", 0.5), proposal("saw", 0.4)))) as server:
        found = cut(source(server, tmp_path))
        assert found.labels == ("knife",)
        assert [c.label for c in found.unknown] == ["laser", "saw"]
        assert "left out, because the segmenter does not know it: `laser`, `saw`" in found.announcements[-1]
        assert cut(source(server, tmp_path, top_k=1)).labels == ("knife",)
        free = cut(source(server, tmp_path, open_="nearest"))
        assert "Labels:" not in server.got[-1].texts[1]
        assert free.api_seconds > 0
        lying = cut(source(server, tmp_path), ("mug",))
    assert lying.labels == ()
    assert "knows none of the proposed labels (laser, knife, saw)" in str(nothing_known(lying))


def test_no_proposal_ends_the_search_and_says_so(tmp_path: Path):
    with ChatServer(good(reply())) as server:
        settings = config(server, tmp_path)
        kit = Kit("random", lambda node, pitch: 0.5, settings)
        grounded = Agent(settings, kit.parts).run(World(), "cut")
    assert grounded.record.result is not None
    assert grounded.record.result.stop_reason == "no candidate: llm proposed nothing"
    assert grounded.record.knowledge == "llm"


def test_it_is_told_the_verb_and_the_query_only_where_asked_to(tmp_path: Path):
    with ChatServer(good(reply(proposal("knife")))) as server:
        made = source(server, tmp_path)
        cut(made, text="cut a rope")
        cut(made, text="slice bread")
        assert len(server.got) == 1  # one question a verb
        told = source(server, tmp_path, asks="query")
        cut(told, text="cut a rope")
        cut(told, text="slice bread")
    assert [got.texts[1].split("\n")[0] for got in server.got] == [
        "Function: cut",
        "Function: cut (cut a rope)",
        "Function: cut (slice bread)",
    ]


@pytest.mark.parametrize(
    "wrong",
    [
        "knife",
        {"candidates": "knife"},
        {"candidates": [{"label": "knife"}]},
        reply(proposal("knife", 1.5)),
        reply(proposal("knife", True)),
        reply(proposal("   ")),
        reply(proposal("k" * 61)),
        reply(proposal("kn\nife")),
        reply(*[proposal("knife")] * 101),
        '{"candidates": [{"label": "knife", "score": NaN, "reason": ""}]}',
    ],
    ids=["words", "no list", "less", "score", "bool", "blank", "long", "lines", "many", "nan"],
)
def test_a_reply_that_does_not_fit_is_corrected_once(tmp_path: Path, wrong: Any):
    with ChatServer([good(wrong), good(reply(proposal("knife")))]) as server:
        assert cut(source(server, tmp_path)).labels == ("knife",)
        first, second = server.got
    assert [m["role"] for m in second.body["messages"]] == ["system", "user", "assistant", "user"]
    assert second.texts[:2] == first.texts
    assert second.texts[3].startswith("That does not fit: ")
    with ChatServer(good(wrong)) as server:
        with pytest.raises(FuseError, match="no reply of `m` fits the schema") as failed:
            cut(source(server, tmp_path))
        assert not isinstance(failed.value, InputError)  # a benchmark goes on
        assert len(server.got) == 2
        with pytest.raises(FuseError, match="fits the schema"):
            cut(source(server, tmp_path, corrections=0))
        assert len(server.got) == 2  # the first reply was kept


def test_a_server_without_schemas_is_announced_each_time(tmp_path: Path):
    with ChatServer(no_schema(good(reply(proposal("knife"))))) as server:
        first = cut(source(server, tmp_path))
        assert "the server takes no schema (response_format)" in first.announcements[1]
        assert cut(source(server, tmp_path, timeout_s=9.0)) == first  # another process would, too
        worded = cut(source(server, tmp_path, constraint="prompt"))
        assert len(worded.announcements) == 1  # as it was wanted


def test_an_episode_is_replayed_offline_bit_for_bit(tmp_path: Path):
    with ChatServer(good(reply(proposal("knife"), proposal("laser", 0.2)))) as server:
        online = config(server, tmp_path)
        first = Agent(online, Kit("random", lambda node, pitch: 0.5, online).parts).run(World(), "cut")
    offline = config(server, tmp_path, offline=True)
    again = Agent(offline, Kit("random", lambda node, pitch: 0.5, offline).parts).run(World(), "cut")
    assert bare(first.record.model_dump()) == bare(again.record.model_dump())
    assert first.record.steps[0].timings["api"] > 0
    with pytest.raises(InputError, match=r"knowledge.llm.offline`: the reply [0-9a-f]{64} is not in"):
        Agent(offline, Kit("random", lambda node, pitch: 0.5, offline).parts).run(World(), "pour")


def bare(value: Any) -> Any:
    """Without what may differ between two runs, and without the setting that makes the second one offline."""
    if isinstance(value, list):
        return [bare(inner) for inner in value]
    if isinstance(value, dict):
        return {
            key: bare(inner)
            for key, inner in value.items()
            if key not in ("timings", "offline") and not key.endswith("_seconds")
        }
    return value


def by_verb(got: Got) -> dict[str, Any]:
    return reply(proposal("knife" if "Function: cut\n" in got.texts[1] else "mug"))


def test_it_is_judged_as_the_other_sources_are(tmp_path: Path):
    with ChatServer(good(by_verb)) as server:
        where = ["--set", f"knowledge.llm.base_url={server.url}", "--set", "knowledge.llm.model=m"]
        where += ["--set", f"knowledge.llm.cache={tmp_path}"]
        arguments = ["knowledge", "--source", "llm", "--source", "plain", "--json", *where]
        done = CliRunner().invoke(app, arguments)
        assert done.exit_code == 0, done.output
        judged = json.loads(done.output)
        assert judged["llm"]["verbs"]["cut"]["proposed"] == ["knife"]
        assert judged["llm"]["verbs"]["cut"]["precision"] == 1.0
        assert set(judged) == {"llm", "plain"}
        assert len(server.got) == len(judged["llm"]["verbs"])


def test_the_command_line_names_what_is_missing(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    assert execute(["run", "cut", "--knowledge", "llm", "--out", str(tmp_path / "run")]) == 2
    assert "`knowledge.llm.base_url` is not set" in capsys.readouterr().err
    with ChatServer(status(401, "who?")) as server:
        where = ["--set", f"knowledge.llm.base_url={server.url}", "--set", "knowledge.llm.model=m"]
        assert execute(["knowledge", "--source", "llm", *where]) == 2
    assert "a key is wanted, and none was sent" in capsys.readouterr().err
