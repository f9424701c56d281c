"""Every metric on cases whose value is found by hand."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from agent_doubles import HEIGHT, WIDTH, Kit, World, camera
from truth_double import KNIFE, Block, Truth

from fuse_grounding.agent import Agent
from fuse_grounding.benchmark import metrics
from fuse_grounding.environment import TabletopEnvironment, Target, load_episodes
from fuse_grounding.grounding import Grounded

TARGETS = {4: ("ruler", (0.2, 0.0, 0.0)), 9: ("knife", (-0.2, 0.0, 0.0))}
"""The sampled target is a ruler, which the double's segmenter never sees; a knife is valid, too."""


def ground(kit: Kit) -> Grounded:
    return Agent(kit.config, kit.parts).run(World(), "cut")


def test_overlap_of_masks():
    a = np.zeros((4, 6), bool)
    b = a.copy()
    a[:, :3] = True
    b[:, 2:4] = True
    assert metrics.iou(a, b) == pytest.approx(4 / 16)
    assert metrics.iou(a & False, b & False) == 0.0


def test_pixels_and_distances_are_scaled_to_what_is_reachable():
    assert metrics.pixel_ratio(30, 10, 50) == pytest.approx(0.5)
    assert metrics.pixel_ratio(70, 10, 50) == 1.0
    assert metrics.pixel_ratio(5, 5, 5) == 0.0
    assert metrics.distance_score(0.6, 0.5, 1.0) == pytest.approx(0.8)
    assert metrics.distance_score(2.0, 0.5, 1.0) == 0.0


def test_the_robust_ratio_is_scaled_by_the_90th_percentile():
    views = np.full((36, 3), 100.0)
    views[:3, :] = 1000.0  # one view in twelve
    views[5, 0] = 20.0
    assert metrics.robust_pixel_ratio(60, views) == pytest.approx(0.5)
    assert metrics.pixel_ratio(60, views.min(), views.max()) == pytest.approx(40 / 980)
    assert metrics.robust_pixel_ratio(1000, views) == 1.0
    linear = np.arange(108.0).reshape(36, 3)  # the percentile lies at 0.9 * 107
    assert metrics.robust_pixel_ratio(48.15, linear) == pytest.approx(0.5)
    rare = np.zeros((36, 3))
    rare[0, 0] = 500.0
    assert (metrics.robust_pixel_ratio(500, rare), metrics.robust_pixel_ratio(0, rare)) == (1.0, 0.0)


def test_the_ratio_over_observed_views_is_their_90th_percentile():
    assert metrics.observed_pixel_ratio([i / 10 for i in range(11)]) == pytest.approx(0.9)
    assert metrics.observed_pixel_ratio([0.0, 1.0]) == pytest.approx(0.9)
    assert metrics.observed_pixel_ratio([0.25]) == 0.25
    assert metrics.observed_pixel_ratio([]) is None


def test_centring():
    middle = np.zeros((4, 6), bool)
    middle[1:3, 2:4] = True
    assert metrics.center_score(middle) == pytest.approx(1.0)
    corner = np.zeros((4, 6), bool)
    corner[0, 0] = True
    # Pixel centre (0.5, 0.5), image centre (3, 2), corner distance sqrt(13).
    assert metrics.center_score(corner) == pytest.approx(1 - np.sqrt(2.5**2 + 1.5**2) / np.sqrt(13))
    assert metrics.center_score(corner & False) == 0.0


def test_the_matched_object_is_the_one_that_overlaps_best():
    ids = np.zeros((4, 6), np.uint32)
    ids[:, :2], ids[:, 2:6] = 4, 9
    nothing = np.zeros((36, 3))
    targets = [Target(i, "x", np.zeros(3), 0, 1, 0, 1, nothing, nothing) for i in (4, 9)]
    right = ids == 9
    assert (metrics.match(right, ids, targets).target.instance, metrics.match(right, ids, targets).iou) == (
        9,
        1,
    )
    assert metrics.match(None, ids, targets).target.instance == 4
    assert metrics.match(None, ids, targets).iou == 0.0
    half = np.ones((4, 6), bool)
    assert metrics.match(half, ids, targets).iou == pytest.approx(16 / 24)
    assert np.array_equal(metrics.match(half, ids, targets).mask, right)


def test_evaluating_takes_the_best_valid_object():
    def blocks(node: int, pitch: int) -> dict[int, Block]:
        seen = {4: (slice(0, 20), slice(0, 20)), 9: KNIFE}
        return seen if node == 0 else {9: (slice(0, 10 if node < 18 else 40), slice(0, 20))}

    kit = Kit("static", lambda node, pitch: 0.6)
    grounded = ground(kit)
    found = metrics.evaluate(grounded, Truth(blocks, TARGETS), kit.seer, kit.config)
    assert (found["success"], found["iou"], found["target_pixels"]) == (True, 1.0, 400)
    # The knife has 200 to 800 pixels over the ring, and 800 in half of the views.
    assert found["target_pixel_ratio"] == pytest.approx(200 / 600)
    assert found["target_pixel_ratio_90"] == pytest.approx(200 / 600)
    assert found["observed_pixel_ratio_90"] == pytest.approx(200 / 600)
    center = camera(0, 1).center
    far, near = (np.linalg.norm([x, 0, 1.0]) for x in (1.2, 0.8))
    assert found["distance_score"] == pytest.approx(
        (far - np.linalg.norm(center - [-0.2, 0, 0])) / (far - near)
    )
    assert found["distance_score"] == pytest.approx(0.0)  # the knife is on the far side
    off = np.hypot(15 - WIDTH / 2, 24 - HEIGHT / 2)
    assert found["center_score"] == pytest.approx(1 - off / np.hypot(WIDTH / 2, HEIGHT / 2))
    assert found["final_score"] == 0.6  # of the object that was found, not of the ruler that was sampled
    assert found["best_target_score"] == grounded.score
    assert grounded.record.result is not None
    assert float(found["runtime_seconds"] or 0) >= grounded.record.result.wall_seconds


def test_a_grounding_that_misses_is_judged_by_the_sampled_target():
    blocks: dict[int, Block] = {4: (slice(40, 48), slice(40, 60)), 9: (slice(0, 5), slice(40, 60))}
    kit = Kit("static", lambda node, pitch: 0.6)
    lost = metrics.evaluate(ground(kit), Truth(lambda node, pitch: blocks, TARGETS), kit.seer, kit.config)
    assert (lost["success"], lost["iou"], lost["target_pixels"]) == (False, 0.0, 160)
    assert lost["final_score"] == 0.0
    assert float(lost["best_target_score"] or 0) > 0


def test_runtime_leaves_out_hosted_models_and_counts_the_last_query():
    kit = Kit("static", lambda node, pitch: 0.6)
    grounded = ground(kit)
    result = grounded.record.result
    assert result is not None
    result.wall_seconds, result.timings = 70.0, {"segment": 5.0, metrics.HOSTED: 60.0}
    truth = Truth(lambda node, pitch: {9: KNIFE}, TARGETS)
    runtime = metrics.evaluate(grounded, truth, kit.seer, kit.config)["runtime_seconds"]
    assert runtime is not None
    assert 10.0 < runtime < 15.0


def test_success_begins_at_half():
    """Supplement: IoU >= 0.5; the main text's "greater than 0.5" differs at 0.5 itself alone."""
    kit = Kit("static", lambda node, pitch: 0.6)
    half: dict[int, Block] = {9: (slice(14, 34), slice(5, 15))}
    found = metrics.evaluate(ground(kit), Truth(lambda n, p: half, TARGETS), kit.seer, kit.config)
    assert (found["iou"], found["success"]) == (0.5, True)


def test_what_is_missing():
    """A label that a closed set lacks has no score; a search that saw nothing has IoU and scores of 0."""
    kit = Kit("static", lambda node, pitch: 0.0)
    truth = Truth(lambda node, pitch: {4: KNIFE}, {4: ("sickle", (0.0, 0.0, 0.0))})
    lost = metrics.evaluate(ground(kit), truth, kit.seer, kit.config)
    assert lost["final_score"] is None
    assert lost["position_error_m"] is None
    assert (lost["success"], lost["iou"], lost["best_target_score"]) == (False, 0.0, 0.0)


def test_the_canonical_view_has_no_observed_ratio():
    kit = Kit("canonical", lambda node, pitch: 0.6)
    truth = Truth(lambda node, pitch: {9: KNIFE}, {9: ("knife", (0.0, 0.0, 0.0))})
    found = metrics.evaluate(ground(kit), truth, kit.seer, kit.config)
    assert truth.asked == {(None, None): 1}
    assert (found["success"], found["target_pixels"], found["observed_pixel_ratio_90"]) == (True, 400, None)


def test_every_metric_is_named_and_documented():
    kit = Kit("static", lambda node, pitch: 0.6)
    truth = Truth(lambda node, pitch: {9: KNIFE}, {9: ("knife", (0.0, 0.0, 0.0))})
    counted = {"online_actions", "observations", "total_steps"}  # by the record
    named = {metric.name for metric in metrics.METRICS}
    assert (
        set(metrics.evaluate(ground(kit), truth, kit.seer, kit.config)) - {"target_pixels"} == named - counted
    )
    text = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text()
    assert named <= set(re.findall(r"`(\w+)`", text))


def test_the_worlds_truth_is_what_it_shows():
    """Ids without a picture are those of the picture, and their counts are the shipped statistics."""
    world = TabletopEnvironment(load_episodes("dev")[0])
    for node, pitch in ((3, 0), (17, 1), (30, 2)):
        ids = world.true_instances(node, pitch)
        seen = world.render_at(node, pitch).instance
        assert seen is not None
        assert np.array_equal(ids, seen)
        for target in world.true_targets():
            assert np.count_nonzero(ids == target.instance) == target.visible_px[node, pitch]
    above = world.canonical_observation()
    assert above.instance is not None
    assert above.camera is not None
    assert np.array_equal(world.true_instances(None, None), above.instance)
    assert np.array_equal(world.true_camera(None, None).center, above.camera.center)
