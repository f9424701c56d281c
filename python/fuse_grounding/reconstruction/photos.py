"""Poses of a folder of photos, by COLMAP: features, exhaustive matching, incremental mapping."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2

from fuse_grounding.errors import FuseError, InputError

_SUFFIXES = (".jpg", ".jpeg", ".png")
# From so many photos on, matching all pairs takes long enough to say so.
_MANY = 150


@dataclass(frozen=True)
class Effort:
    """How thoroughly COLMAP looks: pixels of the longer side, and features, of a photo; its own defaults."""

    longest: int = 3200
    features: int = 8192


def find_photos(folder: Path) -> tuple[Path, list[str]]:
    """The folder with the photos (`images` in it, or itself) and their names, sorted."""
    root = folder / "images" if (folder / "images").is_dir() else folder
    if not root.is_dir():
        return root, []
    return root, sorted(p.name for p in root.iterdir() if p.suffix.lower() in _SUFFIXES and p.is_file())


def has_poses(folder: Path) -> bool:
    """Whether there is COLMAP output or a transforms.json to train on."""
    places = [folder / "sparse" / "0", folder / "sparse", folder / "colmap" / "sparse" / "0", folder]
    models = (place / f"cameras.{suffix}" for place in places for suffix in ("bin", "txt"))
    return folder.is_file() or (folder / "transforms.json").is_file() or any(m.is_file() for m in models)


def find_poses(
    folder: Path,
    told: Callable[[str], None],
    seed: int = 0,
    *,
    focal_px: float | None = None,
    effort: Effort | None = None,
) -> int:
    """Runs COLMAP on the photos of `folder` and writes `sparse/0` into it; returns the views with poses.

    Photos of one size share a camera (one focal length, one radial coefficient); otherwise each has its
    own. COLMAP starts from the EXIF data's focal length, where there is one, and refines it; `focal_px`, in
    pixels of the photos as stored and for photos of one size, is kept as it is. Raises InputError for fewer
    than three photos, FuseError where COLMAP finds no poses.
    """
    import pycolmap

    root, names = find_photos(folder)
    if len(names) < 3:
        raise InputError(f"{root} has {len(names)} photos (JPEG or PNG), COLMAP needs at least three")
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    pycolmap.set_random_seed(seed)
    effort = effort or Effort()
    extraction = pycolmap.FeatureExtractionOptions(max_image_size=effort.longest)
    extraction.sift.max_num_features = effort.features
    reader = pycolmap.ImageReaderOptions()
    mapping = pycolmap.IncrementalPipelineOptions()
    if focal_px is not None:
        width, height = _size(root / names[0])
        reader.camera_params = f"{focal_px},{width / 2},{height / 2},0"
        mapping.ba_refine_focal_length = False
    mode = pycolmap.CameraMode.SINGLE if _one_size(root, names) else pycolmap.CameraMode.PER_IMAGE
    with tempfile.TemporaryDirectory(prefix=".colmap-", dir=folder) as work:
        database, images = str(Path(work) / "database.db"), str(root)
        told(f"features of {len(names)} photos")
        pycolmap.extract_features(
            database,
            images,
            names,
            camera_mode=mode,
            camera_model="SIMPLE_RADIAL",
            reader_options=reader,
            extraction_options=extraction,
        )
        pairs = len(names) * (len(names) - 1) // 2
        told(f"matching {pairs} pairs" + (", which takes a while" if len(names) > _MANY else ""))
        pycolmap.match_exhaustive(database)
        told("poses and points")
        models = pycolmap.incremental_mapping(database, images, work, mapping)
        if not models:
            raise FuseError(
                f"COLMAP found no poses for the photos in {root}; they need overlap, texture and parallax"
            )
        best = max(models.values(), key=lambda m: m.num_reg_images())
        made = Path(work) / "model"
        made.mkdir()
        best.write_binary(str(made))
        target = folder / "sparse" / "0"
        target.parent.mkdir(exist_ok=True)
        shutil.move(made, target)
    registered = best.num_reg_images()
    told(f"{registered} of {len(names)} photos have poses, {best.num_points3D()} points, in {target}")
    return registered


def _one_size(root: Path, names: list[str]) -> bool:
    return len({_size(root / name) for name in names}) == 1


def _size(path: Path) -> tuple[int, int]:
    """Width and height as stored: COLMAP does not turn photos by their EXIF data either."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise InputError(f"{path} is no JPEG or PNG that can be read")
    return image.shape[1], image.shape[0]
