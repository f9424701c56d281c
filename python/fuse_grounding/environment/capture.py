"""Photos that were taken around a table, with their poses in a world frame: docs/capture.md is the format."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.environment.frame import level, moved, turned
from fuse_grounding.environment.photo_header import PhotoHeader, read_header
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.reconstruction import photos
from fuse_grounding.reconstruction.cameras import focus, up_axis
from fuse_grounding.reconstruction.dataset import Dataset
from fuse_grounding.registration.posed import PosedRegistrar
from fuse_grounding.registration.similarity import Similarity

LEAST = 5
"""The start and four seed views of the map."""
PIXELS = 640 * 480
"""What the agent looks at: photos are made smaller to about so many pixels, in their own shape."""
EFFORT = photos.Effort(longest=1600, features=4096)
"""A table top is near and full of texture; a phone's photos have more pixels than poses need."""
_UPRIGHT = math.cos(math.radians(20))
_MILLIMETRE = 1e-3
_LEAST_SAMPLES = 50

Scale = float | Literal["poses"] | None
"""Mean distance from the camera to the scene in metres; or poses that are in metres, z up; or not known."""


@dataclass(frozen=True)
class Capture:
    """A folder of photos, all of one camera and size.

    `names` are file names; `images` (H, W, 3) uint8, upright, without distortion; `cameras` in a frame with
    z up, whose unit is the metre if `metric`, otherwise the mean distance from a camera to `middle` (3,);
    `depths` (H, W) float32 metres, 0 where unknown; `instances` (H, W) uint32. `notes`: what a reader of the
    results must know. `points` (P, 3) and `colours` (P, 3) in [0, 1]: COLMAP's, where there are any.
    """

    folder: Path
    names: list[str]
    images: list[np.ndarray]
    cameras: list[Camera]
    middle: np.ndarray
    metric: bool
    points: np.ndarray
    colours: np.ndarray
    depths: list[np.ndarray] | None = None
    instances: list[np.ndarray] | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images, pixels."""
        return self.cameras[0].width, self.cameras[0].height

    @property
    def hfov_deg(self) -> float:
        """Horizontal field of view, degrees."""
        return math.degrees(2 * math.atan(0.5 * self.cameras[0].width / self.cameras[0].fx))


def load_capture(
    folder: str | Path,
    *,
    scale: Scale = None,
    hfov_deg: float | None = None,
    told: Callable[[str], None] = lambda text: None,
) -> Capture:
    """Reads a folder of photos; where it has no poses, COLMAP finds them and they are kept in `sparse/0`.

    `hfov_deg` is the horizontal field of view of the photos as stored, for COLMAP; without it, COLMAP
    starts from the EXIF data, or guesses. `told` hears what takes time. Raises InputError for folders that
    are no capture, and FuseError where COLMAP finds no poses.
    """
    folder = Path(folder)
    _check_scale(scale, hfov_deg)
    notes: list[str] = []
    if photos.has_poses(folder):
        if hfov_deg is not None:
            raise InputError(f"{folder} has poses with intrinsics; the field of view is for photos without")
    else:
        notes.append(_find_poses(folder, hfov_deg, told))
    data = Dataset(folder, downscale=1, holdout=0)
    headers = _headers([_photo_path(folder, name) for name in data.names])
    data, turns = _shrinking(data, headers), _turns(headers, notes)
    if len(data.names) < LEAST:
        raise InputError(f"{folder} has {len(data.names)} photos with poses, expected at least {LEAST}")
    images, cameras = _upright(data, turns)
    _one_camera(folder, data.names, cameras)
    missing = sorted(set(photos.find_photos(folder)[1]) - {Path(name).name for name in data.names})
    if missing:
        notes.append(f"{len(missing)} photo(s) have no pose and are left out: {', '.join(missing[:5])}")
    size = cameras[0].width, cameras[0].height
    depths = _beside(folder, "depth", data.names, size, turns, _depth)
    world = _world(folder, cameras, scale)
    cameras = cameras if world is None else [moved(camera, world) for camera in cameras]
    points, colours = _points(data, world, images, cameras)
    if depths is not None and scale is None:
        factor = _scale_by_depth(folder, cameras, points, depths)
        grow = Similarity(factor, np.eye(3), np.zeros(3))
        cameras, points = [moved(camera, grow) for camera in cameras], grow.points(points)
        notes.append(
            f"scale by the depth images: the photos were taken {factor:.2f} m from the scene on average"
        )
    metric = scale is not None or depths is not None
    if not metric:
        notes.append(
            "the scale is arbitrary: lengths are in units of the mean distance from the camera to the scene; "
            "--scale METRES gives that distance"
        )
    return Capture(
        folder,
        [Path(name).name for name in data.names],
        images,
        cameras,
        focus(cameras),
        metric,
        points,
        colours,
        depths,
        _beside(folder, "masks", data.names, size, turns, _instances),
        notes,
    )


def _points(
    data: Dataset, world: Similarity | None, images: Sequence[np.ndarray], cameras: Sequence[Camera]
) -> tuple[np.ndarray, np.ndarray]:
    """The reconstruction's points in the world; where poses came without any, what the photos agree on."""
    if data.has_points:
        xyz, colours = data.points()
        return (xyz if world is None else world.points(xyz)).astype(np.float64), colours
    registrar = PosedRegistrar()
    registrar.initialize(
        [Observation(image, camera=camera) for image, camera in zip(images, cameras, strict=True)]
    )
    xyz, rgb = registrar.points()
    return xyz, (rgb / 255).astype(np.float32)


def _check_scale(scale: Scale, hfov_deg: float | None) -> None:
    if isinstance(scale, str) and scale != "poses":
        raise InputError(f'scale must be metres or "poses", found {scale!r}')
    if isinstance(scale, (int, float)) and not (math.isfinite(scale) and scale > 0):
        raise InputError(f"scale must be a positive number of metres, found {scale}")
    if hfov_deg is not None and not 1 < hfov_deg < 170:
        raise InputError(f"the field of view must be between 1 and 170 degrees, found {hfov_deg}")


def _find_poses(folder: Path, hfov_deg: float | None, told: Callable[[str], None]) -> str:
    """Runs COLMAP, once everything is known to be in order; says where the focal length came from."""
    if not folder.is_dir():
        raise InputError(f"capture {folder} is not a folder")
    root, names = photos.find_photos(folder)
    if len(names) < LEAST:
        other = sorted(
            p.name for p in root.iterdir() if p.suffix.lower() in (".heic", ".heif", ".dng", ".webp")
        )
        hint = f"; {len(other)} such as {other[0]} are not read: save them as JPEG" if other else ""
        raise InputError(
            f"capture {root} has {len(names)} photo(s) (JPEG or PNG), "
            f"expected at least {LEAST} taken around the table{hint}"
        )
    headers = _headers([root / name for name in names])
    width = headers[names[0]].width
    focal = None if hfov_deg is None else 0.5 * width / math.tan(math.radians(0.5 * hfov_deg))
    photos.find_poses(folder, told, focal_px=focal, effort=EFFORT)
    if focal is not None:
        return f"the field of view was given: {hfov_deg:g} degrees"
    import pycolmap

    guess = pycolmap.infer_camera_from_image(str(root / names[0]))
    if guess.has_prior_focal_length:
        return "the field of view is the EXIF data's, refined by COLMAP"
    return "the photos have no focal length in their EXIF data: the field of view is COLMAP's estimate"


def _photo_path(folder: Path, name: str) -> Path:
    for path in (folder / "images" / name, folder / name):
        if path.is_file():
            return path
    raise InputError(f"{folder} has poses for {name}, but no such photo")


def _headers(paths: Sequence[Path]) -> dict[str, PhotoHeader]:
    """By file name. Raises InputError where sizes differ."""
    found = {path.name: read_header(path) for path in paths}
    first = paths[0]
    for path in paths:
        mine, theirs = found[path.name], found[first.name]
        if (mine.width, mine.height) != (theirs.width, theirs.height):
            raise InputError(
                f"capture {first.parent} has photos of different sizes: {first.name} is {theirs.width}x"
                f"{theirs.height}, {path.name} {mine.width}x{mine.height}; expected one size, from one camera"
            )
    return found


def _turns(headers: dict[str, PhotoHeader], notes: list[str]) -> int:
    """Quarter turns that most photos need; phones that look down are not sure of theirs."""
    counts = Counter(header.quarter_turns for header in headers.values())
    turns, agreeing = counts.most_common(1)[0]
    if agreeing < len(headers):
        notes.append(
            f"{len(headers) - agreeing} of {len(headers)} photos state another orientation; all are "
            "turned as most are"
        )
    return turns


def _shrinking(data: Dataset, headers: dict[str, PhotoHeader]) -> Dataset:
    """The same, read as small as whole numbers make it without losing pixels that are wanted."""
    first = next(iter(headers.values()))
    by = max(1, int(math.sqrt(first.width * first.height / PIXELS)))
    return Dataset(data.folder, downscale=by, holdout=0)


def _upright(data: Dataset, turns: int) -> tuple[list[np.ndarray], list[Camera]]:
    """Photos of at most `PIXELS` pixels, turned upright, with their cameras."""
    images, cameras = [], []
    for image, camera in data.read(range(len(data.names))):
        shrink = min(1.0, math.sqrt(PIXELS / (camera.width * camera.height)))
        size = round(camera.width * shrink), round(camera.height * shrink)
        small = image if shrink == 1.0 else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        images.append(np.ascontiguousarray(np.rot90(small, -turns)))
        cameras.append(turned(camera.resized(*size), turns))
    return images, cameras


def _one_camera(folder: Path, names: Sequence[str], cameras: Sequence[Camera]) -> None:
    def lens(camera: Camera) -> tuple[float, ...]:
        return (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)

    for name, camera in zip(names, cameras, strict=True):
        if not np.allclose(lens(camera), lens(cameras[0]), rtol=0, atol=1e-6):
            raise InputError(
                f"{folder}: its poses give {Path(names[0]).name} a focal length of {cameras[0].fx:.1f} px "
                f"and {Path(name).name} one of {camera.fx:.1f} px; expected one camera for all photos"
            )


def _world(folder: Path, cameras: Sequence[Camera], scale: Scale) -> Similarity | None:
    """World from the poses' frame; None where that is the world."""
    if scale != "poses":
        return level(cameras, 1.0 if scale is None else scale)
    up = up_axis(cameras)
    if up[2] < _UPRIGHT:
        raise InputError(
            f"{folder}: its poses are said to be a world with z up, but up in the photos is "
            f"({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}); give the scale in metres instead"
        )
    return None


def _beside(
    folder: Path,
    kind: str,
    names: Sequence[str],
    size: tuple[int, int],
    turns: int,
    read: Callable[[Path], np.ndarray],
) -> list[np.ndarray] | None:
    """Pictures of `folder/kind`, one for each photo under its name as PNG; None without such a folder."""
    if not (folder / kind).is_dir():
        return None
    found = []
    for name in names:
        path = folder / kind / f"{Path(name).stem}.png"
        if not path.is_file():
            raise InputError(f"{path} is missing: {kind} has a PNG for each photo, or is not there at all")
        picture = np.ascontiguousarray(np.rot90(read(path), -turns))
        if abs(picture.shape[1] / picture.shape[0] - size[0] / size[1]) > 0.02:
            raise InputError(
                f"{path} is {picture.shape[1]}x{picture.shape[0]}, expected the shape of its photo, "
                f"{size[0]}x{size[1]} or a multiple"
            )
        found.append(cv2.resize(picture, size, interpolation=cv2.INTER_NEAREST))
    return found


def _grey(path: Path, kinds: tuple[type, ...], expected: str) -> np.ndarray:
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise InputError(f"{path} is no PNG that can be read")
    if picture.ndim != 2 or picture.dtype.type not in kinds:
        raise InputError(f"{path} has {picture.dtype} pixels of shape {picture.shape}, expected {expected}")
    return picture


def _depth(path: Path) -> np.ndarray:
    millimetres = _grey(path, (np.uint16,), "16-bit grey: millimetres along the optical axis, 0 unknown")
    return (millimetres * _MILLIMETRE).astype(np.float32)


def _instances(path: Path) -> np.ndarray:
    return _grey(path, (np.uint8, np.uint16), "8- or 16-bit grey: a number for each object, 0 none").astype(
        np.int32
    )


def _scale_by_depth(
    folder: Path, cameras: Sequence[Camera], points: np.ndarray, depths: Sequence[np.ndarray]
) -> float:
    """Median over views and points of measured over reconstructed depth."""
    pairs = zip(cameras, depths, strict=True)
    ratios = [_depth_ratios(camera, points, depth) for camera, depth in pairs]
    samples = np.concatenate(ratios)
    if len(samples) < _LEAST_SAMPLES:
        raise FuseError(
            f"{folder}: {len(samples)} points of the reconstruction have a measured depth, too few for "
            f"a scale ({_LEAST_SAMPLES}); give --scale"
        )
    return float(np.median(samples))


def _depth_ratios(camera: Camera, points: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Depth image over depth of the point, for each of `points` (P, 3) that falls on a known pixel."""
    local = points @ camera.rotation.T + camera.translation
    local = local[local[:, 2] > 1e-6]
    column = np.floor(local[:, 0] / local[:, 2] * camera.fx + camera.cx).astype(int)
    row = np.floor(local[:, 1] / local[:, 2] * camera.fy + camera.cy).astype(int)
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    known = depth[row[inside], column[inside]]
    return known[known > 0] / local[inside, 2][known > 0]
