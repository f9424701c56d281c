"""Benchmarks run whole: worker processes, deaths, interrupts, resuming. Small episodes, real processes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fuse_grounding.benchmark.store import HEADER, RESULTS
from fuse_grounding.benchmark.worker import Setup, Task, Worker
from fuse_grounding.cli.app import execute
from fuse_grounding.config import Config
from fuse_grounding.environment import load_episodes
from fuse_grounding.perception.embedded import EmbeddedSegmenter

DOCS = Path(__file__).resolve().parents[2] / "docs" / "benchmark.md"
EYE = ["--segmenter", "bench_doubles:Eye"]
METHODS = "random,bench_doubles:walk"


def arguments(out: Path, methods: str = METHODS, *more: str, limit: int = 3) -> list[str]:
    few = ["--episodes", "dev", "--limit", str(limit), "--set", "budget.actions=2"]
    return ["bench", *few, "--methods", methods, *EYE, "--out", str(out), *more]


def rows(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / RESULTS).read_text().splitlines()]


def untimed(out: Path) -> list[dict[str, Any]]:
    """Rows without what may differ between two runs."""
    return [
        {k: v for k, v in row.items() if k not in ("timings", "concurrent") and not k.endswith("_seconds")}
        for row in rows(out)
    ]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three episodes by two methods, one worker, never interrupted."""
    out = tmp_path_factory.mktemp("whole") / "out"
    assert execute(arguments(out, METHODS, "--gallery", "1")) == 0
    return out


def started(out: Path, until: Callable[[], bool], *more: str) -> subprocess.Popen[str]:
    """A benchmark in a process of its own that is as far as `until` says."""
    child = subprocess.Popen(
        [sys.executable, "-m", "fuse_grounding.cli.app", *arguments(out, METHODS, *more)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "BENCH_DOUBLES_SLEEP": "0.4", "PYTHONPATH": os.pathsep.join(sys.path)},
        start_new_session=True,  # as a terminal's job: an interrupt reaches all of it
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not until():
        assert child.poll() is None, child.communicate()
        time.sleep(0.02)
    return child


def members(group: int) -> list[int]:
    """Processes of a session that still run."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(session) == group and state != "Z":
            found.append(int(stat.parent.name))
    return found


def gone(group: int) -> bool:
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline and members(group):
        time.sleep(0.05)
    return not members(group)


def test_rows_are_in_order_and_say_what_they_are_of(whole: Path):
    found = rows(whole)
    assert [(r["index"], r["method"]) for r in found] == [
        (i, m) for i in range(3) for m in ("random", "walk")
    ]
    assert [r["episode_id"] for r in found[::2]] == ["dev_0000", "dev_0001", "dev_0002"]
    for row in found:
        assert (row["status"], row["concurrent"]) == ("ok", False)
        assert row["calls"]["segment"] == row["observations"] == 3
        assert (row["calls"]["act"], row["calls"]["observe"], row["calls"]["plan"]) == (2, 3, 2)
        assert set(row["calls"]) == set(row["timings"])
        assert row["runtime_seconds"] >= row["wall_seconds"] >= sum(row["timings"].values()) * 0.999
    assert len({r["identity"] for r in found}) == 6
    header = json.loads((whole / HEADER).read_text())
    assert header["provenance"]["jobs"] == 1
    assert {"processor", "cores"} <= set(header["provenance"]["machine"])
    assert set(header["identity"]["methods"]["walk"]["weights"]) == {"segmenter", "encoder", "method"}
    assert set(header["identity"]["methods"]["random"]["weights"]) == {"segmenter", "encoder"}


def test_pictures_of_the_first_episodes_are_kept(whole: Path):
    for method in ("random", "walk"):
        assert [p.name for p in (whole / "gallery" / method).iterdir()] == ["dev_0000"]
        folder = whole / "gallery" / method / "dev_0000"
        record = json.loads((folder / "episode.json").read_text())
        assert record["result"]["metrics"]["iou"] == next(
            r["iou"] for r in rows(whole) if r["method"] == method
        )
        assert (folder / "overview.png").is_file()
        assert len(list((folder / "steps").glob("*/observation.png"))) == 3


def test_two_workers_give_the_rows_of_one(whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert execute(arguments(tmp_path / "b", METHODS, "--jobs", "2")) == 0
    assert untimed(tmp_path / "b") == untimed(whole)
    assert all(row["concurrent"] for row in rows(tmp_path / "b"))
    lines = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r" +1/6  dev_000\d .* IoU .* 2 actions .* left", lines[0])
    assert re.fullmatch(r" +6/6  dev_000\d .* s", lines[5])


def test_killed_and_resumed_it_ends_as_if_never_interrupted(whole: Path, tmp_path: Path):
    out = tmp_path / "b"
    child = started(out, lambda: (out / RESULTS).exists() and len(rows(out)) >= 2, "--jobs", "2")
    child.kill()
    child.communicate()
    assert gone(child.pid), "workers outlive their parent"
    before = rows(out)
    assert 2 <= len(before) < 6
    with (out / RESULTS).open("a") as file:
        file.write('{"identity": "')  # as if the power had failed, too
    assert execute(arguments(out, METHODS, "--resume")) == 0
    assert untimed(out) == untimed(whole)
    kept = {(r["index"], r["method"]): r for r in rows(out)}
    assert all(kept[r["index"], r["method"]] == r for r in before)  # nothing twice


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupt_stops_the_workers_and_says_how_to_go_on(tmp_path: Path, number: int, status: int):
    out = tmp_path / "b"
    child = started(out, lambda: (out / RESULTS).exists() and len(rows(out)) >= 1, "--jobs", "2")
    os.killpg(child.pid, number)
    _, stderr = child.communicate(timeout=30)
    assert child.returncode == status
    done = len(rows(out))
    assert f"interrupted: {done} of 6 results are in {out}; the same command with --resume" in (
        stderr.replace("\n", " ")
    )
    assert "Traceback" not in stderr
    assert "Aborted" not in stderr  # nor a stack of native code
    assert gone(child.pid)


def test_an_error_is_the_episodes_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    methods = "bench_doubles:raising,bench_doubles:wrong,bench_doubles:walk"
    assert execute(arguments(tmp_path / "b", methods, limit=2)) == 1
    found = rows(tmp_path / "b")
    bad = [r for r in found if r["status"] != "ok"]
    assert [(r["index"], r["method"]) for r in bad] == [(1, "raising"), (1, "wrong")]
    assert len(found) == 6
    assert bad[0]["error"] == "ValueError: the arm is stuck"
    assert re.fullmatch(r"bench_doubles\.py:\d+ in _boom", bad[0]["traceback"][-1])
    assert (bad[0]["success"], bad[0]["iou"]) == (False, 0.0)
    assert bad[1]["error"] == "InputError: no such view"
    out = capsys.readouterr().out
    assert "raising        error: ValueError: the arm is stuck" in out
    assert "2 (1 errors)" in out
    # Errors are tried again, the rest is not.
    before = [r for r in found if r["status"] == "ok"]
    assert execute(arguments(tmp_path / "b", methods, "--resume", limit=2)) == 1
    again = rows(tmp_path / "b")
    assert [r for r in again if r["status"] == "ok"] == before
    assert len(again) == 6


def test_what_no_episode_can_run_with_stops_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "b"
    assert execute(arguments(out, "bench_doubles:useless", limit=2)) == 2
    assert "the key was refused" in capsys.readouterr().err
    assert len(rows(out)) == 1
    assert execute(arguments(tmp_path / "c", "static", "--set", "encoder.weights=none.onnx")) == 2
    assert "none.onnx" in capsys.readouterr().err
    assert not (tmp_path / "c").exists()


def test_a_worker_that_dies_takes_its_episode_alone(tmp_path: Path):
    marker = tmp_path / "marker"
    option = ["--set", f"segmenter.options.marker={marker}"]
    out = tmp_path / "b"
    methods = "bench_doubles:dying,bench_doubles:dying_once"
    assert execute(arguments(out, methods, *option, limit=2)) == 1
    found = rows(out)
    assert len(found) == 4
    (bad,) = [r for r in found if r["status"] != "ok"]
    assert (bad["index"], bad["method"]) == (1, "dying")
    assert bad["error"] == "the process that ran it died 2 times (SIGKILL, out of memory?)"
    assert marker.exists()


@pytest.mark.parametrize(
    ("method", "sentence"),
    [
        ("fused", "unknown method `fused`; did you mean `fuse`? known: static, "),
        ("bench_doubles:wlak", "method `bench_doubles:wlak`: module `bench_doubles` has no `wlak`"),
        ("not_there:walk", "method `not_there:walk`: there is no module `not_there` here"),
        ("bench_doubles:nothing", "`bench_doubles:nothing` made a NoneType, expected a fuse_grounding.b"),
        ("bench_doubles:PLAIN", "`bench_doubles:PLAIN` is a int, expected a function that makes a Method"),
        ("bench_doubles:taken", "calls itself `static`, which is a method of FUSE's own"),
        ("bench_doubles:unreadable", "calls itself `a b`, expected letters, digits"),
        ("bench_doubles:_die_once", "cannot be made: TypeError"),
        ("amortized", "method `amortized` needs a planner"),
    ],
)
def test_a_method_that_is_none_is_told_why(
    method: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    more = ["--set", "planner.name=none"] if method == "amortized" else []
    assert execute(arguments(tmp_path / "b", f"static,{method}", *more)) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


def test_options_that_exclude_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    for more, sentence in [
        (["--timing", "--jobs", "2"], "leave out --jobs 2"),
        (["--timing", "--engine", "ray"], "leave out --engine ray"),
        (["--engine", "ray", "--gallery", "1"], "leave out --engine ray"),
        (["--engine", "slurm"], "--engine must be local or ray, found slurm"),
        (["--suite", "main"], "--suite main says which methods run; leave out --methods"),
    ]:
        assert execute(arguments(tmp_path / "b", METHODS, *more)) == 2
        assert sentence in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


def test_latencies_of_a_folder_are_printed_without_running(whole: Path, capsys: pytest.CaptureFixture[str]):
    before = (whole / RESULTS).read_bytes()
    assert execute(["bench", "--timing", "--out", str(whole), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [t["method"] for t in found] == ["random", "walk"]
    assert found[1]["episodes"] == 3
    assert found[1]["components"]["camera_execution"]["calls_per_ep"] == 5
    assert (whole / RESULTS).read_bytes() == before
    assert execute(["bench", "--timing", "--out", str(whole)]) == 0
    assert "walk, 3 episodes" in capsys.readouterr().out
    assert execute(arguments(whole, METHODS, "--timing", "--resume")) == 0
    assert "6 of 6 results are there already" in capsys.readouterr().out


def test_no_method_has_its_first_view_for_nothing(monkeypatch: pytest.MonkeyPatch):
    looked: list[int] = []
    find = EmbeddedSegmenter._find
    monkeypatch.setattr(EmbeddedSegmenter, "_find", lambda self, rgb: looked.append(1) or find(self, rgb))  # type: ignore[func-returns-value]
    worker, episode = Worker([Setup(Config().to_dict(), {"static": "static"})]), load_episodes("dev")[0]
    counts = []
    for _ in range(2):
        looked.clear()
        assert worker.run(Task(0, 0, "static", episode)).row["status"] == "ok"
        counts.append(len(looked))
    assert counts == [1, 1]


def test_what_cannot_be_timed_is_said_and_the_rest_is(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert execute(arguments(tmp_path / "b", "random,bench_doubles:always", "--timing", limit=1)) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert "`always` has no episode that ran through" in told
    assert "random, 1 episodes" in told
    assert execute(["bench", "--timing", "--out", str(tmp_path / "typo")]) == 2
    assert f"there is no {RESULTS} in it" in capsys.readouterr().err
    assert not (tmp_path / "typo").exists()
    assert execute(["bench", "--timing", "--out", str(whole.parent)]) == 2
    assert "its parts are out" in capsys.readouterr().err
    assert execute(arguments(tmp_path / "two", METHODS, "--jobs", "2", limit=1)) == 0
    assert execute(arguments(tmp_path / "two", METHODS, "--timing", "--resume")) == 2
    assert "2 results in" in capsys.readouterr().err
    assert len(rows(tmp_path / "two")) == 2  # refused before anything ran


def test_no_methods_are_not_the_default_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert execute(arguments(tmp_path / "b", "")) == 2
    assert "--methods is empty" in capsys.readouterr().err


def test_the_method_of_the_documentation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    example = next(s for s in re.findall(r"```python\n(.*?)```", DOCS.read_text(), re.S) if "Method(" in s)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lawnmower.py").write_text(example)
    assert execute(arguments(tmp_path / "b", "lawnmower:lawnmower", limit=1)) == 0
    (row,) = rows(tmp_path / "b")
    assert (row["method"], row["branches"]) == ("lawnmower", {"lawnmower": 2})
    again = arguments(tmp_path / "b", "lawnmower:lawnmower", "--resume", limit=1)
    monkeypatch.delitem(sys.modules, "lawnmower")
    assert execute(again) == 0
    assert rows(tmp_path / "b") == [row]
    # Another version of it is another method.
    (tmp_path / "lawnmower.py").write_text(example + "\n# changed\n")
    monkeypatch.delitem(sys.modules, "lawnmower")
    assert execute(again) == 2
    assert re.search(
        r"made with other weights \(`weights\.method` is \w{12} there and \w{12} here, method `lawnmower`\)",
        capsys.readouterr().err,
    )
