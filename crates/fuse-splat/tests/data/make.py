"""Remakes the recorded files of this folder, except `niantic_v*.spz` (see README.md).

Run at the root of the repository: python crates/fuse-splat/tests/data/make.py
"""

import sys
from pathlib import Path

import numpy as np
import plyfile

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[3] / "tests" / "python"))

import tabletop_twin as twin  # noqa: E402
from photo_sets import PhotoSet, sample_points  # noqa: E402

NAMES = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{i}" for i in range(3))]
NAMES += [*(f"f_rest_{i}" for i in range(45)), "opacity"]
NAMES += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]


def gaussians(count: int) -> None:
    """Random ones, in three formats."""
    rng = np.random.default_rng(11)
    vertex = np.zeros(count, [(name, "f4") for name in NAMES])
    for name in NAMES:
        low, high = {"s": (-7, -1), "o": (-4, 5), "r": (-1, 1)}.get(name[0], (-0.9, 0.9))
        vertex[name] = rng.uniform(low, high, count) if name[0] != "n" else 0
    element = plyfile.PlyElement.describe(vertex, "vertex")
    plyfile.PlyData([element], byte_order="<").write(str(HERE / "scene.ply"))
    few = plyfile.PlyElement.describe(vertex[:3], "vertex")
    plyfile.PlyData([few], byte_order=">").write(str(HERE / "big_endian.ply"))
    plyfile.PlyData([few], text=True).write(str(HERE / "ascii.ply"))


def photo_sets() -> None:
    """Three views, in three forms."""
    faces = twin.scene(5)
    xyz, rgb = sample_points(faces, 12)
    cameras = [twin.camera(node, 1).resized(32, 24) for node in (0, 2, 4)]
    images = [np.full((24, 32, 3), 40 * i, np.uint8) for i in range(3)]
    photos = PhotoSet(images, cameras, xyz, rgb)
    for name, write in (
        ("colmap_binary", photos.write_colmap),
        ("colmap_text", lambda folder: photos.write_colmap(folder, text=True)),
        ("nerfstudio", photos.write_nerfstudio),
    ):
        (HERE / name).mkdir(exist_ok=True)
        write(HERE / name)
        for extra in (HERE / name).glob("sparse/0/[rf]*"):  # rigs, frames
            extra.unlink()


gaussians(40)
photo_sets()
