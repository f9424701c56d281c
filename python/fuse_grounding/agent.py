"""Algorithm 1: observe, register, segment, ground, stop or plan, act.

`Agent.run` is a loop over an environment; `Agent.start` turns the same loop inside out for a robot
that owns its camera: each `Session.step` takes a picture and returns a move or the grounding. What
the stages are made of is decided in `assembly`; here is their order.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fuse_grounding import evidence, grounding, intake, ledger
from fuse_grounding.arguments import whole
from fuse_grounding.config import Config
from fuse_grounding.environment.blind import Blind
from fuse_grounding.environment.protocol import Environment, Observation
from fuse_grounding.errors import InputError
from fuse_grounding.grounding import Grounded, Move, SeedRequest, Viewpoint
from fuse_grounding.knowledge.protocol import Confidant
from fuse_grounding.knowledge.vocabulary import nothing_known
from fuse_grounding.parts import Glance, Parts, Watcher, surer
from fuse_grounding.perception.protocol import Detection, Segmenter
from fuse_grounding.planning.protocol import Decision, EvidenceMaps, Situation, check_decision, check_policy
from fuse_grounding.record import HOSTED, StepEntry, Stopwatch
from fuse_grounding.registration.protocol import RegisteredView


class Agent:
    """Finds the object that serves a functional query by moving a camera.

    `config` is the one it runs by; `provenance` the versions and weights that its records name.
    """

    def __init__(self, config: Config | None = None, parts: Parts | None = None):
        """`parts` are assembled from the configuration unless given. Raises InputError."""
        config = config or Config()
        if parts is None:
            from fuse_grounding.assembly import assemble  # brings in the network and COLMAP

            parts, config = assemble(config)
        self.config, self._parts, self.provenance = config, parts, parts.provenance

    @property
    def segmenter(self) -> Segmenter:
        """What finds the candidates."""
        return self._parts.segmenter

    def start(
        self,
        query: str,
        *,
        node: int | None = None,
        pitch_index: int = 1,
        episode_index: int = 0,
        world: Confidant | None = None,
        watchers: Sequence[Watcher] = (),
    ) -> Session:
        """A search for a robot that owns its camera, which stands at `node` and `pitch_index`.

        `world` is asked by the oracle knowledge source alone. Raises InputError for a query not understood.
        """
        return Session(self.config, self._parts, query, (node, pitch_index), episode_index, world, watchers)

    def run(
        self, env: Environment, query: str, *, episode_index: int = 0, watchers: Sequence[Watcher] = ()
    ) -> Grounded:
        """One whole episode in an environment. Raises InputError."""
        env = Blind(env)
        world: Any = env if hasattr(env, "oracle_target") else None
        session = self.start(query, episode_index=episode_index, world=world, watchers=watchers)
        if session.seed_requests:
            with session.clock("observe"):
                seeds = env.seed_observations()
            for seed in seeds:
                session.add_seed(seed.rgb, seed.depth, seed.camera, seed.node, seed.pitch_index)
        with session.clock("observe"):
            seen = session.first_view(env)
        while True:
            mask = env.action_mask()
            turn = session.step(
                seen.rgb, seen.depth, seen.camera, mask, node=seen.node, pitch_index=seen.pitch_index
            )
            if isinstance(turn, Grounded):
                return turn
            with session.clock("act"):
                env.act(turn.action)
            with session.clock("observe"):
                seen = env.observe()


class Session:
    """One search. `record` is the episode so far, `glance` the last view, `best` the best scored one;
    `grounded` and `returned`, the grounding and its view, are there when the search is over."""

    def __init__(
        self,
        config: Config,
        parts: Parts,
        query: str,
        position: tuple[int | None, int],
        episode_index: int,
        world: Confidant | None,
        watchers: Sequence[Watcher],
    ):
        self._began, self.clock = time.perf_counter(), Stopwatch()
        self._config, self._parts, self._watchers = config, parts, watchers
        node, pitch_index = position
        self._node = None if node is None else whole("node", node, 0, config.camera.nodes - 1)
        self._visited: list[tuple[int, int]] = []
        self._ring = 0
        self._pitch_index = whole("pitch_index", pitch_index, 0, len(config.camera.pitches_deg) - 1)
        whole("episode_index", episode_index)
        self.query = parts.understand(query)
        self.hypotheses = parts.knowledge.hypotheses(self.query, parts.segmenter.labels, world)
        self.policy = check_policy(parts.policy(episode_index))
        self.spatial = parts.spatial() if self.hypotheses.candidates else None
        self._patience = evidence.Patience(config.stopping.patience)
        self._seeds: list[Observation] = []
        self.glance: Glance | None = None
        self.best: Glance | None = None
        self._runner_up: Glance | None = None
        self.returned: Glance | None = None
        self.grounded: Grounded | None = None
        self.record = ledger.open_record(config, parts, self.query, self.hypotheses)
        if self.hypotheses.api_seconds:
            self.clock.add(HOSTED, self.hypotheses.api_seconds)
        self.record.announcements += ledger.opening(self.policy, world)
        self._tell(lambda watcher: watcher.started(self))

    def announce(self, sentence: str) -> None:
        """Puts into the record, once, what a reader must know."""
        if sentence not in self.record.announcements:
            self.record.announcements.append(sentence)

    # -- before the first step -----------------------------------------------------------------

    @property
    def seed_requests(self) -> list[SeedRequest]:
        """Views still wanted before the first step; empty for methods without a map."""
        camera = self._config.camera
        offsets = camera.seed_offsets if self.spatial is not None else ()
        return [SeedRequest(ring, camera.seed_pitch_index) for ring in offsets[len(self._seeds) :]]

    def add_seed(
        self,
        rgb: np.ndarray,
        depth: np.ndarray | None = None,
        pose: Any = None,
        node: int | None = None,
        pitch_index: int | None = None,
    ) -> None:
        """The next of `seed_requests`; the last one registers them all. Raises InputError."""
        if not self.seed_requests:
            raise InputError("no seed view is wanted: all were given, or the method keeps no map")
        request = self.seed_requests[0]
        if node is None and self._node is not None:
            node = (self._node + request.ring) % self._config.camera.nodes
        pitch_index = request.pitch_index if pitch_index is None else pitch_index
        self._seeds.append(intake.take_in(self._config.camera, rgb, depth, pose, node, pitch_index))
        if not self.seed_requests:
            self._register_seeds()

    def _register_seeds(self) -> None:
        assert self.spatial is not None
        with self.clock("initialize"):
            views = self.spatial.registrar.initialize(self._seeds)
            points, _ = self.spatial.registrar.points()
        for seed in self._seeds:
            self.spatial.map.add_seed(seed.rgb)
        self.record.initialization = ledger.initialization(
            self._config, self._seeds, views, len(points), self.clock.take()
        )

    def first_view(self, env: Any) -> Observation:
        """The first online view: from where the camera is, or the canonical one."""
        if self.policy.start == "here":
            return env.observe()
        if not hasattr(env, "canonical_observation"):
            raise InputError("this environment has no canonical view; choose another method")
        return env.canonical_observation()

    # -- the loop --------------------------------------------------------------------------------

    def step(
        self,
        rgb: np.ndarray,
        depth: np.ndarray | None = None,
        pose: Any = None,
        action_mask: np.ndarray | None = None,
        *,
        node: int | None = None,
        pitch_index: int | None = None,
    ) -> Move | Grounded:
        """Takes in one picture; returns where to look next, or the grounding when the search is over.

        `rgb` (H, W, 3) uint8, `depth` (H, W) metres, `pose` a Camera or a (4, 4) world-to-camera
        matrix; `action_mask` (15,) bool, without it the session keeps its own account of the pitch.
        Raises InputError for pictures that do not fit, missing seed views or a search that is over.
        """
        seen, feasible = self._take_in(rgb, depth, pose, action_mask, node, pitch_index)
        registered = self._register(seen)
        with self.clock("segment"):
            detections = self._parts.segmenter.segment(seen.rgb, self.hypotheses.labels)
        with self.clock("ground"):
            step, view = self._ground(seen, registered, detections)
        if (reason := nothing_known(self.hypotheses) or self._stop_reason(step)) is not None:
            return self._finish(step, reason)
        made = self.policy.decide(self._situation(view, feasible), self.clock)
        decision = check_decision(self.policy, made)
        ledger.note(self.record, step, decision)
        self._keep(step, decision.maps)
        if decision.action is None:
            return self._finish(step, decision.reason)
        self._close(step)
        return self._move(decision, decision.action)

    def _take_in(
        self, rgb: Any, depth: Any, pose: Any, mask: Any, node: int | None, pitch_index: int | None
    ) -> tuple[Observation, np.ndarray]:
        """Checks what came in; the observation and the feasible actions."""
        if self.grounded is not None:
            raise InputError("this search is over; start another session")
        if self.seed_requests:
            raise InputError(
                f"this method needs {len(self.seed_requests)} more seed views before the first step "
                "(Session.seed_requests, Session.add_seed)"
            )
        if self.policy.start == "canonical":
            node, pitch_index = None, None
        else:
            node = self._node if node is None else node
            pitch_index = self._pitch_index if pitch_index is None else pitch_index
        seen = intake.take_in(self._config.camera, rgb, depth, pose, node, pitch_index)
        feasible = None if mask is None else intake.action_mask(mask)
        # All is sound: only now is it believed.
        self._node = self._node if seen.node is None else seen.node
        self._pitch_index = self._pitch_index if seen.pitch_index is None else seen.pitch_index
        self._visited.append((self._ring if self._node is None else self._node, self._pitch_index))
        if seen.depth is None:
            self.announce("no depth: depth terms of score and evidence are off, the object is not located")
        elif seen.camera is None and self.spatial is None:
            self.announce("no pose: the object is not located in the world")
        if feasible is None:
            feasible = intake.pitch_mask(self._pitch_index, len(self._config.camera.pitches_deg))
        return seen, feasible

    def _register(self, seen: Observation) -> RegisteredView | None:
        """Adds the view to reconstruction and map; None for methods with neither."""
        if self.spatial is None:
            return None
        with self.clock("register"):
            registered = self.spatial.registrar.register(seen)
        self.spatial.map.add(seen.rgb)
        return registered

    def _ground(
        self, seen: Observation, registered: RegisteredView | None, detections: list[Detection]
    ) -> tuple[StepEntry, Glance]:
        """Scores the detections, keeps the best view, counts patience."""
        index, pitch = len(self.record.steps), ledger.pitch_deg(self._config, seen)
        scored = grounding.score(detections, seen.depth, self._config.stopping)
        camera = registered.camera if registered is not None else seen.camera
        self.glance = Glance(seen, Viewpoint(index, seen.node, pitch, camera), scored)
        best, improved = grounding.best_fused(scored), False
        if index > 0 or self._config.return_.include_initial:
            counts = best or self.best or self._config.stopping.rule != "patience_once_found"
            improved = bool(counts) and self._patience.observe(None if best is None else best.fused)
            self.best = self.glance if improved else self.best
            self._runner_up = surer(self._runner_up, self.glance)
        step = StepEntry(
            index=index,
            node=seen.node,
            pitch_deg=pitch,
            registration=None if registered is None else registered.status,
            scores=grounding.score_entries(scored),
            best_score=self._best_score(),
            improved=improved,
        )
        return step, self.glance

    def _best_score(self) -> float | None:
        best = None if self.best is None else grounding.best_fused(self.best.scored)
        return None if best is None else best.fused

    def _stop_reason(self, step: StepEntry) -> str | None:
        if self._patience.exhausted and self._config.stopping.rule != "policy":
            return f"patience: {self._config.stopping.patience} observations brought nothing better"
        if step.index >= self._config.budget.actions:
            return f"budget: {self._config.budget.actions} actions"
        return None

    def _situation(self, view: Glance, feasible: np.ndarray) -> Situation:
        return Situation(
            index=view.viewpoint.index,
            rgb=view.observation.rgb,
            feasible=feasible,
            candidates=self.hypotheses.candidates,
            detections=view.detections,
            camera=view.viewpoint.camera,
            scene=None if self.spatial is None else self.spatial.map,
            depth=view.observation.depth,
            pitch_index=view.observation.pitch_index,
            node=view.observation.node,
            visited=tuple(self._visited),
        )

    def _move(self, decision: Decision, action: int) -> Move:
        """The move for a decision, with the account of where it leads."""
        ring, pitch = action % 5 - 2, action // 5 - 1
        self._node = None if self._node is None else (self._node + ring) % self._config.camera.nodes
        self._ring += ring
        self._pitch_index += pitch
        return Move(action, ring, pitch, decision)

    # -- what is kept ----------------------------------------------------------------------------

    @property
    def leading(self) -> Glance | None:
        """The view that would be returned if the search ended now; None before the first one."""
        if self._config.return_.view == "final":
            return self.glance
        return self.best or self._runner_up or self.glance

    def _keep(self, step: StepEntry, maps: EvidenceMaps | None) -> None:
        """Attaches the evidence of a decision to the last view; under `explicit.every_step`, makes it."""
        assert self.glance is not None
        if maps is None and self.spatial is not None and self._config.explicit.every_step:
            self.spatial.map.refine(self.clock)
            with self.clock("evidence"):
                maps = self.evidence_of(self.glance)
        if maps is None:
            return
        step.functional_uncertainty, step.coverage = maps.functional_uncertainty, maps.coverage
        seen, self.glance = self.glance, replace(self.glance, maps=maps)
        self.best = self.glance if self.best is seen else self.best
        self._runner_up = self.glance if self._runner_up is seen else self._runner_up

    def evidence_of(self, view: Glance) -> EvidenceMaps:
        """Evidence of a view with the map as it is, for pictures; without a map, semantics alone."""
        situation = self._situation(view, np.ones(15, bool))
        if self.spatial is None:
            semantic = self._parts.look(situation, None).semantic
            return EvidenceMaps(semantic, None, semantic)
        return self._parts.look(situation, self.spatial.map.render(situation.camera))

    def _close(self, step: StepEntry) -> None:
        """The step is done: into the record, to the watchers."""
        step.map = None if self.spatial is None else self.spatial.map.entry()
        step.timings = self.clock.take()
        self.record.steps.append(step)
        self._tell(lambda watcher: watcher.stepped(self, step))

    def _finish(self, step: StepEntry, reason: str) -> Grounded:
        """The search is over: the best instance of the best view, and where it is."""
        if step.branch is None:
            self._keep(step, None)
        view = self.returned = self.leading
        assert view is not None
        with self.clock("ground"):
            fused = grounding.best_fused(view.scored)
            chosen = grounding.choose(view.scored, self._config.metric)
            mask, depth = None if chosen is None else chosen.detection.mask, view.observation.depth
            place = None if mask is None else grounding.locate(mask, depth, view.viewpoint.camera)
        if chosen is not None and self.best is None and view is self._runner_up:
            self.announce("no region was large enough to be scored; the surest smaller one is returned")
        self._close(step)
        self.grounded = Grounded(
            label=None if chosen is None else chosen.detection.label,
            mask=mask,
            rgb=view.observation.rgb,
            viewpoint=view.viewpoint,
            score=None if fused is None else fused.fused,
            instance_score=None if chosen is None else chosen.detection.score,
            place=place,
            record=self.record,
        )
        self.record.result = ledger.result(
            self.record,
            self.grounded,
            None if fused is None else fused.detection.label,
            reason,
            self.policy.planner,
            1 if self.policy.start == "canonical" else 0,
            time.perf_counter() - self._began,
        )
        grounded = self.grounded
        self._tell(lambda watcher: watcher.finished(self, grounded))
        return grounded

    def _tell(self, what: Callable[[Watcher], None]) -> None:
        """Tells the watchers; what they do with it is no part of the run's time."""
        began = time.perf_counter()
        for watcher in self._watchers:
            what(watcher)
        self._began += time.perf_counter() - began
