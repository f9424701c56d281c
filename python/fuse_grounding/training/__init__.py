"""What makes the weights that ship. Needs the extra `train`; running them does not."""
