"""Our own renderer, through the world of an episode, as an agent sees it."""

from __future__ import annotations

from typing import Any

from fuse_grounding._core import Camera, Stage, World
from renderers.scene import Scene, View

PACKAGE = "fuse_grounding"


class Renderer:
    """Soft shadow, ambient occlusion, anti-aliasing; colour comes with depth and ids."""

    def __init__(self, scene: Scene, variant: str):
        stage = Stage(scene.folder / "stage", scene.folder / "scenes.json")
        self._world = World((scene.folder / "episode.json").read_text(), stage)

    def color(self, view: View) -> Any:
        """(H, W, 3) uint8."""
        return self.all(view)[0]

    def all(self, view: View) -> Any:
        """Colour, depth (H, W) metres, ids (H, W)."""
        return self._world.render_camera(_camera(view))

    def depth_ids(self, view: View) -> Any:
        """Depth (H, W) metres, ids (H, W)."""
        return self._world.depth_ids(_camera(view))


def _camera(view: View) -> Camera:
    return Camera(view.width, view.height, *view.intrinsics, view.rotation, view.translation)
