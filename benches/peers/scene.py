"""The photos that all are trained on: rendered here, registered by COLMAP, split into two folders."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path

import cv2

from fuse_grounding._core import Camera
from fuse_grounding.environment import TabletopEnvironment, make_episode
from fuse_grounding.errors import FuseError
from fuse_grounding.reconstruction.dataset import Dataset

WIDTH, HEIGHT = 640, 360
HOLDOUT = 8
"""Every eighth photo by name is held out, as is usual."""
FEATURES = 4096
"""A photo: enough for 5,000 to 10,000 points."""


def viewpoints() -> list[tuple[int, int]]:
    """42 places (node, pitch index) on the ring: all at the middle pitch, then six looking further down.
    In this order what is held out lies between photos that are not."""
    return [(node, 1) for node in range(36)] + [(node, 2) for node in range(3, 36, 6)]


def make(folder: Path, scene: str) -> None:
    """Writes `folder/{all,train}`: photos and COLMAP models; nothing where both are there already.

    `train` has cameras and points of `all`, and none of the images that are held out: a peer that cannot
    be told which photos to leave out finds only those to train on. Raises FuseError where COLMAP finds no
    poses.
    """
    if (folder / "train" / "sparse" / "0" / "images.bin").is_file():
        return
    shutil.rmtree(folder, ignore_errors=True)
    photos = folder / "all" / "images"
    photos.mkdir(parents=True)
    environment = TabletopEnvironment(make_episode("cut", scene, 0))
    for i, (node, pitch) in enumerate(viewpoints()):
        at = environment.camera_at(node, pitch)
        # The episode's camera, without the strips above and below.
        wide = Camera(WIDTH, HEIGHT, at.fx, at.fy, WIDTH / 2, HEIGHT / 2, at.rotation, at.translation)
        rgb = environment._world.render_camera(wide)[0]
        cv2.imwrite(str(photos / f"{i:03d}.png"), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    _register(folder / "all")
    _without_held_out(folder / "all", folder / "train")


def _register(folder: Path) -> None:
    """COLMAP as in `fuse splat train --colmap`, but without distortion, of which the photos have none
    (peers undistort by rules of their own, after which sizes would differ)."""
    import pycolmap

    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    pycolmap.set_random_seed(0)
    database, images, work = str(folder / "database.db"), str(folder / "images"), folder / "models"
    work.mkdir()
    options = pycolmap.FeatureExtractionOptions()
    options.sift.max_num_features = FEATURES
    pycolmap.extract_features(
        database,
        images,
        camera_mode=pycolmap.CameraMode.SINGLE,
        camera_model="SIMPLE_PINHOLE",
        extraction_options=options,
    )
    pycolmap.match_exhaustive(database)
    models = pycolmap.incremental_mapping(database, images, str(work))
    if not models:
        raise FuseError(f"COLMAP found no poses for the photos in {images}")
    best = max(models.values(), key=lambda m: m.num_reg_images())
    target = folder / "sparse" / "0"
    target.mkdir(parents=True)
    best.write_binary(str(target))


def _without_held_out(full: Path, target: Path) -> None:
    """A COLMAP folder with the training images only; all points stay."""
    names = Dataset(full, 1, HOLDOUT)
    kept = {names.names[i] for i in names.train}
    model = target / "sparse" / "0"
    model.mkdir(parents=True)
    shutil.copytree(full / "images", target / "images")
    source = full / "sparse" / "0"
    for name in ("cameras.bin", "points3D.bin"):
        shutil.copy(source / name, model / name)
    (model / "images.bin").write_bytes(filter_images((source / "images.bin").read_bytes(), kept))


def filter_images(data: bytes, kept: set[str]) -> bytes:
    """COLMAP's `images.bin` with the images of these names only, without their 2D points."""
    (count,), at, records = struct.unpack_from("<Q", data), 8, []
    for _ in range(count):
        pose_end = at + struct.calcsize("<I7dI")
        name_end = data.index(b"\0", pose_end)
        (points,) = struct.unpack_from("<Q", data, name_end + 1)
        if data[pose_end:name_end].decode() in kept:
            records.append(data[at : name_end + 1] + struct.pack("<Q", 0))
        at = name_end + 1 + 8 + 24 * points
    return struct.pack("<Q", len(records)) + b"".join(records)
