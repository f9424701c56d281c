"""One renderer in a process of its own: `python -m renderers.child MODULE VARIANT SCENE OUT ROUNDS` draws all
views and prints one JSON object. OUT gets the pictures and ids of all views as `.npz`."""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from renderers.scene import Scene, View


def rounds_of(draw: Callable[[View], Any], views: list[View], rounds: int) -> list[float]:
    """Frames per second of each round over all views."""
    found = []
    for _ in range(rounds):
        begin = time.perf_counter()
        for view in views:
            draw(view)
        found.append(len(views) / (time.perf_counter() - begin))
    return found


def measure(module: str, variant: str, scene: Scene, out: Path, rounds: int) -> dict[str, Any]:
    """Set-up, then speeds; what is kept for comparison is drawn before, which warms up."""
    begin = time.perf_counter()
    renderer = importlib.import_module(f"renderers.{module}").Renderer(scene, variant)
    pictures = [renderer.all(scene.views[0])]
    setup = time.perf_counter() - begin
    pictures += [renderer.all(view) for view in scene.views[1:]]
    rgb, depth, ids = (np.stack(image) for image in zip(*pictures, strict=True))
    np.savez(out, rgb=rgb.astype(np.uint8), depth=depth.astype(np.float32), ids=ids.astype(np.uint32))
    modes = {name: getattr(renderer, name, None) for name in ("color", "all", "depth_ids")}
    fps = {name: rounds_of(draw, scene.views, rounds) for name, draw in modes.items() if draw is not None}
    return {"setup": setup, "fps": fps}


def main(arguments: list[str]) -> None:
    """The package comes first, so that one that is missing says so by itself."""
    module, variant, folder, out, rounds = arguments
    print(json.dumps(measure(module, variant, Scene.load(Path(folder)), Path(out), int(rounds))))


if __name__ == "__main__":
    main(sys.argv[1:])
