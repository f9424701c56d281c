"""Running methods over episodes, and judging what they return."""
