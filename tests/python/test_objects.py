"""The shipped objects, the commands around them, the validity table."""

from __future__ import annotations

import itertools
import json
import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from fuse_grounding import _core
from fuse_grounding.cli.app import execute
from fuse_grounding.cli.objects import SHIPPED
from fuse_grounding.errors import InputError
from fuse_grounding.knowledge.affordances import shipped
from fuse_grounding.knowledge.judge import PATH as VALIDITY
from fuse_grounding.perception.embedded import DEFAULT_PATH

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
    assert len(CATEGORIES) >= 45
    assert len(set(CATEGORIES)) == len({label for _, label in _core.object_categories()}) == len(CATEGORIES)
    assert sum(f.stat().st_size for f in SHIPPED.iterdir()) <= 40e6
    assert {f.name for f in SHIPPED.iterdir()} == {r["file"] for r in records} | {"catalogue.json"}


def solids(path: Path) -> tuple[NDArray[np.float32], list[NDArray[np.int64]]]:
    """Points of a GLB's meshes, equal ones merged, and the triangles of each of its primitives."""
    data = path.read_bytes()
    assert data[:4] == b"glTF"
    assert struct.unpack_from("<I", data, 8)[0] == len(data)
    length = struct.unpack_from("<I", data, 12)[0]
    head, body = json.loads(data[20 : 20 + length]), data[28 + length :]

    def array(index: int) -> NDArray[np.generic]:
        accessor = head["accessors"][index]
        view = head["bufferViews"][accessor["bufferView"]]
        kind = {5126: np.float32, 5125: np.uint32, 5123: np.uint16}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC3": 3}[accessor["type"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        return np.frombuffer(body, kind, accessor["count"] * width, start).reshape(-1, width)

    points: list[NDArray[np.generic]] = []
    faces: list[NDArray[np.int64]] = []
    shift = 0
    for primitive in (p for mesh in head["meshes"] for p in mesh["primitives"]):
        points.append(array(primitive["attributes"]["POSITION"]))
        faces.append(array(primitive["indices"]).astype(np.int64).reshape(-1, 3) + shift)
        shift += len(points[-1])
    merged, where = np.unique(np.vstack(points) + np.float32(0), axis=0, return_inverse=True)
    return merged, [where.reshape(-1)[f] for f in faces]


@pytest.mark.parametrize("category", CATEGORIES)
def test_shipped_models_are_closed_textured_and_of_their_recorded_size(category: str):
    for record in (r for r in _core.ObjectCatalogue(str(SHIPPED)).records() if r["category"] == category):
        path = SHIPPED / record["file"]
        assert path.stat().st_size <= 250e3
        points, faces = solids(path)
        x, y, z = np.ptp(points, axis=0)
        assert np.allclose(np.array(record["size_m"]), (x, z, y), atol=1e-5)  # glTF's y is up
        assert 0.03 <= max(record["size_m"]) <= 0.48, "metres"
        triangles = np.vstack(faces)
        edges = np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        low, high = edges.min(axis=1), edges.max(axis=1)
        _, where = np.unique(low * len(points) + high, return_inverse=True)
        turns = np.bincount(where.reshape(-1), weights=np.sign(edges[:, 1] - edges[:, 0]))
        assert not turns.any(), f"{record['id']} has {np.count_nonzero(turns)} open edges"


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


def test_sheets_show_each_category_from_two_heights(small: Path, tmp_path: Path):
    out = tmp_path / "sheets"
    arguments = ["objects", "preview", "--library", str(small), "--pixels", "48", "--sheets", str(out)]
    assert execute(arguments) == 0
    assert sorted(f.name for f in out.iterdir()) == ["book.png", "ruler.png"]
    for path in out.iterdir():
        sheet = cv2.imread(str(path))
        assert sheet is not None
        assert sheet.shape == (48 + 64, 8 * 48, 3)
        above, across = (sheet[y : y + 48, :48].astype(int) for y in (0, 48))
        assert above.std() > 8
        assert np.abs(above - across).mean() > 2


def test_every_category_has_its_sheet_in_the_documentation():
    docs = Path(__file__).parents[2] / "docs"
    assert {f.stem for f in (docs / "images" / "objects").glob("*.png")} == set(CATEGORIES)
    text = (docs / "objects.md").read_text(encoding="utf-8")
    for category in CATEGORIES:
        assert f"(images/objects/{category}.png)" in text
    assert sum(f.stat().st_size for f in (docs / "images" / "objects").iterdir()) <= 12e6


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
    assert "object `book_train_0`: unknown category `boat`, neither" in fails(list_, capsys)
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
    verbs += ["erase", "scrub", "pick_hot", "fasten", "strain", "beat", "roll", "illuminate", "serve"]
    assert list(table) == verbs
    assert len(verbs) >= 20
    assert set(verbs) == set(shipped().verbs)
    for verb, row in table.items():
        assert set(row) == set(CATEGORIES), verb
        valid = [c for c, entry in row.items() if entry["valid"]]
        assert 1 <= len(valid) <= 6, verb
        assert all(len(entry["reason"]) > 3 for entry in row.values()), verb
    served = {c for row in table.values() for c, entry in row.items() if entry["valid"]}
    # A book, a grater, a can serve none of these verbs: they are there to be passed over.
    assert set(CATEGORIES) - served == {"book", "grater", "can"}


def test_every_category_is_in_the_graph_under_its_label():
    things = shipped().things
    assert set(CATEGORIES) == set(things)
    for category, label in _core.object_categories():
        assert label in (things[category].label, "kitchen knife"), category
        assert things[category].properties


def test_the_network_knows_categories_of_the_catalogue():
    assert set(json.loads(DEFAULT_PATH.with_suffix(".json").read_text())["labels"]) <= set(CATEGORIES)
