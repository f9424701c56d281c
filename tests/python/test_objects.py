"""The shipped objects, the commands around them, the validity table."""

from __future__ import annotations

import itertools
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from fuse_grounding import _core
from fuse_grounding.cli.app import execute
from fuse_grounding.cli.objects import SHIPPED
from fuse_grounding.errors import InputError
from fuse_grounding.knowledge.judge import PATH as VALIDITY

CATEGORIES = [name for name, _ in _core.object_categories()]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue of the two categories that are quickest to make."""
    folder = tmp_path_factory.mktemp("objects") / "small"
    assert (
        execute(["objects", "generate", "--out", str(folder), "--category", "ruler", "--category", "book"])
        == 0
    )
    return folder


@pytest.fixture
def broken(small: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(small, tmp_path / "broken"))


def test_shipped_set_is_complete_and_small():
    records = _core.ObjectCatalogue(str(SHIPPED)).records()
    for category in CATEGORIES:
        splits = [r["split"] for r in records if r["category"] == category]
        assert splits == ["train"] * 5 + ["dev"] + ["eval"] * 2
    assert sum(f.stat().st_size for f in SHIPPED.iterdir()) <= 15e6
    assert {f.name for f in SHIPPED.iterdir()} == {r["file"] for r in records} | {"catalogue.json"}


def test_regeneration_gives_the_shipped_bytes(small: Path):
    shipped = {r["id"]: r for r in _core.ObjectCatalogue(str(SHIPPED)).records()}
    made = _core.ObjectCatalogue(str(small)).records()
    assert len(made) == 16
    for record in made:
        assert record == shipped[record["id"]]
        assert (small / record["file"]).read_bytes() == (SHIPPED / record["file"]).read_bytes()


def test_any_seed_can_be_written(tmp_path: Path):
    for seed in (77, 78):
        _core.write_object(str(tmp_path / f"{seed}.glb"), "ruler", "train", seed)
    assert (tmp_path / "77.glb").read_bytes() != (tmp_path / "78.glb").read_bytes()
    with pytest.raises(InputError, match="unknown split `test`, expected train, dev or eval"):
        _core.write_object(str(tmp_path / "x.glb"), "ruler", "test", 1)


def test_list_prints_json_only(small: Path, capsys: pytest.CaptureFixture[str]):
    assert execute(["objects", "list", "--library", str(small), "--category", "book", "--json"]) == 0
    records = json.loads(capsys.readouterr().out)
    assert [r["id"] for r in records][:2] == ["book_train_0", "book_train_1"]
    assert all(sum(p["probability"] for p in r["resting"]) == pytest.approx(1.0, abs=1e-4) for r in records)


def test_preview_is_a_sheet_of_distinct_pictures(small: Path, tmp_path: Path):
    out = tmp_path / "sheet.png"
    arguments = ["objects", "preview", "--library", str(small), "--pixels", "48", "--out", str(out)]
    assert execute(arguments) == 0
    sheet = cv2.imread(str(out))
    assert sheet is not None
    assert sheet.shape == (2 * 64, 130 + 8 * 48, 3)
    cells = [sheet[:48, 130 + 48 * k : 178 + 48 * k].astype(int) for k in range(8)]
    assert all(cell.std() > 8 for cell in cells)
    assert all(np.abs(a - b).mean() > 2 for a, b in itertools.pairwise(cells))


def test_things_rest_in_several_ways():
    catalogue = _core.ObjectCatalogue(str(SHIPPED))
    for category, tall in {"mug": False, "water_bottle": False, "book": True}.items():
        # Apart from their usual pose, mugs and bottles lie, books stand.
        record = next(r for r in catalogue.records() if r["category"] == category)
        usual, *others = record["resting"]
        assert usual["probability"] > 0.5
        change = [abs(pose["quaternion"][3]) for pose in others]
        assert any(0.55 < w < 0.85 for w in change), f"{category}: no pose is a quarter turn away"
        k = 1 + next(i for i, w in enumerate(change) if 0.55 < w < 0.85)
        first, second = (catalogue.preview(record["id"], 64, 0.5, pose).astype(int) for pose in (0, k))
        assert np.abs(first - second).mean() > 3
        flat = record["size_m"][2] / 2
        assert (others[k - 1]["height"] > flat) == tall
    with pytest.raises(InputError, match="no pose 99"):
        catalogue.preview(record["id"], 64, 0.5, 99)


def fails(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert execute(["objects", *arguments]) == 2
    return capsys.readouterr().err


def test_generate_refuses_what_it_cannot_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("keep")
    assert "exists and is not an empty folder" in fails(["generate", "--out", str(tmp_path / "full")], capsys)
    assert (tmp_path / "full" / "mine.txt").read_text() == "keep"
    said = fails(["generate", "--out", str(tmp_path / "new"), "--category", "sword"], capsys)
    assert "unknown category `sword`, expected one of: knife, scissors" in said
    assert not (tmp_path / "new").exists()
    said = fails(
        ["generate", "--out", str(tmp_path / "full" / "mine.txt" / "x"), "--category", "book"], capsys
    )
    assert "mine.txt" in said
    assert [f.name for f in tmp_path.iterdir()] == ["full"]


def test_missing_and_broken_catalogues_are_named(broken: Path, capsys: pytest.CaptureFixture[str]):
    list_ = ["list", "--library", str(broken)]
    (broken / "book_train_1.glb").unlink()
    assert "book_train_1.glb" in fails(list_, capsys)
    path = broken / "catalogue.json"
    whole = path.read_text()
    path.write_text(whole.replace('"category": "book"', '"category": "boat"', 1))
    assert "catalogue.json is not an object catalogue: unknown variant `boat`" in fails(list_, capsys)
    path.write_text(whole.replace("book_train_0.glb", "../book_train_0.glb"))
    assert "must be a path inside the catalogue's folder" in fails(list_, capsys)
    path.write_text(whole[: len(whole) // 2])
    assert "catalogue.json is not an object catalogue: EOF" in fails(list_, capsys)
    path.unlink()
    assert "catalogue.json" in fails(list_, capsys)


def test_truncated_model_is_named(broken: Path):
    model = broken / "book_train_0.glb"
    model.write_bytes(model.read_bytes()[:3000])
    with pytest.raises(InputError, match=r"object `book_train_0`: .*book_train_0\.glb"):
        _core.ObjectCatalogue(str(broken)).preview("book_train_0")


def test_validity_judges_every_verb_over_every_category():
    table = json.loads(VALIDITY.read_text(encoding="utf-8"))["verbs"]
    verbs = ["cut", "scoop", "pour", "sip", "stir", "spread", "pound", "write", "wipe", "measure", "tighten"]
    assert list(table) == verbs
    for verb, row in table.items():
        assert set(row) == set(CATEGORIES), verb
        valid = [c for c, entry in row.items() if entry["valid"]]
        assert 1 <= len(valid) <= 6, verb
        assert all(len(entry["reason"]) > 3 for entry in row.values()), verb
