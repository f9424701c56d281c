"""What `benches/peers.py` runs: the scene, ours, and one module for each peer."""
