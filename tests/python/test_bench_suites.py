"""Suites: parts in folders, rows that two parts share, what cannot be run here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fuse_grounding.benchmark import suites
from fuse_grounding.benchmark.methods import METHODS
from fuse_grounding.benchmark.store import HEADER, RESULTS
from fuse_grounding.benchmark.suites import SUITES, Part
from fuse_grounding.cli.app import execute
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode
from fuse_grounding.errors import InputError

EPISODES = [Episode('{"episode_id": "a", "seed": 1}')]


def arguments(out: Path, suite: str, *more: str) -> list[str]:
    few = ["--episodes", "dev", "--limit", "1", "--set", "budget.actions=1"]
    return ["bench", *few, "--suite", suite, "--segmenter", "bench_doubles:Eye", "--out", str(out), *more]


def header(folder: Path) -> dict[str, Any]:
    return json.loads((folder / HEADER).read_text())


def row(folder: Path) -> dict[str, Any]:
    (line,) = (folder / RESULTS).read_text().splitlines()
    return json.loads(line)


def test_the_paper_is_all_groups_with_a_folder_of_its_own_for_each_part(tmp_path: Path):
    found = suites.plans("paper", tmp_path, Config(), EPISODES, gallery=3)
    names = [plan.out.name for plan in found]
    assert len(set(names)) == len(names)
    for group in SUITES["paper"]:
        mine = suites.plans(group, tmp_path, Config(), EPISODES)
        assert [p.out for p in mine] == [p.out for p in found if p.notes["group"] == group]
    main = found[0]
    assert main.gallery == 3
    assert all(plan.gallery == 0 for plan in found[1:])
    assert set(METHODS.names()) <= set(main.methods)
    by_name = dict(zip(names, found, strict=True))
    assert by_name["stopping_k5_depth"].settings == Config()  # as `fuse` of main
    assert by_name["stopping_k3"].settings.stopping.patience == 3
    assert by_name["stopping_k3"].settings.stopping.weights == (0.7, 0.0)
    assert by_name["eta_0.6"].settings == by_name["weights_1_1"].settings == Config()
    assert by_name["planner_plain"].settings == by_name["revisit_left_out"].settings == Config()
    assert by_name["revisit_allowed"].settings.search.revisit
    assert not by_name["reach_not_weighed"].settings.evidence.within_reach
    assert [suites.group_of(name) for name in ("stopping_k3", "evidence_clip_patches", "b")] == [
        "stopping",
        "evidence",
        None,
    ]
    several = suites.plans("eta, main,eta", tmp_path, Config(), EPISODES)
    assert [p.out for p in several] == [
        p.out for g in ("eta", "main") for p in found if p.notes["group"] == g
    ]
    many = suites.plans("paper", tmp_path, Config(), EPISODES * 60)
    short = {plan.notes["group"] for plan in many if len(plan.episodes) == 50}
    assert short == {"planner", "revisit", "reach", "eta", "weights"}  # what no table of the paper has
    assert {len(plan.episodes) for plan in many if plan.notes["group"] not in short} == {60}
    for plan in found:
        assert set(plan.optional) <= set(plan.methods)
    with pytest.raises(InputError, match="unknown suite `pape`; did you mean `paper`"):
        suites.plans("main,pape", tmp_path, Config(), EPISODES)
    (tmp_path / "note").write_text("x")
    with pytest.raises(InputError, match="exists and is not empty"):
        suites.plans("main", tmp_path, Config(), EPISODES)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A suite of two groups: cheap methods, one of them twice, and two that cannot run."""
    static = ("static",)
    groups = {
        "main": (Part("main", ("static", "bench_doubles:walk", "vlm"), optional=("vlm",)),),
        "eta": (
            Part("eta_0.6", static, {"gate": {"eta": 0.6}}),
            Part("eta_0.5", static, {"gate": {"eta": 0.5}}),
            Part("eta_none", static, {"encoder": {"weights": "none.onnx"}}, optional=static),
        ),
    }
    monkeypatch.setattr(suites, "_PARTS", groups)
    monkeypatch.setattr(suites, "SUITES", {"main": ("main",), "small": ("main", "eta")})


@pytest.mark.usefixtures("small")
def test_parts_share_rows_of_one_identity_and_list_what_was_not_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out = tmp_path / "s"
    assert execute(arguments(out, "small")) == 0
    printed = capsys.readouterr().out
    assert sorted(p.name for p in out.iterdir()) == ["eta_0.5", "eta_0.6", "main"]
    assert str(Path("eta_0.6") / RESULTS) in printed
    assert "1 rows are asked for by several parts, and are run once" in printed
    assert "vlm was not run: " in printed
    assert "static was not run: " in printed
    main = (out / "main" / RESULTS).read_text().splitlines()
    assert [json.loads(line)["method"] for line in main] == ["static", "walk"]
    assert row(out / "eta_0.6") == json.loads(main[0])  # times, too
    assert row(out / "eta_0.5")["identity"] != row(out / "eta_0.6")["identity"]
    assert {k: header(out / "main")[k] for k in ("suite", "group", "part")} == {
        "suite": "small",
        "group": "main",
        "part": "main",
    }
    assert [entry["name"] for entry in header(out / "main")["not_run"]] == ["vlm"]
    for part in ("eta_0.6", "eta_0.5"):
        (entry,) = header(out / part)["not_run"]
        assert entry["name"] == "eta_none"
        assert "none.onnx" in entry["reason"]
    before = {path: path.read_bytes() for path in out.rglob(RESULTS)}
    assert execute(arguments(out, "small")) == 2  # without --resume
    assert execute(arguments(out, "small", "--resume", "--json")) == 0
    told = json.loads(capsys.readouterr().out)
    assert {name: len(tables) for name, tables in told.items()} == {
        "main": 2,
        "eta_0.6": 1,
        "eta_0.5": 1,
        "eta_none": 0,
    }
    assert {path: path.read_bytes() for path in out.rglob(RESULTS)} == before
    assert [entry["name"] for entry in header(out / "eta_0.5")["not_run"]] == ["eta_none"]
