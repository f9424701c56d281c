"""The confidence gate (FUSE): trust the amortised planner where it is sure, explore explicitly elsewhere.

    H = -1/log|A| sum_a p(a) log p(a),  p = softmax(values / temperature);  amortised iff H <= eta

over the options A, which are the feasible actions (supplement, "Confidence Gate") that lead to a new view.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from fuse_grounding import evidence
from fuse_grounding.config import Config
from fuse_grounding.planning.options import options
from fuse_grounding.planning.protocol import Decision, Planner, Policy, Situation
from fuse_grounding.record import Stopwatch

NO_PLANNER = "no amortised planner is loaded: every decision is explicit"


class Gated:
    """Amortised when the entropy is at most eta, explicit otherwise or without a planner."""

    start: Literal["here"] = "here"

    def __init__(self, planner: Planner | None, explicit: Policy, config: Config):
        self._planner = planner
        self._explicit = explicit
        self._config = config

    @property
    def planner(self) -> str:
        """The planner's name, `none` without one."""
        return self._planner.name if self._planner is not None else "none"

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        """The gate, then one of the branches; the map is refined only by the explicit one."""
        if self._planner is None:
            return replace(self._explicit.decide(situation, clock), reason=NO_PLANNER)
        gate = self._config.gate
        with clock("predict"):
            predicted = np.asarray(self._planner.values(situation), np.float32)
            considered = options(situation, self._config)
            values = np.where(considered, predicted, np.nan)
            entropy = evidence.action_entropy(predicted, temperature=gate.temperature, mask=considered)
        if entropy <= gate.eta:
            reason = f"entropy {entropy:.3f} <= {gate.eta}"
            return Decision(int(np.nanargmax(values)), "amortized", values, entropy, reason)
        reason = f"entropy {entropy:.3f} > {gate.eta}"
        return replace(self._explicit.decide(situation, clock), entropy=entropy, reason=reason)
