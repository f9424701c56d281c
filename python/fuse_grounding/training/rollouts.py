"""Walks through training scenes and measures each view: what a row of `transitions` is made of.

Every measurement is the real one: pictures from the renderer, registration by COLMAP, a map that is refined
at every view by the configured schedule, the segmenter, the encoder. The truth (ids, positions) serves q, v
and g alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from fuse_grounding._core import action_mask, apply_action, seed_viewpoints
from fuse_grounding.assembly import assemble
from fuse_grounding.benchmark.metrics import iou
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode, TabletopEnvironment
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.knowledge.protocol import Candidate
from fuse_grounding.mapping import ForkingRegistrar, GaussianMap
from fuse_grounding.perception.protocol import Detection, Encoder
from fuse_grounding.planning.context import nearest_candidate
from fuse_grounding.planning.protocol import Situation
from fuse_grounding.planning.summary import summarize
from fuse_grounding.record import Stopwatch
from fuse_grounding.training.transitions import Transitions, gains, utility

LENGTHS = np.arange(5, 14)
"""Actions of a walk. Supplement, "Planner Training Targets": 5 to 13."""
LENGTH_DECAY = 0.096
"""Longer walks are a little rarer, so that 416 of them make about 3,479 transitions, as the paper's do."""
_CHANCE = np.exp(-LENGTH_DECAY * (LENGTHS - LENGTHS[0]))
_CHANCE /= _CHANCE.sum()
NODES, PITCHES = 36, 3

Viewpoint = tuple[int, int]


@dataclass
class Spatial:
    """Registration and map of one walk, which can go two ways from here."""

    registrar: ForkingRegistrar
    map: GaussianMap

    def fork(self) -> Spatial:
        """A twin that goes its own way."""
        registrar = self.registrar.fork()
        return Spatial(registrar, self.map.fork(registrar))


@dataclass(frozen=True)
class State:
    """One view as it was measured; fields as in `Transitions`."""

    viewpoint: Viewpoint
    step: int
    feature: np.ndarray
    summary: np.ndarray
    levels: np.ndarray
    feasible: np.ndarray
    context: int


@dataclass(frozen=True)
class Walk:
    """States of one trajectory, and (before, action, after) by their places."""

    number: int
    candidates: tuple[str, ...]
    states: list[State]
    moves: list[tuple[int, int, int]]


class Prober:
    """What measures: an agent's parts, loaded once. `labels` are those of the transitions' `texts`."""

    def __init__(self, config: Config, encoder: Encoder, labels: Sequence[str]) -> None:
        self.parts, self.config = assemble(config.with_(method="explicit"))
        self.encoder, self.labels = encoder, tuple(labels)

    def candidates(self, episode: Episode) -> tuple[Candidate, ...]:
        """What the episode's query may mean; empty when the segmenter knows none of it."""
        query = self.parts.understand(episode.query)
        return self.parts.knowledge.hypotheses(query, self.parts.segmenter.labels, None).candidates

    def walk(
        self, number: int, episode: Episode, rng: np.random.Generator, actions: int | None = None
    ) -> Walk:
        """A random walk from a random viewpoint: `actions` (None: 5 to 13), each uniform over the feasible
        ones."""
        drawn = int(rng.choice(LENGTHS, p=_CHANCE))
        actions = drawn if actions is None else actions
        at = (int(rng.integers(NODES)), int(rng.integers(PITCHES)))
        scene = _Scene(self, episode, at)
        states = [scene.visit(scene.spatial, at, 0)]
        moves = []
        for step in range(1, actions + 1):
            action = int(rng.choice(np.flatnonzero(action_mask(*at))))
            at = apply_action(*at, action)
            states.append(scene.visit(scene.spatial, at, step))
            moves.append((step - 1, action, step))
        return Walk(number, scene.labels, states, moves)

    def survey(self, number: int, episode: Episode, visited: int, rng: np.random.Generator) -> Walk:
        """From the episode's start, `visited` states on a random walk, each with every feasible action
        measured."""
        at = episode.start
        scene = _Scene(self, episode, at)
        states = [scene.visit(scene.spatial, at, 0)]
        moves: list[tuple[int, int, int]] = []
        here = 0
        for step in range(1, visited + 1):
            feasible = np.flatnonzero(action_mask(*at))
            chosen = int(rng.choice(feasible))
            follow: tuple[int, Spatial, Viewpoint] | None = None
            for action in feasible.tolist():
                there, spatial = apply_action(*at, action), scene.spatial.fork()
                states.append(scene.visit(spatial, there, step))
                moves.append((here, action, len(states) - 1))
                if action == chosen:
                    follow = (len(states) - 1, spatial, there)
            assert follow is not None
            here, scene.spatial, at = follow
        return Walk(number, scene.labels, states, moves)

    def replay(self, episode: Episode, viewpoints: Sequence[Viewpoint]) -> Iterator[Situation]:
        """What a search knows at each of `viewpoints`, taken one after the other from the walk's start.

        All share one map, refined with the view when its situation is yielded: use each before the next.
        """
        scene = _Scene(self, episode, viewpoints[0])
        for step, at in enumerate(viewpoints):
            yield scene.look(scene.spatial, at, step)[0]


class _Scene:
    """An episode being walked through: its world, its truth, the map so far."""

    def __init__(self, prober: Prober, episode: Episode, start: Viewpoint) -> None:
        self._prober, self._config = prober, prober.config
        self._candidates = prober.candidates(episode)
        self.labels = tuple(c.label for c in self._candidates)
        self._world = TabletopEnvironment(episode, self._config.render.device, sensor=self._config.sensor)
        self._target = self._world.true_targets()[0]
        spatial = prober.parts.spatial()
        assert spatial is not None
        assert isinstance(spatial.map, GaussianMap)
        self.spatial = Spatial(cast(ForkingRegistrar, spatial.registrar), spatial.map)
        seeds = [replace(self._world.render_at(*v), instance=None) for v in seed_viewpoints(*start)]
        self.spatial.registrar.initialize(seeds)
        for seed in seeds:
            self.spatial.map.add_seed(seed.rgb)

    def look(self, spatial: Spatial, at: Viewpoint, step: int) -> tuple[Situation, Observation]:
        """Looks from `at` and takes the view into `spatial`; the observation has the truth."""
        seen = self._world.render_at(*at)
        blind = replace(seen, instance=None)
        registered = spatial.registrar.register(blind)
        spatial.map.add(seen.rgb)
        spatial.map.refine(Stopwatch())
        detections = self._prober.parts.segmenter.segment(seen.rgb, self.labels)
        situation = Situation(
            index=step,
            rgb=seen.rgb,
            feasible=action_mask(*at),
            candidates=self._candidates,
            detections=detections,
            camera=registered.camera,
            scene=spatial.map,
            depth=seen.depth,
            pitch_index=at[1],
        )
        return situation, seen

    def visit(self, spatial: Spatial, at: Viewpoint, step: int) -> State:
        """Looks, and measures."""
        situation, seen = self.look(spatial, at, step)
        feature = self._prober.encoder.image(seen.rgb)
        context = nearest_candidate(self._prober.encoder, feature, self.labels)
        return State(
            viewpoint=at,
            step=step,
            feature=feature,
            summary=summarize(situation, self._config),
            levels=self._levels(situation, seen),
            feasible=situation.feasible,
            context=self._prober.labels.index(context),
        )

    def _levels(self, situation: Situation, seen: Observation) -> np.ndarray:
        """(5,) s, u, q, v, g of a view."""
        assert situation.scene is not None
        assert seen.instance is not None
        assert seen.camera is not None
        maps = self._prober.parts.look(situation, situation.scene.render(situation.camera))
        assert maps.geometric is not None
        region = maps.semantic > 0
        uncertainty = maps.geometric[region] if region.any() else maps.geometric
        surest: Detection | None = max(situation.detections, key=lambda d: d.score, default=None)
        truth = seen.instance == self._target.instance
        distance = float(np.linalg.norm(seen.camera.center - self._target.position))
        far, near = 1.0 / self._target.most_distance, 1.0 / self._target.least_distance
        return np.array(
            [
                0.0 if surest is None else surest.score,
                uncertainty.mean(dtype=np.float64),
                0.0 if surest is None else iou(surest.mask, truth),
                np.count_nonzero(truth) / max(self._target.most_pixels, 1.0),
                np.clip((1.0 / distance - far) / max(near - far, 1e-9), 0.0, 1.0),
            ],
            np.float32,
        )


def tables(walk: Walk, texts: np.ndarray, labels: Sequence[str]) -> Transitions:
    """One trajectory as tables."""
    states = walk.states
    before, action, after = (np.array(column, np.int32) for column in zip(*walk.moves, strict=True))
    levels = np.stack([s.levels for s in states])
    terms = gains(levels[before], levels[after])
    known = np.array([label in walk.candidates for label in labels])
    return Transitions(
        texts=texts.astype(np.float16),
        number=np.array([walk.number], np.int32),
        feature=np.stack([s.feature for s in states]).astype(np.float16),
        summary=np.stack([s.summary for s in states]).astype(np.float16),
        levels=levels,
        feasible=np.stack([s.feasible for s in states]),
        context=np.array([s.context for s in states], np.int32),
        candidates=np.repeat(known[None], len(states), 0),
        viewpoint=np.array([s.viewpoint for s in states], np.int32),
        trajectory=np.zeros(len(states), np.int32),
        step=np.array([s.step for s in states], np.int32),
        before=before,
        after=after,
        action=action,
        terms=terms,
        utility=utility(terms),
    )
