"""Mistakes in a method of a user's own: one sentence that names it and its file, no traceback."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from agent_doubles import Kit, World

from fuse_grounding.agent import Agent
from fuse_grounding.assembly import assemble
from fuse_grounding.benchmark import cluster
from fuse_grounding.benchmark.cluster import RayEngine
from fuse_grounding.benchmark.methods import METHODS, Method
from fuse_grounding.benchmark.processes import Processes
from fuse_grounding.benchmark.store import RESULTS
from fuse_grounding.benchmark.worker import Setup
from fuse_grounding.cli.app import execute
from fuse_grounding.config import Config
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.planning.protocol import Decision

OWN = """
from functools import partial
from fuse_grounding.benchmark.methods import Method
from fuse_grounding.planning.protocol import Decision

class Mine:
    start = "here"
    planner = None

    def decide(self, situation, clock):
        return Decision(9, "mine")

def mine(policy=lambda config, episode: Mine(), **more):
    return Method("mine", policy, **more)

"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working directory, whose module `own` is forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop("own", None)


MISTAKES = [
    ("class P(Mine):\n start = 'nowhere'", "P()", "`P` has the start 'nowhere', expected `here` or `can"),
    ("class P:\n start = 'here'\n decide = Mine.decide", "P()", "`P` has no `planner`, expected start,"),
    ("class P:\n start = 'here'\n planner = None", "P()", "`P` has no `decide`, expected start, planner"),
    ("class P(Mine):\n decide = 3", "P()", "`P` has a `decide` that is 3, expected a method"),
    ("class P(Mine):\n planner = 3", "P()", "`P` has the planner 3, expected its name or None"),
    ("", "Mine", "`Mine` is a class, expected an object of it"),
    ("", "None", "`NoneType` has no `start`"),
    ("", "1 / 0", "cannot be made: ZeroDivisionError: division by zero"),
]


@pytest.mark.parametrize(("code", "made", "sentence"), MISTAKES)
def test_a_policy_that_is_none_is_told_when_it_is_loaded(here: Path, code: str, made: str, sentence: str):
    (here / "own.py").write_text(f"{OWN}{code}\ndef bad(): return mine(lambda config, episode: {made})")
    with pytest.raises(InputError) as caught:
        assemble(Config().with_(method="own:bad"))
    assert sentence in str(caught.value)
    assert str(caught.value).startswith("method `mine` (own.py): ")


@pytest.mark.parametrize(
    ("factory", "sentence"),
    [
        ("lambda: mine(lambda config: Mine())", "method `mine` (own.py): its policy cannot be made: TypeErr"),
        ("lambda: mine(Mine())", "its policy cannot be made: TypeError: 'Mine' object is not callable; exp"),
        ("lambda: 1 / 0", "method `own:bad` cannot be made: ZeroDivisionError: division by zero"),
        ("lambda: mine(stopping='polcy')", "method `mine`: unknown stopping `polcy`; did you mean `policy`?"),
        ("lambda: Method(None, Mine)", "method `own:bad` calls itself `None`, expected letters"),
        ("partial(mine)", "method `own:bad` is a partial, expected a function that makes a Method"),
    ],
)
@pytest.mark.parametrize("command", ["bench", "run"])
def test_the_command_line_says_it_in_one_sentence(
    here: Path, factory: str, sentence: str, command: str, capsys: pytest.CaptureFixture[str]
):
    (here / "own.py").write_text(f"{OWN}bad = {factory}\n")
    line = {
        "bench": ["bench", "--limit", "1", "--methods", "own:bad"],
        "run": ["run", "cut", "--method", "own:bad"],
    }
    assert execute([*line[command], "--out", "b"]) == 2
    told = capsys.readouterr().err
    assert sentence in told
    assert "Traceback" not in told
    assert not (here / "b").exists()


def test_ways_of_stopping_are_those_that_are_there():
    assert {method.stopping for method in METHODS} == {"patience", "one view", "policy"}
    with pytest.raises(
        InputError, match=r"method `x`: unknown stopping `never`; .*known: patience, one view"
    ):
        Method("x", lambda config, episode: Returning(None), stopping="never")


class Returning:
    """Decides whatever it was given."""

    planner = None

    def __init__(self, decision: Any, start: Any = "here"):
        self._decision, self.start = decision, start

    def decide(self, situation: Any, clock: Any) -> Any:
        return self._decision


def searching(policy: Any) -> Any:
    kit = Kit("random", lambda node, pitch: 0.5, policy=policy)
    return Agent(kit.config, kit.parts).run(World(), "cut")


@pytest.mark.parametrize(
    ("decision", "sentence"),
    [
        (9, "policy `Returning` returned int, expected a Decision"),
        (None, "policy `Returning` returned NoneType, expected a Decision"),
        (Decision(15, "x"), "policy `Returning`: action must be a whole number from 0 to 14, found 15"),
        (Decision(True, "x"), "policy `Returning`: action must be a whole number from 0 to 14, found True"),
        (
            Decision(9, "x", entropy=math.nan),
            "policy `Returning`: entropy must be a finite number, found nan",
        ),
        (Decision(9, "x", np.zeros(9)), "policy `Returning`: values must be (15,), found (9,)"),
        (Decision(9, None), "policy `Returning`: branch must be a str, found NoneType"),  # type: ignore[arg-type]
    ],
)
def test_what_a_policy_returns_is_a_decision(decision: Any, sentence: str):
    with pytest.raises(FuseError) as caught:
        searching(Returning(decision))
    assert str(caught.value) == sentence


def test_numbers_of_numpy_are_as_good_and_become_the_records():
    decision = Decision(np.int64(9), "x", entropy=np.float32(0.5))  # type: ignore[arg-type]
    step = searching(Returning(decision)).record.steps[0]
    assert (step.action, step.entropy) == (9, 0.5)
    json.dumps([step.action, step.entropy])


def test_a_start_that_is_nowhere_is_not_taken_for_another():
    with pytest.raises(InputError, match="policy `Returning` has the start 'nowhere', expected `here`"):
        searching(Returning(Decision(9, "x"), "nowhere"))


def test_what_is_no_decision_is_the_row_of_its_episode(here: Path):
    (here / "own.py").write_text(
        f"{OWN}class P(Mine):\n def decide(self, situation, clock): return 9\n"
        "def nine(): return mine(lambda config, episode: P())"
    )
    few = ["--episodes", "dev", "--limit", "1", "--segmenter", "bench_doubles:Eye"]
    assert execute(["bench", *few, "--methods", "own:nine", "--out", "b"]) == 1
    (row,) = [json.loads(line) for line in (here / "b" / RESULTS).read_text().splitlines()]
    assert row["error"] == "FuseError: policy `P` returned int, expected a Decision"


@pytest.mark.parametrize(
    ("engine", "sentence"),
    [
        (Processes, "a worker process died while it was loading (exit status 3)"),
        (RayEngine, "a worker of the cluster was lost 2 times while it was loading (WorkerCrashedError)"),
    ],
)
def test_a_worker_that_dies_while_it_loads_is_told(
    here: Path, monkeypatch: pytest.MonkeyPatch, engine: Any, sentence: str
):
    if engine is RayEngine:
        pytest.importorskip("ray", reason="ray is not installed: pip install 'fuse-grounding[ray]'")
    monkeypatch.setattr(cluster, "RETRIES", 1)
    (here / "own.py").write_text(
        f"import os\n{OWN}def dying(): return mine(lambda config, episode: os._exit(3))"
    )
    setup = Setup(Config().to_dict(), {"mine": "own:dying"}, path=(str(here),))
    workers = engine([setup], None, 1) if engine is RayEngine else engine([setup], 1)
    with workers, pytest.raises(FuseError) as caught:
        workers.load()
    assert str(caught.value) == f"{sentence}; results so far are kept"
