from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fuse_grounding import evidence
from fuse_grounding.benchmark.methods import METHODS, resolve
from fuse_grounding.config import Config
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.knowledge.protocol import Candidate
from fuse_grounding.perception.protocol import Detection
from fuse_grounding.planning.explicit import Explicit, evidence_maps
from fuse_grounding.planning.options import leads_on
from fuse_grounding.planning.protocol import Rendering, Situation
from fuse_grounding.planning.random_walk import RandomWalk
from fuse_grounding.planning.sweep import Sweep
from fuse_grounding.record import Stopwatch
from fuse_grounding.registry import Registry

H, W = 40, 60


class Map:
    """Renders the picture itself, so that it explains everything, after `refine`."""

    def __init__(self, rgb: np.ndarray):
        self._rgb, self.calls = rgb, []  # type: ignore[var-annotated]

    def refine(self, clock: Stopwatch) -> None:
        self.calls.append("refine")

    def render(self, camera: object) -> Rendering:
        self.calls.append("render")
        return Rendering((self._rgb / np.float32(255)).astype(np.float32), 1.0)


def situation(mask: np.ndarray, scene: Map | None = None, rgb: np.ndarray | None = None) -> Situation:
    feasible = np.ones(15, bool)
    feasible[:5] = False  # the upper pitch: less far down is masked
    return Situation(
        index=0,
        rgb=texture() if rgb is None else rgb,
        feasible=feasible,
        candidates=[Candidate("knife", 1.0, "")],
        detections=[Detection("knife", 0.9, mask)],
        scene=scene,
    )


def texture() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 255, (H, W, 3), np.uint8)


def region(rows: slice, columns: slice) -> np.ndarray:
    mask = np.zeros((H, W), bool)
    mask[rows, columns] = True
    return mask


@pytest.mark.parametrize(
    ("rows", "columns", "action"),
    [
        (slice(0, 20), slice(45, 60), 8),  # upper right: one node to the right; up is masked
        (slice(20, 40), slice(0, 60), 12),  # the lower half: further down
        (slice(0, 20), slice(0, 15), 6),  # upper left: one node to the left
    ],
)
def test_semantic_evidence_pulls_the_camera_towards_it(rows: slice, columns: slice, action: int):
    decision = Explicit("semantic_only", Config()).decide(situation(region(rows, columns)), Stopwatch())
    assert decision.action == action
    assert decision.branch == "semantic_only"
    assert decision.values is not None
    masked = np.flatnonzero(np.isnan(decision.values))
    assert masked.tolist() == [0, 1, 2, 3, 4, 7]


def test_two_node_moves_and_staying_are_options():
    mask = region(slice(0, 40), slice(30, 60))
    two = Config().with_(explicit={"stride": "two"})
    assert Explicit("semantic_only", two).decide(situation(mask), Stopwatch()).action == 9
    everywhere = region(slice(0, 40), slice(0, 60))
    stay = Config().with_(explicit={"noop": True})
    decision = Explicit("semantic_only", stay).decide(situation(everywhere), Stopwatch())
    assert decision.values is not None
    assert np.isfinite(decision.values[7])


def test_a_search_that_does_not_revisit_takes_new_views_while_there_are_any():
    policy, seen = Explicit("semantic_only", Config()), situation(region(slice(0, 40), slice(30, 60)))

    def chosen(visited: list[tuple[int, int]]) -> int | None:
        return policy.decide(replace(seen, visited=visited), Stopwatch()).action

    around = [((30 + i) % 36, 1) for i in range(36)]  # always to the right: once around the ring
    assert [chosen(around[:n]) for n in (1, 2, 7, 35)] == [8, 8, 8, 8]
    assert chosen([(3, 1), (4, 1), (3, 1)]) == 9  # the next node is known, that beyond is not
    assert leads_on(around, 36).tolist() == [True] * 5 + [False] * 5 + [True] * 5
    assert chosen(around) in range(10, 15)
    everything = [(node, level) for level in (0, 2, 1) for node in range(36)]
    assert chosen(everything) == 8  # nothing new is left: as usual
    assert chosen([]) == 8
    policy = Explicit("semantic_only", Config().with_(search={"revisit": True}))
    assert chosen([(3, 1), (4, 1), (3, 1)]) == 8  # the paper's: nothing is remembered


def test_geometry_looks_where_the_map_is_wrong():
    rgb = texture()
    wrong = rgb.copy()
    wrong[:, 40:] = np.random.default_rng(1).integers(0, 255, wrong[:, 40:].shape, np.uint8)
    scene = Map(wrong)
    mask = region(slice(0, 40), slice(0, 20))  # semantics pull to the left
    decision = Explicit("geometry_only", Config()).decide(situation(mask, scene, rgb), Stopwatch())
    assert decision.action == 8
    assert scene.calls == ["refine", "render"]
    assert decision.maps is not None
    assert decision.maps.coverage == 1.0


def test_the_rendering_can_be_taken_before_the_refinement():
    scene = Map(texture())
    before = Config().with_(ssnr={"render": "before"})
    Explicit("explicit", before).decide(situation(region(slice(0, 9), slice(0, 9)), scene), Stopwatch())
    assert scene.calls == ["render", "refine"]


def test_the_fields_are_the_formulas():
    seen = situation(region(slice(0, 20), slice(0, 30)))
    maps = evidence_maps(seen, None, Config())
    semantic = np.where(region(slice(0, 20), slice(0, 30)), np.float32(0.9), 0)
    np.testing.assert_allclose(maps.semantic, semantic)
    assert maps.geometric is not None
    np.testing.assert_allclose(maps.geometric, 0.4)  # no rendering: 0 dB
    np.testing.assert_allclose(maps.field, semantic + 0.4, rtol=1e-6)
    assert maps.functional_uncertainty == pytest.approx(1 - 0.9 / 4 + 0.4, rel=1e-5)
    assert maps.coverage == 0.0
    uncertain = evidence_maps(seen, None, Config().with_(explicit={"field": "uncertainty"}))
    np.testing.assert_allclose(uncertain.field, 1 - semantic + 0.4, rtol=1e-6)
    weighted = Config().with_(evidence={"semantic_weight": 2.0, "geometric_weight": 0.5})
    np.testing.assert_allclose(evidence_maps(seen, None, weighted).field, 2 * semantic + 0.2, rtol=1e-6)


def test_geometric_evidence_counts_by_reach():
    depth = np.full((40, 60), 3.0, np.float32)  # a wall
    depth[20:, :30], depth[20:, 30:], depth[30:, 30:] = 0.75, 0.3, np.nan
    seen = replace(situation(region(slice(0, 20), slice(0, 30))), depth=depth)
    semantic = np.where(region(slice(0, 20), slice(0, 30)), np.float32(0.9), 0)
    reach = np.zeros((40, 60), np.float32)
    reach[20:, :30], reach[20:30, 30:] = 0.5, 1.0
    maps = evidence_maps(seen, None, Config())
    assert maps.geometric is not None
    np.testing.assert_allclose(maps.geometric, 0.4)  # the map's own does not depend on it
    np.testing.assert_allclose(maps.field, semantic + 0.4 * reach, rtol=1e-6)
    alone = evidence_maps(seen, None, Config(), geometry_only=True)
    np.testing.assert_allclose(alone.field, 0.4 * reach, rtol=1e-6)
    papers = Config().with_(evidence={"within_reach": False})
    np.testing.assert_allclose(evidence_maps(seen, None, papers).field, semantic + 0.4, rtol=1e-6)


def test_random_walks_repeat_by_seed_and_respect_the_mask():
    seen = situation(region(slice(0, 1), slice(0, 1)))

    def draw(seed: int) -> list[int | None]:
        policy = RandomWalk(seed)
        return [policy.decide(seen, Stopwatch()).action for _ in range(200)]

    first = draw(2)
    assert first == draw(2)
    assert first != draw(3)
    assert set(first) == set(range(5, 15))  # every feasible action, the no-op included


def test_a_sweep_goes_down_then_around_and_looks_at_nothing():
    policy, seen = Sweep(), situation(region(slice(0, 1), slice(0, 1)))
    moves = []
    for feasible in ("down", "around", "by one", "stay"):
        left = seen.feasible.copy()
        for action, (ring, pitch) in enumerate(evidence.ACTIONS):
            if feasible != "down" and pitch == 1:
                left[action] = False
            if feasible in ("by one", "stay") and abs(ring) == 2:
                left[action] = False
            if feasible == "stay" and ring:
                left[action] = False
        moves.append(policy.decide(replace(seen, feasible=left), Stopwatch()).action)
    assert [evidence.ACTIONS[m] for m in moves if m is not None] == [(0, 1), (2, 0), (1, 0), (0, 0)]


def test_methods_say_what_they_need():
    maps = {m.name for m in METHODS if m.maps}
    assert maps == {"geometry_only", "explicit", "fuse", "fuse_oracle"}
    assert {m.name for m in METHODS if m.stopping == "one view"} == {"static", "canonical"}
    _, config = resolve(Config().with_(method="fuse_oracle"))
    assert config.knowledge.source == "oracle"
    with pytest.raises(
        InputError, match=r"unknown method `explict`; did you mean `explicit`\? known: static"
    ):
        resolve(Config().with_(method="explict"))


def test_asking_for_planner_weights_is_an_error_not_a_stand_in(tmp_path: Path):
    wanted = {"weights": str(tmp_path / "p.onnx")}
    for name in ("fuse", "amortized"):
        method, config = resolve(Config().with_(method=name, planner=wanted))
        with pytest.raises(InputError, match=r"p\.onnx \(planner\.weights\) do not exist"):
            method.policy(config, 0)
    (tmp_path / "p.onnx").write_bytes(b"x")
    with pytest.raises(InputError, match=r"p\.json \(planner\.weights\) do not exist"):
        method.policy(config, 0)
    method, config = resolve(Config().with_(method="amortized", planner={"name": "none"}))
    with pytest.raises(InputError, match="method `amortized` needs a planner"):
        method.policy(config, 0)


def test_registering_a_name_twice_is_an_error():
    registry: Registry[int] = Registry("number")
    registry.add("one", 1)
    with pytest.raises(FuseError, match="number `one` is registered twice"):
        registry.add("one", 2)


def test_a_nested_stage_is_not_counted_twice():
    clock = Stopwatch()
    with clock("outer"), clock("inner"):
        sum(range(200_000))
    seconds = clock.take()
    assert seconds["inner"] > seconds["outer"]
    assert clock.take() == {}
