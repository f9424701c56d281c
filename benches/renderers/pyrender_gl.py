"""pyrender on EGL. Its shadows look wrong and take two thirds of its speed: off. Ids are a second drawing."""

from __future__ import annotations

import os
from typing import Any

os.environ.setdefault("PYOPENGL_PLATFORM", "egl")

import numpy as np
from PIL import Image

from renderers.gl_matrices import gl_camera
from renderers.scene import Scene, View

# pyrender 0.1.45 is older than NumPy 2, which has neither.
for _name, _value in (("infty", np.inf), ("float_", np.float64)):
    if not hasattr(np, _name):
        setattr(np, _name, _value)

import pyrender  # noqa: E402

PACKAGE = "pyrender"
NEAR, FAR = 0.05, 20.0


class Renderer:
    """One node for each part."""

    def __init__(self, scene: Scene, variant: str):
        self._scene = pyrender.Scene(ambient_light=[0.35] * 3, bg_color=[0.6, 0.6, 0.6])
        self._nodes: dict[Any, tuple[int, int, int]] = {}
        for part, place, number in scene.parts():
            texture = None
            if part.texture is not None:
                sampler = pyrender.Sampler(magFilter=9729, minFilter=9987)
                texture = pyrender.Texture(
                    sampler=sampler, source=Image.fromarray(part.texture), source_channels="RGB"
                )
            material = pyrender.MetallicRoughnessMaterial(
                baseColorFactor=[*part.color, 1.0],
                baseColorTexture=texture,
                metallicFactor=part.metallic,
                roughnessFactor=part.roughness,
                doubleSided=True,
            )
            primitive = pyrender.Primitive(
                positions=part.positions,
                normals=part.normals,
                texcoord_0=part.uvs * [1, -1] + [0, 1],
                indices=part.triangles,
                material=material,
            )
            node = self._scene.add(pyrender.Mesh([primitive]), pose=place)
            self._nodes[node] = (number, 0, 0)
        lamp = np.eye(4)
        lamp[:3, 3] = scene.lamp
        self._scene.add(pyrender.PointLight(color=[1, 1, 1], intensity=45.0), pose=lamp)
        view = scene.views[0]
        self._camera = self._scene.add(
            pyrender.IntrinsicsCamera(*view.intrinsics, znear=NEAR, zfar=FAR), pose=np.eye(4)
        )
        self._renderer = pyrender.OffscreenRenderer(view.width, view.height)

    def _draw(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        self._scene.set_pose(self._camera, np.linalg.inv(gl_camera(view)))
        return self._renderer.render(self._scene)

    def color(self, view: View) -> Any:
        """(H, W, 3) uint8; depth comes with it."""
        return self._draw(view)[0]

    def all(self, view: View) -> Any:
        """Colour, depth (H, W) metres, ids (H, W)."""
        rgb, depth = self._draw(view)
        ids = self._renderer.render(self._scene, pyrender.RenderFlags.SEG, self._nodes)[0]
        return rgb, depth, ids[..., 0].astype(np.uint32)
