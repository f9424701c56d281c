"""PyBullet's TinyRenderer, which runs on one core and needs no GL. Its shadow spoils the picture: off."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
from PIL import Image

from renderers.gl_matrices import clip_from_camera, gl_camera
from renderers.glb import Part
from renderers.scene import Scene, View

PACKAGE = "pybullet"
NEAR, FAR = 0.05, 20.0


def write_obj(path: Path, part: Part) -> None:
    """One part as OBJ, v upwards."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in part.positions]
    lines += [f"vt {u:.6f} {1 - v:.6f}" for u, v in part.uvs]
    lines += [f"vn {x:.5f} {y:.5f} {z:.5f}" for x, y, z in part.normals]
    lines += ["f " + " ".join(f"{i}/{i}/{i}" for i in t) for t in part.triangles + 1]
    path.write_text("\n".join(lines) + "\n")


class Renderer:
    """One body for each part."""

    def __init__(self, scene: Scene, variant: str):
        self._client = pybullet.connect(pybullet.DIRECT)
        self._numbers = np.zeros(len(scene.parts()) + 1, np.uint32)
        self._lamp = scene.lamp.tolist()
        with tempfile.TemporaryDirectory() as folder:
            for k, (part, place, number) in enumerate(scene.parts()):
                body = self._add(Path(folder), k, part, place)
                self._numbers[body] = number

    def _add(self, folder: Path, k: int, part: Part, place: np.ndarray) -> int:
        obj, png = folder / f"{k}.obj", folder / f"{k}.png"
        write_obj(obj, part)
        color = [*(np.array(part.color) ** (1 / 2.2)), 1]
        shape = pybullet.createVisualShape(
            pybullet.GEOM_MESH, fileName=str(obj), rgbaColor=color, specularColor=[0.1] * 3
        )
        angle = float(np.arctan2(place[1, 0], place[0, 0]))
        body = pybullet.createMultiBody(
            0, -1, shape, place[:3, 3].tolist(), pybullet.getQuaternionFromEuler([0, 0, angle])
        )
        if part.texture is not None:
            Image.fromarray(part.texture).save(png)
            pybullet.changeVisualShape(body, -1, textureUniqueId=pybullet.loadTexture(str(png)))
        return body

    def _picture(self, view: View, flags: int) -> Any:
        return pybullet.getCameraImage(
            view.width,
            view.height,
            gl_camera(view).T.ravel().tolist(),
            clip_from_camera(view, NEAR, FAR).T.ravel().tolist(),
            lightDirection=self._lamp,
            lightAmbientCoeff=0.55,
            lightDiffuseCoeff=0.45,
            lightSpecularCoeff=0.05,
            shadow=0,
            renderer=pybullet.ER_TINY_RENDERER,
            flags=flags,
        )

    def color(self, view: View) -> Any:
        """(H, W, 3) uint8."""
        picture = self._picture(view, pybullet.ER_NO_SEGMENTATION_MASK)[2]
        return np.ascontiguousarray(np.reshape(picture, (view.height, view.width, 4))[..., :3], np.uint8)

    def all(self, view: View) -> Any:
        """Colour, depth (H, W) metres, ids (H, W)."""
        _, _, rgba, z, bodies = self._picture(view, 0)
        shape = (view.height, view.width)
        rgb = np.ascontiguousarray(np.reshape(rgba, (*shape, 4))[..., :3], np.uint8)
        depth = FAR * NEAR / (FAR - (FAR - NEAR) * np.reshape(z, shape))
        return rgb, depth, self._numbers[np.reshape(bodies, shape)]
