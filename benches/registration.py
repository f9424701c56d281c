"""Registration over random walks: how many views register, how well, and how fast.

Each walk: four seed views, the start view, then random moves among the feasible actions. The registrar is not
told the poses of the views after the seeds, so that a view counts as registered only when COLMAP placed it.

    python benches/registration.py                                  # 20 walks of 10 moves over four scenes
    python benches/registration.py --profile paper --walks 1
    python benches/registration.py --world twin                     # the tests' ray-cast room instead
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding._core import Camera
from fuse_grounding.environment.protocol import Environment, Observation
from fuse_grounding.errors import InputError
from fuse_grounding.registration import ColmapRegistrar, RegistrationError

SCENES = ("train_workshop", "dev_kitchen", "train_study", "dev_plain_table")
VERB = "cut"
NO_OP = 7


@dataclass
class View:
    """One registered view of a walk, judged."""

    scene: str
    walk: int
    node: int
    pitch_index: int
    registered: bool
    seconds: float
    cpu_seconds: float
    millimetres: float = float("nan")
    degrees: float = float("nan")


class TwinEnvironment:
    """The tests' ray-cast tabletop as an environment."""

    def __init__(self, contrast: float, seed: int) -> None:
        sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "python"))
        import tabletop_twin

        self._twin = tabletop_twin
        self._faces = tabletop_twin.scene(seed, contrast)
        self._node, self._pitch = seed * 7 % 36, 1

    def observe(self) -> Observation:
        """The view from here."""
        return self._twin.observe(self._faces, self._node, self._pitch)

    def action_mask(self) -> np.ndarray:
        """(15,) bool."""
        pitches = self._pitch + np.repeat([-1, 0, 1], 5)
        return (pitches >= 0) & (pitches <= 2)

    def act(self, action: int) -> None:
        """Moves."""
        self._node, self._pitch = (self._node + action % 5 - 2) % 36, self._pitch + action // 5 - 1

    def seed_observations(self) -> list[Observation]:
        """Four views around here."""
        return self._twin.seeds(self._faces, self._node)


def twin_world(scene: str, seed: int) -> Environment:
    """The ray-cast room with a strongly or weakly textured table."""
    return TwinEnvironment({"strong": 14.0, "weak": 2.0, "faint": 0.8}[scene], seed)


def tabletop_world(scene: str, seed: int) -> Environment:
    """A generated episode in one of the scene configurations."""
    from fuse_grounding.environment import TabletopEnvironment, make_episode

    for turn in range(3):
        try:
            return TabletopEnvironment(make_episode(VERB, scene, seed + 1000 * turn))
        except InputError as error:  # No layout of this seed hides a target.
            print(error, file=sys.stderr)
    raise InputError(f"no episode in {scene} with seed {seed}")


def errors(found: Camera, true: Camera) -> tuple[float, float]:
    """Millimetres between the centres, degrees between the orientations."""
    turn = found.rotation @ true.rotation.T
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    return 1e3 * float(np.linalg.norm(found.center - true.center)), float(angle)


def observations(environment: Environment, moves: int, rng: np.random.Generator) -> Iterator[Observation]:
    """The start view and `moves` more."""
    yield environment.observe()
    for _ in range(moves):
        mask = environment.action_mask().copy()
        mask[NO_OP] = False
        environment.act(int(rng.choice(np.flatnonzero(mask))))
        yield environment.observe()


def run_walk(
    make: Callable[[], ColmapRegistrar], environment: Environment, moves: int, scene: str, walk: int
) -> tuple[list[View], dict[str, Any]]:
    """Judges every view after the walk's last adjustment; also what became of the seeds."""
    registrar = make()
    seen_first = environment.seed_observations()
    began = time.perf_counter()
    seeds = registrar.initialize(seen_first)
    start_seconds = time.perf_counter() - began
    views: list[View] = []
    truth: list[Camera] = []
    for seen in observations(environment, moves, np.random.default_rng(walk)):
        assert seen.camera is not None
        assert seen.node is not None
        assert seen.pitch_index is not None
        began, began_cpu = time.perf_counter(), time.process_time()
        try:
            registrar.register(replace(seen, camera=None))
            registered = True
        except RegistrationError:
            registered = False
        seconds, cpu = time.perf_counter() - began, time.process_time() - began_cpu
        views.append(View(scene, walk, seen.node, seen.pitch_index, registered, seconds, cpu))
        if registered:
            truth.append(seen.camera)
    placed = registrar.views()[len(seeds) :]
    for view, found, true in zip([v for v in views if v.registered], placed, truth, strict=True):
        view.registered = found.status == "colmap"
        view.millimetres, view.degrees = errors(found.camera, true)
    colmap_seeds = sum(seed.status == "colmap" for seed in seeds)
    summary = {"seeds": colmap_seeds, "start_seconds": start_seconds, "points": len(registrar.points()[0])}
    return views, summary


def table_row(name: str, views: list[View], walks: list[dict[str, Any]]) -> dict[str, Any]:
    """The figures of one scene, or of all."""
    good = [v for v in views if v.registered]
    off = np.array([v.millimetres for v in good] or [np.nan])
    return {
        "scene": name,
        "walks": len(walks),
        "views": len(views),
        "registered": len(good) / len(views),
        "seeds_registered": float(np.mean([w["seeds"] for w in walks])) / 4,
        "position_median_mm": float(np.median(off)),
        "position_p95_mm": float(np.quantile(off, 0.95)),
        "position_max_mm": float(off.max()),
        "rotation_median_deg": float(np.median([v.degrees for v in good] or [np.nan])),
        "view_median_seconds": float(np.median([v.seconds for v in views])),
        "view_median_cpu_seconds": float(np.median([v.cpu_seconds for v in views])),
        "start_median_seconds": float(np.median([w["start_seconds"] for w in walks])),
        "points_median": float(np.median([w["points"] for w in walks])),
    }


def print_table(rows: list[dict[str, Any]]) -> None:
    """The rows for a person."""
    print(
        f"{'scene':18} {'walks':>5} {'views':>5} {'registered':>10} {'mm median':>9} {'p95':>6} {'max':>6} "
        f"{'degrees':>7} {'s a view':>8} {'CPU s':>6} {'s start':>7} {'points':>6}"
    )
    for r in rows:
        print(
            f"{r['scene']:18} {r['walks']:5d} {r['views']:5d} {r['registered']:10.1%} "
            f"{r['position_median_mm']:9.2f} {r['position_p95_mm']:6.2f} {r['position_max_mm']:6.1f} "
            f"{r['rotation_median_deg']:7.3f} {r['view_median_seconds']:8.3f} "
            f"{r['view_median_cpu_seconds']:6.3f} {r['start_median_seconds']:7.2f} {r['points_median']:6.0f}"
        )


def main() -> None:
    """Parses, walks, prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--world", choices=("tabletop", "twin"), default="tabletop")
    parser.add_argument("--scenes", nargs="+", help="which scenes; the twin has strong, weak and faint")
    parser.add_argument("--profile", choices=("fast", "paper"), default="fast")
    parser.add_argument("--walks", type=int, default=20, help="spread over the scenes in turn")
    parser.add_argument("--moves", type=int, default=10)
    parser.add_argument("--json", type=Path, help="write the figures and every view here")
    parser.add_argument("--verbose", action="store_true", help="a line for every view")
    arguments = parser.parse_args()
    world = twin_world if arguments.world == "twin" else tabletop_world
    scenes = arguments.scenes or (("strong", "weak") if arguments.world == "twin" else SCENES)
    views: list[View] = []
    walks: list[tuple[str, dict[str, Any]]] = []
    for walk in range(arguments.walks):
        scene = scenes[walk % len(scenes)]
        found, summary = run_walk(
            lambda: ColmapRegistrar(profile=arguments.profile),
            world(scene, walk),
            arguments.moves,
            scene,
            walk,
        )
        views += found
        walks.append((scene, summary))
        print(
            f"walk {walk + 1}/{arguments.walks} {scene}: {sum(v.registered for v in found)} of {len(found)}, "
            f"{summary}",
            file=sys.stderr,
        )
        if arguments.verbose:
            for v in found:
                print("   ", v, file=sys.stderr)
    rows = []
    for scene in dict.fromkeys(s for s, _ in walks):
        rows.append(
            table_row(scene, [v for v in views if v.scene == scene], [w for s, w in walks if s == scene])
        )
    rows.append(table_row("all", views, [w for _, w in walks]))
    print_table(rows)
    if arguments.json:
        arguments.json.write_text(
            json.dumps({"rows": rows, "views": [vars(v) for v in views]}, indent=1) + "\n"
        )


if __name__ == "__main__":
    main()
