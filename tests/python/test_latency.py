"""The latency table on rows made by hand."""

from __future__ import annotations

from typing import Any

import pytest

from fuse_grounding.benchmark.latency import COMPONENTS, latency
from fuse_grounding.benchmark.metrics import HOSTED
from fuse_grounding.errors import InputError


def row(**changes: Any) -> dict[str, Any]:
    """An episode of three observations; 10 s by the stopwatch, 0.5 s beside it, 1 s to evaluate it."""
    return {
        "method": "fuse",
        "status": "ok",
        "concurrent": False,
        "calls": {"initialize": 1, "segment": 3, "ground": 4, "register": 3, "predict": 2}
        | {"initialize_map": 1, "refine": 1, "render": 1, "evidence": 1, "plan": 1, "observe": 4, "act": 2},
        "timings": {"initialize": 1.0, "segment": 3.0, "ground": 0.2, "register": 1.5, "predict": 0.1}
        | {"initialize_map": 2.0, "refine": 1.0, "render": 0.3, "evidence": 0.5, "plan": 0.1}
        | {"observe": 0.2, "act": 0.1},
        "branches": {"amortized": 1, "explicit": 1},
        "wall_seconds": 10.5,
        "runtime_seconds": 11.5,
        **changes,
    }


def test_a_table_by_hand():
    # The second episode is amortised throughout: neither map nor evidence.
    short = row(
        calls={"initialize": 1, "segment": 1, "observe": 2},
        timings={"initialize": 3.0, "segment": 2.0, "observe": 0.5},
        branches={"amortized": 3},
        wall_seconds=5.5,
        runtime_seconds=6.5,
    )
    table = latency([row(), short, row(status="error", timings={})])
    assert (table.method, table.episodes, table.errors, table.concurrent) == ("fuse", 2, 1, 0)
    assert list(table.components) == [*COMPONENTS, "final_evaluation", "other"]

    def of(name: str) -> Any:
        c = table.components[name]
        assert c.s_per_call is not None
        return pytest.approx((c.calls_per_ep, c.s_per_call, c.s_per_ep, c.share_pct))

    assert of("initialization") == (1.0, 3.0, 3.0, 100 * 6 / 18)  # 1 + 2 and 3 seconds
    assert of("segmentation") == (2.0, 5 / 4, 2.5, 100 * 5 / 18)
    assert of("depth_and_stopping") == (2.0, 0.05, 0.1, 100 * 0.2 / 18)
    assert of("amortized_planning") == (1.0, 0.05, 0.05, 100 * 0.1 / 18)
    assert of("view_registration") == (1.5, 0.5, 0.75, 100 * 1.5 / 18)
    assert of("map_refinement") == (0.5, 1.0, 0.5, 100 * 1 / 18)
    assert of("explicit_evidence") == (0.5, 0.8, 0.4, 100 * 0.8 / 18)
    assert of("camera_execution") == (4.0, 0.1, 0.4, 100 * 0.8 / 18)
    assert of("final_evaluation") == (1.0, 1.0, 1.0, 100 * 2 / 18)
    other = table.components["other"]
    assert (other.calls_per_ep, other.s_per_call) == (0, None)
    assert other.s_per_ep == pytest.approx(0.25)
    assert table.total_s_per_ep == pytest.approx(9.0)
    assert sum(c.s_per_ep for c in table.components.values()) == pytest.approx(table.total_s_per_ep)
    assert sum(c.share_pct for c in table.components.values()) == pytest.approx(100)
    assert table.branch_pct == {"amortized": 80.0, "explicit": 20.0}
    assert table.refinements_per_ep.mean == 0.5
    assert table.refinements_per_ep.sd == pytest.approx(0.5**0.5)
    assert latency([row()]).refinements_per_ep.sd == 0.0
    assert table.to_dict()["components"]["segmentation"]["calls_per_ep"] == 2.0


def test_waiting_for_a_hosted_model_is_no_part_of_it():
    timings = {**row()["timings"], HOSTED: 30.0}
    calls = {**row()["calls"], HOSTED: 2}
    waited = latency([row(timings=timings, calls=calls, wall_seconds=40.5)])
    assert waited.to_dict() == latency([row()]).to_dict()


def test_what_cannot_be_timed_is_refused():
    with pytest.raises(InputError, match="1 of 2 rows of `fuse` ran beside other episodes"):
        latency([row(), row(concurrent=True)])
    assert latency([row(), row(concurrent=True)], concurrent=True).concurrent == 1
    with pytest.raises(InputError, match="of one method, found explicit, fuse"):
        latency([row(), row(method="explicit")])
    with pytest.raises(InputError, match="found no rows"):
        latency([])
    with pytest.raises(InputError, match="`fuse` has no episode that ran through"):
        latency([row(status="error")])
