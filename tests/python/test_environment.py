"""The tabletop environment against what an episode says of it."""

from __future__ import annotations

import numpy as np
import pytest

from fuse_grounding.environment import Blind, TabletopEnvironment, load_episodes
from fuse_grounding.errors import InputError


@pytest.fixture(scope="module")
def environment() -> TabletopEnvironment:
    return TabletopEnvironment(load_episodes("dev")[0])


def test_observations_have_their_shapes_and_their_depth_is_metric(environment):
    environment.reset()
    seen = environment.observe()
    assert seen.rgb.shape == (480, 640, 3)
    assert seen.rgb.dtype == np.uint8
    assert seen.depth.dtype == np.float32
    assert seen.instance.dtype == np.uint32
    assert (seen.node, seen.pitch_index) == environment.episode.start
    # Unprojected by the camera, the pixels of the target lie around its middle.
    target = environment.true_targets()[0]
    rows, columns = np.nonzero(seen.instance == target.instance)
    assert len(rows) == target.visible_px[environment.episode.start]
    z, k = seen.depth[rows, columns], seen.camera
    points = np.stack([(columns + 0.5 - k.cx) / k.fx * z, (rows + 0.5 - k.cy) / k.fy * z, z], 1)
    world = (points - k.translation) @ k.rotation
    assert np.linalg.norm(world.mean(0) - target.position) < 0.2


def test_moves_follow_the_mask_and_seeds_leave_the_camera_alone(environment):
    environment.reset()
    start = environment.viewpoint
    seeds = environment.seed_observations()
    assert [s.node for s in seeds] == [(start[0] + d) % 36 for d in (-2, -1, 1, 2)]
    assert {s.pitch_index for s in seeds} == {1}
    assert environment.viewpoint == start
    for action in np.flatnonzero(environment.action_mask()):
        environment.reset()
        environment.act(int(action))
        assert environment.viewpoint == (
            (start[0] + action % 5 - 2) % 36,
            start[1] + action // 5 - 1,
        )
    environment.reset()
    while environment.viewpoint[1] < 2:
        environment.act(12)
    with pytest.raises(InputError, match="action 12 is not possible at pitch index 2"):
        environment.act(12)
    with pytest.raises(InputError, match="found 15"):
        environment.act(15)
    environment.reset()


def test_pictures_are_the_same_twice(environment):
    again = TabletopEnvironment(environment.episode)
    one, two = environment.render_at(7, 0), again.render_at(7, 0)
    assert np.array_equal(one.rgb, two.rgb)
    assert one.depth is not None
    assert two.depth is not None
    assert np.array_equal(one.depth, two.depth)
    with pytest.raises(InputError, match="node 36"):
        environment.render_at(36, 0)


def test_the_blind_environment_has_no_truth_but_the_oracle_answers(environment):
    environment.reset()
    blind = Blind(environment)
    views = [blind.observe(), blind.canonical_observation(), *blind.seed_observations()]
    assert all(seen.instance is None and seen.depth is not None for seen in views)
    assert blind.oracle_target() == environment.oracle_target()
    for name in ("true_instances", "true_targets", "episode", "render_at"):
        assert not hasattr(blind, name)


def test_canonical_view_looks_straight_down_on_everything(environment):
    seen = environment.canonical_observation()
    assert seen.node is None
    assert np.allclose(seen.camera.rotation[2], [0, 0, -1], atol=1e-9)
    assert set(environment.episode.categories) == set(np.unique(seen.instance)) - {0}
