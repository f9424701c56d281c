"""Small worlds and parts whose every answer is known, for tests of the loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding import knowledge
from fuse_grounding._core import Camera
from fuse_grounding.benchmark.methods import resolve
from fuse_grounding.config import Config
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.parts import Parts, Spatial
from fuse_grounding.perception.protocol import Detection
from fuse_grounding.planning.explicit import evidence_maps
from fuse_grounding.planning.protocol import Rendering
from fuse_grounding.record import MapEntry, Stopwatch
from fuse_grounding.registration.protocol import RegisteredView

HEIGHT, WIDTH = 48, 64
CONFIG = Config().with_(camera={"width": WIDTH, "height": HEIGHT}, stopping={"min_region_px": 50})
LABELS = ("knife", "scissors", "ruler", "mug")

Score = Callable[[int, int], float]
"""(node, pitch index) -> segmentation score of the knife there."""


def camera(node: int, pitch_index: int) -> Camera:
    """A camera on a circle of 1 m at 1 m height that looks at the origin's vertical axis."""
    azimuth, pitch = math.radians(10 * node), math.radians((15, 30, 45)[pitch_index])
    center = np.array([math.cos(azimuth), math.sin(azimuth), 1.0])
    inward = -np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    forward = math.cos(pitch) * inward - math.sin(pitch) * np.array([0, 0, 1.0])
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera(WIDTH, HEIGHT, 60.0, 60.0, WIDTH / 2, HEIGHT / 2, rotation, -rotation @ center)


class World:
    """A ring of pictures: the node and the pitch are written into the first pixel.

    Instance ids are there, as a careless world would leave them, to see that nobody gets them.
    """

    def __init__(self, node: int = 0, pitch_index: int = 1, depth: float | None = 0.75):
        self.node, self.pitch_index, self.depth = node, pitch_index, depth
        self.acts: list[int] = []

    def _look(self, node: int, pitch_index: int) -> Observation:
        rgb = np.random.default_rng(3 * node + pitch_index).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
        rgb[0, 0] = (node, pitch_index, 0)
        depth = None if self.depth is None else np.full((HEIGHT, WIDTH), self.depth, np.float32)
        ids = np.ones((HEIGHT, WIDTH), np.uint32)
        return Observation(rgb, depth, ids, camera(node, pitch_index), node, pitch_index)

    def observe(self) -> Observation:
        return self._look(self.node, self.pitch_index)

    def action_mask(self) -> np.ndarray:
        return np.repeat([self.pitch_index > 0, True, self.pitch_index < 2], 5)

    def act(self, action: int) -> None:
        assert self.action_mask()[action]
        self.acts.append(action)
        self.node = (self.node + action % 5 - 2) % 36
        self.pitch_index += action // 5 - 1

    def seed_observations(self) -> list[Observation]:
        return [self._look((self.node + o) % 36, 1) for o in (-2, -1, 1, 2)]

    def canonical_observation(self) -> Observation:
        seen = self._look(35, 2)
        return Observation(seen.rgb, seen.depth, seen.instance, seen.camera)

    def oracle_target(self) -> str:
        return "ruler"

    def oracle_valid(self) -> Sequence[str]:
        return ("knife", "ruler")


class Seer:
    """Finds a knife wherever `score` is positive: a block of 20x20 pixels left of the middle."""

    labels = LABELS

    def __init__(self, score: Score):
        self._score = score
        self.seen: list[tuple[int, int]] = []

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        node, pitch_index = int(rgb[0, 0, 0]), int(rgb[0, 0, 1])
        self.seen.append((node, pitch_index))
        value = self._score(node, pitch_index)
        if value <= 0 or "knife" not in labels:
            return []
        mask = np.zeros((HEIGHT, WIDTH), bool)
        mask[14:34, 5:25] = True
        return [Detection("knife", value, mask)]


class Registrar:
    """Knows every pose."""

    def __init__(self) -> None:
        self.observations: list[Observation] = []

    def initialize(self, seeds: Sequence[Observation]) -> list[RegisteredView]:
        self.observations = list(seeds)
        return self.views()

    def register(self, observation: Observation) -> RegisteredView:
        self.observations.append(observation)
        return self.views()[-1]

    def views(self) -> list[RegisteredView]:
        return [RegisteredView(o.camera, "posed") for o in self.observations if o.camera is not None]

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros((10, 3)), np.zeros((10, 3), np.uint8)


class GreyMap:
    """Renders grey once it was refined."""

    def __init__(self) -> None:
        self.seeds = self.views = self.refinements = 0

    def add_seed(self, rgb: np.ndarray) -> None:
        self.seeds += 1

    def add(self, rgb: np.ndarray) -> None:
        self.views += 1

    def refine(self, clock: Stopwatch) -> None:
        with clock("refine"):
            self.refinements += 1

    def render(self, camera: Any) -> Rendering | None:
        return Rendering(np.full((HEIGHT, WIDTH, 3), 0.5, np.float32), 1.0) if self.refinements else None

    def entry(self) -> MapEntry | None:
        return MapEntry(gaussians=10, views=self.views + self.seeds, refinements=self.refinements)

    def save(self, path: Path) -> None:
        path.write_bytes(b"ply")


class Kit:
    """Parts for a method, with the doubles at hand."""

    def __init__(self, method: str, score: Score, config: Config = CONFIG, policy: Any = None):
        chosen, self.config = resolve(config.with_(method=method))
        self.seer, self.registrar, self.map = Seer(score), Registrar(), GreyMap()
        self.parts = Parts(
            understand=knowledge.parse,
            knowledge=knowledge.make(self.config.knowledge),
            segmenter=self.seer,
            policy=lambda episode: policy or chosen.policy(self.config, episode),
            spatial=lambda: Spatial(self.registrar, self.map) if chosen.maps else None,
            look=lambda situation, rendered: evidence_maps(situation, rendered, self.config),
            provenance={},
        )
