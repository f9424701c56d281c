"""torch-splatting, Gaussian splatting in plain PyTorch, on the CPU.

It is written for CUDA, square pictures of 256 pixels and cameras that have everything in front of them.
A copy is changed by the replacements below; run as a script, this file times that copy.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import resource
import shutil
import sys
import time
import types
from pathlib import Path
from typing import Any

REPLACEMENTS = {
    "gaussian_splatting/gauss_render.py": [
        ("import pdb\n", ""),
        ("from einops import reduce\n", ""),
        ("'cuda'", "'cpu'"),
        ('"cuda"', '"cpu"'),
        # Tiles at the border are smaller where the size is no multiple of theirs.
        (
            ".reshape(TILE_SIZE, TILE_SIZE, -1)",
            ".reshape(*self.pix_coord[h:h+TILE_SIZE, w:w+TILE_SIZE].shape[:2], -1)",
        ),
        # What is behind the camera goes from all arrays, not only from two of them.
        ("cov2d=cov2d,", "cov2d=cov2d[in_mask],"),
        ("color=color,", "color=color[in_mask],"),
        ("opacity=opacity, \n", "opacity=opacity[in_mask],\n"),
    ],
    "gaussian_splatting/gauss_model.py": [(".cuda()", ""), ('"cuda"', '"cpu"')],
    "gaussian_splatting/utils/__init__.py": [("import imageio\n", "")],
}


def build(sources: Path, folder: Path) -> Path:
    """A copy for the CPU. Raises Failed without torch, or for another version of the sources."""
    from peers.process import Failed, replace_all

    if importlib.util.find_spec("torch") is None:
        raise Failed("needs torch: `pip install torch`")
    copy = folder / "source"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(sources, copy, ignore=shutil.ignore_patterns(".git", "*.zip"))
    replace_all(copy, REPLACEMENTS)
    return copy


def iteration(copy: Path, scene: Path, folder: Path, count: int, discard: int) -> dict[str, Any]:
    """Seconds an iteration from the COLMAP points, in a process of its own."""
    from peers.process import run

    arguments = ["--count", str(count), "--discard", str(discard)]
    ran = run([sys.executable, __file__, copy, scene, *arguments], folder / "iteration.log")
    return json.loads(ran.lines[-1][1]) | {"others": ran.others}


def _three_nearest(points: Any) -> Any:
    """Mean squared distance to the three nearest points, as the CUDA module `simple_knn` computes it."""
    import torch

    lots = [torch.cdist(lot, points).topk(4, largest=False).values[:, 1:] for lot in points.split(1024)]
    return torch.cat(lots).square().mean(1)


def _measure(copy: Path, scene: Path, count: int, discard: int) -> dict[str, Any]:
    import numpy as np
    import torch

    from fuse_grounding.reconstruction.dataset import Dataset

    neighbours = types.ModuleType("simple_knn._C")
    neighbours.distCUDA2 = _three_nearest  # type: ignore[attr-defined]
    sys.modules["simple_knn"], sys.modules["simple_knn._C"] = types.ModuleType("simple_knn"), neighbours
    sys.path.insert(0, str(copy))
    from gaussian_splatting.gauss_model import GaussModel
    from gaussian_splatting.gauss_render import GaussRenderer
    from gaussian_splatting.utils import loss_utils
    from gaussian_splatting.utils.camera_utils import Camera
    from gaussian_splatting.utils.point_utils import PointCloud

    data = Dataset(scene / "train", 1, 0)
    xyz, rgb = data.points()
    model = GaussModel(sh_degree=3)
    model.create_from_pcd(PointCloud(xyz, {name: rgb[:, i] for i, name in enumerate("RGB")}))
    renderer = GaussRenderer(white_bkgd=False)
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3, betas=(0.9, 0.99))
    views = []
    for image, camera in data.read(data.train):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = camera.rotation, camera.translation
        intrinsic = torch.tensor([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        back = torch.tensor(np.linalg.inv(pose), dtype=torch.float32)
        views.append((torch.tensor(image) / 255, Camera(camera.width, camera.height, intrinsic, back)))
    width, height = views[0][1].image_width, views[0][1].image_height
    grid = torch.meshgrid(torch.arange(width), torch.arange(height), indexing="xy")
    renderer.pix_coord = torch.stack(grid, dim=-1)

    times, order = [], np.random.default_rng(0)
    for _ in range(discard + count):
        photo, view = views[order.integers(len(views))]
        begin = time.perf_counter()
        drawn = renderer(pc=model, camera=view)["render"]
        loss = 0.8 * loss_utils.l1_loss(drawn, photo) + 0.2 * (1 - loss_utils.ssim(drawn, photo))
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
        times.append(time.perf_counter() - begin)
        print(f"{times[-1]:.3f} s, loss {loss.item():.4f}", flush=True)
    return {
        "seconds": float(np.mean(times[discard:])),
        "gaussians": len(xyz),
        "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def main() -> None:
    """Times the copy; the last line is a JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("copy", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--discard", type=int, default=2)
    asked = parser.parse_args()
    found = _measure(asked.copy, asked.scene, asked.count, asked.discard)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
