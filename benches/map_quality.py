"""How well the Gaussian map predicts views that it has not seen.

Per scene: 1000 iterations on the four seed views, then ten moves of a random walk with 400 iterations each.
After every refinement the map is drawn at two sets of twelve held-out viewpoints that the path did not visit,
evenly spaced in ring order:

- ring: one node from a viewpoint of the path, at the same pitch;
- tilt: one pitch step from a viewpoint of the path, at the same node. These look 15 degrees further up or
  down, so that part of what they show was in no picture.

Beside them, the training views: the oldest (mean of the seeds), the newest one, and all.

    python benches/map_quality.py                     # both textured scenes, known poses
    python benches/map_quality.py --config '{"schedule": "official"}'
    python benches/map_quality.py --config '{"fine_iterations": null}'   # fast, but at full resolution
    python benches/map_quality.py --registration colmap --scenes train_workshop
    python benches/map_quality.py --plot docs/images/views.png           # old and new views over the moves
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from plot import Panel, save

from fuse_grounding import splat
from fuse_grounding.config import MapConfig
from fuse_grounding.environment import TabletopEnvironment, make_episode
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.registration import ColmapRegistrar, PosedRegistrar

NODES, PITCHES, NO_OP = 36, 3, 7
HELD_OUT = 12

Viewpoint = tuple[int, int]


def place(view: Observation) -> Viewpoint:
    """Node and pitch index of an observation."""
    assert view.node is not None
    assert view.pitch_index is not None
    return view.node, view.pitch_index


def go(environment: TabletopEnvironment, start: Viewpoint, goal: Viewpoint) -> None:
    """Acts until the camera is at `goal`."""
    node, pitch = start
    while (node, pitch) != goal:
        ahead = (goal[0] - node + NODES // 2) % NODES - NODES // 2
        step, tilt = int(np.clip(ahead, -2, 2)), int(np.clip(goal[1] - pitch, -1, 1))
        environment.act(5 * (tilt + 1) + step + 2)
        node, pitch = (node + step) % NODES, pitch + tilt


def held_out_places(path: list[Viewpoint], kind: str) -> list[Viewpoint]:
    """Twelve viewpoints next to the path and not on it, evenly spaced in ring order."""
    if kind == "ring":
        near = {((n + d) % NODES, p) for n, p in path for d in (-1, 1)}
    else:
        near = {(n, p + d) for n, p in path for d in (-1, 1) if 0 <= p + d < PITCHES}
    candidates = sorted(near - set(path))
    count = min(HELD_OUT, len(candidates))
    return [candidates[i * len(candidates) // count] for i in range(count)]


def walk(environment: TabletopEnvironment, moves: int, rng: np.random.Generator) -> Iterator[Observation]:
    """`moves` views along random feasible actions."""
    for _ in range(moves):
        mask = environment.action_mask().copy()
        mask[NO_OP] = False
        environment.act(int(rng.choice(np.flatnonzero(mask))))
        yield environment.observe()


class Judge:
    """The held-out views."""

    def __init__(self, kind: str, scene: str, seed: int, start: Viewpoint, path: list[Viewpoint]) -> None:
        environment, at = TabletopEnvironment(make_episode("cut", scene, seed)), start
        self.views: list[Observation] = []
        for goal in held_out_places(path, kind):
            go(environment, at, goal)
            self.views.append(environment.observe())
            at = goal

    def flat(self) -> float:
        """Mean PSNR of the one colour that fits each view best."""
        means = [
            np.broadcast_to(v.rgb.mean((0, 1)) / 255, v.rgb.shape).astype(np.float32) for v in self.views
        ]
        return float(np.mean([splat.psnr(m, v.rgb) for m, v in zip(means, self.views, strict=True)]))

    def mapped(self, gaussians: splat.Gaussians) -> list[float]:
        """PSNR of the map's prediction of each view."""
        drawn = (
            np.rint(splat.render(gaussians, v.camera)[0] * 255).astype(np.uint8)
            for v in self.views
            if v.camera
        )
        return [splat.psnr(d, v.rgb) for d, v in zip(drawn, self.views, strict=True)]

    def save(self, gaussians: splat.Gaussians, path: Path) -> None:
        """Three held-out views, observed above and predicted below."""
        chosen = self.views[:: max(1, len(self.views) // 3)][:3]
        drawn = [
            np.rint(splat.render(gaussians, v.camera)[0] * 255).astype(np.uint8) for v in chosen if v.camera
        ]
        sheet = np.vstack([np.hstack([v.rgb for v in chosen]), np.hstack(drawn)])
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))


def run(scene: str, options: argparse.Namespace) -> dict[str, Any]:
    """One scene: seeds, walk, refinements; prints a line for each."""
    environment = TabletopEnvironment(make_episode("cut", scene, options.seed))
    start = place(environment.observe())
    seeds = list(environment.seed_observations())
    views = list(walk(environment, options.moves, np.random.default_rng(options.seed)))
    path = [place(v) for v in seeds + views]
    judge, tilted = (Judge(kind, scene, options.seed, start, path) for kind in ("ring", "tilt"))
    flat = judge.flat()

    registrar = ColmapRegistrar() if options.registration == "colmap" else PosedRegistrar()
    registrar.initialize(seeds)
    ids, xyz, rgb = registrar.points_by_id()
    known = set(ids.tolist())
    config = MapConfig(**json.loads(options.config))
    trainer = splat.Trainer(splat.Gaussians.from_points(xyz, rgb), config)
    for seed_view, registered in zip(seeds, registrar.views(), strict=True):
        trainer.add_view(seed_view.rgb, registered.camera)
    print(
        f"{scene}: {len(xyz)} points from {len(seeds)} seeds; "
        f"one flat colour {flat:.2f} dB (tilted {tilted.flat():.2f})"
    )

    lines = []
    for step in range(len(views) + 1):
        if step > 0:
            registrar.register(views[step - 1])
            cameras = [v.camera for v in registrar.views()]
            for index, camera in enumerate(cameras[:-1]):
                trainer.set_camera(index, camera)
            trainer.add_view(views[step - 1].rgb, cameras[-1])
            if not options.no_points:
                ids, xyz, rgb = registrar.points_by_id()
                new = np.array([i not in known for i in ids.tolist()], bool)
                if new.any():
                    trainer.add_points(xyz[new], rgb[new])
                known.update(ids.tolist())
        begin = time.perf_counter()
        stats = trainer.refine(options.first if step == 0 else options.each)
        seconds = time.perf_counter() - begin
        views_so_far = zip(seeds + views[:step], registrar.views(), strict=True)
        trained = [splat.quality(trainer.gaussians, r.camera, v.rgb)[0] for v, r in views_so_far]
        values, tilts = judge.mapped(trainer.gaussians), tilted.mapped(trainer.gaussians)
        line = {
            "step": step,
            "psnr": float(np.mean(values)),
            "psnr_worst": min(values),
            "psnr_tilt": float(np.mean(tilts)),
            "psnr_oldest": float(np.mean(trained[: len(seeds)])),
            "psnr_newest": trained[-1],
            "psnr_trained": float(np.mean(trained)),
            "gaussians": stats.gaussians,
            "seconds": seconds,
            "stage_seconds": stats.stage_seconds,
        }
        lines.append(line)
        print(
            f"  {step:2d}: held out {line['psnr']:.2f} dB (worst {line['psnr_worst']:.2f}), "
            f"tilted {line['psnr_tilt']:.2f} dB; trained on, oldest {line['psnr_oldest']:.2f}, "
            f"newest {line['psnr_newest']:.2f}, all {line['psnr_trained']:.2f} dB; "
            f"loss {stats.loss:.4f}, {stats.gaussians} Gaussians, {seconds:.1f} s",
            flush=True,
        )
        if options.pictures:
            judge.save(trainer.gaussians, Path(options.pictures) / f"{scene}_{step:02d}.png")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"  {lines[-1]['psnr'] - flat:+.2f} dB over one flat colour; peak memory {peak:.0f} MiB")
    return {"scene": scene, "flat_psnr": flat, "refinements": lines, "peak_mib": peak}


def panel(result: dict[str, Any]) -> Panel:
    """PSNR over the moves of one scene."""
    names = {"oldest four views": "psnr_oldest", "newest view": "psnr_newest", "held out": "psnr"}
    lines = {
        name: [(float(line["step"]), line[key]) for line in result["refinements"]]
        for name, key in names.items()
    }
    return Panel(result["scene"], "moves", "PSNR, dB", lines)


def main() -> None:
    """Parses the command line and runs the scenes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="+", default=["train_workshop", "dev_kitchen"])
    parser.add_argument("--registration", choices=["posed", "colmap"], default="posed")
    parser.add_argument("--moves", type=int, default=10)
    parser.add_argument("--first", type=int, default=1000, help="iterations on the seed views")
    parser.add_argument("--each", type=int, default=400, help="iterations after each further view")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-points", action="store_true", help="do not add newly triangulated points")
    parser.add_argument("--config", default="{}", help="settings of the map as JSON")
    parser.add_argument("--pictures", help="write observed and predicted views to this folder")
    parser.add_argument("--plot", help="draw the PSNR of old, new and held-out views to this PNG")
    parser.add_argument("--json", help="write the figures to this file")
    options = parser.parse_args()
    results = [run(scene, options) for scene in options.scenes]
    if options.plot:
        save(Path(options.plot), [panel(result) for result in results])
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(results, file, indent=1)


if __name__ == "__main__":
    main()
