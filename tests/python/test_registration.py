"""Registration on a tabletop that FUSE's renderer has no part in (tabletop_twin.py)."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tabletop_twin as twin

import fuse_grounding
from fuse_grounding._core import Camera
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.errors import InputError
from fuse_grounding.registration import ColmapRegistrar, PosedRegistrar, RegistrationError, features
from fuse_grounding.registration.posed import triangulate
from fuse_grounding.registration.similarity import fit_similarity

START = 3
WALK = [(3, 1), (5, 1), (6, 2), (5, 1)]  # (node, pitch index); the last stands where the second stood.


@cache
def scene() -> list[twin.Face]:
    return twin.scene(0)


@cache
def view(node: int, pitch_index: int) -> Observation:
    return twin.observe(scene(), node, pitch_index)


def seeds() -> list[Observation]:
    return [view(START + step, 1) for step in (-2, -1, 1, 2)]


def known(observation: Observation) -> Camera:
    assert observation.camera is not None
    return observation.camera


def millimetres_and_degrees(found: Camera, true: Camera) -> tuple[float, float]:
    turn = found.rotation @ true.rotation.T
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    return 1e3 * float(np.linalg.norm(found.center - true.center)), float(angle)


def surface_distance(xyz: np.ndarray) -> np.ndarray:
    """Metres from each point to the nearest face of the scene."""
    best = np.full(len(xyz), np.inf)
    for face in scene():
        offset = xyz - face.corner
        a = np.clip(offset @ face.u / (face.u @ face.u), 0, 1)
        b = np.clip(offset @ face.v / (face.v @ face.v), 0, 1)
        best = np.minimum(best, np.linalg.norm(offset - np.outer(a, face.u) - np.outer(b, face.v), axis=1))
    return best


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return q * np.sign(np.linalg.det(q))


def poses_in_two_frames(rng: np.random.Generator, centres: np.ndarray, noise: float):
    """The same cameras in a map frame and in the world, orientations off by `noise` radians."""
    scale, rotation, translation = 0.37, random_rotation(rng), rng.standard_normal(3)
    map_poses, world_poses = [], []
    for centre in centres:
        r = random_rotation(rng)
        axis = noise * rng.standard_normal(3)
        x, y, z = axis
        wobble = np.linalg.qr(np.eye(3) + np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))[0]
        wobble *= np.sign(np.diag(wobble))
        map_poses.append((r, -r @ centre))
        world_rotation = wobble @ r @ rotation.T
        world_poses.append((world_rotation, -world_rotation @ (scale * rotation @ centre + translation)))
    return map_poses, world_poses, (scale, rotation, translation)


def test_a_similarity_is_recovered() -> None:
    rng = np.random.default_rng(1)
    centres = rng.standard_normal((4, 3))
    map_poses, world_poses, (scale, rotation, translation) = poses_in_two_frames(rng, centres, 0.0)
    found = fit_similarity(map_poses, world_poses)
    assert abs(found.scale - scale) < 1e-12
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, translation, atol=1e-12)
    np.testing.assert_allclose(found.points(centres), scale * centres @ rotation.T + translation, atol=1e-12)
    for map_pose, (world_rotation, world_translation) in zip(map_poses, world_poses, strict=True):
        turned, moved = found.pose(*map_pose)
        np.testing.assert_allclose(turned, world_rotation, atol=1e-12)
        np.testing.assert_allclose(moved, world_translation, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_centres_on_a_line_do_not_let_the_frame_turn(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centres = np.outer(np.arange(4.0), [1.0, 0.2, 0.1]) + 1e-3 * rng.standard_normal((4, 3))
    map_poses, world_poses, (scale, rotation, _) = poses_in_two_frames(rng, centres, 0.002)
    found = fit_similarity(map_poses, world_poses)
    assert np.linalg.det(found.rotation) > 0.999
    assert np.degrees(np.arccos((np.trace(found.rotation @ rotation.T) - 1) / 2)) < 0.5
    assert abs(found.scale / scale - 1) < 0.01


def test_coinciding_centres_have_no_scale() -> None:
    rng = np.random.default_rng(0)
    map_poses, world_poses, _ = poses_in_two_frames(rng, np.ones((3, 3)), 0.0)
    with pytest.raises(ValueError, match="scale"):
        fit_similarity(map_poses, world_poses)


def test_matching_agrees_with_an_obvious_loop() -> None:
    first, second = (features.extract(view(node, 1).rgb, max_features=150) for node in (4, 5))
    a, b = (f.descriptors.astype(np.int64) for f in (first, second))

    def best(row: np.ndarray, others: np.ndarray) -> int | None:
        angles = np.arccos(np.minimum(others @ row / 512.0**2, 1.0))
        order = np.argsort(angles, kind="stable")
        passes = angles[order[0]] <= 0.8 and angles[order[0]] < 0.9 * angles[order[1]]
        return int(order[0]) if passes else None

    expected = []
    for i, row in enumerate(a):
        j = best(row, b)
        if j is not None and best(b[j], a) == i:
            expected.append((i, j))
    found = features.match(first, second)
    assert len(expected) > 30
    assert [tuple(pair) for pair in found.tolist()] == expected


def test_neighbours_are_the_nearest_on_the_ring_across_its_seam() -> None:
    empty = np.zeros((0, 0, 3), np.uint8)
    places = [(0, 1), (34, 1), (20, 1), (35, 2), (1, 1)]
    ring = [Observation(rgb=empty, node=n, pitch_index=p) for n, p in places]
    assert features.nearest_views(Observation(rgb=empty, node=35, pitch_index=1), ring, 4) == [3, 1, 0, 4]
    by_pose = [replace(o, camera=twin.camera(o.node or 0, 1), node=None) for o in ring]
    here = Observation(rgb=empty, camera=twin.camera(33, 1))
    assert features.nearest_views(here, by_pose, 3) == [1, 3, 0]
    blind = [Observation(rgb=empty)] * 5
    assert features.nearest_views(Observation(rgb=empty), blind, 2) == [4, 3]


def walk(registrar: ColmapRegistrar | PosedRegistrar, moves: list[tuple[int, int]], status: str) -> None:
    """Registers seeds and moves without telling the moves' poses, and judges poses and points."""
    observations = seeds()
    registrar.initialize(observations)
    first_ids = registrar.points_by_id()[0]
    for node, pitch_index in moves:
        observations.append(view(node, pitch_index))
        told = observations[-1] if status == "posed" else replace(observations[-1], camera=None)
        assert registrar.register(told).status == status
    views = registrar.views()
    assert [v.status for v in views] == [status] * len(observations)
    for found, observation in zip(views, observations, strict=True):
        off, turned = millimetres_and_degrees(found.camera, known(observation))
        assert off < 3.0, observation.node
        assert turned < 0.15, observation.node
    ids, xyz, rgb = registrar.points_by_id()
    assert len(ids) == len(xyz) == len(rgb) > 300
    assert (np.diff(ids) > 0).all()
    assert len(np.setdiff1d(ids, first_ids)) > 50
    assert (xyz.dtype, rgb.dtype) == (np.float64, np.uint8)
    on_table = (np.abs(xyz[:, :2]) < 0.6).all(axis=1) & (np.abs(xyz[:, 2] - 0.85) < 0.12)
    assert on_table.sum() > 150
    assert np.quantile(surface_distance(xyz[on_table]), 0.8) < 0.005
    assert rgb.astype(float).std(axis=0).min() > 5.0  # Colours of the scene, not a constant.


def test_fast_walk_is_registered_without_known_poses() -> None:
    walk(ColmapRegistrar(), WALK, "colmap")


def test_paper_walk_is_registered_without_known_poses() -> None:
    walk(ColmapRegistrar(profile="paper"), WALK[1:2], "colmap")


def test_posed_walk_has_points_on_the_surfaces() -> None:
    walk(PosedRegistrar(), WALK, "posed")


def test_linear_triangulation_is_exact_without_noise() -> None:
    rng = np.random.default_rng(0)
    cameras = [twin.camera(node, 1) for node in (0, 2, 5)]
    xyz = rng.uniform([-0.3, -0.3, 0.7], [0.3, 0.3, 1.0], (20, 3))
    local = np.stack([xyz @ c.rotation.T + c.translation for c in cameras], axis=1)
    poses = np.stack([np.column_stack([c.rotation, c.translation]) for c in cameras])
    np.testing.assert_allclose(triangulate(poses, local[..., :2] / local[..., 2:]), xyz, atol=1e-9)


TWO_RUNS = """
import sys
import test_registration as t
registrar = t.ColmapRegistrar(profile=sys.argv[1])
registrar.initialize(t.seeds())
for node, pitch_index in t.WALK[:int(sys.argv[2])]:
    registrar.register(t.view(node, pitch_index))
for v in registrar.views():
    print(v.status, v.camera.rotation.tobytes().hex(), v.camera.translation.tobytes().hex())
print(registrar.points()[0].tobytes().hex(), registrar.points()[1].tobytes().hex())
"""


@pytest.mark.parametrize(("profile", "moves"), [("fast", 3), ("paper", 1)])
def test_two_processes_give_the_same_bits(profile: str, moves: int) -> None:
    command = [sys.executable, "-c", TWO_RUNS, profile, str(moves)]
    here = Path(__file__).parent
    package = Path(fuse_grounding.__file__).parent.parent
    environment = {**os.environ, "PYTHONPATH": str(package)}
    runs = [
        subprocess.Popen(
            command, cwd=here, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    (first, first_error), (second, _) = (run.communicate(timeout=120) for run in runs)
    assert first.count("colmap") == 4 + moves, first_error
    assert first == second


def black(observation: Observation) -> Observation:
    return replace(observation, rgb=np.zeros_like(observation.rgb))


def test_a_black_picture_falls_back_and_the_next_one_does_not() -> None:
    registrar = ColmapRegistrar()
    registrar.initialize(seeds())
    placed = registrar.register(black(view(3, 1)))
    assert placed.status == "posed_fallback"
    assert millimetres_and_degrees(placed.camera, known(view(3, 1))) == pytest.approx((0, 0), abs=1e-3)
    with pytest.raises(RegistrationError, match="pose is not known"):
        registrar.register(replace(black(view(3, 1)), camera=None))
    assert registrar.register(view(5, 1)).status == "colmap"
    assert [v.status for v in registrar.views()] == ["colmap"] * 4 + ["posed_fallback", "colmap"]


def test_on_failure_error_raises_and_forgets_the_view() -> None:
    registrar = ColmapRegistrar(on_failure="error")
    registrar.initialize(seeds())
    with pytest.raises(RegistrationError, match="could not register"):
        registrar.register(black(view(3, 1)))
    assert len(registrar.views()) == 4


def test_one_bad_seed_keeps_its_known_pose(caplog: pytest.LogCaptureFixture) -> None:
    registrar = ColmapRegistrar()
    views = registrar.initialize([black(seeds()[0]), *seeds()[1:]])
    assert [v.status for v in views] == ["posed_fallback", "colmap", "colmap", "colmap"]
    assert "seed views [0]" in caplog.text
    assert registrar.register(view(3, 1)).status == "colmap"


@pytest.mark.parametrize("profile", ["fast", "paper"])
def test_seeds_without_a_model_are_announced_and_posed(
    profile: str, caplog: pytest.LogCaptureFixture
) -> None:
    registrar = ColmapRegistrar(profile=profile)  # type: ignore[arg-type]
    views = registrar.initialize([black(seed) for seed in seeds()])
    assert {v.status for v in views} == {"posed_fallback"}
    assert "no model" in caplog.text
    assert len(registrar.points()[0]) == 0
    assert registrar.register(view(3, 1)).status == "posed_fallback"
    assert registrar.register(view(5, 1)).status == "posed_fallback"
    assert len(registrar.points()[0]) > 100
    with pytest.raises(RegistrationError, match="COLMAP did not register the seed views"):
        ColmapRegistrar(on_failure="error").initialize([black(seed) for seed in seeds()])


def test_seeds_that_contradict_their_known_poses_are_no_model() -> None:
    mixed = [replace(s, camera=o.camera) for s, o in zip(seeds(), reversed(seeds()), strict=True)]
    assert {v.status for v in ColmapRegistrar().initialize(mixed)} == {"posed_fallback"}


def test_input_errors_say_what_is_wrong() -> None:
    seed = seeds()[0]
    camera = known(seed)
    for registrar in (ColmapRegistrar(), PosedRegistrar()):
        with pytest.raises(InputError, match="before initialize"):
            registrar.register(seed)
        with pytest.raises(InputError, match="two or more seed views, found 1"):
            registrar.initialize([seed])
        with pytest.raises(InputError, match="seed 1 has no camera"):
            registrar.initialize([seed, replace(seeds()[1], camera=None)])
        with pytest.raises(InputError, match="one point"):
            registrar.initialize([seed, seed])
        with pytest.raises(InputError, match="320x240 pixels, the intrinsics are for 640x480"):
            registrar.initialize([seed, replace(seeds()[1], rgb=seed.rgb[:240, :320])])
        with pytest.raises(InputError, match=r"uint8 array \(height, width, 3\), found float64"):
            registrar.initialize([replace(seed, rgb=seed.rgb / 255.0), seeds()[1]])
        other = Camera(640, 480, 500.0, 500.0, 320.0, 240.0, camera.rotation, camera.translation)
        with pytest.raises(InputError, match="one registrar serves one camera"):
            registrar.initialize([seed, replace(seeds()[1], camera=other)])
    wrongs: list[tuple[dict[str, Any], str]] = [
        ({"profile": "quick"}, 'must be "fast" or "paper", found \'quick\''),
        ({"on_failure": "ignore"}, "found 'ignore'"),
        ({"neighbours": 0}, "neighbours must be 1 or more, found 0"),
        ({"seed": -1}, "seed must be 0 or more"),
    ]
    for wrong, message in wrongs:
        with pytest.raises(InputError, match=message):
            ColmapRegistrar(**wrong)


@pytest.mark.parametrize("fallback", [False, True])
def test_a_fork_goes_on_as_its_original_would(fallback: bool, monkeypatch: pytest.MonkeyPatch):
    from fuse_grounding.registration.mapping import LiveModel

    if fallback:
        monkeypatch.setattr(LiveModel, "start", lambda *_: False)
    whole, first = ColmapRegistrar(), ColmapRegistrar()
    views = [view(START + step, 1) for step in (0, 2, 3, 4, 5, 6)]  # the fifth adjusts globally
    for registrar in (whole, first):
        registrar.initialize(seeds())
    for seen in views:
        whole.register(seen)
    for seen in views[:3]:
        first.register(seen)
    twin_ = first.fork()
    first.register(view(START - 4, 2))  # another way
    before = [v.camera.translation for v in first.views()]
    for seen in views[3:]:
        twin_.register(seen)
    assert {v.status for v in twin_.views()} == {"posed_fallback" if fallback else "colmap"}
    for mine, theirs in zip(twin_.views(), whole.views(), strict=True):
        np.testing.assert_array_equal(mine.camera.rotation, theirs.camera.rotation)
        np.testing.assert_array_equal(mine.camera.translation, theirs.camera.translation)
    for mine_, theirs_ in zip(twin_.points_by_id(), whole.points_by_id(), strict=True):
        np.testing.assert_array_equal(mine_, theirs_)
    np.testing.assert_array_equal(before, [v.camera.translation for v in first.views()])
