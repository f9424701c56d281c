"""Does explicit search look where it pays? Its choices where the utility of every action was measured.

Replays the states of `fuse collect --exhaustive` (pictures, COLMAP, map, segmenter really run), lets explicit
search choose by several readings of the paper and by ours, and compares with the planners and with a rule
that sees nothing: rank correlation of Q and measured utility within states (where Q is not the same for all
actions; in how many), regret of the chosen action, and what is gained on a random action, with an interval
(bootstrap over trajectories). All feasible actions may be chosen, views seen before too; staying by planners
alone. Then the gate: for each threshold, the regret of planner and of explicit search on the states that the
gate leaves to either.

    python benches/search_regret.py [--transitions data/planner/judged.safetensors] [--jobs 2] [--json]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding import Config, evidence
from fuse_grounding.child import settle, threads_each
from fuse_grounding.environment import load_episodes
from fuse_grounding.perception.embedded_encoder import EmbeddedEncoder
from fuse_grounding.planning.amortized import KINDS, Network, shipped
from fuse_grounding.planning.explicit import choose, evidence_maps
from fuse_grounding.planning.summary import summarize
from fuse_grounding.training import planner_score, transitions
from fuse_grounding.training.collect import labels
from fuse_grounding.training.rollouts import Prober

PAPER: dict[str, Any] = {"evidence": {"within_reach": False}}
READINGS: dict[str, tuple[bool, dict[str, Any]]] = {
    "explicit, the paper's": (False, PAPER),
    "explicit, quadrant": (False, {**PAPER, "explicit": {"coupled": "quadrant"}}),
    "explicit, two nodes": (False, {**PAPER, "explicit": {"stride": "two"}}),
    "explicit, spatial normalisation": (False, {**PAPER, "ssnr": {"normalization": "spatial"}}),
    "explicit, vector gradient": (False, {**PAPER, "ssnr": {"gradient": "vector"}}),
    "explicit, U_func": (False, {**PAPER, "explicit": {"field": "uncertainty"}}),
    "geometry only, the paper's": (True, PAPER),
    "semantics only": (False, {"evidence": {"geometric_weight": 0.0}}),
    "geometry only, within reach": (True, {}),
    "explicit, within reach": (False, {}),
    "explicit, within reach, quadrant": (False, {"explicit": {"coupled": "quadrant"}}),
    "explicit, within reach, two nodes": (False, {"explicit": {"stride": "two"}}),
}
"""Name → whether on geometry alone, and settings."""
OURS = "explicit, within reach"
PITCH = np.array([pitch for _, pitch in evidence.ACTIONS])
DOWN = evidence.ACTIONS.index((0, 1))


def replayed(path: Path, trajectory: int) -> dict[int, dict[str, tuple[int, np.ndarray]]]:
    """State's row → reading → chosen action and Q, (15,)."""
    data, note = transitions.load(path)
    card = json.loads(path.with_suffix(".json").read_text())
    settings = Config.from_dict(card["request"]["config"])
    prober = Prober(settings, EmbeddedEncoder(None), labels())
    episodes = {e.episode_id: e for e in load_episodes(note["split"])}
    episode = episodes[note["trajectories"][trajectory]["episode_id"]]
    rows = [row for row in np.unique(data.before).tolist() if data.trajectory[row] == trajectory]
    rows.sort(key=lambda row: data.step[row])
    viewpoints = [(int(data.viewpoint[row][0]), int(data.viewpoint[row][1])) for row in rows]
    found: dict[int, dict[str, tuple[int, np.ndarray]]] = {}
    for row, situation in zip(rows, prober.replay(episode, viewpoints), strict=True):
        assert situation.scene is not None
        if np.abs(summarize(situation, settings) - data.summary[row]).max() > 2e-3:
            raise SystemExit(
                f"state {row} of {path} cannot be replayed: other weights, or another SIMD level"
            )
        rendered = situation.scene.render(situation.camera)
        found[row] = {}
        for name, (geometry_only, changed) in READINGS.items():
            config = settings.with_(**changed)
            maps = evidence_maps(situation, rendered, config, geometry_only=geometry_only)
            found[row][name] = choose(maps.field, situation.feasible, config)
    return found


def figures(found: planner_score.Choices, values: np.ndarray, chosen: np.ndarray) -> dict[str, Any]:
    """Of one way to choose: `values` (S, 15) ranks what is not NaN, `chosen` (S,) is done."""
    ranked = planner_score.within_states(values, found.measured)
    regret = found.regret(chosen)
    return {
        "rank_correlation": round(float(ranked.mean()), 3) if ranked.size else None,
        "ranked_states": ranked.size,
        "regret": planner_score.interval(regret, found.trajectory),
        "gained_on_random": planner_score.interval(found.random - regret, found.trajectory),
        "less_far_down": round(float((PITCH[chosen] < 0).mean()), 3),
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--transitions", type=Path, default=Path("data/planner/judged.safetensors"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    data, _ = transitions.load(given.transitions)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(given.jobs, context, settle, (threads_each(given.jobs),)) as pool:
        parts = pool.map(partial(replayed, given.transitions), range(len(data.number)))
        chosen = {row: by for part in parts for row, by in part.items()}

    table: dict[str, dict[str, Any]] = {}
    found = planner_score.choices(data, lambda row: np.zeros(15))
    for name in READINGS:
        actions, values = zip(*(chosen[row][name] for row in found.state), strict=True)
        table[name] = figures(found, np.array(values), np.array(actions))
    down = np.where(np.isnan(found.measured[:, DOWN]), evidence.NOOP, DOWN)
    table["further down, or stay"] = figures(found, np.zeros((len(down), 15)), down)
    explicit = found.regret(np.array([chosen[row][OURS][0] for row in found.state]))
    gate: dict[str, list[dict[str, Any]]] = {}
    for kind in KINDS:
        found = planner_score.choices(data, planner_score.by_network(data, Network(shipped(kind))))
        table[f"planner, {kind}"] = figures(found, found.predicted, np.nanargmax(found.predicted, 1))
        gate[kind] = [split(found, explicit, eta) for eta in planner_score.THRESHOLDS]
    if given.json:
        print(json.dumps({"choices": table, "gate": gate}, indent=1))
        return
    print(f"{'':36}ranks   of   regret  gained on random (95 %)   less far down")
    for name, one in table.items():
        gained, ranks = one["gained_on_random"], one["rank_correlation"]
        shown = "     -" if ranks is None else f"{ranks:+.3f}"
        print(
            f"{name:34} {shown}  {one['ranked_states']:3}   {one['regret']['mean']:.3f}   "
            f"{gained['mean']:+.3f} ({gained['low']:+.3f} to {gained['high']:+.3f})   "
            f"{one['less_far_down']:4.0%}"
        )
    print(f"random {found.random.mean():.3f}, staying {found.stay.mean():.3f}; {len(found.state)} states")
    print("planner        eta  trusted  regret of planner, explicit   and of the others")
    for kind, rows in gate.items():
        for one in rows:
            regrets = (
                one["trusted_planner"],
                one["trusted_explicit"],
                one["left_planner"],
                one["left_explicit"],
            )
            shown = ["-" if r is None else f"{r:.3f}" for r in regrets]
            print(f"{kind:12} {one['eta']:5}  {one['trusted']:7.0%}  {shown[0]:>17}  {shown[1]:>8}", end="")
            print(f"  {shown[2]:>6}  {shown[3]:>6}")


def split(found: planner_score.Choices, explicit: np.ndarray, eta: float) -> dict[str, Any]:
    """Mean regrets of planner and of explicit search, (S,), on either side of the gate; None if empty."""
    trusted = found.entropy <= eta
    result: dict[str, Any] = {"eta": eta, "trusted": round(float(trusted.mean()), 3)}
    for side, of in (("trusted", trusted), ("left", ~trusted)):
        for who, regret in (("planner", found.top), ("explicit", explicit)):
            result[f"{side}_{who}"] = round(float(regret[of].mean()), 3) if of.any() else None
    return result


if __name__ == "__main__":
    main()
