"""Active functional affordance grounding."""
