"""Rows in, tables out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuse_grounding.benchmark import power, statistics
from fuse_grounding.benchmark.comparison import CONTINUOUS, Comparison, compare, summarize
from fuse_grounding.benchmark.metrics import METRICS
from fuse_grounding.errors import InputError

Row = dict[str, Any]


def row(method: str, episode: int, iou: float, actions: float | None = None, **more: Any) -> Row:
    return {
        "method": method,
        "episode_id": f"e{episode:03d}",
        "status": "ok",
        "success": iou >= 0.5,
        "iou": iou,
        "online_actions": actions,
        **more,
    }


def failed(method: str, episode: int) -> Row:
    return {"method": method, "episode_id": f"e{episode:03d}", "status": "error", "error": "broke"}


def rows_of(**ious: list[float]) -> list[Row]:
    return [
        row(method, i, value, actions=i % 4 + len(method))
        for method, values in ious.items()
        for i, value in enumerate(values)
    ]


ROWS = rows_of(
    fuse=[0.9, 0.8, 0.9, 0.7, 0.1, 0.0, 0.95, 0.6],
    random=[0.9, 0.2, 0.1, 0.0, 0.6, 0.0, 0.95, 0.4],
    static=[0.0, 0.0, 0.1, 0.7, 0.1, 0.0, 0.3, 0.4],
)


def test_a_success_table_by_hand():
    table = compare(ROWS, "fuse")
    assert (table.reference, table.others, table.episodes) == ("fuse", ("random", "static"), 8)
    line = table.success[0]
    assert (line.reference, line.other, line.pairs) == ("fuse", "random", 8)
    assert (line.reference_successes, line.other_successes) == (6, 3)
    assert (line.both, line.reference_only, line.other_only, line.neither) == (2, 4, 1, 1)
    assert line.delta_points == pytest.approx(37.5)
    assert line.p == pytest.approx(2 * 6 / 32)
    assert (line.odds_ratio, line.cohens_g) == (4.0, pytest.approx(0.3))
    assert line.interval_points is not None
    assert line.interval_points.low <= 37.5 <= line.interval_points.high
    assert [x.holm_p for x in table.success] == statistics.holm([x.p for x in table.success])
    assert line.pairs_needed == power.pairs_needed(4 / 8, 1 / 8)
    assert line.detectable_points is None  # five discordant pairs are never significant


def test_a_continuous_table_by_hand():
    table = compare(ROWS, "fuse", metrics=["iou"])
    random, static = table.continuous
    assert (random.other, random.metric, random.pairs, random.left_out) == ("random", "iou", 8, 0)
    assert random.reference_mean == pytest.approx(4.95 / 8)
    assert random.delta == pytest.approx((4.95 - 3.15) / 8)
    assert random.nonzero == 5
    d = np.array([0, 0.6, 0.8, 0.7, -0.5, 0, 0, 0.2])
    assert random.p == pytest.approx(statistics.wilcoxon(d).p)
    assert random.rank_biserial == pytest.approx((15 - 2 * 2) / 15)
    assert random.d_z == pytest.approx(d.mean() / d.std(ddof=1))
    assert [random.holm_p, static.holm_p] == statistics.holm([random.p, static.p])


def test_families_are_a_metric_each():
    """Holm within a metric: a third method raises the adjusted values, another metric does not."""
    alone = compare(ROWS, "fuse", ["random"])
    both = compare(ROWS, "fuse", ["random", "static"])
    for line in alone.continuous:
        assert line.holm_p == line.p
    assert alone.success[0].holm_p == alone.success[0].p
    iou_alone = [x.holm_p for x in compare(ROWS, "fuse", metrics=["iou"]).continuous]
    assert [x.holm_p for x in both.continuous if x.metric == "iou"] == iou_alone
    raw, adjusted = [x.p for x in both.success], [x.holm_p for x in both.success]
    assert adjusted == pytest.approx(statistics.holm(raw))
    assert adjusted != pytest.approx(raw)


def test_a_failed_episode_is_a_failure_and_leaves_the_other_metrics():
    rows = [r for r in ROWS if (r["method"], r["episode_id"]) != ("random", "e000")] + [failed("random", 0)]
    table = compare(rows, "fuse", ["random"])
    line = table.success[0]
    assert (line.pairs, line.other_failed, line.reference_failed) == (8, 1, 0)
    assert (line.both, line.reference_only) == (1, 5)
    by_metric = {x.metric: x for x in table.continuous}
    assert (by_metric["iou"].pairs, by_metric["iou"].left_out) == (8, 0)
    assert by_metric["iou"].other_mean == pytest.approx((3.15 - 0.9) / 8)
    assert (by_metric["online_actions"].pairs, by_metric["online_actions"].left_out) == (7, 1)
    summary = next(s for s in summarize(rows) if s.method == "random")
    assert (summary.episodes, summary.failed, summary.successes) == (8, 1, 2)
    assert {m.metric: m.episodes for m in summary.means} == {"iou": 8, "online_actions": 7}


def test_a_metric_that_no_pair_has_is_no_test():
    rows = [{**r, "final_score": None if r["method"] == "static" else r["iou"]} for r in ROWS]
    table = compare(rows, "fuse", metrics=["final_score"])
    random, static = table.continuous
    assert (static.pairs, static.left_out, static.p, static.holm_p, static.delta) == (0, 8, None, None, None)
    assert (static.interval, static.d_z, static.rank_biserial, static.pairs_needed) == (None,) * 4
    assert random.holm_p == random.p


def test_equal_methods():
    rows = rows_of(a=[0.9, 0.1, 0.6], b=[0.9, 0.1, 0.6])
    table = compare(rows, "a")
    line = table.success[0]
    assert (line.p, line.holm_p, line.odds_ratio, line.pairs_needed) == (1.0, 1.0, None, None)
    iou = table.continuous[0]
    assert (iou.delta, iou.nonzero, iou.p, iou.holm_p, iou.d_z) == (0.0, 0, 1.0, 1.0, None)
    assert iou.interval == statistics.Interval(0.0, 0.0)


def test_a_method_by_itself():
    fuse = summarize(ROWS)[0]
    assert (fuse.method, fuse.successes, fuse.rate) == ("fuse", 6, 0.75)
    assert fuse.rate_interval == statistics.wilson(6, 8)
    iou = next(m for m in fuse.means if m.metric == "iou")
    assert iou.mean == pytest.approx(4.95 / 8)
    assert iou.interval == statistics.bootstrap_mean([0.9, 0.8, 0.9, 0.7, 0.1, 0.0, 0.95, 0.6])


def test_any_column_can_tell_methods_apart():
    rows = [{**r, "knowledge": r["method"], "method": "fuse"} for r in ROWS]
    mine, theirs = compare(rows, "fuse", by="knowledge"), compare(ROWS, "fuse")
    assert mine == theirs


@settings(max_examples=10, deadline=None)
@given(st.randoms(use_true_random=False))
def test_tables_know_no_order_of_rows(random: Any):
    shuffled = random.sample(ROWS, len(ROWS))
    order = ["random", "static"]
    assert compare(shuffled, "fuse", order, resamples=50) == compare(ROWS, "fuse", order, resamples=50)


def test_tables_turn_with_the_reference():
    one, other = compare(ROWS, "fuse", ["random"]), compare(ROWS, "random", ["fuse"])
    a, b = one.success[0], other.success[0]
    assert (a.p, a.delta_points, a.pairs_needed) == (b.p, -b.delta_points, b.pairs_needed)
    assert (a.reference_only, a.other_only) == (b.other_only, b.reference_only)
    for x, y in zip(one.continuous, other.continuous, strict=True):
        assert (x.p, x.nonzero) == (y.p, y.nonzero)
        assert x.delta == pytest.approx(-(y.delta or 0.0))
        assert x.interval is not None
        assert y.interval is not None
        assert (x.interval.low, x.interval.high) == pytest.approx((-y.interval.high, -y.interval.low))


def test_the_seed_is_kept_with_the_table():
    table = compare(ROWS, "fuse", resamples=200, seed=7)
    assert (table.seed, table.resamples) == (7, 200)
    assert table == compare(ROWS, "fuse", resamples=200, seed=7)
    assert _intervals(table) != _intervals(compare(ROWS, "fuse", resamples=200, seed=8))
    assert replace(table, seed=8) != table


def _intervals(table: Comparison) -> list[Any]:
    return [line.interval for line in table.continuous]


def test_what_is_compared_is_what_is_documented():
    assert tuple(m.name for m in METRICS)[1:] == CONTINUOUS
    assert [line.metric for line in compare(ROWS, "fuse", ["random"]).continuous] == ["iou", "online_actions"]


@pytest.mark.parametrize(
    ("rows", "arguments", "message"),
    [
        (ROWS, {"reference": "fsue"}, "no method `fsue`; they have fuse, random, static"),
        (ROWS, {"reference": "fuse", "others": ["fuse"]}, "each must be there once"),
        (ROWS, {"reference": "fuse", "others": ["random", "random"]}, "each must be there once"),
        (ROWS, {"reference": "fuse", "metrics": ["iuo"]}, "no result has the metric `iuo`; known: iou,"),
        (ROWS[1:], {"reference": "fuse"}, "`fuse` has no result for e000"),
        (
            ROWS[:9],
            {"reference": "fuse"},
            "`random` has no result for e001, e002, e003, e004, e005 and 2 more",
        ),
        ([*ROWS, ROWS[0]], {"reference": "fuse"}, "`fuse` has two results for episode e000"),
        ([{"method": "fuse"}], {"reference": "fuse"}, "result 1 has no `episode_id`"),
        ([], {"reference": "fuse"}, "no results to compute"),
        (ROWS, {"reference": "fuse", "by": "knowledge"}, "result 1 has no `knowledge`"),
        (
            [{**r, "success": None} for r in ROWS],
            {"reference": "fuse"},
            "e000: `success` is None, expected true or false",
        ),
        (
            [{**r, "iou": "0.5"} for r in ROWS],
            {"reference": "fuse"},
            "e000: `iou` is '0.5', expected a number",
        ),
    ],
)
def test_wrong_rows_are_named(rows: list[Row], arguments: dict[str, Any], message: str):
    with pytest.raises(InputError, match=message):
        compare(rows, **arguments)
