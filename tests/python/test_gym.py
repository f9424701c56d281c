"""The Gymnasium environment: Gymnasium's own checks, rewards, vectors, films, the agent of the README."""

from __future__ import annotations

import gzip
import json
import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from fuse_grounding.environment import Episode, TabletopEnvironment, load_episodes
from fuse_grounding.environment.episodes import DATA
from fuse_grounding.environment.gym import SEEN_FRACTION, SEEN_PIXELS, STEP_COST, TabletopGym
from fuse_grounding.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
NAME = "fuse_grounding/Tabletop-v0"
EPISODE = next(e for e in load_episodes("dev") if e.episode_id == "dev_0001")


@pytest.fixture(scope="module")
def env() -> gymnasium.Env[Any, Any]:
    return gymnasium.make(NAME, episodes=[EPISODE], render_mode="rgb_array")


def test_gymnasium_finds_nothing_to_complain_of(env):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)


def test_observations_are_the_tabletops(env):
    seen, info = env.reset(options={"episode_id": "dev_0001"})
    world = TabletopEnvironment(EPISODE)
    truth = world.observe()
    assert truth.depth is not None
    assert truth.camera is not None
    assert np.array_equal(seen["rgb"], truth.rgb)
    assert np.array_equal(seen["depth"], truth.depth)
    assert np.allclose(seen["pose"][:3, 3], truth.camera.translation)
    assert (seen["node"], seen["pitch"], info["query"]) == (*EPISODE.start, EPISODE.query)
    assert bytes(seen["query"]).rstrip(b"\0").decode() == EPISODE.query
    assert np.array_equal(info["action_mask"], world.action_mask())
    assert info["episode_id"] == "dev_0001"
    assert "instance" not in seen


def test_rewards_add_up_to_what_is_seen_more_and_finding_ends_the_episode(env):
    targets = TabletopEnvironment(EPISODE).true_targets()
    good = np.any([(t.fraction >= SEEN_FRACTION) & (t.visible_px >= SEEN_PIXELS) for t in targets], axis=0)
    _, start = env.reset()
    total, steps, found, pitch = 0.0, 0, False, EPISODE.start[1]
    while not found:  # straight round the table, at the pitch that shows it from somewhere
        wanted = int(np.argmax(good.any(axis=0)))
        turn = int(np.sign(wanted - pitch))
        seen, reward, found, truncated, info = env.step(7 + 1 + 5 * turn)
        total, steps, pitch = total + float(reward), steps + 1, int(seen["pitch"])
        assert not truncated
        assert found == good[seen["node"], pitch] == info["is_success"]

    def sight(fraction: float, pixels: int) -> float:
        return fraction * min(1.0, pixels / SEEN_PIXELS)

    gained = sight(info["visible_fraction"], info["visible_px"]) - sight(
        start["visible_fraction"], start["visible_px"]
    )
    assert total == pytest.approx(gained - STEP_COST * steps + 1.0)


def test_a_masked_action_stays_and_costs_a_step(env):
    seen, info = env.reset()
    while info["action_mask"][12]:
        seen, *_, info = env.step(12)
    again, reward, found, _, info = env.step(12)
    assert np.array_equal(seen["rgb"], again["rgb"])
    assert info["refused"]
    assert reward == pytest.approx(-STEP_COST + found)


def test_an_episode_is_cut_off_after_thirty_actions():
    env = gymnasium.make(NAME, episodes=[EPISODE])
    env.reset()
    ends = [env.step(7)[2:4] for _ in range(30)]
    assert ends == [(False, False)] * 29 + [(False, True)]


def test_a_seed_draws_the_same_episode_and_an_option_names_it():
    env = TabletopGym("dev")
    assert len({env._choose({}).episode_id for _ in range(8)}) > 1
    env = TabletopGym([EPISODE])
    assert env.reset(seed=3)[1]["episode_id"] == "dev_0001"
    with pytest.raises(InputError, match="no episode 'dev_0002' among the 1 of this environment"):
        env.reset(options={"episode_id": "dev_0002"})
    with pytest.raises(InputError, match="unknown option `episode` of reset; known: episode_id"):
        env.reset(options={"episode": "dev_0001"})


def test_wrong_arguments_are_named():
    with pytest.raises(InputError, match="no episode file nowhere"):
        TabletopGym("nowhere")
    with pytest.raises(InputError, match="render_mode must be \"rgb_array\" or None, found 'human'"):
        TabletopGym(render_mode="human")
    with pytest.raises(InputError, match="episodes is empty"):
        TabletopGym([])
    fresh = TabletopGym([EPISODE])
    with pytest.raises(InputError, match="call reset before step"):
        fresh.step(7)
    fresh.reset()
    with pytest.raises(InputError, match="action must be a whole number from 0 to 14, found 15"):
        fresh.step(15)
    long = Episode(EPISODE.text.replace(EPISODE.query, 101 * "é"), EPISODE.statistics_text)
    with pytest.raises(InputError, match="its query has 202 bytes, expected at most 200"):
        TabletopGym([long])


def test_broken_episode_files_are_named(tmp_path: Path):
    path = tmp_path / "mine.json.gz"
    whole = (DATA / "episodes" / "dev.json.gz").read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"mine\.json\.gz is not a complete gzip file"):
        TabletopGym(path)

    def written(edit) -> Path:
        data = json.loads(gzip.decompress(whole))
        data["episodes"] = data["episodes"][:1]
        edit(data)
        path.write_bytes(gzip.compress(json.dumps(data).encode()))
        return path

    with pytest.raises(InputError, match=r"mine\.json\.gz has schema version 7, expected 2"):
        TabletopGym(written(lambda d: d.update(schema_version=7)))
    with pytest.raises(
        InputError, match=r"mine\.json\.gz: episode `dev_0000` has schema version 7, expected 2"
    ):
        TabletopGym(written(lambda d: d["episodes"][0].update(schema_version=7)))
    # Objects are looked up when an episode is played.
    env = TabletopGym(written(lambda d: d["episodes"][0]["objects"][0].update(model_id="teapot_dev_9")))
    with pytest.raises(
        InputError, match=r"mine\.json\.gz: episode `dev_0000`: unknown object `teapot_dev_9`"
    ):
        env.reset()


def test_it_can_be_filmed(env, tmp_path: Path):
    pytest.importorskip("moviepy")
    film = gymnasium.wrappers.RecordVideo(env, str(tmp_path), disable_logger=True)
    film.reset()
    film.step(8)
    film.close()
    (made,) = tmp_path.glob("*.mp4")
    assert made.stat().st_size > 1000


# One script for both: what a user runs, in a process that has not rendered yet.
VECTORS = """
import fuse_grounding, gymnasium, numpy as np
from fuse_grounding.environment import load_episodes
episodes = [e for e in load_episodes("dev", validate=False) if e.episode_id == "dev_0001"]
seen = []
for mode in ("async", "sync"):
    envs = gymnasium.make_vec("fuse_grounding/Tabletop-v0", 2, vectorization_mode=mode, episodes=episodes)
    first, info = envs.reset(seed=1)
    assert list(info["episode_id"]) == ["dev_0001"] * 2
    second, reward, *_, info = envs.step(np.array([8, 6]))
    assert not np.array_equal(second["rgb"][0], second["rgb"][1])
    seen.append([np.copy(second[key]) for key in second] + [reward])
    envs.close()
for a, b in zip(*seen):
    assert np.array_equal(a, b)
envs = gymnasium.make_vec("fuse_grounding/Tabletop-v0", 2, vectorization_mode="async", episodes=episodes)
try:
    envs.reset()
except Exception as error:  # the sync one has rendered here: forks have no threads
    print(type(error).__name__, error)
"""


def test_vectors_agree_and_a_fork_without_threads_says_so():
    done = subprocess.run([sys.executable, "-c", VECTORS], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "InputError this process was forked from one that has rendered" in done.stdout


@pytest.mark.parametrize("order", ["fuse_grounding, gymnasium", "gymnasium, fuse_grounding"])
def test_either_order_of_imports_registers_it(order: str):
    code = f"import {order}; print(gymnasium.spec('{NAME}').max_episode_steps)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == ("30\n", "")


def test_gymnasium_is_not_imported_for_those_who_do_not_use_it():
    code = "import sys, fuse_grounding.cli.commands; print('gymnasium' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stdout == "False\n"


def test_without_gymnasium_the_extra_is_named():
    code = "import sys; sys.modules['gymnasium'] = None\nimport fuse_grounding.environment.gym"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "needs the optional package `gymnasium`" in done.stderr
    assert "pip install 'fuse-grounding[gym]'" in done.stderr


def test_the_readmes_random_agent_runs_as_it_stands(capsys: pytest.CaptureFixture[str]):
    (code,) = re.findall(
        r"```python\n(import fuse_grounding  #.*?)```", (ROOT / "README.md").read_text(), re.S
    )
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    exec(compile(code, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert any(episode.query in printed for episode in load_episodes("dev"))
    assert "True" in printed or "False" in printed


def test_every_shipped_episode_can_be_won():
    for episode in load_episodes("dev", validate=False):
        assert episode.statistics is not None
        pixels = np.array([s["visible_px"] for s in episode.statistics])
        alone = np.array([s["unoccluded_px"] for s in episode.statistics])
        assert ((pixels >= SEEN_FRACTION * alone) & (pixels >= SEEN_PIXELS)).any(), episode.episode_id
