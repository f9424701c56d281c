"""`fuse splat`: a map from posed photos, killed and resumed, measured, drawn, converted."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
import tabletop_twin as twin
from photo_sets import PhotoSet, sample_points

from fuse_grounding.cli import splat as commands
from fuse_grounding.cli.app import execute
from fuse_grounding.reconstruction import cameras, training
from fuse_grounding.reconstruction.dataset import Dataset
from fuse_grounding.splat import Gaussians, device_name


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten small views, a COLMAP folder."""
    faces = twin.scene(4)
    views = [twin.camera(node, 1) for node in range(10)]
    xyz, rgb = sample_points(faces, 1500)
    images = [cv2.resize(twin.render(faces, c), (128, 96), interpolation=cv2.INTER_AREA) for c in views]
    photos = PhotoSet(images, [c.resized(128, 96) for c in views], xyz, rgb)
    return photos.write_colmap(tmp_path_factory.mktemp("data"))


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    status = execute(["splat", *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    assert image is not None
    return image


def test_train_measure_draw_convert(capsys: pytest.CaptureFixture[str], data: Path, tmp_path: Path):
    out, preview = tmp_path / "map.ply", tmp_path / "preview.png"
    status, text, _ = run(
        capsys, "train", data, "--out", out, "--iterations", "200", "--preview", preview, "--json"
    )
    assert status == 0
    trained = json.loads(text)
    assert (trained["train_views"], trained["held_out_views"], trained["downscale"]) == (8, 2, 1)
    assert trained["gaussians"] == len(Gaussians.from_ply(out))
    assert (trained["schedule"], trained["device"]) == ("fast", device_name("cpu"))
    assert not training.checkpoint_of(out).exists()
    picture = read(preview)
    assert picture.shape == (96, 256, 3)
    left, right = np.split(picture.astype(float), 2, axis=1)
    assert 10 * np.log10(255**2 / np.mean((left - right) ** 2)) > 20

    status, text, _ = run(capsys, "eval", out, data, "--json")
    measured = json.loads(text)
    assert status == 0
    assert measured["psnr"] == pytest.approx(trained["psnr"])
    assert measured["ssim"] == pytest.approx(trained["ssim"])
    assert [v["name"] for v in measured["views"]] == ["view 000.png", "view 008.png"]
    assert measured["psnr"] == pytest.approx(np.mean([v["psnr"] for v in measured["views"]]))
    # The points alone are worse.
    start = tmp_path / "start.ply"
    Gaussians.from_points(*Dataset(data).points()).save(start)
    untrained = json.loads(run(capsys, "eval", start, data, "--json")[1])
    assert measured["psnr"] > untrained["psnr"] + 4
    assert measured["ssim"] > untrained["ssim"]

    small = tmp_path / "map.spz"
    assert run(capsys, "convert", out, small)[0] == 0
    assert json.loads(run(capsys, "eval", small, data, "--json")[1])["psnr"] == pytest.approx(
        measured["psnr"], abs=0.3
    )

    drawn = tmp_path / "view.png"
    assert run(capsys, "render", out, "--data", data, "--view", "view 008.png", "--out", drawn)[0] == 0
    photo = read(data / "images" / "view 008.png").astype(float)
    error = np.mean((photo - read(drawn)) ** 2)
    assert 10 * np.log10(255**2 / error) == pytest.approx(measured["views"][1]["psnr"], abs=1e-3)
    one = tmp_path / "camera.json"
    one.write_text(json.dumps(cameras.to_json(Dataset(data).camera(8))))
    again = tmp_path / "again.png"
    assert run(capsys, "render", out, "--camera", one, "--out", again)[0] == 0
    assert np.array_equal(read(again), read(drawn))
    frames = tmp_path / "frames"
    assert run(capsys, "render", out, "--data", data, "--orbit", "3", "--out", frames)[0] == 0
    assert sorted(p.name for p in frames.iterdir()) == ["00000.png", "00001.png", "00002.png"]


def test_an_orbit_circles_what_the_cameras_see(data: Path):
    frames = cameras.orbit(Dataset(data), 4)
    centers = np.array([c.center for c in frames])
    middle = centers.mean(0)
    assert np.linalg.norm(middle[:2]) < 0.1
    assert np.linalg.norm(centers[0] - middle) == pytest.approx(0.75, abs=0.12)
    for camera in frames:
        # Level, and aimed at the axis.
        assert abs(camera.rotation[0] @ [0, 0, 1]) < 0.05
        assert (middle - camera.center) @ camera.rotation[2] > 0.5


def start(data: Path, out: Path) -> subprocess.Popen[bytes]:
    arguments = ["splat", "train", str(data), "--out", str(out), *OPTIONS]
    return subprocess.Popen(
        [sys.executable, "-m", "fuse_grounding.cli.app", *arguments],
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


# Densification begins after 500 iterations; the checkpoint is written amid it too.
OPTIONS = ["--iterations", "700", "--checkpoint-every", "150", "--seed", "4"]


def wait_for(path: Path, child: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + 120
    while not path.exists():
        assert child.poll() is None, child.stderr.read() if child.stderr else ""
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_resumed_after_a_kill_it_ends_in_the_same_bits(
    capsys: pytest.CaptureFixture[str], data: Path, tmp_path: Path, how: signal.Signals
):
    whole, cut = tmp_path / "whole.ply", tmp_path / "cut.ply"
    assert run(capsys, "train", data, "--out", whole, *OPTIONS)[0] == 0
    child = start(data, cut)
    wait_for(training.checkpoint_of(cut), child)
    child.send_signal(how)
    _, stderr = child.communicate(timeout=60)
    if how == signal.SIGINT:
        assert child.returncode == 130
        assert b"interrupted" in stderr
    assert not cut.exists()
    assert os.listdir(tmp_path).count("cut.ply.checkpoint") == 1

    status, _, stderr_text = run(capsys, "train", data, "--out", cut, *OPTIONS)
    assert status == 2
    assert "cut.ply.checkpoint is an interrupted training; --resume continues it" in stderr_text
    status, _, stderr_text = run(capsys, "train", data, "--out", cut, *OPTIONS[:-1], "5", "--resume")
    assert status == 2
    assert "`seed: 4" in stderr_text
    assert "--resume needs the data and options of the first run" in stderr_text
    official = ("--schedule", "official")
    status, _, stderr_text = run(capsys, "train", data, "--out", cut, *OPTIONS, *official, "--resume")
    assert status == 2
    assert "written under --schedule fast, this training has --schedule official" in stderr_text
    status, _, stderr_text = run(capsys, "train", data, "--out", cut, *OPTIONS, "--resume")
    assert status == 0
    assert "continues after iteration" in stderr_text
    assert cut.read_bytes() == whole.read_bytes()
    assert not training.checkpoint_of(cut).exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["train", "DATA", "--out", "TMP/x.obj"], "a map is a .ply or .spz file, found suffix '.obj'"),
        (["train", "DATA", "--out", "TMP/no/x.ply"], "the folder of --out does not exist"),
        (["train", "DATA", "--out", "TMP/x.ply", "--preview", "TMP/p.jpg"], "--preview must end in .png"),
        (["train", "DATA", "--out", "TMP/x.ply", "--holdout", "1"], "holdout must be 0 (none) or at least 2"),
        (
            ["train", "DATA", "--out", "TMP/x.ply", "--max-gaussians", "9"],
            "1500 points, more than --max-gaus",
        ),
        (
            ["train", "TMP", "--out", "TMP/x.ply"],
            "has no poses (sparse/0/cameras.bin or .txt, transforms.json)",
        ),
        (["train", "TMP/gone", "--out", "TMP/x.ply"], "and no photos (JPEG, PNG)"),
        (["train", "DATA", "--out", "TMP/x.ply", "--schedule", "slow"], "schedule must be `fast` or"),
        (
            ["train", "DATA", "--out", "TMP/x.ply", "--device", "cuda"],
            "device must be `auto`, `cpu` or `gpu`",
        ),
        (["eval", "TMP/gone.ply", "DATA"], "gone.ply: No such file"),
        (["eval", "DATA", "DATA"], "a map is a .ply or .spz file"),
        (["render", "MAP", "--out", "TMP/x.png"], "one of --camera, --view and --orbit says where"),
        (["render", "MAP", "--out", "TMP/x.png", "--view", "a"], "--view and --orbit need --data"),
        (
            ["render", "MAP", "--out", "TMP/x.png", "--view", "a", "--data", "DATA"],
            "has no view `a`; there are",
        ),
        (["render", "MAP", "--out", "TMP/x", "--view", "view 001.png", "--data", "DATA"], "must be a .png"),
        (["render", "MAP", "--out", "TMP/x.png", "--camera", "TMP/gone.json"], "gone.json: No such file"),
        (["convert", "MAP", "TMP/x.obj"], "a map is a .ply or .spz file"),
    ],
)
def test_wrong_input_is_one_sentence_and_status_2(
    capsys: pytest.CaptureFixture[str], data: Path, tmp_path: Path, arguments: list[str], sentence: str
):
    places = tmp_path / "maps"
    places.mkdir()
    Gaussians.from_points(np.zeros((4, 3)), np.zeros((4, 3))).save(places / "map.ply")
    (tmp_path / "tmp").mkdir()
    words = {"DATA": str(data), "TMP": str(tmp_path / "tmp"), "MAP": str(places / "map.ply")}
    filled = [a for a in arguments]
    for key, value in words.items():
        filled = [a.replace(key, value) for a in filled]
    status, stdout, stderr = run(capsys, *filled)
    assert status == 2
    assert stdout == ""
    assert sentence in stderr
    assert stderr.startswith("fuse: ") or "held out" in stderr
    assert not any((tmp_path / "tmp").iterdir())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("[]", "the list of cameras is empty"),
        ("[3]", "camera 0: expected an object with width"),
        ('{"width": 4}', "camera 0: `height` is missing"),
        ("SWAP rotation", "rotation has shape"),
        ("SWAP fx", "could not convert string to float"),
        ("SWAP width", "image size must be"),
    ],
)
def test_a_bad_camera_file_is_one_clear_error(
    capsys: pytest.CaptureFixture[str], data: Path, tmp_path: Path, text: str, message: str
):
    if text.startswith("SWAP"):
        value = cameras.to_json(Dataset(data).camera(0))
        value[text.split()[1]] = {"rotation": [1, 2], "fx": "far", "width": 0}[text.split()[1]]
        text = json.dumps(value)
    (tmp_path / "c.json").write_text(text)
    Gaussians.from_points(np.zeros((4, 3)), np.zeros((4, 3))).save(tmp_path / "map.ply")
    status, _, stderr = run(
        capsys, "render", tmp_path / "map.ply", "--camera", tmp_path / "c.json", "--out", tmp_path / "x.png"
    )
    assert status == 2
    assert "c.json" in stderr
    assert message in stderr


def test_mere_photos_get_their_poses_from_colmap(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    faces = twin.scene(2)
    for i, node in enumerate((0, 1, 2, 3, 4, 5)):
        image = twin.render(faces, twin.camera(node, 1))
        assert cv2.imwrite(str(tmp_path / f"IMG_{i}.png"), image[..., ::-1])
    out = tmp_path / "map.ply"
    arguments = ("train", tmp_path, "--out", out, "--iterations", "20", "--downscale", "4", "--holdout", "0")
    status, _, stderr = run(capsys, *arguments)
    assert status == 2
    assert "--colmap finds them for the 6 photos" in stderr

    # On a terminal it asks, and takes no for an answer.
    asked: list[str] = []
    monkeypatch.setattr(commands, "_asks", lambda: True)
    monkeypatch.setattr(commands.typer, "confirm", lambda text, err: asked.append(text))
    assert run(capsys, *arguments)[0] == 2
    assert "Run COLMAP on the 6 photos" in asked[0]

    status, _, stderr = run(capsys, *arguments, "--colmap")
    assert status == 0, stderr
    assert "COLMAP: 6 of 6 photos have poses" in stderr
    assert sorted(p.name for p in (tmp_path / "sparse" / "0").iterdir())[0] == "cameras.bin"
    assert not list(tmp_path.glob(".colmap-*"))
    # The focal length is found from the photos alone: that of the views within a few per cent.
    assert Dataset(tmp_path, 1, 0).camera(0).fx == pytest.approx(twin.FOCAL, rel=0.06)
    assert len(Gaussians.from_ply(out)) > 300
