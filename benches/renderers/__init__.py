"""What `benches/renderers.py` runs: the scene, the table and one module for each renderer."""
