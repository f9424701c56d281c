"""MuJoCo's renderer on EGL. Variants: `default` (as `mujoco.Renderer` comes: shadow map of 4096², four
samples), `tuned` (2048², one sample; colour and depth read at once), `tuned_plain` (the same, no shadow)."""

from __future__ import annotations

import os
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np

from renderers.scene import Scene, View

PACKAGE = "mujoco"
NEAR, FAR = 0.05, 20.0


def build(scene: Scene, tuned: bool) -> tuple[Any, np.ndarray]:
    """The model, and the id of each geom."""
    spec = mujoco.MjSpec()
    view = scene.views[0]
    spec.visual.global_.offwidth, spec.visual.global_.offheight = view.width, view.height
    if tuned:
        spec.visual.quality.shadowsize, spec.visual.quality.offsamples = 2048, 0
    spec.visual.headlight.ambient = [0.35] * 3
    spec.visual.headlight.diffuse = [0.1] * 3
    spec.visual.headlight.specular = [0.0] * 3
    # Near and far planes and the map's clip are in units of the extent.
    spec.stat.extent, spec.stat.center = 1.0, [0, 0, 0.75]
    spec.visual.map.znear, spec.visual.map.zfar = NEAR, FAR
    lamp = spec.worldbody.add_light()
    lamp.pos, lamp.castshadow = scene.lamp, True
    lamp.dir = np.array([0, 0, 0.75]) - scene.lamp
    lamp.diffuse, lamp.specular, lamp.cutoff, lamp.exponent = [0.75] * 3, [0.2] * 3, 70, 0
    numbers = []
    for k, (part, place, number) in enumerate(scene.parts()):
        mesh = spec.add_mesh()
        mesh.name = f"m{k}"
        mesh.uservert, mesh.usernormal = part.positions.ravel(), part.normals.ravel()
        mesh.usertexcoord = part.uvs.ravel()
        mesh.userface = part.triangles.ravel()
        mesh.userfacenormal = mesh.userfacetexcoord = part.triangles.ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        material = spec.add_material()
        material.name = f"c{k}"
        material.rgba = [*(np.array(part.color) ** (1 / 2.2)), 1]
        material.specular, material.shininess = 0.3 * (1 - part.roughness), 0.5
        if part.texture is not None:
            texture = spec.add_texture()
            texture.name, texture.type = f"t{k}", mujoco.mjtTexture.mjTEXTURE_2D
            texture.height, texture.width, texture.nchannel = *part.texture.shape[:2], 3
            texture.data = part.texture.tobytes()
            material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
        geom = spec.worldbody.add_geom()
        geom.type, geom.meshname, geom.material = mujoco.mjtGeom.mjGEOM_MESH, mesh.name, material.name
        geom.pos = place[:3, 3]
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, place[:3, :3].ravel())
        geom.quat = quaternion
        geom.contype = geom.conaffinity = 0
        numbers.append(number)
    return spec.compile(), np.array([*numbers, 0])


class Renderer:
    """One camera that is put where a view is; ids are a second drawing, as MuJoCo has it."""

    def __init__(self, scene: Scene, variant: str):
        self._tuned = variant != "default"
        self._model, self._numbers = build(scene, self._tuned)
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        view = scene.views[0]
        self._model.vis.global_.fovy = np.degrees(2 * np.arctan(view.height / 2 / view.intrinsics[1]))
        self._renderer = mujoco.Renderer(self._model, view.height, view.width)
        flags = self._renderer.scene.flags
        self._shadow = variant != "tuned_plain"
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self._shadow
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self._camera = mujoco.MjvCamera()
        self._size = (view.height, view.width)

    def _look(self, view: View) -> None:
        """The scene from a view: a free camera looks at a point from a distance at two angles."""
        forward = view.rotation[2]
        self._camera.lookat[:] = view.center + forward
        self._camera.distance = 1.0
        self._camera.azimuth = np.degrees(np.arctan2(forward[1], forward[0]))
        self._camera.elevation = np.degrees(np.arcsin(forward[2]))
        self._renderer.update_scene(self._data, self._camera)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self._shadow

    def color(self, view: View) -> Any:
        """(H, W, 3) uint8."""
        self._look(view)
        return self._renderer.render()

    def all(self, view: View) -> Any:
        """Colour, depth (H, W) metres, ids (H, W)."""
        r = self._renderer
        if self._tuned:
            rgb, depth = self._color_and_depth(view)
        else:
            rgb = self.color(view)
            r.enable_depth_rendering()
            depth = r.render()
            r.disable_depth_rendering()
        r.enable_segmentation_rendering()
        geoms = r.render()[..., 0]
        r.disable_segmentation_rendering()
        return rgb, depth, self._numbers[geoms]

    def _color_and_depth(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        """Both of one drawing, which `mujoco.Renderer` does not offer."""
        self._look(view)
        r = self._renderer
        r._gl_context.make_current()
        rgb = np.empty((*self._size, 3), np.uint8)
        z = np.empty(self._size, np.float32)
        mujoco.mjr_render(r._rect, r.scene, r._mjr_context)
        mujoco.mjr_readPixels(rgb, z, r._rect, r._mjr_context)
        # Depth is stored reversed: 1 at the near plane, 0 at the far one.
        depth = NEAR * FAR / (NEAR + z * (FAR - NEAR))
        return np.ascontiguousarray(rgb[::-1]), depth[::-1]
