"""Photos as a world: reading folders, the frame, moves, a whole search, and what is refused."""

from __future__ import annotations

import contextlib
import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fuse_grounding.cli.app import execute
from fuse_grounding.environment import ReplayEnvironment, TabletopEnvironment, load_episodes
from fuse_grounding.environment import capture as capture_module
from fuse_grounding.environment.capture import load_capture
from fuse_grounding.environment.frame import Ring, level, moved, ring, turned
from fuse_grounding.environment.photo_header import PhotoHeader, read_header, with_exif
from fuse_grounding.environment.photograph import photograph
from fuse_grounding.environment.replay import nearest_in_direction
from fuse_grounding.errors import InputError
from fuse_grounding.reconstruction.photos import Effort
from fuse_grounding.record import EpisodeRecord

COUNT, ARC = 7, 105.0


@pytest.fixture(scope="module")
def world() -> TabletopEnvironment:
    return TabletopEnvironment(next(e for e in load_episodes("dev") if e.episode_id == "dev_0001"))


@pytest.fixture(scope="module")
def posed(world: TabletopEnvironment, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Seven photos on a third of the round, with poses in metres, depth and masks."""
    folder = tmp_path_factory.mktemp("captures") / "posed"
    photograph(world, folder, COUNT, arc_deg=ARC, poses=True, truth=True)
    return folder


@pytest.fixture
def folder(posed: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    return Path(shutil.copytree(posed, tmp_path / "photos"))


def without_poses(folder: Path) -> Path:
    for name in ("depth", "masks"):
        shutil.rmtree(folder / name)
    (folder / "transforms.json").unlink()
    return folder


def test_a_made_capture_is_small_and_the_same_twice(world: TabletopEnvironment, posed: Path, tmp_path: Path):
    photograph(world, tmp_path / "again", 2, arc_deg=30.0)
    for name in ("000.jpg", "001.jpg"):
        assert (tmp_path / "again" / "images" / name).read_bytes() == (posed / "images" / name).read_bytes()
    sizes = [p.stat().st_size for p in (posed / "images").iterdir()]
    assert 18 * max(sizes) < 2e6
    with pytest.raises(InputError, match="exists; a capture is made in a new folder"):
        photograph(world, tmp_path / "again", 2)
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_given_poses_in_metres_are_kept(world: TabletopEnvironment, posed: Path):
    capture = load_capture(posed, scale="poses")
    assert (capture.metric, capture.size, capture.notes) == (True, (640, 480), [])
    node = world.episode.start[0]
    for index, camera in enumerate(capture.cameras):
        truth = world.camera_at((node + round(ARC / 10 * index / COUNT)) % 36, 2 if index % 3 == 2 else 1)
        assert np.linalg.norm(camera.center - truth.center) < 0.06  # the hand's shake
    assert capture.depths is not None
    assert capture.instances is not None
    target = world.true_targets()[0]
    seen = world.photograph(capture.cameras[3])
    assert seen.depth is not None
    assert seen.instance is not None
    assert np.abs(capture.depths[3] - seen.depth).max() <= 0.0006
    assert np.array_equal(capture.instances[3], seen.instance)
    assert (capture.instances[3] == target.instance).any()
    # Points that the photos agree on, where the poses came without any: they lie on what is seen.
    local = capture.points @ capture.cameras[3].rotation.T + capture.cameras[3].translation
    assert len(capture.points) > 300
    assert 0.4 < np.median(local[:, 2]) < 2.5


def test_depth_images_give_the_scale_and_without_anything_it_is_arbitrary(posed: Path, folder: Path):
    metres = load_capture(posed, scale="poses")
    distance = np.mean([np.linalg.norm(c.center - metres.middle) for c in metres.cameras])
    by_depth = load_capture(posed)
    found = np.mean([np.linalg.norm(c.center - by_depth.middle) for c in by_depth.cameras])
    assert found == pytest.approx(distance, rel=0.02)
    assert any(f"taken {found:.2f} m from the scene" in note for note in by_depth.notes)
    for name in ("depth", "masks"):
        shutil.rmtree(folder / name)
    bare = load_capture(folder)
    assert not bare.metric
    assert any("scale is arbitrary" in note for note in bare.notes)
    assert np.mean([np.linalg.norm(c.center) for c in bare.cameras]) == pytest.approx(1.0)
    assert np.allclose(bare.middle, 0, atol=1e-9)
    given = load_capture(folder, scale=0.7)
    assert given.metric
    assert np.mean([np.linalg.norm(c.center) for c in given.cameras]) == pytest.approx(0.7)


def test_levelling_finds_up_whatever_frame_the_poses_are_in(posed: Path):
    from fuse_grounding.registration.similarity import Similarity, project_to_rotation

    cameras = load_capture(posed, scale="poses").cameras
    tumbled = project_to_rotation(np.random.default_rng(1).normal(size=(3, 3)))
    other = [moved(c, Similarity(3.0, tumbled, np.array([5.0, -2, 9]))) for c in cameras]
    levelled = [moved(c, level(other)) for c in other]
    for ours, truth in zip(levelled, cameras, strict=True):
        assert np.degrees(np.arcsin(-ours.rotation[2, 2])) == pytest.approx(
            np.degrees(np.arcsin(-truth.rotation[2, 2])), abs=2.5
        )
    steps = np.diff(ring(levelled, np.zeros(3)).azimuth) % 36 * 10
    assert np.all((steps > 5) & (steps < 30))  # counter-clockwise, as they were taken


def test_turned_cameras_see_turned_pictures(posed: Path):
    camera = load_capture(posed, scale="poses").cameras[0]
    point = camera.rotation.T @ (np.array([0.1, -0.05, 1.0]) - camera.translation)
    x, y = 0.1 * camera.fx + camera.cx, -0.05 * camera.fy + camera.cy
    picture = np.zeros((camera.height, camera.width))
    picture[int(y), int(x)] = 1
    for turns in (1, 2, 3):
        upright = turned(camera, turns)
        local = upright.rotation @ point + upright.translation
        column = int(local[0] / local[2] * upright.fx + upright.cx)
        row = int(local[1] / local[2] * upright.fy + upright.cy)
        assert np.rot90(picture, -turns)[row, column] == 1


def test_moves_go_to_the_nearest_photo_in_their_direction():
    # Four at 30 degrees, 20 degrees apart; one steeper above the second; one on the far side.
    places = Ring(np.array([0.0, 2, 4, 6, 2, 20]), np.array([2.0, 2, 2, 2, 3, 2]))
    assert (
        nearest_in_direction(places, 1).reshape(3, 5).tolist()
        == [
            [-1, -1, -1, -1, -1],
            [0, 0, 1, 2, 2],
            [-1, 4, 4, 4, -1],
        ]
        or nearest_in_direction(places, 1)[12] == 4
    )
    assert nearest_in_direction(places, 0)[[5, 6]].tolist() == [-1, -1]  # the far side is no direction
    assert nearest_in_direction(places, 3)[[8, 9]].tolist() == [-1, -1]
    assert nearest_in_direction(places, 4)[2] == 1  # and back down
    around = Ring(np.array([35.0, 0.5]), np.array([2.0, 2.0]))
    assert nearest_in_direction(around, 0)[8] == 1  # over the seam


def test_the_replay_moves_and_starts_where_it_is_told(posed: Path):
    capture = load_capture(posed, scale="poses")
    env = ReplayEnvironment(capture, start="003.jpg")
    seen = env.observe()
    assert np.array_equal(seen.rgb, capture.images[3])
    assert env.action_mask()[7]
    before = env.photo
    env.act(9)
    assert env.photo > before  # to the camera's right is counter-clockwise
    assert env.visited == [before, env.photo]
    forbidden = int(np.flatnonzero(~env.action_mask())[0])
    with pytest.raises(InputError, match=f"action {forbidden} is not possible at {env.photo}"):
        env.act(forbidden)
    env.reset()
    assert env.photo == before
    seeds = env.seed_observations()
    assert len({id(s.rgb) for s in seeds} - {id(seen.rgb)}) == 4
    with pytest.raises(InputError, match=r"has no photo nope.jpg; there are 000.jpg"):
        ReplayEnvironment(capture, start="nope.jpg")


def test_a_scale_without_depth_takes_depth_from_a_map(folder: Path):
    truth = load_capture(folder, scale="poses")
    assert truth.depths is not None
    shutil.rmtree(folder / "depth")
    env = ReplayEnvironment(load_capture(folder, scale="poses"), "003.jpg", map_iterations=400)
    assert any("rendered from a Gaussian map of all 7" in note for note in env.notes)
    depth = env.observe().depth
    assert depth is not None
    near = truth.depths[3] < 1.2
    known = near & (depth > 0)
    assert known.sum() > 0.9 * near.sum()
    assert np.median(np.abs(depth[known] / truth.depths[3][known] - 1)) < 0.3  # a short training


def test_a_phones_photos_become_an_episode(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    """COLMAP finds the poses; the search runs, says what it does not know, and names the photo."""
    monkeypatch.setattr(capture_module, "EFFORT", Effort(longest=640, features=1500))
    without_poses(folder)
    out = tmp_path / "run"
    few = ["map.initial_iterations=20", "map.incremental_iterations=5", "budget.actions=2"]
    settings = [argument for setting in few for argument in ("--set", setting)]
    line = ["run", "measure a board", "--capture", str(folder), "--method", "explicit", *settings]
    assert execute([*line, "--out", str(out)]) == 0, capsys.readouterr().err
    stdout, stderr = capsys.readouterr()
    assert "COLMAP: 7 of 7 photos have poses" in stderr
    record = EpisodeRecord.load(out / "episode.json")
    said = "\n".join(record.announcements)
    assert "the field of view is the EXIF data's" in said
    assert "the scale is arbitrary" in said
    assert "no depth" in said
    assert record.result is not None
    assert record.result.centroid_m is None
    assert record.result.metrics is None
    assert record.photos is not None
    assert len(record.photos) == len(record.steps) == 3
    assert record.result.view is not None
    assert f"photo       {record.photos[record.result.view.index]}" in stdout
    assert record.result.label == "ruler"
    assert (out / "grounding.png").is_file()
    # The poses stay: the second time COLMAP is not asked.
    assert execute(["capture", "check", str(folder), "--json"]) == 0
    stdout, stderr = capsys.readouterr()
    told = json.loads(stdout)
    assert stderr == ""
    assert [p["name"] for p in told["photos"]] == [f"{i:03d}.jpg" for i in range(COUNT)]
    assert told["hfov_deg"] == pytest.approx(60, abs=3)
    tilts = [p["tilt_deg"] for p in told["photos"]]
    assert tilts == pytest.approx([45 if i % 3 == 2 else 30 for i in range(COUNT)], abs=5)


# -- what is refused -------------------------------------------------------------------------------


def shrunk(path: Path) -> None:
    assert cv2.imwrite(str(path), np.zeros((240, 320, 3), np.uint8))


def keep(folder: Path, count: int) -> None:
    for path in sorted((folder / "images").iterdir())[count:]:
        path.unlink()


def mirrored(folder: Path) -> None:
    path = folder / "images" / "002.jpg"
    jpeg = cv2.imencode(".jpg", np.zeros((480, 640, 3), np.uint8))[1].tobytes()
    path.write_bytes(with_exif(jpeg, 30, orientation=2))


def heic(folder: Path) -> None:
    keep(folder, 0)
    (folder / "images" / "IMG_1.HEIC").write_bytes(b"x")


BARE: dict[str, tuple[Any, str]] = {
    "one photo": (lambda f: keep(f, 1), r"images has 1 photo\(s\) \(JPEG or PNG\), expected at least 5"),
    "no photo": (lambda f: keep(f, 0), r"has 0 photo\(s\)"),
    "heic": (heic, r"1 such as IMG_1.HEIC are not read: save them as JPEG"),
    "mixed sizes": (
        lambda f: shrunk(f / "images" / "003.jpg"),
        "photos of different sizes: 000.jpg is 640x480, 003.jpg 320x240; expected one size",
    ),
    "mirrored": (mirrored, r"002.jpg is stored mirrored \(EXIF orientation 2\)"),
    "not a photo": (lambda f: (f / "images" / "001.jpg").write_text("hello"), "001.jpg is no JPEG or PNG"),
    "cut off": (lambda f: (f / "images" / "001.jpg").write_bytes(b"\xff\xd8\xff"), "001.jpg is cut off"),
}


@pytest.mark.parametrize("case", BARE)
def test_folders_that_are_no_capture_are_refused_before_colmap_runs(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str
):
    spoil, sentence = BARE[case]
    spoil(without_poses(folder))
    before = sorted(tmp_path.rglob("*"))
    assert execute(["run", "cut", "--capture", str(folder), "--out", str(tmp_path / "out")]) == 2
    stdout, stderr = capsys.readouterr()
    assert stdout == ""
    assert stderr.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before
    with pytest.raises(InputError, match=sentence):
        load_capture(folder)


def edited(folder: Path, edit: Any) -> None:
    path = folder / "transforms.json"
    value = json.loads(path.read_text())
    edit(value)
    path.write_text(json.dumps(value))


def tumble(value: Any) -> None:
    for frame in value["frames"]:
        matrix = np.array(frame["transform_matrix"])
        frame["transform_matrix"] = (np.diag([1.0, -1, -1, 1]) @ matrix).tolist()


POSED: dict[str, tuple[Any, str]] = {
    "few poses": (
        lambda f: edited(f, lambda v: v["frames"].__delitem__(slice(3, None))),
        "has 3 photos with poses",
    ),
    "two lenses": (
        lambda f: edited(f, lambda v: v["frames"][4].update(fl_x=300.0)),
        r"give 000.jpg a focal length of 554.3 px and 004.jpg one of 300.0 px",
    ),
    "upside down": (lambda f: edited(f, tumble), "said to be a world with z up, but up in the photos is"),
    "no depth for one": (lambda f: (f / "depth" / "004.png").unlink(), "depth/004.png is missing"),
    "depth of 8 bits": (
        lambda f: cv2.imwrite(str(f / "depth" / "004.png"), np.zeros((480, 640), np.uint8)),
        r"depth/004.png has uint8 pixels of shape \(480, 640\), expected 16-bit grey",
    ),
    "depth of another shape": (
        lambda f: cv2.imwrite(str(f / "depth" / "004.png"), np.zeros((480, 480), np.uint16)),
        "depth/004.png is 480x480, expected the shape of its photo",
    ),
    "a mask in colour": (
        lambda f: cv2.imwrite(str(f / "masks" / "001.png"), np.zeros((480, 640, 3), np.uint8)),
        "expected 8- or 16-bit grey: a number for each object",
    ),
    "a mask that is none": (lambda f: (f / "masks" / "001.png").write_text("x"), "no PNG that can be read"),
}


@pytest.mark.parametrize("case", POSED)
def test_what_lies_beside_the_photos_is_checked(folder: Path, case: str):
    spoil, sentence = POSED[case]
    spoil(folder)
    with pytest.raises(InputError, match=sentence):
        load_capture(folder, scale="poses")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("--capture nowhere", "capture nowhere is not a folder"),
        ("--capture photos --seed 3", "--scene and --seed are for made ones"),
        ("--capture photos --scene train_study", "--scene and --seed are for made ones"),
        ("--capture photos --scale far", "--scale far: expected metres, such as 0.8, or poses"),
        ("--capture photos --scale -1", "scale must be a positive number of metres, found -1.0"),
        ("--capture photos --scale nan", "scale must be a positive number of metres, found nan"),
        ("--capture photos --hfov 50", "photos has poses with intrinsics"),
        ("--capture photos --start 9.jpg", "capture photos has no photo 9.jpg"),
        ("--capture photos --method canonical", "method `canonical` looks straight down"),
        ("--capture photos --knowledge oracle", "needs an episode that knows its target"),
        ("--start 000.jpg", "--start 000.jpg is for photos"),
        ("--scale 1", "--scale 1 is for photos"),
    ],
)
def test_the_command_line_refuses_in_one_sentence(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: str,
    sentence: str,
):
    monkeypatch.chdir(folder.parent)
    before = sorted(folder.parent.rglob("*"))
    assert execute(["run", "measure", *arguments.split()]) == 2
    stdout, stderr = capsys.readouterr()
    assert (stdout, stderr.count("\n")) == ("", 1)
    assert sentence in stderr
    assert sorted(folder.parent.rglob("*")) == before


def test_headers_are_read_and_damage_is_refused_not_believed(posed: Path, tmp_path: Path):
    whole = (posed / "images" / "000.jpg").read_bytes()
    assert read_header(posed / "images" / "000.jpg") == PhotoHeader(640, 480, 0)
    jpeg = cv2.imencode(".jpg", np.zeros((30, 40, 3), np.uint8))[1].tobytes()
    path = tmp_path / "a.jpg"
    for orientation, turns in ((1, 0), (6, 1), (3, 2), (8, 3)):
        path.write_bytes(with_exif(jpeg, 26, orientation))
        assert read_header(path) == PhotoHeader(40, 30, turns)
        # OpenCV turns by the same data.
        shown = cv2.imread(str(path))
        assert shown is not None
        assert shown.shape[:2] == ((40, 30) if turns % 2 else (30, 40))
    random = np.random.default_rng(0)
    for _ in range(400):
        damaged = bytearray(whole[:400])
        for at in random.integers(2, 400, random.integers(1, 8)):
            damaged[at] = random.integers(256)
        path.write_bytes(damaged[: random.integers(2, 401)])
        with contextlib.suppress(InputError):  # and nothing else
            assert 0 <= read_header(path).width < 65536
