"""`fuse report`: what it reads and refuses, what its tables say, in which files."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_folders import make_row, write_folder

from fuse_grounding.benchmark.identity import stamp
from fuse_grounding.benchmark.report import Options, build, load, write
from fuse_grounding.benchmark.report.latex import escape
from fuse_grounding.benchmark.report.load import set_name
from fuse_grounding.benchmark.report.model import Cell, Column, Figure, Report, Row, Table, Text
from fuse_grounding.benchmark.store import HEADER, RESULTS
from fuse_grounding.cli.app import execute
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode, load_episodes
from fuse_grounding.errors import InputError

pytest.importorskip("scipy", reason="the statistics of a report need the extra `report`")
pytest.importorskip("statsmodels", reason="the statistics of a report need the extra `report`")

DEV = load_episodes("dev")[:10]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder where nothing is out of the ordinary."""
    return write_folder(tmp_path_factory.mktemp("plain") / "b")


@pytest.fixture(scope="module")
def usual(plain: Path) -> Report:
    return report_of(plain)


def report_of(*folders: Path, partial: bool = False, options: Options | None = None) -> Report:
    return build(load(folders, partial), options or Options())


def table(report: Report, name: str) -> Table:
    return next(t for t in report.tables() if t.name == name)


def line(made: Table, *first: str) -> dict[str, Cell]:
    """The row that begins with these words, by column."""
    row = next(r for r in made.rows if tuple(c.value for c in r.cells[: len(first)]) == first)
    return {c.key: cell for c, cell in zip(made.columns, row.cells, strict=False)}


def figures(report: Report) -> dict[str, Figure]:
    return {b.name: b for s in report.sections for b in s.blocks if isinstance(b, Figure)}


# -- what is read ------------------------------------------------------------------------------------


def test_what_is_no_benchmark_is_refused_by_name(tmp_path: Path):
    with pytest.raises(InputError, match="missing does not exist"):
        load([tmp_path / "missing"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty has no results: no bench\.json in it"):
        load([tmp_path / "empty"])
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file is a file"):
        load([tmp_path / "file"])
    none_yet = write_folder(
        tmp_path / "none", without=[(m, e.episode_id) for m in ("fuse",) for e in DEV], methods=["fuse"]
    )
    with pytest.raises(InputError, match=r"none: no results yet; expected lines in results\.jsonl"):
        load([none_yet])


def test_results_of_another_version_are_refused(tmp_path: Path):
    folder = write_folder(tmp_path / "old")
    header = json.loads((folder / HEADER).read_text())
    (folder / HEADER).write_text(json.dumps({**header, "schema_version": 2}))
    with pytest.raises(InputError, match=r"old/bench\.json has schema_version 2, expected 3"):
        load([folder])


def test_a_row_that_ran_through_says_whether_it_succeeded(tmp_path: Path):
    folder = write_folder(tmp_path / "broken", success="perhaps")
    with pytest.raises(
        InputError, match=r"results\.jsonl, line 1: not a result \(`success`: found 'perhaps', expected: "
    ):
        load([folder])


def test_missing_pairs_are_named_and_reported_on_only_if_asked(tmp_path: Path):
    gone = [("fuse", e.episode_id) for e in DEV[2:9]]
    folder = write_folder(tmp_path / "part", without=gone)
    with pytest.raises(InputError) as error:
        load([folder])
    lacks = (
        "part `main` over `dev`: `fuse` lacks 7 of 10 episodes (dev_0002, dev_0003, dev_0004, dev_0005, "
        "dev_0006 and 2 more)"
    )
    needs = "; paired comparisons need every episode of every method: finish with `fuse bench --resume`"
    assert str(error.value).startswith(lacks + needs)
    report = report_of(folder, partial=True)
    assert line(table(report, "dev_main"), "FUSE")["episodes"].value == 3
    assert "the same 3 episodes" in table(report, "dev_main_paired_success").caption
    words = [
        b.words for s in report.sections for b in s.blocks if isinstance(b, Text) and b.kind == "warning"
    ]
    assert words[0] == f"Incomplete: {lacks}."
    assert words[1].startswith("Lines of a table may be over different episodes")


def test_a_method_without_a_result_is_listed_as_not_run(tmp_path: Path):
    folder = write_folder(tmp_path / "part", without=[("fuse", e.episode_id) for e in DEV])
    report = report_of(folder, partial=True)
    (row,) = [r for r in table(report, "dev_main").rows if r.note]
    assert (row.cells[0].value, row.note) == ("FUSE", "not run: no results yet")


def test_one_method_with_two_results_is_refused_and_with_one_counted_once(tmp_path: Path):
    first = write_folder(tmp_path / "first", ["static", "fuse"])
    same = write_folder(tmp_path / "same", ["fuse"], wall_seconds=77.0)  # times may differ
    assert len(load([first, same]).parts[0].arms) == 2
    other = write_folder(tmp_path / "other", ["fuse"], iou=0.123)
    with pytest.raises(InputError) as error:
        load([first, other])
    assert str(error.value) == (
        f"{first} and {other} both have method `fuse` under the same settings, with different results of "
        "episode dev_0000; report one of them"
    )


def test_times_that_were_measured_alone_are_taken_before_those_beside_others(tmp_path: Path):
    beside = write_folder(tmp_path / "beside", ["fuse"], concurrent=True, wall_seconds=9.0)
    alone = write_folder(tmp_path / "timing", ["fuse"], DEV[:3], concurrent=False, wall_seconds=4.0)
    for order in ([beside, alone], [alone, beside]):
        (arm,) = load(order).parts[0].arms
        seconds = {e: r["wall_seconds"] for e, r in arm.rows.items()}
        assert seconds == {e.episode_id: 4.0 if e in DEV[:3] else 9.0 for e in DEV}


def test_episodes_of_one_name_must_be_one_episode(tmp_path: Path):
    twin = Episode(DEV[0].text.replace(str(DEV[0].seed), "7"))
    assert twin.text != DEV[0].text
    first = write_folder(tmp_path / "first", ["static"], DEV[:1])
    second = write_folder(tmp_path / "second", ["fuse"], [twin])
    with pytest.raises(
        InputError, match="ran different episodes of the name dev_0000; they cannot be compared"
    ):
        load([first, second])


def test_folders_inside_a_folder_are_found_and_named_without_their_place(tmp_path: Path):
    write_folder(tmp_path / "suite" / "main")
    write_folder(tmp_path / "suite" / "eta" / "low", ["fuse"], part="eta", settings={"gate": {"eta": 0.6}})
    write_folder(tmp_path / "suite" / "eta" / "high", ["fuse"], part="eta", settings={"gate": {"eta": 0.9}})
    results = load([tmp_path / "suite", tmp_path / "suite" / "main"])
    assert [f.label for f in results.folders] == ["suite/main", "suite/eta/high", "suite/eta/low"]
    assert [(p.name, [a.label for a in p.arms]) for p in results.parts] == [
        ("main", ["static", "explicit", "fuse"]),
        ("eta", ["eta = 0.9", "eta = 0.6"]),
    ]
    report = build(results)
    write(report, tmp_path / "out")
    for path in (tmp_path / "out").rglob("*.*"):
        assert str(tmp_path) not in path.read_text(), f"{path} says where it was made"


def test_parts_of_a_suite_are_compared_within_their_group(tmp_path: Path):
    write_folder(tmp_path / "s" / "eta_0.6", ["fuse"], part="eta_0.6", settings={"gate": {"eta": 0.6}})
    write_folder(tmp_path / "s" / "eta_0.8", ["fuse"], part="eta_0.8", settings={"gate": {"eta": 0.8}})
    for path in (tmp_path / "s").iterdir():
        header = json.loads((path / HEADER).read_text())
        missing = [{"name": "eta_0.9", "reason": "no time"}]
        (path / HEADER).write_text(json.dumps({**header, "group": "eta", "not_run": missing}))
    report = report_of(tmp_path / "s")
    assert [r.cells[0].value for r in table(report, "dev_eta").rows] == [0.6, 0.8, "eta_0.9"]
    assert [r.cells[0].value for r in table(report, "dev_eta_endings").rows] == ["eta = 0.6", "eta = 0.8"]
    assert [r.note for r in table(report, "folders").rows if r.note] == ["not run: no time"]


def test_several_methods_under_several_settings_are_each_compared_with_themselves(tmp_path: Path):
    for eta in (0.6, 0.8):
        settings = {"gate": {"eta": eta}}
        write_folder(tmp_path / str(eta), ["amortized", "fuse"], part="eta", settings=settings)
    report = report_of(tmp_path)
    for method, title in (("amortized", "Amortized Planner"), ("fuse", "FUSE")):
        made = table(report, f"dev_eta_{method}_paired_success")
        assert made.title == f"Paired: success, {title}"
        assert made.caption.startswith(f"{title} (eta = 0.6) against the others")
        assert [row.cells[0].value for row in made.rows] == [f"{title} (eta = 0.8)"]


def test_a_part_run_by_hand_is_compared_with_its_suite(tmp_path: Path):
    """And what is there is not listed as not run."""
    note = ("evidence_clip_patches", "no weights")
    write_folder(tmp_path / "s" / "main", ["static", "fuse"], part="main")
    write_folder(tmp_path / "s" / "evidence_pixel", ["fuse"], part="evidence", not_run=[note])
    by_hand = tmp_path / "s" / "evidence_clip_patches"
    write_folder(by_hand, ["fuse"], settings={"segmenter": {"name": "clip_patches"}})
    results = load([tmp_path / "s"])
    assert {p.name: [a.label for a in p.arms] for p in results.parts} == {
        "main": ["static", "fuse"],
        "evidence": ["name = clip_patches", "name = embedded"],
    }
    assert [p.not_run for p in results.parts] == [[], []]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (("results_version",), "`results_version` is 4 in "),
        (("data",), "`data` is "),
        (("methods", "fuse", "weights", "segmenter"), r"`methods\.fuse\.weights\.segmenter` is "),
    ],
)
def test_what_was_made_otherwise_is_not_compared(tmp_path: Path, change: tuple[str, ...], sentence: str):
    """Else two versions stand in one paired table, or two networks in one line."""
    first = write_folder(tmp_path / "a", ["fuse"], DEV[:5])
    other = write_folder(tmp_path / "b", ["fuse"], DEV[5:])
    assert len(load([first, other]).parts[0].arms[0].rows) == 10
    header = json.loads((other / HEADER).read_text())
    place = header["identity"]
    for key in change[:-1]:
        place = place[key]
    place[change[-1]] = 3 if change == ("results_version",) else "77" * 32
    restamp(other, header)
    with pytest.raises(InputError, match=f"^{sentence}.*report one of them$"):
        load([first, other])


def restamp(folder: Path, header: dict[str, Any]) -> None:
    """Makes a folder's results those of another header."""
    (folder / HEADER).write_text(json.dumps(header))
    rows = [json.loads(text) for text in (folder / RESULTS).read_text().splitlines()]
    for row in rows:
        row["identity"] = stamp(header["identity"], row["method"], row["episode_id"])
    (folder / RESULTS).write_text("".join(json.dumps(row) + "\n" for row in rows))


def test_a_set_of_episodes_is_named_by_what_their_ids_share():
    assert set_name(["eval_0000", "eval_0001"]) == "eval"
    assert set_name(["eval_0000", "dev_0001"]) == "mixed"
    assert set_name(["kitchen"]) == "kitchen"


# -- what the tables say -----------------------------------------------------------------------------


def test_the_main_table_has_means_and_intervals_of_the_rows(usual: Report):
    made = table(usual, "dev_main")
    rows = [make_row("explicit", e, i) for i, e in enumerate(DEV)]
    found = line(made, "Explicit Exploration")
    won = sum(r["success"] for r in rows)
    assert found["success"].value == won / 10
    p, z, n = won / 10, 1.959964, 10  # Wilson's formula
    centre, half = (
        (p + z**2 / 2 / n) / (1 + z**2 / n),
        z * np.sqrt(p * (1 - p) / n + z**2 / 4 / n**2) / (1 + z**2 / n),
    )
    assert (found["success"].low, found["success"].high) == pytest.approx(
        (centre - half, centre + half), abs=1e-6
    )
    for metric in ("iou", "online_actions", "center_score", "runtime_seconds"):
        values = [r[metric] for r in rows]
        assert found[metric].value == pytest.approx(np.mean(values))
        assert found[metric].low is not None
        assert found[metric].high is not None
        assert found[metric].low <= np.mean(values) <= found[metric].high
    assert [r.cells[0].value for r in made.rows] == ["Static", "Explicit Exploration", "FUSE"]


def test_an_error_is_a_failure_and_is_listed(tmp_path: Path, usual: Report):
    won = next(e.episode_id for i, e in enumerate(DEV) if make_row("fuse", e, i)["success"])
    report = report_of(write_folder(tmp_path / "b", errors=[("fuse", won)]))
    before, after = (line(table(r, "dev_main"), "FUSE") for r in (usual, report))
    assert isinstance(before["success"].value, float)
    assert after["success"].value == pytest.approx(before["success"].value - 0.1)
    assert (after["episodes"].value, after["errors"].value) == (10, 1)
    listed = table(report, "errors")
    assert [c.value for c in listed.rows[0].cells[:3]] == ["b", "FUSE", won]
    assert "Each counts as a failure" in listed.caption
    assert any("IoU 0" in note for note in table(report, "dev_main").notes)


def test_what_was_not_run_stands_with_its_reason_in_every_format(tmp_path: Path):
    folder = write_folder(tmp_path / "b", not_run=[("vlm", "needs a hosted model & a key_")])
    write(report_of(folder), tmp_path / "out")
    reason = "needs a hosted model"
    assert f"not run: {reason} &amp; a key_" in (tmp_path / "out/report.html").read_text()
    assert f"VLM Active | not run: {reason} & a key\\_ |" in (tmp_path / "out/report.md").read_text()
    assert rf"\emph{{not run: {reason} \& a key\_}}" in (tmp_path / "out/tables/dev_main.tex").read_text()
    with (tmp_path / "out/tables/dev_main.csv").open() as file:
        last = list(csv.DictReader(file))[-1]
    assert (last["method"], last["success"], last["note"]) == (
        "VLM Active",
        "",
        f"not run: {reason} & a key_",
    )


def test_paired_tables_compare_with_fuse_or_with_whom_one_asks(plain: Path, usual: Report):
    paired = table(usual, "dev_main_paired_success")
    assert [r.cells[0].value for r in paired.rows] == ["Static", "Explicit Exploration"]
    fuse, explicit = ([make_row(m, e, i)["success"] for i, e in enumerate(DEV)] for m in ("fuse", "explicit"))
    found = line(paired, "Explicit Exploration")
    assert found["reference_only"].value == sum(a and not b for a, b in zip(fuse, explicit, strict=True))
    assert found["other_only"].value == sum(b and not a for a, b in zip(fuse, explicit, strict=True))
    other = report_of(plain, options=Options(reference="static"))
    assert [r.cells[0].value for r in table(other, "dev_main_paired_success").rows] == [
        "Explicit Exploration",
        "FUSE",
    ]
    with pytest.raises(InputError, match="unknown method `fues`; did you mean `fuse`"):
        report_of(plain, options=Options(reference="fues"))


def test_an_ablation_is_compared_with_the_default_settings(tmp_path: Path):
    etas, default = (0.6, 0.8, 0.9), Config().gate.eta
    for eta in etas:
        write_folder(
            tmp_path / "s" / str(eta), ["fuse"], part="eta", settings={"gate": {"eta": eta}}, shift=eta
        )
    report = report_of(tmp_path / "s")
    made = table(report, "dev_eta")
    assert [c.key for c in made.columns[:2]] == ["gate.eta", "episodes"]
    assert [r.cells[0].value for r in table(report, "dev_eta_paired_success").rows] == [
        f"eta = {eta}" for eta in etas if eta != default
    ]


def test_the_papers_figures_are_labelled_as_of_another_world(usual: Report):
    made = table(usual, "dev_main_paper")
    assert "another world" in made.title
    assert "not comparable" in made.notes[0]
    found = line(made, "FUSE")
    ours = line(table(usual, "dev_main"), "FUSE")["success"].value
    assert (found["success_here"].value, found["success_paper"].value) == (ours, 0.72)
    assert found["steps_paper"].value == 9.32
    missing = line(made, "Canonical View")
    assert missing["success_here"].text == "not run here"
    assert missing["success_paper"].value == 0.32
    assert len(made.rows) == 10


def test_arms_of_the_ablations_answer_to_rows_of_the_papers(tmp_path: Path):
    for name, weights in (("no_depth", [0.7, 0.0]), ("depth", [0.7, 0.3])):
        settings: dict[str, Any] = {"stopping": {"patience": 3, "weights": weights}}
        write_folder(tmp_path / "s" / name, ["fuse"], part="stopping", settings=settings, shift=sum(weights))
    write_folder(tmp_path / "s" / "graph", ["fuse"], part="knowledge")
    write_folder(tmp_path / "s" / "oracle", ["fuse_oracle"], part="knowledge")
    report = report_of(tmp_path / "s")
    stopping = table(report, "dev_stopping_paper")
    assert line(stopping, "K = 3, depth")["arm"].value == "weights = [0.7, 0.3]"
    assert line(stopping, "K = 5, depth")["arm"].value == "not run here"
    knowledge = table(report, "dev_knowledge_paper")
    assert line(knowledge, "CRAFT-E")["arm"].value == "fuse"
    assert line(knowledge, "Oracle-Label")["arm"].value == "fuse_oracle"
    assert [c.value for c in table(report, "dev_knowledge").rows[1].cells[:2]] == [
        "Oracle-Label FUSE",
        "oracle",
    ]


def test_the_speed_up_is_over_what_explicit_search_took_on_the_same_episodes(tmp_path: Path):
    folder = write_folder(tmp_path / "b", errors=[("fuse", "dev_0001")])
    found = line(table(report_of(folder), "dev_main_runtime"), "FUSE")
    seconds = {
        m: {e.episode_id: make_row(m, e, i)["runtime_seconds"] for i, e in enumerate(DEV)}
        for m in ("fuse", "explicit")
    }
    both = [e.episode_id for e in DEV if e.episode_id != "dev_0001"]
    expected = sum(seconds["explicit"][e] for e in both) / sum(seconds["fuse"][e] for e in both)
    assert found["speedup"].value == pytest.approx(expected)
    assert found["speedup"].low is not None
    assert found["speedup"].low < expected
    assert found["speedup_paper"].value == 1.33


def test_times_that_were_measured_beside_others_are_announced(tmp_path: Path, usual: Report):
    alone = table(usual, "dev_main_runtime")
    beside = table(report_of(write_folder(tmp_path / "b", concurrent=True)), "dev_main_runtime")
    assert not any("at the same time" in n for n in alone.notes)
    assert any("other episodes ran at the same time" in n and "FUSE" in n for n in beside.notes)
    mixed = report_of(
        write_folder(tmp_path / "m" / "slow", ["explicit", "fuse"]),
        write_folder(tmp_path / "m" / "fast", ["amortized"], concurrent=True),
    )
    runtimes = table(mixed, "dev_main_runtime")
    assert line(runtimes, "FUSE")["speedup"].value is not None
    assert line(runtimes, "Amortized Planner")["speedup"].value is None
    assert any("at the same time" in n for n in table(mixed, "dev_main").notes)
    pairs = {
        (row.cells[0].value, row.cells[1].value): row.cells[2].value
        for row in table(mixed, "dev_main_paired_metrics").rows
    }
    assert pairs["Explicit Exploration", "Runtime, s"] == 10
    assert pairs["Amortized Planner", "Runtime, s"] == 0


def test_success_is_broken_down_by_verb_scene_and_visibility(usual: Report):
    for name in ("verb", "scene", "visibility"):
        counts = [r.cells[1].value for r in table(usual, f"dev_main_by_{name}").rows]
        assert sum(int(n) for n in counts if n is not None) == 10
    rows = [make_row("fuse", e, i) for i, e in enumerate(DEV)]
    verb = DEV[0].verb
    mine = [r["success"] for r in rows if r["verb"] == verb]
    assert line(table(usual, "dev_main_by_verb"), verb.replace("_", " "))["fuse"].value == np.mean(mine)
    hidden = [0.2 <= e.data["start_fraction"] < 0.3 for e in DEV]
    assert any(hidden)
    share = np.mean([r["success"] for r, h in zip(rows, hidden, strict=True) if h])
    assert line(table(usual, "dev_main_by_visibility"), "20 to 30 %")["fuse"].value == pytest.approx(share)


@pytest.mark.parametrize(
    ("changes", "kind"),
    [
        ({"success": False, "iou": 0.3}, "rough"),
        ({"success": False, "iou": 0.02}, "another"),
        ({"success": False, "iou": 0.0, "label": None}, "nothing"),
    ],
)
def test_failures_are_told_apart_by_what_they_returned(tmp_path: Path, changes: dict[str, Any], kind: str):
    report = report_of(write_folder(tmp_path / "b", ["fuse"], **changes))
    found = line(table(report, "dev_main_endings"), "FUSE")
    assert {k for k in ("success", "rough", "another", "nothing", "error") if found[k].value} == {kind}
    assert found[kind].value == 1
    held = [make_row("fuse", e, i)["success"] for i, e in enumerate(DEV)]  # traces still say what was seen
    assert found["lost"].value == pytest.approx(np.mean(held))
    assert found["unscored"].value == 0
    assert found["views_won"].value is None
    seen = [make_row("fuse", e, i)["observations"] for i, e in enumerate(DEV)]
    assert found["views_lost"].value == pytest.approx(np.mean(seen))


def test_searches_that_end_well_and_in_errors_are_told_apart(tmp_path: Path, usual: Report):
    won = next(e.episode_id for i, e in enumerate(DEV) if make_row("fuse", e, i)["success"])
    report = report_of(write_folder(tmp_path / "b", errors=[("fuse", won)]))
    before, after = (line(table(r, "dev_main_endings"), "FUSE") for r in (usual, report))
    assert (before["error"].value, after["error"].value) == (0, 0.1)
    assert isinstance(before["success"].value, float)
    assert after["success"].value == pytest.approx(before["success"].value - 0.1)
    assert before["lost"].value == 0  # of these rows the last view is always the best


def test_where_the_camera_went_is_counted(tmp_path: Path):
    path = [(34, 15.0), (1, 30.0), (1, 45.0), (1, 45.0)]
    keep = dict(branch="x", entropy=None, action=7, best_iou=0.0, best_score=None, target_pixel_ratio=0.1)
    trace = [{"node": node, "pitch_deg": pitch, **keep} for node, pitch in path]
    results = write_folder(tmp_path / "b", ["explicit"]) / RESULTS
    rows = [{**json.loads(text), "trace": trace} for text in results.read_text().splitlines()]
    results.write_text("".join(json.dumps(row) + "\n" for row in rows))
    found = line(table(report_of(tmp_path / "b"), "dev_main_travel"), "Explicit Exploration")
    assert (found["episodes"].value, found["views"].value, found["distinct"].value) == (10, 4, 3)
    assert found["around"].value == 30  # over the ring's seam
    assert [found[f"pitch_{p}"].value for p in (15, 30, 45)] == pytest.approx([0, 1 / 3, 2 / 3])


# -- plots -------------------------------------------------------------------------------------------


def test_every_plot_has_units_and_a_caption_that_says_n(usual: Report):
    found = figures(usual)
    assert len(found) == 9
    for name, figure in found.items():
        assert not figure.missing, f"{name}: {figure.missing}"
        assert re.search(r"\bn = \d", figure.caption), name
        assert figure.caption.endswith("."), name
        axes = re.findall(r'class="axisname"[^>]*>([^<]*)<', figure.svg)
        for axis in filter(None, axes):
            assert re.search(r"%|\bs\b|0 to 1|actions|pp|decision|score", axis), f"{name}: {axis} has no unit"
        assert "#" not in re.sub(r"&#\w+;", "", figure.svg), f"{name} has a colour of its own"


def test_rows_without_a_trace_make_plots_say_so(tmp_path: Path):
    found = figures(report_of(write_folder(tmp_path / "b", trace=False)))
    for name in (
        "success_over_steps",
        "entropy_over_steps",
        "branch_over_steps",
        "gate_success",
        "gate_gain",
    ):
        assert found[f"dev_{name}"].missing.startswith(
            "not recorded: these results have no step-by-step trace"
        )
    assert not found["dev_pareto"].missing
    write(report_of(tmp_path / "b"), tmp_path / "out")
    assert "not recorded" in (tmp_path / "out/report.html").read_text()


def test_success_over_steps_ends_at_success(tmp_path: Path):
    figure = figures(report_of(write_folder(tmp_path / "b", ["explicit"])))["dev_success_over_steps"]
    won = 10 * sum(make_row("explicit", e, i)["success"] for i, e in enumerate(DEV))
    tips = re.findall(r"<title>Explicit Exploration: (\d+) % after (\d+) actions</title>", figure.svg)
    assert int(tips[-1][0]) == won


# -- files -------------------------------------------------------------------------------------------


def test_the_same_results_make_the_same_files(tmp_path: Path):
    folder = write_folder(tmp_path / "b")
    for out in ("one", "two"):
        assert execute(["report", str(folder), "--out", str(tmp_path / out)]) == 0
    one = sorted(p for p in (tmp_path / "one").rglob("*") if p.is_file())
    assert len(one) > 20
    for path in one:
        assert path.read_bytes() == (tmp_path / "two" / path.relative_to(tmp_path / "one")).read_bytes()


def test_an_earlier_report_is_replaced_and_nothing_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    folder = write_folder(tmp_path / "b")
    assert execute(["report", str(folder)]) == 0
    stale = folder / "report" / "tables" / "old_main.csv"
    stale.write_text("x")
    (folder / "report" / "notes.txt").write_text("mine")
    assert execute(["report", str(folder), "--json"]) == 0
    assert not stale.exists()
    assert (folder / "report" / "notes.txt").read_text() == "mine"
    said = capsys.readouterr().out
    assert json.loads(said[said.index("{") :])["page"] == str(folder / "report" / "report.html")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("")
    assert execute(["report", str(folder), "--out", str(tmp_path / "mine")]) == 2
    assert "is not empty and not an earlier report" in capsys.readouterr().err
    assert (folder / RESULTS).is_file()


def test_latex_escapes_every_special_character():
    assert escape(r"a_b & 50% of {x} \cmd #1 ~ ^ $") == (
        r"a\_b \& 50\% of \{x\} \textbackslash{}cmd \#1 \textasciitilde{} \textasciicircum{} \$"
    )
    assert escape("−1 ± 2 × η\n≥ 日") == r"$-$1 $\pm$ 2 $\times$ $\eta$ $\geq$ ?"


def test_latex_tables_are_rectangular_and_balanced(tmp_path: Path):
    folder = write_folder(
        tmp_path / "b", errors=[("fuse", "dev_0003")], not_run=[("vlm", "no `key` {here} & no_model 100%")]
    )
    write(report_of(folder), tmp_path / "out")
    texts = sorted((tmp_path / "out" / "tables").glob("*.tex"))
    assert len(texts) > 10
    for path in texts:
        text = path.read_text()
        assert text.isascii() or "é" in text, f"{path.name} has a letter that pdfLaTeX may lack"
        plain = re.sub(r"\\[\\{}&%$#_]", "", text)
        assert plain.count("{") == plain.count("}"), path.name
        assert plain.count("$") % 2 == 0, path.name
        columns = len(re.search(r"\\begin\{tabular\}\{([lr]+)\}", text)[1])  # type: ignore[index]
        body = text.split(r"\toprule")[1].split(r"\bottomrule")[0]
        for row in (r for r in body.split("\n") if r.endswith(r"\\")):
            spanned = sum(int(n) - 1 for n in re.findall(r"\\multicolumn\{(\d+)\}", row))
            assert len(re.findall(r"(?<!\\)&", row)) + 1 + spanned == columns, f"{path.name}: {row}"


def test_csv_has_the_values_as_computed(tmp_path: Path, usual: Report):
    write(usual, tmp_path / "out")
    with (tmp_path / "out/tables/dev_main.csv").open() as file:
        rows = {r["method"]: r for r in csv.DictReader(file)}
    values = [make_row("fuse", e, i)["iou"] for i, e in enumerate(DEV)]
    assert float(rows["FUSE"]["iou"]) == pytest.approx(np.mean(values), rel=1e-12)
    assert float(rows["FUSE"]["iou_low"]) < float(rows["FUSE"]["iou"]) < float(rows["FUSE"]["iou_high"])


def test_a_column_prints_its_unit_and_no_negative_zero():
    column = Column("x", "X", "%", 1, 100.0)
    assert column.show(Cell(0.7234)) == "72.3"
    assert column.show(Cell(-0.0001)) == "0.0"
    assert column.show(Cell(-0.051)) == "−5.1"
    assert column.show(Cell()) == "–"
    assert column.interval(Cell(0.5, 0.25, 0.75)) == "[25.0, 75.0]"
    assert Row([Cell("a")], note="not run").note == "not run"
