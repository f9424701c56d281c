"""`fuse objects import`: a user's own models become objects of a library, or are refused clearly."""

from __future__ import annotations

import csv
import json
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fuse_grounding import _core
from fuse_grounding.cli.app import execute
from fuse_grounding.environment.episodes import DATA
from fuse_grounding.errors import InputError

FOREIGN = Path(__file__).parents[3] / "shared" / "real_objects"
"""171 models that nobody here made; only where that folder is."""


def box(path: Path, size: tuple[float, float, float], *, lid: bool = True) -> Path:
    """An OBJ file of a box, with or without its lid."""
    corners = [(size[0] * (i & 1), size[1] * (i >> 1 & 1), size[2] * (i >> 2)) for i in range(8)]
    faces = ["1 3 4 2", "1 2 6 5", "2 4 8 6", "4 3 7 8", "3 1 5 7", *(["5 6 8 7"] if lid else [])]
    path.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "".join(f"f {f}\n" for f in faces))
    return path


def glb(path: Path, **changes: Any) -> Path:
    """A GLB of one triangle, 10 cm, with parts of its JSON replaced."""
    data = struct.pack("<9f", 0, 0, 0, 0.1, 0, 0, 0, 0.1, 0)
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 3,
                "type": "VEC3",
                "min": [0, 0, 0],
                "max": [1, 1, 1],
            }
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
    } | changes
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", 36) + b"BIN\0" + data
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)
    return path


def imports(library: Path, *arguments: str | Path) -> int:
    return execute(["objects", "import", "--library", str(library), *map(str, arguments)])


def fails(capsys: pytest.CaptureFixture[str], library: Path, *arguments: str | Path) -> str:
    assert imports(library, *arguments) == 2
    return capsys.readouterr().err


def test_a_model_becomes_an_object_with_its_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    library = tmp_path / "mine"
    model = box(tmp_path / "Oar 1.obj", (30, 5, 2))
    given = ("--category", "paddle", "--verbs", "stir,scoop", "--unit", "cm", "--split", "dev", "--json")
    assert imports(library, model, *given) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["refused"] == []
    assert "`paddle` is a new category" in told["notes"][0]
    assert sorted(f.name for f in library.iterdir()) == ["catalogue.json", "oar_1.glb", "oar_1.png"]
    catalogue = _core.ObjectCatalogue(str(library))
    (record,) = catalogue.records()
    assert told["imported"] == [record]
    assert (record["category"], record["split"], record["seed"]) == ("paddle", "dev", None)
    assert np.allclose(record["size_m"], (0.3, 0.05, 0.02), atol=1e-6)
    found = record["imported"]
    assert found["closed"]
    assert found["mass_from"] == "solid"
    assert found["triangles"] == 12
    assert found["volume_m3"] == pytest.approx(3e-4, rel=1e-4)
    assert sum(p["probability"] for p in record["resting"]) == pytest.approx(1, abs=1e-4)
    assert catalogue.valid_for() == {"paddle": {"stir": "stated by the user", "scoop": "stated by the user"}}
    picture = cv2.imread(str(library / "oar_1.png"))
    assert picture is not None
    assert picture.shape == (256, 256, 3)
    assert picture.std() > 8


def test_a_library_can_be_listed_and_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    library = tmp_path / "mine"
    for name, category in (("a", "mug"), ("b", "crate")):
        assert imports(library, box(tmp_path / f"{name}.obj", (0.1, 0.08, 0.09)), "--category", category) == 0
    capsys.readouterr()
    assert execute(["objects", "list", "--library", str(library), "--category", "crate", "--json"]) == 0
    assert [r["id"] for r in json.loads(capsys.readouterr().out)] == ["b"]
    sheet = tmp_path / "sheet.png"
    wanted = ["--library", str(library), "--pixels", "64", "--out", str(sheet)]
    assert execute(["objects", "preview", *wanted]) == 0
    picture = cv2.imread(str(sheet))
    assert picture is not None
    assert picture.shape == (2 * 80, 130 + 64, 3)


def test_the_same_name_twice_needs_replace(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    library, model = tmp_path / "mine", box(tmp_path / "a.obj", (0.1, 0.1, 0.1))
    assert imports(library, model, "--category", "crate") == 0
    before = {f.name: f.read_bytes() for f in library.iterdir()}
    box(model, (0.2, 0.1, 0.1))
    said = fails(capsys, library, model, "--category", "crate")
    assert "object `a` is in" in said
    assert "--replace" in said
    assert {f.name: f.read_bytes() for f in library.iterdir()} == before
    assert imports(library, model, "--category", "crate", "--replace") == 0
    (record,) = _core.ObjectCatalogue(str(library)).records()
    assert record["size_m"][0] == pytest.approx(0.2)


def test_wrong_sizes_name_the_likely_unit(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    library, model = tmp_path / "mine", box(tmp_path / "mug.obj", (0.1, 0.08, 0.09))
    said = fails(capsys, library, model, "--category", "mug", "--unit", "mm")
    assert "mug.obj: its longest side is 0.1 mm" in said
    assert "did you mean --unit m (10 cm)?" in said
    assert "50 m" in fails(capsys, library, model, "--category", "mug", "--scale", "500")
    assert not library.exists()
    assert imports(library, model, "--category", "mug", "--scale", "9") == 0
    said = capsys.readouterr().out
    assert "warning: its longest side is 90 cm, that of a mug usually 6 cm to 20 cm" in said


def test_open_surfaces_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    library, model = tmp_path / "mine", box(tmp_path / "a.obj", (0.2, 0.2, 0.05), lid=False)
    assert imports(library, model, "--category", "tray") == 0
    assert "it is open (4 edges): mass, centre of mass and resting poses" in capsys.readouterr().out
    (record,) = _core.ObjectCatalogue(str(library)).records()
    assert record["imported"]["mass_from"] == "hull"
    assert not record["imported"]["closed"]


def test_one_bad_file_does_not_keep_the_others_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    good = box(tmp_path / "a.obj", (0.1, 0.1, 0.1))
    bad = glb(tmp_path / "b.glb", extensionsRequired=["KHR_draco_mesh_compression"])
    said = fails(capsys, tmp_path / "mine", bad, good, "--category", "crate")
    assert "1 of 2 files were refused" in said
    assert "b.glb" in said
    assert "KHR_draco_mesh_compression" in said
    assert [r["id"] for r in _core.ObjectCatalogue(str(tmp_path / "mine")).records()] == ["a"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("--category", "Mug"), "a category is named with lower-case letters"),
        (("--category", "mug", "--unit", "ft"), "unknown unit `ft`, expected one of: m, cm, mm, in"),
        (("--category", "mug", "--unit", "cm", "--scale", "2"), "--scale and --unit"),
        (("--category", "mug", "--scale", "-1"), "a scale must be finite and greater than 0"),
        (("--category", "mug", "--up", "x"), "unknown axis `x`, expected y or z"),
        (("--category", "mug", "--split", "test"), "unknown split `test`"),
        (("--category", "mug", "--verbs", "Cut!"), "--verbs: a verb is of lower-case letters"),
        (("--category", "mug", "--id", "mug_eval_0"), "the shipped set has objects named so"),
    ],
)
def test_bad_arguments_are_refused(
    arguments: tuple[str, ...], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    said = fails(capsys, tmp_path / "mine", box(tmp_path / "a.obj", (0.1, 0.1, 0.1)), *arguments)
    assert expected in said
    assert not (tmp_path / "mine").exists()


def test_a_folder_that_is_no_library_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    full = tmp_path / "full"
    full.mkdir()
    (full / "mine.txt").write_text("keep")
    model = box(tmp_path / "a.obj", (0.1, 0.1, 0.1))
    assert "expected a library or a new folder" in fails(capsys, full, model, "--category", "mug")
    assert [f.name for f in full.iterdir()] == ["mine.txt"]


def test_a_stage_takes_libraries_beside_the_shipped_objects(tmp_path: Path):
    library = tmp_path / "mine"
    given = ("--category", "paddle", "--verbs", "stir", "--split", "dev")
    assert imports(library, box(tmp_path / "a.obj", (0.3, 0.05, 0.02)), *given) == 0
    stage = _core.Stage(DATA / "objects", DATA / "scenes.json", [library])
    assert stage.stated() == {"stir": ["paddle"]}
    with pytest.raises(InputError, match="unknown category `padel`"):
        stage.make_episode({"stir": ["padel"]}, ("dev_kitchen", "stir", "stir", 0, "x"), "{}")
    with pytest.raises(InputError, match=r"object `a` is in .* and in"):
        _core.Stage(DATA / "objects", DATA / "scenes.json", [library, library])


def test_an_episode_can_show_a_users_object(tmp_path: Path):
    library = tmp_path / "mine"
    given = ("--category", "mug", "--split", "dev")
    assert imports(library, box(tmp_path / "my_mug.obj", (0.08, 0.08, 0.1)), *given) == 0
    stage = _core.Stage(DATA / "objects", DATA / "scenes.json", [library])
    made = (
        json.loads(stage.make_episode({"cut": ["knife"]}, ("dev_kitchen", "cut", "cut", seed, "x"), "{}")[0])
        for seed in range(20)
    )
    episode = next(e for e in made if any(o["model_id"] == "my_mug" for o in e["objects"]))
    own = next(o for o in episode["objects"] if o["model_id"] == "my_mug")
    world = _core.World(json.dumps(episode), stage)
    _, _, ids = world.render_camera(world.canonical_camera())
    assert (ids == own["instance_id"]).sum() > 100
    with pytest.raises(InputError, match="unknown object `my_mug`"):
        _core.World(json.dumps(episode), _core.Stage(DATA / "objects", DATA / "scenes.json"))


@pytest.mark.skipif(not FOREIGN.is_dir(), reason=f"the trial models are not at {FOREIGN}")
def test_foreign_models_are_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    rows = list(csv.DictReader((FOREIGN / "manifest.csv").open(encoding="utf-8")))
    for row in rows[::12]:
        assert imports(tmp_path / "mine", FOREIGN / row["glb"], "--category", row["category"]) == 0, row["id"]
    records = {r["id"]: r for r in _core.ObjectCatalogue(str(tmp_path / "mine")).records()}
    for row in rows[::12]:
        # y up as shipped.
        size = [float(row[f"bbox_{axis}"]) for axis in "xzy"]
        assert np.allclose(records[row["id"]]["size_m"], size, atol=2e-4), row["id"]
