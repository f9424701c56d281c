"""The same benchmark over a Ray cluster of several nodes, one of which is killed in the middle."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fuse_grounding.benchmark.cluster import RayEngine
from fuse_grounding.benchmark.driver import Means, Plan, run_benchmarks
from fuse_grounding.benchmark.processes import Processes
from fuse_grounding.benchmark.runner import Row
from fuse_grounding.benchmark.store import RESULTS
from fuse_grounding.config import Config
from fuse_grounding.environment import load_episodes

ray = pytest.importorskip("ray", reason="ray is not installed: pip install 'fuse-grounding[ray]'")

CONFIG = Config().with_(segmenter={"name": "bench_doubles:Eye"}, budget={"actions": 2})


class Quiet:
    """A listener that calls `first` after the first row."""

    def __init__(self, first: Any = lambda: None):
        self._first, self.rows = first, 0

    def opened(self, done: int, total: int) -> None:
        pass

    def note(self, sentence: str) -> None:
        raise AssertionError(sentence)

    def row(self, row: Row, part: str) -> None:
        self.rows += 1
        if self.rows == 1:
            self._first()


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A head without processors and two nodes of one each."""
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("BENCH_DOUBLES_SLEEP", "0.5")  # nodes inherit it
    store = 80 * 2**20
    # A lost node, which refuses connections, is noticed within seconds; a busy one is given time.
    hasty = {"health_check_initial_delay_ms": 0, "health_check_period_ms": 500}
    hasty |= {"health_check_timeout_ms": 10_000, "health_check_failure_threshold": 4}
    head = {"num_cpus": 0, "object_store_memory": store, "_system_config": hasty}
    made = Cluster(initialize_head=True, head_node_args=head)
    nodes = [made.add_node(num_cpus=1, object_store_memory=store) for _ in range(2)]
    made.wait_for_nodes()
    ray.init(address=made.address, log_to_driver=False, logging_level=logging.ERROR)
    try:
        yield made, nodes
    finally:
        ray.shutdown()
        made.shutdown()


def untimed(out: Path) -> list[dict[str, Any]]:
    rows = [json.loads(line) for line in (out / RESULTS).read_text().splitlines()]
    return [
        {k: v for k, v in row.items() if k not in ("timings", "concurrent") and not k.endswith("_seconds")}
        for row in rows
    ]


def test_a_lost_node_loses_nothing_and_doubles_nothing(cluster: Any, tmp_path: Path):
    made, nodes = cluster
    methods = ("bench_doubles:walk",)
    episodes = load_episodes("dev")[:4]
    heard = Quiet(lambda: made.remove_node(nodes[1], allow_graceful=False))
    plan = Plan(tmp_path / "ray", CONFIG, episodes, methods)
    (outcome,) = run_benchmarks([plan], Means(RayEngine, "ray", None), heard)
    assert heard.rows == len(outcome.rows) == 4
    assert all(row["status"] == "ok" for row in outcome.rows)
    alone = Means(lambda setups: Processes(setups, 1), "local", 1)
    run_benchmarks([Plan(tmp_path / "alone", CONFIG, episodes, methods)], alone, Quiet())
    assert untimed(tmp_path / "ray") == untimed(tmp_path / "alone")
