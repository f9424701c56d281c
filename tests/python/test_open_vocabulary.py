"""Labels outside a closed set: a typed error, left out, or the nearest known one, announced and recorded."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from agent_doubles import CONFIG, Kit, World

from fuse_grounding import knowledge
from fuse_grounding.agent import Agent
from fuse_grounding.config import KnowledgeConfig, SegmenterConfig
from fuse_grounding.errors import InputError, UnknownLabelError
from fuse_grounding.knowledge.affordances import shipped
from fuse_grounding.knowledge.nearest import Nearest
from fuse_grounding.knowledge.protocol import Candidate, Hypotheses, Query
from fuse_grounding.knowledge.vocabulary import replaced
from fuse_grounding.perception import EmbeddedSegmenter, Segmenter, TextEncoder
from fuse_grounding.perception.doors import open_segmenter
from fuse_grounding.perception.lexical import Lexical
from fuse_grounding.record import EpisodeRecord

RGB = np.full((48, 64, 3), 120, np.uint8)
LABELS = ("ladle", "knife", "water_bottle", "sponge")


@pytest.fixture(scope="module")
def embedded() -> EmbeddedSegmenter:
    return EmbeddedSegmenter()


def nearest(encoder: TextEncoder | None = None) -> Nearest:
    return Nearest(shipped(), encoder or Lexical())


def test_an_unknown_label_is_an_error_of_its_own_type(embedded: EmbeddedSegmenter):
    for label, shown in (
        ("rocket", "`rocket`"),
        ("🦊", "`🦊`"),
        ("Knife", "`Knife`"),
        ("a\nb", "`a b`"),
        ("x" * 10_000, rf"`{'x' * 50}…` \(10000 characters\)"),
    ):
        with pytest.raises(
            UnknownLabelError, match=rf"\Athe segmenter does not know the label {shown}; it knows: knife,"
        ) as caught:
            embedded.segment(RGB, ["knife", label])
        assert isinstance(caught.value, InputError)
        assert caught.value.label == label
        assert len(str(caught.value)) < 1500


def test_how_many_labels_does_not_matter(embedded: EmbeddedSegmenter):
    assert embedded.segment(RGB, []) == []
    two_hundred = [embedded.labels[i % len(embedded.labels)] for i in range(200)]
    assert [d.label for d in embedded.segment(RGB, two_hundred)] == [
        d.label for d in embedded.segment(RGB, embedded.labels)
    ]
    with pytest.raises(UnknownLabelError, match="`thing 0`"):
        embedded.segment(RGB, [f"thing {i}" for i in range(200)])
    for wrong, message in (
        ([""], "not be empty, found ''"),
        ([None], "strings, found NoneType"),
        (7, "found int"),
    ):
        with pytest.raises(InputError, match=message):
            embedded.segment(RGB, wrong)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def patches() -> Segmenter:
    """`embedded_patches` with the weights that ship; at threshold 0 each label is one region."""
    return open_segmenter(SegmenterConfig(name="embedded_patches", threshold=0.0)).part


def test_patches_take_any_number_of_labels(patches: Segmenter):
    assert patches.labels is None
    assert patches.segment(RGB, []) == []
    two_hundred = [f"thing {i}" for i in range(200)]
    found = patches.segment(RGB, two_hundred)
    assert sorted(d.label for d in found) == sorted(two_hundred)
    assert all(d.mask.all() and 0 <= d.score <= 1 for d in found)
    assert [d.label for d in patches.segment(RGB, ["mug"] * 200)] == ["mug"]


@pytest.mark.parametrize(
    "label", ["🦊", "👩🏽‍🍳", "刀", "Knife", "a\nb", "{}", "x" * 10_000, "water " * 10_000, "🦊" * 10_000]
)
def test_patches_take_any_label(patches: Segmenter, label: str):
    found = patches.segment(RGB, [label, "mug"])
    assert sorted(d.label for d in found) == sorted([label, "mug"])
    (score,) = (d.score for d in found if d.label == label)
    assert 0 <= score <= 1
    assert [d.score for d in patches.segment(RGB, [label])] == pytest.approx([score], rel=1e-4)


def test_patches_name_what_is_no_label(patches: Segmenter):
    for wrong, message in (
        (["mug", ""], "labels must not be empty, found ''"),
        ([" _ "], "labels must not be empty, found ' _ '"),
        (["mug", None], "labels must be strings, found NoneType"),
        (7, "labels must be a sequence of strings, found int"),
        ("x" * 10_000, rf"found the string `{'x' * 50}…` \(10000 characters\)"),
        (["mug", "\u200b"], "the text `\u200b` has no visible character"),
        (["\u200b" * 10_000], r"…` \(10000 characters\) has no visible character"),
    ):
        with pytest.raises(InputError, match=message):
            patches.segment(RGB, wrong)  # type: ignore[arg-type]


def test_letters_tell_spellings_and_compounds():
    vectors = Lexical().text(["soup ladle", "ladle", "knife", "🦊"])
    assert np.linalg.norm(vectors, axis=1) == pytest.approx(1)
    assert vectors[0] @ vectors[1] == pytest.approx(similarity_by_hand("soup ladle", "ladle"), abs=1e-6)
    assert vectors[0] @ vectors[1] > 0.5 > vectors[0] @ vectors[2]
    assert vectors[3] @ vectors[1] == 0
    assert Lexical().text([]).shape[0] == 0


def similarity_by_hand(a: str, b: str) -> float:
    def grams(text: str) -> list[str]:
        padded = [f" {w} " for w in text.split()]
        return [p[i : i + n] for p in padded for n in (2, 3, 4) for i in range(len(p) - n + 1)]

    x, y = grams(a), grams(b)
    dot = sum(x.count(g) * y.count(g) for g in set(x))
    return dot / np.sqrt(sum(x.count(g) ** 2 for g in set(x)) * sum(y.count(g) ** 2 for g in set(y)))


def test_what_is_not_known_becomes_the_nearest_once():
    proposed = [
        Candidate(label, score, "why")
        for label, score in (("soup_ladle", 0.9), ("knife", 0.8), ("ladles", 0.7), ("🦊", 0.6))
    ]
    found = replaced(Hypotheses("some", tuple(proposed), ("first",)), LABELS, nearest())
    assert [(c.label, c.score) for c in found.candidates] == [("ladle", 0.9), ("knife", 0.8)]
    assert [(r.proposed, r.label, r.encoder) for r in found.replaced] == [
        ("soup_ladle", "ladle", "lexical"),
        ("ladles", "ladle", "lexical"),
    ]
    assert [c.label for c in found.unknown] == ["🦊"]
    assert found.candidates[0].reason == "nearest known label to `soup_ladle`: why"
    assert found.announcements[0] == "first"
    assert found.announcements[1].startswith(
        "some: the segmenter has a closed set of labels: `soup_ladle` is replaced by the nearest one, "
        "`ladle` ('ladle', lexical similarity 0."
    )
    assert found.announcements[-1] == "some: left out, because the segmenter does not know it: `🦊`"
    assert nearest().to("knife", ()) is None


def test_an_encoder_that_knows_meaning_decides_instead_of_letters():
    class Meaning:
        name = "meaning"

        def text(self, texts: Sequence[str]) -> np.ndarray:
            return np.array(
                [[1, 0] if t in ("canteen", "water bottle") else [0.6, 0.8] for t in texts], np.float32
            )

    found = nearest(Meaning()).to("canteen", LABELS)
    assert found is not None
    assert (found.label, found.words, found.similarity) == ("water_bottle", "water bottle", 1.0)
    tie = nearest(Meaning()).to("anything", LABELS)
    assert tie is not None
    assert tie.label == "ladle"  # equals keep the order of the labels


def test_synonyms_count_as_names():
    thing = next(
        t for t in shipped().things.values() if t.synonyms and t.name in ("flashlight", "water_bottle")
    )
    found = nearest().to(thing.synonyms[0], ["knife", thing.name])
    assert found is not None
    assert (found.label, found.words, found.similarity) == (thing.name, thing.synonyms[0], 1.0)


def test_only_when_asked_for_are_candidates_replaced():
    query = Query("light", "illuminate", "light")
    by_default = knowledge.make(KnowledgeConfig()).hypotheses(query, LABELS, None)
    assert by_default.candidates == ()
    assert by_default.replaced == ()
    opened = knowledge.make(KnowledgeConfig(open_vocabulary="nearest")).hypotheses(query, LABELS, None)
    assert {c.label for c in opened.candidates} <= set(LABELS)
    assert {r.proposed for r in opened.replaced} | {c.label for c in opened.unknown} == {
        c.label for c in by_default.unknown
    }
    anything = knowledge.make(KnowledgeConfig(open_vocabulary="nearest")).hypotheses(query, None, None)
    assert anything.replaced == ()
    assert anything.candidates


def test_the_record_says_what_became_of_the_labels(tmp_path: Path):
    config = CONFIG.with_(knowledge={"open_vocabulary": "nearest", "top_k": 9})
    kit = Kit("static", lambda node, pitch: 0.6, config)
    grounded = Agent(kit.config, kit.parts).run(World(), "cut")
    entries = grounded.record.candidates_replaced
    assert entries
    assert all(entry.label in kit.seer.labels and entry.proposed not in kit.seer.labels for entry in entries)
    assert all(
        any(f"`{e.proposed}` is replaced" in a for a in grounded.record.announcements) for e in entries
    )
    grounded.record.write(tmp_path / "episode.json")
    assert EpisodeRecord.load(tmp_path / "episode.json").candidates_replaced == entries
    # Records from before there was such a thing stay readable.
    old: dict[str, Any] = json.loads((tmp_path / "episode.json").read_text())
    del old["candidates_replaced"]
    (tmp_path / "old.json").write_text(json.dumps(old))
    assert EpisodeRecord.load(tmp_path / "old.json").candidates_replaced == []
