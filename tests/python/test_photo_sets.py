"""Reading posed photos: COLMAP by pycolmap, nerfstudio's JSON, distortion against OpenCV, bad input."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest
import tabletop_twin as twin
from photo_sets import PhotoSet, sample_points

from fuse_grounding._core import SplatDataset
from fuse_grounding.errors import InputError
from fuse_grounding.reconstruction.dataset import Dataset

COUNT = 9


@pytest.fixture(scope="module")
def photos() -> PhotoSet:
    """Nine small views around the table."""
    faces = twin.scene(4)
    cameras = [twin.camera(2 * i, 1) for i in range(COUNT)]
    xyz, rgb = sample_points(faces, 300)
    images = [cv2.resize(twin.render(faces, c), (96, 72), interpolation=cv2.INTER_AREA) for c in cameras]
    return PhotoSet(images, [c.resized(96, 72) for c in cameras], xyz, rgb)


@pytest.mark.parametrize("form", ["binary", "text", "nerfstudio"])
def test_images_cameras_and_points_come_back(photos: PhotoSet, tmp_path: Path, form: str):
    if form == "nerfstudio":
        photos.write_nerfstudio(tmp_path)
    else:
        photos.write_colmap(tmp_path, text=form == "text")
    data = Dataset(tmp_path)
    assert [Path(n).name for n in data.names] == photos.names
    assert (data.downscale, data.held_out, data.train) == (1, (0, 8), tuple(range(1, 8)))
    for (image, camera), truth, expected in zip(
        data.read(range(COUNT)), photos.images, photos.cameras, strict=True
    ):
        assert np.array_equal(image, truth)
        assert (camera.width, camera.height) == (96, 72)
        assert camera.rotation == pytest.approx(expected.rotation, abs=1e-9)
        assert camera.translation == pytest.approx(expected.translation, abs=1e-9)
        assert [camera.fx, camera.fy, camera.cx, camera.cy] == pytest.approx(
            [expected.fx, expected.fy, expected.cx, expected.cy]
        )
    xyz, rgb = data.points()
    order, theirs = np.lexsort(xyz.T), np.lexsort(photos.xyz.astype(np.float32).T)
    assert xyz[order] == pytest.approx(photos.xyz[theirs], abs=1e-5)
    assert rgb[order] * 255 == pytest.approx(photos.rgb[theirs], abs=1e-3)


def test_a_smaller_photo_is_the_mean_of_its_pixels_and_sees_the_same(photos: PhotoSet, tmp_path: Path):
    data = Dataset(photos.write_colmap(tmp_path), downscale=5, holdout=0)
    image, camera = next(data.read([2]))
    # 96 x 72: one column and two rows are left over.
    cut = photos.images[2][:70, :95].astype(np.float64)
    assert image.shape == (14, 19, 3)
    assert np.abs(image - cut.reshape(14, 5, 19, 5, 3).mean((1, 3))).max() <= 0.5 + 1e-9
    assert [camera.fx, camera.cy] == pytest.approx([photos.cameras[2].fx / 5, photos.cameras[2].cy / 5])


@pytest.mark.parametrize(
    ("model", "extra"),
    [
        ("SIMPLE_RADIAL", [-0.08]),
        ("RADIAL", [0.09, -0.03]),
        ("OPENCV", [-0.12, 0.04, 2e-3, -1e-3]),
        ("FULL_OPENCV", [-0.12, 0.04, 2e-3, -1e-3, 0.01, 0.02, -0.01, 0.003]),
    ],
)
def test_distortion_is_taken_out_as_opencv_does(
    photos: PhotoSet, tmp_path: Path, model: str, extra: list[float]
):
    one = photos.cameras[0]
    f, cx, cy = one.fx, one.cx - 1.5, one.cy + 0.7
    focal = [f] if model in ("SIMPLE_RADIAL", "RADIAL") else [f, f * 1.01]
    params = [*focal, cx, cy, *extra]
    photos.write_images(tmp_path / "images")
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    photos.reconstruction(model, params).write_binary(tmp_path / "sparse" / "0")
    data = Dataset(tmp_path)
    image, camera = next(data.read([1]))

    # OpenCV counts from pixel centres, COLMAP from the corner.
    def matrix(fx: float, fy: float, x: float, y: float) -> np.ndarray:
        return np.array([[fx, 0, x - 0.5], [0, fy, y - 0.5], [0, 0, 1]])

    radial = [*extra, 0.0] if len(extra) == 1 else extra
    distortion = np.array([*radial, 0.0, 0.0] if len(radial) == 2 else radial)
    if len(extra) == 8:
        distortion = np.array([*extra[:4], *extra[4:]])
    maps = cv2.initUndistortRectifyMap(
        matrix(focal[0], focal[-1], cx, cy),
        distortion,
        np.eye(3),
        matrix(camera.fx, camera.fy, camera.cx, camera.cy),
        (96, 72),
        cv2.CV_32FC1,
    )
    expected = cv2.remap(photos.images[1], *maps, cv2.INTER_LINEAR)
    # OpenCV interpolates in steps of 1/32 of a pixel.
    assert np.abs(image.astype(int) - expected).max() <= 8
    assert np.abs(image.astype(int) - expected).mean() < 0.5
    # Nothing is seen that the photo does not show, and no more is lost than must be.
    x, y = maps
    assert x.min() >= -1e-3
    assert y.min() >= -1e-3
    assert x.max() <= 95 + 1e-3
    assert y.max() <= 71 + 1e-3
    assert min(x.min(), y.min(), 95 - x.max(), 71 - y.max()) < 0.05
    # And COLMAP's own camera model agrees on where a ray goes.
    theirs = pycolmap.Camera(model=model, width=96, height=72, params=params)
    u, v = 20.5, 60.5
    ray = np.array([[(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0]])
    seen = np.squeeze(theirs.img_from_cam(ray))
    assert seen == pytest.approx([x[60, 20] + 0.5, y[60, 20] + 0.5], abs=1e-3)


def test_transparent_pixels_fade_to_black_and_other_kinds_are_read(photos: PhotoSet, tmp_path: Path):
    photos.write_nerfstudio(tmp_path)
    grey = photos.images[1][..., 1]
    alpha = np.full((72, 96), 51, np.uint8)
    cv2.imwrite(str(tmp_path / "images" / photos.names[0]), np.dstack([photos.images[0][..., ::-1], alpha]))
    cv2.imwrite(str(tmp_path / "images" / photos.names[1]), grey)
    cv2.imwrite(
        str(tmp_path / "images" / photos.names[2]), photos.images[2][..., ::-1].astype(np.uint16) * 257
    )
    data = Dataset(tmp_path)
    first, second, third = (image for image, _ in data.read([0, 1, 2]))
    assert np.abs(first - photos.images[0] * 0.2).max() <= 0.5 + 1e-6
    assert np.array_equal(second, np.dstack([grey] * 3))
    assert np.array_equal(third, photos.images[2])


def test_without_a_cloud_points_are_made_up_and_it_is_said(photos: PhotoSet, tmp_path: Path):
    data = Dataset(photos.write_nerfstudio(tmp_path, points=False))
    assert len(data.notes) == 1
    assert "20000 random points" in data.notes[0]
    xyz, _ = data.points()
    assert np.array_equal(xyz, Dataset(tmp_path).points()[0])
    # Around the table's middle, where the cameras look.
    assert np.linalg.norm(np.median(xyz, 0) - [0, 0, 1.0]) < 0.3


def test_intrinsics_of_a_frame_and_of_instant_ngp(photos: PhotoSet, tmp_path: Path):
    photos.write_nerfstudio(tmp_path)
    path = tmp_path / "transforms.json"
    value = json.loads(path.read_text())
    value["frames"][3]["fl_x"] = 123.0
    path.write_text(json.dumps(value))
    assert Dataset(tmp_path).camera(3).fx == 123.0
    for key in ("camera_model", "w", "h", "fl_x", "fl_y", "cx", "cy"):
        del value[key]
    value["camera_angle_x"] = np.radians(60)
    for frame in value["frames"]:
        frame["file_path"] = "./" + frame["file_path"].removesuffix(".png")
        frame.pop("fl_x", None)
    path.write_text(json.dumps(value))
    camera = Dataset(tmp_path / "transforms.json").camera(3)
    assert [camera.fx, camera.fy, camera.cx, camera.cy] == pytest.approx([83.138, 83.138, 48, 36], abs=1e-3)


def _edit(change: Callable[[dict[str, Any]], None]) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        path = folder / "transforms.json"
        value = json.loads(path.read_text())
        change(value)
        path.write_text(json.dumps(value))

    return apply


def _frame(key: str, value: Any) -> Callable[[Path], None]:
    return _edit(lambda data: data["frames"][2].update({key: value}))


SINGULAR = [[1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_edit(lambda v: v.update(frames=[])), r"transforms\.json: `frames` is empty"),
        (_edit(lambda v: v.pop("frames")), r"transforms\.json: .*missing field `frames`"),
        (_frame("file_path", "/etc/passwd"), r"frame 2 \(`/etc/passwd`\): .*leaves the data folder"),
        (_frame("file_path", "../secret.png"), r"leaves the data folder"),
        (_frame("file_path", "images/gone.png"), r"1 of 9 images are missing, the first: .*gone\.png"),
        (_frame("file_path", "images/view 000.png"), r"image `images/view 000\.png` is listed twice"),
        (_frame("transform_matrix", SINGULAR), r"frame 2 .*no rigid pose: .* determinant 0\.000"),
        (_frame("transform_matrix", [[1, 0], [0, 1]]), r"four rows of four numbers"),
        (_frame("transform_matrix", "no"), r"not the JSON that was expected"),
        (_frame("camera_model", "OPENCV_FISHEYE"), r"camera_model OPENCV_FISHEYE is not supported"),
        (_frame("k4", 0.1), r"a fisheye lens or k4 is not supported"),
        (_frame("w", 0), r"`w` is 0, expected a whole number"),
        (_frame("fl_x", -5), r"fx must be finite and positive, found -5"),
        (_edit(lambda v: v.update(ply_file_path="../cloud.ply")), r"leaves the data folder"),
        (_edit(lambda v: v.update(ply_file_path="gone.ply")), r"gone\.ply: No such file"),
        (lambda f: (f / "transforms.json").write_text("{"), r"not the JSON that was expected"),
        (lambda f: (f / "sparse_pc.ply").write_bytes(b"ply\n"), r"sparse_pc\.ply: .*end_header"),
    ],
)
def test_a_bad_transforms_json_is_one_clear_error(photos: PhotoSet, tmp_path: Path, spoil, message: str):
    photos.write_nerfstudio(tmp_path)
    spoil(tmp_path)
    with pytest.raises(InputError, match=message):
        SplatDataset(tmp_path)


def _replace(name: str, old: str, new: str) -> Callable[[Path], None]:
    def apply(folder: Path) -> None:
        path = folder / "sparse" / "0" / f"{name}.txt"
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))

    return apply


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            _replace("cameras", "PINHOLE", "FISHER"),
            r"cameras\.txt: line 4: camera 3: camera model `FISHER` unknown",
        ),
        (
            _replace("cameras", "3 PINHOLE", "4 PINHOLE"),
            r"images\.txt: image `view 008\.png` has camera 3, which",
        ),
        (_replace("cameras", " 96 ", " 96000 "), r"cameras\.txt: .*image size must be"),
        (_replace("images", "view 003.png", "../003.png"), r"images\.txt: image path `\.\./003\.png` leaves"),
        (lambda f: (f / "images" / "view 003.png").unlink(), r"1 of 9 images are missing, .*view 003\.png"),
        (
            lambda f: (f / "sparse" / "0" / "points3D.txt").write_text("# none\n"),
            r"points3D\.txt: no points found",
        ),
        (lambda f: (f / "sparse" / "0" / "points3D.txt").unlink(), r"points3D\.txt: No such file"),
        (lambda f: (f / "sparse" / "0" / "images.txt").write_text("# none\n"), r"no views found"),
        (lambda f: (f / "sparse" / "0" / "images.txt").write_bytes(b"\xff\xfe"), r"images\.txt: not text"),
        (lambda f: shutil.rmtree(f / "sparse"), r"neither COLMAP output .* nor transforms\.json was found"),
    ],
)
def test_a_bad_colmap_folder_is_one_clear_error(photos: PhotoSet, tmp_path: Path, spoil, message: str):
    photos.write_colmap(tmp_path, text=True)
    spoil(tmp_path)
    with pytest.raises(InputError, match=message):
        SplatDataset(tmp_path)


def test_fisheye_models_are_refused_with_advice(photos: PhotoSet, tmp_path: Path):
    photos.write_images(tmp_path / "images")
    (tmp_path / "sparse").mkdir()
    one = photos.cameras[0]
    params = [one.fx, one.fy, one.cx, one.cy, 0.01, 0.0, 0.0, 0.0]
    photos.reconstruction("OPENCV_FISHEYE", params).write_binary(tmp_path / "sparse")
    with pytest.raises(InputError, match=r"OPENCV_FISHEYE is not supported; .*colmap image_undistorter"):
        SplatDataset(tmp_path)


def test_photos_that_do_not_fit_their_camera_are_named(photos: PhotoSet, tmp_path: Path):
    photos.write_colmap(tmp_path)
    path = tmp_path / "images" / photos.names[4]
    cv2.imwrite(str(path), np.zeros((36, 48, 3), np.uint8))
    with pytest.raises(InputError, match=r"view 004\.png: the image is 48x36 but its camera 96x72"):
        list(Dataset(tmp_path).read(range(COUNT)))
    path.write_text("not a picture")
    with pytest.raises(InputError, match=r"view 004\.png: not a PNG or JPEG"):
        list(Dataset(tmp_path).read([4]))
    whole = (tmp_path / "images" / photos.names[5]).read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"view 004\.png: the image is broken"):
        list(Dataset(tmp_path).read([4]))
    with pytest.raises(InputError, match=r"made 100 times smaller: image size"):
        Dataset(tmp_path, downscale=100).camera(0)


def test_options_out_of_range(photos: PhotoSet, tmp_path: Path):
    photos.write_colmap(tmp_path)
    for holdout in (-1, 1):
        with pytest.raises(InputError, match="holdout must be 0"):
            Dataset(tmp_path, holdout=holdout)
    with pytest.raises(InputError, match="downscale must be at least 1"):
        Dataset(tmp_path, downscale=0)
    with pytest.raises(InputError, match=r"has no view `nine`; there are view 000\.png"):
        Dataset(tmp_path).index("nine")
    with pytest.raises(InputError, match="view 9 does not exist, there are 9"):
        Dataset(tmp_path)._inner.camera(9, 1)


def test_large_photos_are_made_smaller_unless_told_otherwise(
    photos: PhotoSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    photos.write_colmap(tmp_path)
    monkeypatch.setattr("fuse_grounding.reconstruction.dataset.LONGEST_SIDE", 40)
    assert (Dataset(tmp_path).downscale, Dataset(tmp_path).camera(0).width) == (3, 32)
    assert Dataset(tmp_path, downscale=1).camera(0).width == 96


def test_a_training_beyond_the_free_memory_is_refused(
    photos: PhotoSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    data = Dataset(photos.write_colmap(tmp_path))
    data.check_memory()
    monkeypatch.setattr("fuse_grounding.reconstruction.dataset._free_memory", lambda: 1_500_000)
    with pytest.raises(InputError, match=r"7 training views take 0\.0 GB, .*; --downscale 2 or more"):
        data.check_memory()
