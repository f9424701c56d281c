"""How good a planner's choices are where every action was measured: `fuse collect --split dev --exhaustive`.

The regret of an action in a state is the largest utility measured there minus its own. Intervals are
percentile bootstraps over trajectories, since states of one trajectory are alike. NumPy only.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fuse_grounding import evidence
from fuse_grounding.errors import InputError
from fuse_grounding.planning.amortized import Network
from fuse_grounding.training.transitions import Transitions

RESAMPLES = 10_000
TEMPERATURE = 0.1
THRESHOLDS = (0.6, 0.7, 0.8, 0.9)


@dataclass(frozen=True)
class Choices:
    """States with every feasible action measured: `measured` and `predicted` (S, 15), NaN where
    infeasible; `state` (S,): its row."""

    measured: np.ndarray
    predicted: np.ndarray
    entropy: np.ndarray
    trajectory: np.ndarray
    state: np.ndarray

    @property
    def top(self) -> np.ndarray:
        """(S,) regret of the action that is valued most."""
        return self.regret(np.nanargmax(self.predicted, 1))

    @property
    def stay(self) -> np.ndarray:
        """(S,) regret of staying."""
        return self.regret(np.full(len(self.measured), evidence.NOOP))

    @property
    def random(self) -> np.ndarray:
        """(S,) expected regret of a feasible action at random."""
        return np.nanmax(self.measured, 1) - np.nanmean(self.measured, 1)

    def regret(self, action: np.ndarray) -> np.ndarray:
        """(S,) regret of one action a state, (S,) int."""
        return np.nanmax(self.measured, 1) - self.measured[np.arange(len(action)), action]


def choices(data: Transitions, values: Callable[[int], np.ndarray]) -> Choices:
    """Groups transitions by state; `values` predicts (15,) for a row of states.

    Raises InputError where no state has all its feasible actions measured.
    """
    measured, predicted, entropy, trajectory, states = [], [], [], [], []
    for state in np.unique(data.before).tolist():
        rows = np.flatnonzero(data.before == state)
        row = np.full(15, np.nan)
        row[data.action[rows]] = data.utility[rows]
        feasible = data.feasible[state]
        if np.isnan(row[feasible]).any():
            continue
        guess = values(state)
        measured.append(row)
        predicted.append(np.where(feasible, guess, np.nan))
        entropy.append(evidence.action_entropy(guess, temperature=TEMPERATURE, mask=feasible))
        trajectory.append(data.trajectory[state])
        states.append(state)
    if not measured:
        raise InputError(
            "no state has every feasible action measured: collect them with `fuse collect --exhaustive`"
        )
    return Choices(*map(np.array, (measured, predicted, entropy, trajectory, states)))


def by_network(data: Transitions, network: Network) -> Callable[[int], np.ndarray]:
    """Predictions of a network from the stored features. Raises InputError for features of another length."""
    if network.settings.kind == "summary":
        return lambda state: network.values(summary=data.summary[state])
    if data.feature.shape[1] != network.settings.dimensions:
        raise InputError(
            f"{network.path} takes vectors of {network.settings.dimensions} dimensions, "
            f"the transitions have {data.feature.shape[1]}"
        )
    return lambda state: network.values(image=data.feature[state], object=data.texts[data.context[state]])


def decision_seconds(values: Callable[[int], np.ndarray], calls: int = 200) -> float:
    """Median time of predicting all 15 actions, what the network reads being given."""
    spent = []
    for _ in range(calls):
        began = time.perf_counter()
        values(0)
        spent.append(time.perf_counter() - began)
    return round(float(np.median(spent)), 6)


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Spearman's, with mean ranks for ties; NaN where one of them is constant."""
    x, y = _mean_ranks(a), _mean_ranks(b)
    x, y = x - x.mean(), y - y.mean()
    norm = float(np.sqrt((x * x).sum() * (y * y).sum()))
    return float((x * y).sum()) / norm if norm > 0 else float("nan")


def within_states(values: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Rank correlation within each state where it has one, (at most S,); `values` and `measured` (S, 15), NaN
    in `values` being left out."""
    known = ~np.isnan(values)
    ranks = [rank_correlation(v[k], m[k]) for v, m, k in zip(values, measured, known, strict=True)]
    return np.array([r for r in ranks if np.isfinite(r)])


def _mean_ranks(values: np.ndarray) -> np.ndarray:
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return (last - (counts - 1) / 2.0)[which]


def interval(values: np.ndarray, groups: np.ndarray, seed: int = 0) -> dict[str, float | None]:
    """Mean with its 95 % percentile-bootstrap interval, whole groups being drawn."""
    names = np.unique(groups)
    sums = np.array([values[groups == g].sum() for g in names])
    counts = np.array([(groups == g).sum() for g in names])
    drawn = np.random.default_rng(seed).integers(len(names), size=(RESAMPLES, len(names)))
    means = sums[drawn].sum(1) / counts[drawn].sum(1)
    low, high = np.percentile(means, [2.5, 97.5])
    return {"mean": _round(values.mean()), "low": _round(low), "high": _round(high)}


def score(found: Choices, seed: int = 0) -> dict[str, Any]:
    """Everything as JSON values.

    `gained_on_random` and `gained_on_stay` are differences of regrets, positive where the planner is better;
    `gate`: for each η, the share of states that the planner would decide, and the regrets on either side.
    """
    top, stay, random, groups = found.top, found.stay, found.random, found.trajectory
    sound = ~np.isnan(found.predicted)
    known = within_states(found.predicted, found.measured)
    return {
        "states": len(top),
        "trajectories": len(np.unique(groups)),
        "seed": seed,
        "rank_correlation": {
            "within_states": _round(known.mean()) if len(known) else None,
            "all_pairs": _round(rank_correlation(found.predicted[sound], found.measured[sound])),
        },
        "regret": {
            "top": interval(top, groups, seed),
            "random": interval(random, groups, seed),
            "stay": interval(stay, groups, seed),
        },
        "gained_on_random": interval(random - top, groups, seed),
        "gained_on_stay": interval(stay - top, groups, seed),
        "entropy_regret_correlation": _round(rank_correlation(found.entropy, top)),
        "gate": [_side(found, eta) for eta in THRESHOLDS],
    }


def _side(found: Choices, eta: float) -> dict[str, Any]:
    trusted = found.entropy <= eta
    top = found.top
    return {
        "eta": eta,
        "trusted": _round(trusted.mean()),
        "regret_trusted": _round(top[trusted].mean()) if trusted.any() else None,
        "regret_left": _round(top[~trusted].mean()) if not trusted.all() else None,
        "random_trusted": _round(found.random[trusted].mean()) if trusted.any() else None,
    }


def _round(value: Any) -> float | None:
    return round(float(value), 5) if np.isfinite(value) else None


def draw(found: dict[str, Choices], path: Any) -> None:
    """A plot for each planner: regret against entropy, states as dots, means of five equal groups as a line.

    Needs matplotlib (extra `plot`).
    """
    from fuse_grounding.extras import require

    require("matplotlib", "plot", "drawing the gate's calibration").use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(found), figsize=(5 * len(found), 4), squeeze=False, sharey=True)
    for axis, (name, one) in zip(axes[0], found.items(), strict=True):
        order = np.argsort(one.entropy, kind="stable")
        groups = [g for g in np.array_split(order, min(5, len(order))) if len(g)]
        axis.scatter(one.entropy, one.top, s=10, alpha=0.4, label="states")
        for values, label in ((one.top, "top action"), (one.random, "random action")):
            axis.plot(
                [one.entropy[g].mean() for g in groups],
                [values[g].mean() for g in groups],
                marker="o",
                label=label,
            )
        axis.set(title=name, xlabel="normalised entropy of the planner's values")
    axes[0][0].set_ylabel("regret")
    axes[0][0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
