"""What the comparison of renderers computes, and that ours and a missing peer go through it."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))

from renderers import glb, room, runs, scene, table

OURS = runs.RUNS[0]


def images(depth: float = 2.0) -> dict[str, np.ndarray]:
    ids = np.zeros((1, 10, 10), np.uint32)
    ids[:, 4:6, 4:6] = 3
    return {"ids": ids, "depth": np.full((1, 10, 10), depth, np.float32)}


def test_a_picture_of_another_view_is_named() -> None:
    assert table.faults(table.agreement(images(), images())) == ""
    moved = images()
    moved["ids"] = np.roll(moved["ids"], 2, axis=2)
    found = table.agreement(moved, images())
    assert found["ids"] == pytest.approx(0.92)
    assert found["objects"] == 0
    assert table.faults(found) == "only 92.0% of the ids are ours"
    assert "depth differs by 5.0%" in table.faults(table.agreement(images(2.1), images()))


def test_the_table_has_the_mean_of_the_rounds_and_says_what_failed() -> None:
    rows = [
        {"name": "A", "light": "x", "setup": 1.0, "fps": {"color": [10.0, 20.0], "all": [4.0]}},
        {"name": "B", "light": "y", "failed": "not installed"},
    ]
    lines = table.render(rows).splitlines()
    assert lines[2] == "| A | x | 15.0 | 4.0 | – | 1.0 | – |"
    assert lines[3].startswith("| B | y | not installed |")
    assert len({line.count("|") for line in lines}) == 1


def test_the_sheet_has_room_for_all() -> None:
    picture = np.full((30, 40, 3), 9, np.uint8)
    whole = table.sheet([("a", picture)] * 4, columns=3)
    assert whole.size == (120, 2 * 48)
    assert whole.getpixel((20, 48 + 18 + 15)) == (9, 9, 9)


def test_splitting_keeps_the_shape() -> None:
    part = room.quad([(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)], np.zeros((2, 2, 3), np.uint8))
    fine = glb.split(part)

    def area(p: glb.Part) -> float:
        a, b, c = (p.positions[p.triangles[:, k]] for k in range(3))
        return float(np.cross(b - a, c - a)[:, 2].sum() / 2)

    assert len(fine.triangles) == 8
    assert len(fine.positions) == 9, "the common edge has one middle"
    assert area(fine) == pytest.approx(2.0)
    np.testing.assert_allclose(fine.uvs[:, 0], fine.positions[:, 0] / 2)


def test_a_written_model_is_read_again(tmp_path: Path) -> None:
    texture = np.arange(12, dtype=np.uint8).reshape(2, 2, 3)
    part = room.quad([(0, 0, 1), (2, 0, 1), (2, 3, 1), (0, 3, 1)], texture, roughness=0.25)
    glb.write(tmp_path / "m.glb", [part])
    (read,) = glb.read(tmp_path / "m.glb")
    np.testing.assert_array_equal(read.positions, part.positions)
    np.testing.assert_array_equal(read.triangles, part.triangles)
    np.testing.assert_array_equal(read.texture, texture)
    assert read.roughness == 0.25


def test_a_missing_peer_announces_itself_and_a_crash_is_quoted(tmp_path: Path) -> None:
    absent = runs.Run("X", "shaders", "no_such_package", "plain", "none")
    row = runs.measure(absent, Path(sys.executable), tmp_path, tmp_path / "o.npz", 1, 60)
    assert row["failed"] == "not installed"
    assert runs.measure(absent, tmp_path / "none", tmp_path, tmp_path / "o.npz", 1, 60)["failed"]
    row = runs.measure(OURS, Path(sys.executable), tmp_path, tmp_path / "o.npz", 1, 60)
    assert "scene.json" in row["failed"], "there is no scene in the folder"


def test_ours_runs_and_shows_the_objects(tmp_path: Path) -> None:
    scene.make(tmp_path, 64, 48, 2, splits=0, texels=64)
    drawn = scene.Scene.load(tmp_path)
    assert len(drawn.instances) == 13
    assert 30_000 < drawn.triangles < 40_000
    row = runs.measure(OURS, Path(sys.executable), tmp_path, tmp_path / "o.npz", 1, 120)
    assert "failed" not in row, row
    assert min(row["fps"]["all"]) > 0
    with np.load(tmp_path / "o.npz") as stored:
        assert stored["rgb"].shape == (2, 48, 64, 3)
        assert stored["rgb"].std() > 10
        assert len(np.unique(stored["ids"])) > 8


def test_the_room_in_files_is_the_room_that_we_draw(tmp_path: Path) -> None:
    from fuse_grounding._core import Camera, Stage, World, load_model, render_models

    scene.make(tmp_path, 64, 48, 2, splits=0, texels=64)
    drawn = scene.Scene.load(tmp_path)
    world = World(
        (tmp_path / "episode.json").read_text(), Stage(tmp_path / "stage", tmp_path / "scenes.json")
    )
    models = [load_model(tmp_path / file) for file, _, _ in drawn.instances]
    places = np.stack([m for _, m, _ in drawn.instances]).astype(np.float32)
    ids = [id for _, _, id in drawn.instances]
    for view in drawn.views:
        fx, fy, cx, cy = view.intrinsics
        camera = Camera(view.width, view.height, fx, fy, cx, cy, view.rotation, view.translation)
        _, depth, seen = render_models(models, places, camera, ids=ids, floor=None, shadows=False)
        _, expected, shown = world.render_camera(camera)
        assert (seen == shown).mean() > 0.999
        assert (np.abs(depth - expected) < 1e-3).mean() > 0.999
