"""What one would write oneself: OpenGL shaders through moderngl, on EGL. One pass gives colour, depth and
ids; one lamp with a hard shadow from a map of 2048²; textures with mip levels, no anti-aliasing."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from renderers.scene import Scene, View

PACKAGE = "moderngl"
NEAR, FAR = 0.05, 20.0
MAP = 2048
SKY = 0.45
"""Ambient share of the base colour."""

SHADOW_VERTEX = """
#version 330
uniform mat4 to_lamp; uniform mat4 place; in vec3 position;
void main() { gl_Position = to_lamp * place * vec4(position, 1.0); }
"""
VERTEX = """
#version 330
uniform mat4 to_clip; uniform mat4 place; uniform mat4 to_lamp;
in vec3 position; in vec3 normal; in vec2 uv;
out vec3 world; out vec3 n; out vec2 t; out vec4 lit;
void main() {
  vec4 p = place * vec4(position, 1.0);
  world = p.xyz; n = mat3(place) * normal; t = uv; lit = to_lamp * p;
  gl_Position = to_clip * p;
}
"""
FRAGMENT = """
#version 330
uniform sampler2D base; uniform sampler2DShadow shadow; uniform vec3 color; uniform vec3 lamp;
uniform float sky; uniform uint id; uniform bool shadows;
in vec3 world; in vec3 n; in vec2 t; in vec4 lit;
layout(location = 0) out vec4 rgb; layout(location = 1) out uint ids;
void main() {
  vec3 to = lamp - world;
  vec3 facing = normalize(gl_FrontFacing ? n : -n);
  float direct = max(dot(facing, normalize(to)), 0.0) * 3.2 / dot(to, to);
  if (shadows) {
    vec3 at = lit.xyz / lit.w * 0.5 + 0.5;
    // What lies outside the map is lit.
    bool seen = lit.w > 0.0 && all(lessThan(abs(at.xy - 0.5), vec2(0.5)));
    if (seen) direct *= texture(shadow, vec3(at.xy, at.z - 0.0006));
  }
  vec3 linear = pow(texture(base, t).rgb, vec3(2.2)) * color * (sky + direct);
  rgb = vec4(pow(linear, vec3(1.0 / 2.2)), 1.0);
  ids = id;
}
"""


def projection(fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> np.ndarray:
    """(4, 4) clip from a camera with x right, y down, z forward; rows of the picture from the top."""
    n, f = NEAR, FAR
    return np.array(
        [
            [2 * fx / width, 0, 2 * cx / width - 1, 0],
            [0, -2 * fy / height, 1 - 2 * cy / height, 0],
            [0, 0, (f + n) / (f - n), -2 * f * n / (f - n)],
            [0, 0, 1, 0],
        ]
    )


def clip_from_world(view: View) -> np.ndarray:
    """(4, 4) of a view."""
    camera = np.eye(4)
    camera[:3, :3], camera[:3, 3] = view.rotation, view.translation
    return projection(*view.intrinsics, view.width, view.height) @ camera


class Renderer:
    """`variant` is `shadow` or `plain`. The shadow map is drawn for each picture, as where things move."""

    def __init__(self, scene: Scene, variant: str):
        self._gl = gl = moderngl.create_context(standalone=True, backend="egl")
        view = scene.views[0]
        self._size = size = (view.width, view.height)
        self._shadows = variant == "shadow"
        self._program = gl.program(VERTEX, FRAGMENT)
        self._caster = gl.program(SHADOW_VERTEX, "#version 330\nvoid main() {}")
        self._color = gl.texture(size, 4)
        self._ids = gl.texture(size, 1, dtype="u4")
        self._depth = gl.depth_texture(size)
        self._frame = gl.framebuffer([self._color, self._ids], self._depth)
        self._map = gl.depth_texture((MAP, MAP))
        self._map.compare_func = "<="
        self._map_frame = gl.framebuffer(depth_attachment=self._map)
        self._lamp = tuple(float(v) for v in scene.lamp)
        self._to_lamp = self._look_down(scene.lamp)
        self._parts = [self._upload(*p) for p in scene.parts()]
        self._program["lamp"], self._program["sky"], self._program["shadows"] = self._lamp, SKY, self._shadows
        self._program["base"] = 0
        if self._shadows:
            self._program["shadow"] = 1
            for program in (self._program, self._caster):
                program["to_lamp"].write(self._to_lamp.T.astype("f4").tobytes())
        gl.enable(moderngl.DEPTH_TEST)

    @staticmethod
    def _look_down(lamp: np.ndarray) -> np.ndarray:
        """Clip from world of the lamp's map: towards the table, wide enough for it."""
        forward = np.array([0.0, 0.0, 0.75]) - lamp
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, (0, 0, 1.0))
        right /= np.linalg.norm(right)
        rotation = np.array([right, np.cross(forward, right), forward])
        camera = np.eye(4)
        camera[:3, :3], camera[:3, 3] = rotation, -rotation @ lamp
        return projection(0.75 * MAP, 0.75 * MAP, MAP / 2, MAP / 2, MAP, MAP) @ camera

    def _upload(self, part: Any, place: np.ndarray, number: int) -> tuple[Any, ...]:
        gl = self._gl
        image = np.full((1, 1, 3), 255, np.uint8) if part.texture is None else part.texture
        texture = gl.texture(image.shape[1::-1], 3, np.ascontiguousarray(image).tobytes(), alignment=1)
        texture.build_mipmaps()
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        rows = np.concatenate([part.positions, part.normals, part.uvs], axis=1).astype("f4")
        vertices, indices = gl.buffer(rows.tobytes()), gl.buffer(part.triangles.astype("u4").tobytes())
        drawn = gl.vertex_array(self._program, [(vertices, "3f 3f 2f", "position", "normal", "uv")], indices)
        cast = gl.vertex_array(self._caster, [(vertices, "3f 20x", "position")], indices)
        return drawn, cast, texture, place.T.astype("f4").tobytes(), part.color, number

    def _draw(self, view: View) -> None:
        if self._shadows:
            self._map_frame.use()
            self._map_frame.clear(depth=1.0)
            for _, cast, _, place, _, _ in self._parts:
                self._caster["place"].write(place)
                cast.render()
        self._frame.use()
        self._frame.clear(0.6, 0.6, 0.6, depth=1.0)
        self._program["to_clip"].write(clip_from_world(view).T.astype("f4").tobytes())
        if self._shadows:
            self._map.use(1)
        for drawn, _, texture, place, color, number in self._parts:
            texture.use(0)
            self._program["place"].write(place)
            self._program["color"], self._program["id"] = color, number
            drawn.render()

    def _read(self, texture: Any, dtype: Any, channels: int) -> np.ndarray:
        shape = (self._size[1], self._size[0], channels)
        return np.frombuffer(texture.read(alignment=1), dtype).reshape(shape)[::-1]

    def color(self, view: View) -> Any:
        """(H, W, 3) uint8."""
        self._draw(view)
        return np.ascontiguousarray(self._read(self._color, np.uint8, 4)[..., :3])

    def all(self, view: View) -> Any:
        """Colour, depth (H, W) metres with 0 for nothing, ids (H, W)."""
        rgb = self.color(view)
        z = self._read(self._depth, np.float32, 1)[..., 0]
        depth = np.where(z < 1, 2 * FAR * NEAR / (FAR + NEAR - (2 * z - 1) * (FAR - NEAR)), 0)
        return rgb, depth, np.ascontiguousarray(self._read(self._ids, np.uint32, 1)[..., 0])
