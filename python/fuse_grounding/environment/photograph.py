"""Takes photos of a laid table as a person with a phone would: a capture to try `fuse run --capture` on."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from pathlib import Path

import cv2
import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.arguments import whole
from fuse_grounding.environment.photo_header import with_exif
from fuse_grounding.environment.tabletop import TabletopEnvironment
from fuse_grounding.errors import InputError
from fuse_grounding.registration.similarity import project_to_rotation

QUALITY = 85
_DIAGONAL_35MM = 43.27
_SHAKE_M, _SHAKE_RAD = 0.01, 0.02
"""Standard deviations of where a hand holds the phone, and of how it points it, off the ring."""


def photograph(
    world: TabletopEnvironment,
    folder: Path,
    count: int = 18,
    *,
    arc_deg: float = 360.0,
    exif: bool = True,
    poses: bool = False,
    truth: bool = False,
) -> list[str]:
    """Writes `count` JPEGs, taken on an arc of `arc_deg` around the table, into `folder/images`; their names.

    Every third photo is taken from steeper above. `exif` writes the focal length as phones do; `poses`
    a transforms.json in metres; `truth` depth and masks as PNG. The episode's seed is the hand's, too: the
    same arguments give the same files. Raises InputError for a folder that exists or cannot be written.
    """
    count = whole("count", count, 1, 108)
    if not 0 < arc_deg <= 360:
        raise InputError(f"arc_deg must be above 0 and at most 360, found {arc_deg}")
    if folder.exists():
        raise InputError(f"{folder} exists; a capture is made in a new folder")
    try:
        made = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {error.strerror}") from None
    try:
        names = _fill(world, made, count, arc_deg, exif, poses, truth)
        os.chmod(made, 0o755)
        made.rename(folder)
    except BaseException:
        shutil.rmtree(made, ignore_errors=True)
        raise
    return names


def _fill(
    world: TabletopEnvironment,
    folder: Path,
    count: int,
    arc_deg: float,
    exif: bool,
    poses: bool,
    truth: bool,
) -> list[str]:
    hand = np.random.default_rng(world.episode.seed)
    first, _ = world.episode.start
    names, frames = [], []
    for index in range(count):
        node = (first + round(arc_deg / 10 * index / count)) % 36
        camera = _held(world.camera_at(node, 2 if index % 3 == 2 else 1), hand)
        seen = world.photograph(camera)
        assert seen.depth is not None
        assert seen.instance is not None
        names.append(f"{index:03d}.jpg")
        bgr = cv2.cvtColor(seen.rgb, cv2.COLOR_RGB2BGR)
        jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
        _write(folder / "images" / names[-1], with_exif(jpeg, _focal_35mm(camera)) if exif else jpeg)
        if truth:
            millimetres = np.clip(np.rint(seen.depth * 1000), 0, 65535).astype(np.uint16)
            for kind, picture in (("depth", millimetres), ("masks", seen.instance.astype(np.uint16))):
                _write(folder / kind / f"{index:03d}.png", cv2.imencode(".png", picture)[1].tobytes())
        frames.append({"file_path": f"images/{names[-1]}", "transform_matrix": _to_world(camera)})
    if poses:
        c = camera
        lens = {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy}
        value = {"camera_model": "OPENCV", **lens, "frames": frames}
        _write(folder / "transforms.json", json.dumps(value, indent=1).encode())
    return names


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(data)


def _held(camera: Camera, hand: np.random.Generator) -> Camera:
    """The camera a little off its place."""
    off = np.eye(3) + np.cross(np.eye(3), hand.normal(0, _SHAKE_RAD, 3))
    rotation = project_to_rotation(off @ camera.rotation)
    center = camera.center + hand.normal(0, _SHAKE_M, 3)
    c = camera
    return Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy, rotation, -rotation @ center)


def _focal_35mm(camera: Camera) -> int:
    """Focal length of a 36 by 24 mm film that sees the same along the diagonal, whole millimetres."""
    return round(camera.fx * _DIAGONAL_35MM / np.hypot(camera.width, camera.height))


def _to_world(camera: Camera) -> list[list[float]]:
    """nerfstudio's matrix: camera to world, camera with y up and z backward."""
    matrix = np.eye(4)
    matrix[:3, :3] = camera.rotation.T @ np.diag([1.0, -1.0, -1.0])
    matrix[:3, 3] = camera.center
    return matrix.tolist()
