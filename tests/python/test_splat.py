"""Gaussians, rendering and training from Python: arrays, files, errors."""

from __future__ import annotations

import dataclasses
import gc
import os
import signal
import threading
import time
import tracemalloc
from typing import Any

import cv2
import numpy as np
import plyfile
import pytest

from fuse_grounding import splat
from fuse_grounding._core import Camera
from fuse_grounding.errors import InputError


def camera(width: int = 64, height: int = 48, shift: float = 0.0) -> Camera:
    """Looks along world y from 1 m before the origin; world x is right, world z up."""
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    focal = width / (2 * np.tan(np.radians(30)))
    center = np.array([shift, -1.0, 0.0])
    return Camera(width, height, focal, focal, width / 2, height / 2, rotation, -rotation @ center)


def scene(count: int = 300) -> splat.Gaussians:
    rng = np.random.default_rng(7)
    xyz = rng.uniform([-0.4, -0.05, -0.3], [0.4, 0.05, 0.3], (count, 3))
    return splat.Gaussians.from_points(xyz, rng.integers(0, 256, (count, 3), dtype=np.uint8))


def picture(gaussians: splat.Gaussians, view: Camera) -> np.ndarray:
    return np.rint(splat.render(gaussians, view)[0] * 255).astype(np.uint8)


def test_a_point_is_drawn_where_the_camera_sees_it() -> None:
    xyz = np.array([[0.1, 0.0, 0.2], [0.1, 0.001, 0.2], [0.101, 0.0, 0.2], [0.1, 0.0, 0.201]])
    image, alpha, depth = splat.render(
        splat.Gaussians.from_points(xyz, np.tile([1.0, 0.5, 0.0], (4, 1))), camera(), [0.0, 0.0, 1.0]
    )
    assert (image.dtype, alpha.dtype, depth.dtype) == (np.float32,) * 3
    assert (image.shape, alpha.shape, depth.shape) == ((48, 64, 3), (48, 64), (48, 64))
    y, x = np.unravel_index(alpha.argmax(), alpha.shape)
    focal = 64 / (2 * np.tan(np.radians(30)))
    assert abs(x + 0.5 - (32 + 0.1 * focal)) <= 1
    assert abs(y + 0.5 - (24 - 0.2 * focal)) <= 1
    assert depth[y, x] == pytest.approx(1.0, abs=0.01)
    assert image[0, 0] == pytest.approx([0, 0, 1])
    assert image[y, x, 0] > 2 * image[0, 0, 0] + 0.05


def test_another_reader_opens_the_ply(tmp_path) -> None:
    gaussians = scene()
    gaussians.save_ply(tmp_path / "scene.ply")
    again = splat.Gaussians.from_ply(str(tmp_path / "scene.ply"))
    assert np.array_equal(again.parameters, gaussians.parameters)

    vertex = plyfile.PlyData.read(tmp_path / "scene.ply")["vertex"]
    names = [p.name for p in vertex.properties]
    expected = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3))]
    expected += [*(f"f_rest_{i}" for i in range(45)), "opacity"]
    expected += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    assert names == expected
    parameters = gaussians.parameters
    assert np.array_equal(np.stack([vertex[n] for n in ("x", "y", "z")], 1), parameters[:, :3])
    assert np.array_equal(vertex["opacity"], parameters[:, 10])
    assert np.array_equal(vertex["rot_0"], np.ones(len(gaussians), np.float32))
    assert not vertex["nx"].any()


def test_a_ply_of_another_writer_is_read(tmp_path) -> None:
    """Shuffled properties, an extra one, through plyfile."""
    gaussians = scene(20)
    gaussians.save_ply(tmp_path / "a.ply")
    data = plyfile.PlyData.read(tmp_path / "a.ply")["vertex"].data
    names = [*reversed(data.dtype.names), "extra"]
    other = np.zeros(20, [(n, "f4" if n != "extra" else "f8") for n in names])
    for name in data.dtype.names:
        other[name] = data[name]
    plyfile.PlyData([plyfile.PlyElement.describe(other, "vertex")], byte_order="<").write(tmp_path / "b.ply")
    assert np.array_equal(splat.Gaussians.from_ply(tmp_path / "b.ply").parameters, gaussians.parameters)
    forms: dict[str, dict[str, Any]] = {"ascii": {"text": True}, "big": {"byte_order": ">"}}
    for name, form in forms.items():
        file = plyfile.PlyData([plyfile.PlyElement.describe(data, "vertex")], **form)
        file.write(str(tmp_path / f"{name}.ply"))
        assert np.array_equal(
            splat.Gaussians.from_ply(tmp_path / f"{name}.ply").parameters, gaussians.parameters
        )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"vertex 20", b"vertex 0", r"a\.ply: 0 vertices of 248 bytes announced, found 4960 bytes"),
        (b"vertex 20", b"vertex 1000000000", "1000000000 vertices of 248 bytes announced"),
        (b"vertex 20", b"vertex many", "vertex count `many` is not a whole number"),
        (b"float rot_3", b"float rot_4", "property `rot_3` is missing"),
        (b"format binary_little_endian", b"format binary_middle", "format `binary_middle` unknown"),
        (b"end_header", b"end_heater", "no `end_header`"),
    ],
)
def test_a_bad_ply_is_one_clear_error(tmp_path, old: bytes, new: bytes, message: str) -> None:
    scene(20).save_ply(tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes()
    assert old in data
    (tmp_path / "a.ply").write_bytes(data.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        splat.Gaussians.from_ply(tmp_path / "a.ply")


def test_nan_in_a_ply_is_named(tmp_path) -> None:
    scene(20).save_ply(tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data[:-4] + np.float32(np.nan).tobytes())
    with pytest.raises(InputError, match=r"a\.ply: `rot_3` of vertex 19 is NaN, expected a finite number"):
        splat.Gaussians.from_ply(tmp_path / "a.ply")


def test_spz_is_small_and_looks_the_same(tmp_path) -> None:
    gaussians = scene()
    for name in ("a.ply", "a.spz"):
        gaussians.save(tmp_path / name)
    assert (tmp_path / "a.spz").stat().st_size < 0.15 * (tmp_path / "a.ply").stat().st_size
    again = splat.Gaussians.load(tmp_path / "a.spz")
    assert splat.psnr(picture(again, camera()), picture(gaussians, camera())) > 40
    whole = (tmp_path / "a.spz").read_bytes()
    (tmp_path / "a.spz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"a\.spz: truncated"):
        splat.Gaussians.load(tmp_path / "a.spz")
    with pytest.raises(InputError, match=r"a map is a \.ply or \.spz file, found suffix '\.obj'"):
        splat.Gaussians.load(tmp_path / "a.obj")


def test_parameters_are_shared_and_read_only() -> None:
    gaussians = scene()
    assert gaussians.parameters is gaussians.parameters
    assert np.shares_memory(gaussians.positions, gaussians.parameters)
    with pytest.raises(ValueError, match="read-only"):
        gaussians.positions[0, 0] = 1.0


def test_arrays_are_the_memory_of_the_native_side() -> None:
    """200,000 Gaussians of 47 MB: no view of them, and no rendering, takes memory of its own."""
    rng = np.random.default_rng(1)
    gaussians = splat.Gaussians.from_points(rng.uniform(-1, 1, (200_003, 3)), np.full((200_003, 3), 0.5))
    tracemalloc.start()
    try:
        blocks = gaussians.blocks
        again = gaussians.blocks
        assert tracemalloc.get_traced_memory()[1] < 100_000
    finally:
        tracemalloc.stop()
    assert blocks.shape == (25_001, 59, 8)
    assert not blocks.flags.owndata
    assert np.shares_memory(blocks, again)
    assert blocks.__array_interface__["data"][0] == again.__array_interface__["data"][0]
    with pytest.raises(ValueError, match="read-only"):
        blocks[0, 0, 0] = 1.0
    with pytest.raises(ValueError, match="WRITEABLE"):
        blocks.flags.writeable = True
    rows = blocks.transpose(0, 2, 1).reshape(-1, 59)[: len(gaussians)]
    assert np.array_equal(rows, gaussians.parameters)
    del gaussians, again
    gc.collect()
    assert np.isfinite(blocks[:25_000]).all()

    for array in (*splat.render(scene(), camera()), scene().parameters):
        assert not array.flags.owndata
        assert array.base is not None
        assert not isinstance(array.base, np.ndarray)


def test_ssim_is_that_of_the_formula() -> None:
    rng = np.random.default_rng(3)
    a = np.asarray(cv2.GaussianBlur(rng.integers(0, 256, (60, 80, 3), dtype=np.uint8), (0, 0), 2), np.uint8)
    b = np.clip(a + rng.normal(0, 12, a.shape), 0, 255).astype(np.uint8)

    def blur(image: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(image, (11, 11), 1.5, borderType=cv2.BORDER_CONSTANT)

    x, y = a / 255.0, b / 255.0
    mx, my = blur(x), blur(y)
    vx, vy, cov = blur(x * x) - mx**2, blur(y * y) - my**2, blur(x * y) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    expected = ((2 * mx * my + c1) * (2 * cov + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))).mean()
    assert splat.ssim(a, b) == pytest.approx(expected, abs=2e-4)
    assert splat.ssim(a, a) == pytest.approx(1.0, abs=1e-5)


def test_a_long_refinement_ends_with_ctrl_c() -> None:
    trainer = splat.Trainer(scene(2000))
    view = camera(320, 240)
    trainer.add_view(picture(scene(2000), view), view)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            trainer.refine(1_000_000)
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, before)
    assert 0 < trainer.iteration < 1_000_000
    assert trainer.refine(1).total_iterations == trainer.iteration


def test_refinement_resumes_and_repeats() -> None:
    truth = scene()
    views = [camera(shift=s) for s in (-0.1, 0.0, 0.1)]

    def train(calls: list[int]) -> tuple[splat.Trainer, list[splat.RefineStats]]:
        start = splat.Gaussians.from_points(truth.positions, np.full((len(truth), 3), 0.5))
        trainer = splat.Trainer(start, splat.TrainerConfig(seed=3))
        for view in views:
            trainer.add_view(picture(truth, view), view)
        return trainer, [trainer.refine(n) for n in calls]

    trainer, stats = train([60, 60])
    assert [s.total_iterations for s in stats] == [60, 120]
    assert stats[1].loss < stats[0].loss < 0.8 * stats[0].loss_first
    assert stats[1].gaussians == len(trainer.gaussians)
    assert set(stats[0].stage_seconds) >= {"rasterize", "loss", "rasterize_backward"}
    assert np.array_equal(train([120])[0].gaussians.parameters, trainer.gaussians.parameters)

    held_out = camera(shift=0.05)
    before = splat.psnr(picture(train([])[0].gaussians, held_out), picture(truth, held_out))
    after = splat.psnr(picture(trainer.gaussians, held_out), picture(truth, held_out))
    assert after > before + 3

    assert trainer.add_points(np.zeros((2, 3)), np.zeros((2, 3), np.uint8)) == 2
    trainer.set_camera(0, camera(shift=-0.11))
    assert trainer.refine(2).gaussians == stats[1].gaussians + 2
    assert (trainer.iteration, trainer.view_count) == (122, 3)


def test_other_threads_run_while_it_trains() -> None:
    trainer = splat.Trainer(scene(2000))
    view = camera(320, 240)
    trainer.add_view(picture(scene(2000), view), view)
    worker = threading.Thread(target=trainer.refine, args=(40,))
    worker.start()
    ticks = 0
    while worker.is_alive():
        ticks += 1
        time.sleep(1e-4)
    assert ticks > 5


def test_every_setting_reaches_the_trainer() -> None:
    for field in dataclasses.fields(splat.TrainerConfig):
        wrong: dict[str, Any] = {field.name: "wrong"}
        with pytest.raises(InputError, match=field.name):
            splat.Trainer(scene(), splat.TrainerConfig(**wrong))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: splat.Gaussians.from_points(np.zeros((0, 3)), np.zeros((0, 3))), "at least one point"),
        (lambda: splat.Gaussians.from_points(np.zeros((4, 2)), np.zeros((4, 3))), r"xyz must be a \(N, 3\)"),
        (lambda: splat.Gaussians.from_points(np.zeros((4, 3)), np.zeros((3, 3))), "4 points but 3 colours"),
        (
            lambda: splat.Gaussians.from_points(np.full((4, 3), np.nan), np.zeros((4, 3))),
            "xyz must be finite",
        ),
        (
            lambda: splat.Gaussians.from_points(np.zeros((4, 3), int), np.zeros((4, 3))),
            "xyz .* floats.*int64",
        ),
        (lambda: splat.Gaussians.from_ply("missing.ply"), r"missing\.ply: No such file"),
        (lambda: scene().save_ply("missing/scene.ply"), r"missing/scene\.ply"),
        (lambda: splat.render(scene(), camera(), [0.0, 2.0, 0.0]), r"background .* in \[0, 1\]"),
        (lambda: splat.render(scene(), camera(), [0.0]), "background must be three numbers"),
        (lambda: splat.Trainer(scene(), splat.TrainerConfig(lambda_dssim=2.0)), "lambda_dssim must be in"),
        (lambda: splat.Trainer(scene()).refine(1), "at least one view"),
        (lambda: splat.Trainer(scene()).refine(-1), "iterations must be a whole number"),
        (lambda: splat.Trainer(scene()).refine(1.5), "iterations must be a whole number"),  # type: ignore[arg-type]
        (lambda: splat.Trainer(scene()).set_camera(0, camera()), "view 0 does not exist"),
        (
            lambda: splat.Trainer(scene()).add_view(np.zeros((48, 64, 3), np.float32), camera()),
            r"image must be a \(H, W, 3\) uint8 array, found float32",
        ),
        (
            lambda: splat.Trainer(scene()).add_view(np.zeros((32, 64, 3), np.uint8), camera()),
            "image is 64x32 but its camera is 64x48",
        ),
        (lambda: splat.psnr(np.zeros((4, 4, 3)), np.zeros((4, 5, 3))), "one shape"),
        (lambda: splat.psnr(np.full((4, 4, 3), np.inf), np.zeros((4, 4, 3))), "a must be finite"),
    ],
)
def test_what_the_caller_can_put_right_is_named(call, message) -> None:
    with pytest.raises(InputError, match=message):
        call()
