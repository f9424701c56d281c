"""Methods that share registration and map of an episode come to what each comes to alone."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import pytest

from fuse_grounding.benchmark import shared, worker
from fuse_grounding.benchmark.processes import Processes
from fuse_grounding.benchmark.worker import Setup, Task, Worker
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode, load_episodes

SMALL = {"initial_iterations": 12, "incremental_iterations": 6, "fine_iterations": 3}
FEW = Config().with_(segmenter={"name": "bench_doubles:Eye"}, budget={"actions": 3}, map=SMALL)
METHODS = {name: name for name in ("explicit", "geometry_only", "bench_doubles:seldom")}
METHODS = {name.rpartition(":")[2]: reference for name, reference in METHODS.items()}


def setups(concurrent: bool) -> list[Setup]:
    """Two parts of one map, and one of another."""
    parts = (
        FEW,
        FEW.with_(stopping={"patience": 2}, explicit={"every_step": True}),
        FEW.with_(map={"rate_gain": 1.0}, registration={"backend": "posed"}),
    )
    return [Setup(part.to_dict(), METHODS, concurrent=concurrent) for part in parts]


def rows(one: Worker) -> dict[tuple[int, str], dict[str, Any]]:
    """All methods of all parts over an episode, each with its times."""
    episode = load_episodes("dev")[0]
    tasks = [Task(part, 0, name, episode) for part in range(3) for name in METHODS]
    return {(task.part, task.method): one.run(task).row for task in tasks}


def untimed(row: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in row.items() if k not in ("timings", "concurrent") and not k.endswith("_seconds")}


@pytest.fixture(scope="module")
def alone() -> dict[tuple[int, str], dict[str, Any]]:
    return rows(Worker(setups(False)))


@pytest.mark.parametrize("kept", [64, 2])
def test_shared_or_alone_the_rows_are_the_same(
    alone: dict[tuple[int, str], dict[str, Any]], kept: int, monkeypatch: pytest.MonkeyPatch
):
    memory = shared.Shared(kept)
    monkeypatch.setattr(worker, "Shared", lambda: memory)
    together = rows(Worker(setups(True)))
    assert {k: untimed(row) for k, row in together.items()} == {k: untimed(row) for k, row in alone.items()}
    assert all(row["status"] == "ok" and row["refinements"] > 0 for row in together.values())
    asked = sum(1 + row["observations"] + row["refinements"] for row in together.values())
    if kept == 64:
        assert memory.made < 0.6 * asked
        first, again = alone[0, "explicit"], together[1, "explicit"]
        # Who takes a map over is told what it took, not nothing.
        assert again["timings"]["initialize_map"] > 0.2 * first["timings"]["initialize_map"]
        assert again["wall_seconds"] > sum(again["timings"].values()) * 0.99
        assert again["runtime_seconds"] > again["wall_seconds"]


def test_what_goes_on_from_a_state_leaves_it_as_it_was():
    from fuse_grounding.assembly import assemble
    from fuse_grounding.environment import TabletopEnvironment
    from fuse_grounding.record import Stopwatch

    memory, (parts, config) = shared.Shared(), assemble(FEW.with_(method="explicit"))
    both, world = memory.parts(parts, config), TabletopEnvironment(load_episodes("dev")[0])
    one, other = both.spatial(), both.spatial()
    assert one is not None
    assert other is not None
    for spatial in (one, other):
        seeds = world.seed_observations()
        spatial.registrar.initialize(seeds)
        for seed in seeds:
            spatial.map.add_seed(seed.rgb)
    assert memory.made == 1
    here = world.observe()
    assert here.camera is not None
    other.registrar.register(here)
    other.map.add(here.rgb)
    other.map.refine(Stopwatch())
    before, views = other.map.render(here.camera), other.registrar.views()
    one.registrar.register(here)
    one.map.add(here.rgb)
    one.map.refine(Stopwatch())
    assert memory.made == 3
    there = world.render_at(20, 2)
    one.registrar.register(there)
    one.map.add(there.rgb)
    one.map.refine(Stopwatch())
    after = other.map.render(here.camera)
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(before.rgb, after.rgb)
    assert len(other.registrar.views()) == len(views)
    for mine, held in zip(other.registrar.views(), views, strict=True):
        np.testing.assert_array_equal(mine.camera.translation, held.camera.translation)
    # Another episode begins with nothing.
    memory.begin(load_episodes("dev")[1])
    third = both.spatial()
    assert third is not None
    third.registrar.initialize(world.seed_observations())
    assert memory.made == 6


def test_a_worker_keeps_to_its_episode_and_helps_out_at_the_end():
    class Child:
        def __init__(self, episode: int | None):
            self.episode = episode

    engine: Any = Processes([], 2)
    first, second = Child(None), Child(None)
    engine._children = [first, second]
    episode = Episode('{"episode_id": "a"}')
    waiting = deque(Task(0, index, name, episode) for index in range(2) for name in "abc")
    order = []
    for child in (first, second, first, first, first, second):
        task = engine._chosen(child, waiting)
        child.episode = task.index
        order.append((child is first, task.index, task.method))
    assert order == [
        (True, 0, "a"),
        (False, 1, "a"),
        (True, 0, "b"),
        (True, 0, "c"),
        (True, 1, "b"),  # nothing is left of its own
        (False, 1, "c"),
    ]
