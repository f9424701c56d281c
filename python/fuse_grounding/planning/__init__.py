"""One file a policy: each chooses the next action from what is known."""

from fuse_grounding.planning.protocol import Decision, EvidenceMaps, Planner, Policy, Situation

__all__ = ["Decision", "EvidenceMaps", "Planner", "Policy", "Situation"]
