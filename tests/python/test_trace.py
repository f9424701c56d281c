"""A trace says, for every step, what would have come back had the search ended there."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from agent_doubles import CONFIG, HEIGHT, WIDTH, Kit, World
from agent_doubles import Seer as Doubled
from truth_double import KNIFE, Block, Truth

from fuse_grounding.agent import Agent
from fuse_grounding.benchmark import metrics
from fuse_grounding.benchmark.trace import Judgement, Trace
from fuse_grounding.config import Config
from fuse_grounding.grounding import Grounded
from fuse_grounding.perception.protocol import Detection

TARGETS = {4: ("ruler", (0.2, 0.0, 0.0)), 9: ("knife", (-0.2, 0.0, 0.0))}


def sight(node: int, pitch: int) -> float:
    """The farther from node 5 the better; nothing is seen from every sixth node."""
    away = min((node - 5) % 36, (5 - node) % 36)
    return min(0.95, 0.2 + 0.06 * away + 0.01 * pitch) if node % 6 else 0.0


class Seer(Doubled):
    """Also finds scissors, too small to be scored and surer than the knife, from every fourth node."""

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        found = super().segment(rgb, labels)
        if rgb[0, 0, 0] % 4 != 1 or not found or "scissors" not in labels:
            return found
        mask = np.zeros((HEIGHT, WIDTH), bool)
        mask[20:26, 20:26] = True
        return [Detection("scissors", 0.97, mask), *found]


def blocks(node: int, pitch: int) -> dict[int, Block]:
    """The knife is where the segmenter sees it from some nodes, and shifted from others."""
    return {
        9: (KNIFE[0], slice(5 + node % 12, 25 + node % 12)),
        4: (slice(40, 48), slice(30, 30 + node % 30)),
    }


def search(config: Config, method: str = "random") -> tuple[Grounded, Judgement, Truth, Kit]:
    kit = Kit(method, sight, config)
    kit.parts = replace(kit.parts, segmenter=Seer(sight))
    trace, truth = Trace(kit.config), Truth(blocks, TARGETS)
    grounded = Agent(kit.config, kit.parts).run(World(node=5), "cut", watchers=[trace])
    assert not truth.asked, "the truth is not asked while the search runs"
    return grounded, trace.judge(grounded, truth, kit.seer), truth, kit


@pytest.mark.parametrize("select", ["instance", "fused"])
@pytest.mark.parametrize("include_initial", [True, False])
def test_each_step_is_judged_as_if_the_search_ended_there(select: str, include_initial: bool):
    config = CONFIG.with_(
        metric={"select": select}, return_={"include_initial": include_initial}, stopping={"patience": 30}
    )
    _, judged, _, _ = search(config.with_(budget={"actions": 12}))
    assert len(judged.steps) == 13
    for step in judged.steps:
        grounded, alone, _, _ = search(config.with_(budget={"actions": step.index}))
        assert len(grounded.record.steps) == step.index + 1
        assert step.best_iou == alone.metrics["iou"]
        assert step.best_score == grounded.record.steps[-1].best_score
    ious = {step.best_iou for step in judged.steps}
    assert len(ious) > 2, "the case tells steps apart"
    assert (min(ious) < 0.1) == (select == "instance"), "and what is selected"


def test_a_step_says_what_the_record_says_and_what_the_view_showed():
    grounded, judged, truth, kit = search(CONFIG.with_(budget={"actions": 8}))
    target = {t.instance: t for t in truth.true_targets()}[9]
    for entry, step in zip(grounded.record.steps, judged.steps, strict=True):
        assert (step.index, step.node, step.branch, step.action) == (
            entry.index,
            entry.node,
            entry.branch,
            entry.action,
        )
        assert (step.improved, step.best_score, step.entropy) == (entry.improved, entry.best_score, None)
        assert step.node is not None
        assert step.pitch_deg is not None
        pitch = (15, 30, 45).index(int(step.pitch_deg))
        assert step.target_pixels == target.visible_px[step.node, pitch]
        assert step.target_pixel_ratio == metrics.pixel_ratio(
            step.target_pixels, target.least_pixels, target.most_pixels
        )
        assert step.target_score == pytest.approx(sight(step.node, pitch))
    ratios = [step.target_pixel_ratio for step in judged.steps]
    assert judged.metrics["observed_pixel_ratio_90"] == pytest.approx(np.percentile(ratios, 90))
    assert max(truth.asked.values()) == 1, "a viewpoint is rendered once"
    rows = json.loads(json.dumps(judged.step_rows(), allow_nan=False))
    assert [row["best_iou"] for row in rows] == [step.best_iou for step in judged.steps]
    again = metrics.evaluate(grounded, Truth(blocks, TARGETS), kit.seer, kit.config)
    assert {**again, "runtime_seconds": None} == {**judged.metrics, "runtime_seconds": None}


def test_a_label_that_was_no_candidate_has_no_score():
    kit = Kit("static", lambda node, pitch: 0.0)
    truth = Truth(lambda node, pitch: {4: KNIFE}, {4: ("mug", (0.0, 0.0, 0.0))})
    trace = Trace(kit.config)
    grounded = Agent(kit.config, kit.parts).run(World(), "cut", watchers=[trace])
    (step,) = trace.judge(grounded, truth, kit.seer).steps
    assert (step.best_iou, step.best_score, step.target_score, step.target_pixels) == (0.0, None, None, 400)


def test_the_canonical_view_is_judged_by_its_own_picture():
    _, judged, _, _ = search(CONFIG, "canonical")
    (step,) = judged.steps
    assert (step.node, step.pitch_deg, step.target_pixels) == (None, None, 400)
    assert step.best_iou == judged.metrics["iou"] == pytest.approx(180 / 620)  # shifted by 35 % 12 = 11


def test_a_trace_is_of_the_last_search_that_it_watched():
    kit = Kit("random", sight, CONFIG.with_(budget={"actions": 6}))
    trace = Trace(kit.config)
    agent = Agent(kit.config, kit.parts)
    agent.run(World(node=5), "cut", watchers=[trace])
    grounded = agent.run(World(node=9), "cut", watchers=[trace])
    steps = trace.judge(grounded, Truth(blocks, TARGETS), kit.seer).steps
    assert [s.node for s in steps] == [s.node for s in grounded.record.steps]
