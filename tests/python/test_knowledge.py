from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from fuse_grounding import knowledge
from fuse_grounding.config import KnowledgeConfig
from fuse_grounding.errors import InputError
from fuse_grounding.knowledge.affordances import PATH, Affordances, Verb, shipped
from fuse_grounding.knowledge.judge import judge, pooled, validity
from fuse_grounding.knowledge.protocol import Candidate, Query
from fuse_grounding.knowledge.query import understand
from fuse_grounding.knowledge.vocabulary import nothing_known, within

LABELS = (
    *("knife", "scissors", "butter_knife", "spoon", "ladle", "mug", "bowl", "pitcher", "water_bottle"),
    *("teapot", "marker", "ruler", "hammer", "mallet", "screwdriver", "sponge", "towel", "book"),
)


@pytest.mark.parametrize(
    ("text", "verb"),
    [
        ("something to cut a rope with", "cut"),
        ("CUTTING the rope!", "cut"),
        ("wiping the table", "wipe"),
        ("she poured tea", "pour"),
        ("drive a nail into the wall", "pound"),
        ("drive a screw into the wall", "tighten"),  # the longer run decides
        ("I want to write down how to pour tea", "pour"),  # a known phrasing is longer than a word
        ("stir it, then pour", "stir"),  # runs of one length: the earliest
        ("pick_hot", "pick_hot"),
    ],
)
def test_a_query_reaches_its_verb(text: str, verb: str):
    assert knowledge.parse(text).verb == verb


def test_every_known_phrasing_reaches_its_own_verb():
    for verb in shipped().verbs.values():
        for text in (verb.name, *verb.synonyms, *verb.queries):
            assert knowledge.parse(text).verb == verb.name, text


def test_held_out_phrasings_are_understood_without_being_listed():
    """Several phrasings a verb; those of evaluation are in no list that the parser looks up."""
    verbs = json.loads(PATH.read_text())["verbs"]
    listed = {text for verb in shipped().verbs.values() for text in (*verb.synonyms, *verb.queries)}
    every: list[str] = []
    for name, entry in verbs.items():
        assert len(entry["queries"]) >= 5, name
        assert len(entry["queries_eval"]) >= 5, name
        assert not set(entry["queries_eval"]) & listed, name
        for text in entry["queries_eval"]:
            assert knowledge.parse(text).verb == name, text
        every += [text.lower() for text in (*entry["queries"], *entry["queries_eval"])]
    assert len(set(every)) == len(every)


def test_unknown_queries_list_what_is_known():
    with pytest.raises(InputError, match=r"unknown verb `spred`; did you mean `spread`\? known: cut, scoop"):
        knowledge.parse("spred")
    with pytest.raises(InputError, match=r"no known verb in the query 'sing a song'; known: cut"):
        knowledge.parse("sing a song")


def test_a_phrase_of_two_verbs_is_refused():
    def verb(name: str) -> Verb:
        return Verb(name, ("press",), (), ("p",), (), "")

    graph = Affordances(1, 0.5, {"p": "p"}, {"iron": verb("iron"), "juice": verb("juice")}, {})
    with pytest.raises(InputError, match="may mean iron or juice"):
        understand("press it", graph)


def test_the_graph_follows_the_table_compiled_by_hand():
    """`satisfied_by` was written beside the degrees: the rule must give the same objects and scores."""
    raw = json.loads(PATH.read_text())
    everything = KnowledgeConfig(top_k=99)
    for verb, entry in raw["verbs"].items():
        found = knowledge.make(everything).hypotheses(Query(verb, verb, verb), None, None)
        expected = {s["object"]: s["score"] for s in entry["satisfied_by"]}
        assert {c.label: pytest.approx(c.score, abs=5e-4) for c in found.candidates} == expected, verb
        for near_miss in entry["distractors"]:
            assert near_miss["object"] not in found.labels


def test_the_graph_explains_and_keeps_to_the_vocabulary():
    source = knowledge.make(KnowledgeConfig())
    pour = source.hypotheses(knowledge.parse("pour"), LABELS, None)
    assert pour.labels == ("teapot", "pitcher", "water_bottle")
    assert "pour_lip 0.6" in pour.candidates[2].reason
    assert len(knowledge.make(KnowledgeConfig(top_k=2)).hypotheses(pour_query(), LABELS, None).labels) == 2
    assert [c.label for c in pour.unknown] == ["measuring_cup"]


@pytest.mark.parametrize("source", ["graph", "oracle"])
def test_what_the_segmenter_does_not_know_is_left_out_and_said(source: str):
    class World:
        def oracle_target(self) -> str:
            return "flashlight"

        def oracle_valid(self) -> list[str]:
            return ["flashlight"]

    made = knowledge.make(KnowledgeConfig(source=source))
    query = knowledge.parse("light up a drawer")
    none = made.hypotheses(query, LABELS, World())
    assert none.candidates == ()
    assert none.unknown[0].label == "flashlight"
    assert (
        f"{source}: left out, because the segmenter does not know it: `flashlight`" in none.announcements[-1]
    )
    reason = nothing_known(none)
    assert reason is not None
    assert "knows none of the proposed labels (flashlight" in reason
    some = made.hypotheses(query, (*LABELS, "flashlight"), World())
    assert some.labels == ("flashlight",)
    assert nothing_known(some) is None
    assert made.hypotheses(query, None, World()).unknown == ()


def test_the_first_k_known_candidates_are_taken():
    proposed = [Candidate(label, 1.0, "") for label in "abcdef"]
    found = within("some", proposed, "bdf", top_k=2, announcements=["first"])
    assert (found.labels, [c.label for c in found.unknown]) == (("b", "d"), ["a", "c"])
    assert found.announcements[0] == "first"


def pour_query() -> Query:
    return Query("pour", "pour", "pour")


def test_direct_announces_the_replacement_of_the_verb():
    source = knowledge.make(KnowledgeConfig(source="direct"))
    closed = source.hypotheses(pour_query(), LABELS, None)
    assert closed.labels == ("pitcher",)  # "pour" is most like "pouring lip"
    assert "closed set of labels" in closed.announcements[0]
    opened = source.hypotheses(pour_query(), None, None)
    assert opened.labels == ("pour",)
    assert not opened.announcements


class Table:
    """A text encoder of three axes, known by heart."""

    name = "table"
    axes: ClassVar[dict[str, tuple[float, float, float]]] = {
        "pour": (1, 0, 0),
        "teapot": (0.8, 0.6, 0),
        "water bottle": (0.6, 0.8, 0),
        "mug": (0.6, 0.8, 0),
        "book": (-1, 0, 0),
        "ruler": (0, 0, 1),
    }

    def text(self, texts: Sequence[str]) -> np.ndarray:
        return np.array([self.axes[text] for text in texts], np.float32)


def test_plain_ranks_labels_by_text_similarity_in_one_hop():
    source = knowledge.make(KnowledgeConfig(source="plain"), Table())
    found = source.hypotheses(pour_query(), ("book", "water_bottle", "mug", "ruler", "teapot"), None)
    # Best first, ties in the order of the labels; what is not similar at all is no candidate.
    assert [(c.label, c.score) for c in found.candidates] == [
        ("teapot", 0.8),
        ("water_bottle", 0.6),
        ("mug", 0.6),
    ]
    assert found.announcements == ("plain: labels were compared with the verb `pour` by table",)
    assert found.unknown == ()
    few = knowledge.make(KnowledgeConfig(source="plain", top_k=1), Table())
    assert few.hypotheses(pour_query(), ("mug", "teapot"), None).labels == ("teapot",)
    none = source.hypotheses(pour_query(), ("book",), None)
    assert nothing_known(none) == "no candidate: plain proposed nothing"


def test_plain_without_a_closed_set_ranks_what_the_catalogue_calls_things():
    source = knowledge.make(KnowledgeConfig(source="plain"))  # by letters
    found = source.hypotheses(Query("staple", "staple", "staple"), None, None)
    assert found.labels[0] == "stapler"
    assert "by lexical" in found.announcements[0]
    # Nothing that the graph knows decides: a verb whose letters are in no label finds none of its things.
    write = source.hypotheses(Query("write", "write", "write"), ("pen", "book"), None)
    assert write.labels == ()


def test_the_oracle_asks_openly():
    class World:
        def oracle_target(self) -> str:
            return "pitcher"

        def oracle_valid(self) -> list[str]:
            return ["bowl", "pitcher"]

    for tell, labels in (("target", ("pitcher",)), ("valid", ("bowl", "pitcher"))):
        source = knowledge.make(KnowledgeConfig.model_validate({"source": "oracle", "oracle": tell}))
        told = source.hypotheses(pour_query(), LABELS, World())
        assert told.labels == labels
        assert "the world was asked" in told.announcements[0]
        with pytest.raises(InputError, match="needs an episode"):
            source.hypotheses(pour_query(), LABELS, None)


def test_an_unknown_source_is_refused_by_name():
    with pytest.raises(InputError, match=r"unknown knowledge source `grap`; did you mean `graph`\?"):
        knowledge.make(KnowledgeConfig(source="grap"))


def test_judging_counts_right_wrong_and_missed():
    table = {
        "pour": {"teapot": True, "mug": True, "water_bottle": False, "book": False},
        "illuminate": {"book": True},  # nothing is proposed
    }
    pour, illuminate = judge(knowledge.make(KnowledgeConfig()), table)
    assert (pour.right, pour.wrong, pour.missed) == (("teapot",), ("water_bottle",), ("mug",))
    assert (pour.precision, pour.recall) == (0.5, 0.5)
    assert (illuminate.precision, illuminate.recall) == (None, 0.0)
    assert pooled([pour, illuminate]) == (0.5, pytest.approx(1 / 3))


def test_a_broken_validity_table_is_named(tmp_path: Path):
    path = tmp_path / "validity.json"
    path.write_text('{"cut": {"knife": {"reason": "sharp"}}}')
    with pytest.raises(InputError, match=r"validity\.json is not verb -> category -> valid"):
        validity(path)
    with pytest.raises(InputError, match="does not exist"):
        validity(tmp_path / "other.json")
