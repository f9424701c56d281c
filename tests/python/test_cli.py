from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from fuse_grounding._core import __version__
from fuse_grounding.cli.app import execute
from fuse_grounding.config import EncoderConfig
from fuse_grounding.perception.doors import settled
from fuse_grounding.record import EpisodeRecord


def without_timings(value: Any) -> Any:
    if isinstance(value, dict):
        kept = {k: v for k, v in value.items() if k != "timings" and not k.endswith("_seconds")}
        return {k: without_timings(v) for k, v in kept.items()}
    return [without_timings(v) for v in value] if isinstance(value, list) else value


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = execute(arguments)
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_version(capsys: pytest.CaptureFixture[str]):
    assert run(capsys, "--version") == (0, f"fuse {__version__}\n", "")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["cut", "--method", "explict"], "unknown method `explict`; did you mean `explicit`? known: static"),
        (["cut", "--knowledge", "grph"], "unknown knowledge source `grph`; did you mean `graph`?"),
        (["cut", "--segmenter", "sam9"], "unknown segmenter `sam9`; did you mean `sam3`? known: embedded"),
        (["cut", "--registration", "slam"], "--set registration.backend=slam: `registration.backend`: found"),
        (["sing a song"], "no known verb in the query 'sing a song'; known: cut"),
        (["cut", "--set", "gate.etta=1"], "--set gate.etta=1: unknown key `gate.etta`; did you mean `eta`?"),
        (["cut", "--set", "budget.actions=-1"], "`budget.actions`: found -1, expected: greater than"),
        (["cut", "--config", "nowhere.toml"], "config file nowhere.toml does not exist"),
        (["cut", "--set", "segmenter.weights=none.onnx"], "none.onnx"),
        (["cut", "--scene", "dev_kitchn"], "dev_kitchn"),
    ],
)
def test_wrong_input_is_one_sentence_status_2_and_leaves_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], sentence: str
):
    out = tmp_path / "out"
    status, stdout, stderr = run(capsys, "run", *arguments, "--out", str(out))
    assert status == 2
    assert stdout == ""
    assert stderr.startswith("fuse: ")
    assert sentence in stderr
    assert stderr.count("\n") == 1
    assert not out.exists()


def test_wrong_usage_is_status_2(capsys: pytest.CaptureFixture[str]):
    assert run(capsys, "run")[0] == 2
    assert run(capsys, "run", "cut", "--seed", "-1")[0] == 2
    assert run(capsys, "fly")[0] == 2


def test_an_output_folder_in_use_is_left_alone(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    (tmp_path / "mine.txt").write_text("x")
    status, _, stderr = run(capsys, "run", "cut", "--seed", "7", "--method", "static", "--out", str(tmp_path))
    assert status == 2
    assert "exists and is not empty" in stderr
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_benchmarks_refuse_unknown_methods_and_sets(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    out = str(tmp_path / "b")
    status, _, stderr = run(capsys, "bench", "--methods", "static,vml", "--out", out)
    assert (status, "unknown method `vml`; did you mean `vlm`?" in stderr) == (2, True)
    status, _, stderr = run(capsys, "bench", "--episodes", "nowhere", "--out", out)
    assert (status, "nowhere" in stderr) == (2, True)
    assert not Path(out).exists()


def test_knowledge_prints_json_alone(capsys: pytest.CaptureFixture[str]):
    status, stdout, _ = run(capsys, "knowledge", "--json")
    table = json.loads(stdout)
    assert status == 0
    assert set(table) == {"graph", "plain", "direct"}
    assert [table[name]["encoder"] for name in ("graph", "plain")] == [None, settled(EncoderConfig()).name]
    assert table["graph"]["recall"] > table["direct"]["recall"]
    assert table["graph"]["precision"] > table["direct"]["precision"]


def test_a_static_run_prints_its_record(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    out = tmp_path / "run"
    status, stdout, _ = run(
        capsys,
        "run",
        "something to cut a rope with",
        "--method",
        "static",
        "--seed",
        "7",
        "--json",
        "--out",
        str(out),
    )
    assert status == 0
    printed = json.loads(stdout)
    record = EpisodeRecord.load(out / "episode.json")
    assert printed.pop("out") == str(out)
    assert printed == record.model_dump(mode="json")
    assert record.verb == "cut"
    assert (record.seed, record.scene) == (7, "dev_kitchen")
    assert record.result is not None
    assert record.result.metrics is not None
    assert 0 <= float(record.result.metrics["iou"] or 0) <= 1
    assert (out / "grounding.png").is_file()
    assert (out / "overview.png").is_file()


def test_the_same_seed_gives_the_same_episode_twice(capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """Every real part: renderer, COLMAP, Gaussian map, segmenter, evidence, explicit planning."""
    few = ["map.initial_iterations=40", "map.incremental_iterations=10", "budget.actions=2"]
    few.append("planner.name=none")
    records = []
    for name in ("a", "b"):
        out = tmp_path / name
        settings = [argument for setting in few for argument in ("--set", setting)]
        status, stdout, stderr = run(capsys, "run", "cut", "--seed", "7", *settings, "--out", str(out))
        assert status == 0, stderr
        assert "step  2" in stdout
        assert "every decision is explicit" in stdout
        records.append(EpisodeRecord.load(out / "episode.json"))
        for file in ("overview.png", "grounding.png", "scene.ply", "steps/02/evidence.png"):
            assert (out / file).is_file(), file
    first, second = (without_timings(r.model_dump(mode="json")) for r in records)
    assert first == second
    assert (tmp_path / "a" / "scene.ply").read_bytes() == (tmp_path / "b" / "scene.ply").read_bytes()
    steps = records[0].steps
    assert [s.branch for s in steps] == ["explicit", "explicit", None]
    assert {s.registration for s in steps} == {"colmap"}
    assert steps[0].map is not None
    assert steps[1].map is not None
    assert (steps[0].map.views, steps[1].map.views) == (5, 6)


def test_interrupting_leaves_a_readable_record_and_status_130(tmp_path: Path):
    out = tmp_path / "run"
    child = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "fuse_grounding.cli.app",
            "run",
            "cut",
            "--seed",
            "7",
            "--method",
            "random",
            "--out",
            str(out),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=os.environ,
        # A shell that runs the tests in the background hands down an ignored SIGINT.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    record = out / "episode.json"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not (
        record.exists() and len(EpisodeRecord.load(record).steps) >= 1
    ):
        assert child.poll() is None, child.stderr.read() if child.stderr else ""
        time.sleep(0.02)
    child.send_signal(signal.SIGINT)
    _, stderr = child.communicate(timeout=60)
    assert child.returncode == 130
    assert b"interrupted" in stderr
    kept = EpisodeRecord.load(record)
    assert kept.steps
    assert kept.seed == 7
    assert kept.result is None
