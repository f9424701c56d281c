#!/usr/bin/env bash
# Builds the wheel, installs it into a fresh environment and uses it from an empty folder.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

cd "$root"
maturin build --release --quiet --out "$work/dist"
wheel=$(ls "$work"/dist/fuse_grounding-*.whl)
case $wheel in *-abi3-*) ;; *) echo "expected an abi3 wheel, found $wheel" >&2; exit 1 ;; esac

python -m venv "$work/env"
"$work/env/bin/pip" install --quiet "$wheel"
cd "$work"
"$work/env/bin/fuse" --version
"$work/env/bin/python" - <<'PY'
import numpy as np

import fuse_grounding as fuse
from fuse_grounding import evidence, splat
from fuse_grounding.environment import TabletopEnvironment, make_episode

flat = np.zeros((480, 640, 3), np.uint8)
assert np.allclose(evidence.geometric_uncertainty(flat, flat), 0.4), "a flat pair is worth 0 dB"
print(f"maps are trained on {splat.device_name('auto')}")  # with a GPU's driver and without
episode = make_episode("cut", seed=7)
result = fuse.Agent(fuse.Config(method="static")).run(TabletopEnvironment(episode), "cut a piece of rope")
assert result.record.steps, "the wheel runs an episode"
print(f"{result.label} at {result.viewpoint.node}, score {result.score}")
PY
"$work/env/bin/pip" install --quiet 'gymnasium>=1.0'
"$work/env/bin/python" - <<'PY'
import fuse_grounding, gymnasium

observation, info = gymnasium.make("fuse_grounding/Tabletop-v0").reset(options={"episode_id": "dev_0001"})
print(f"gymnasium plays {info['episode_id']}: {observation['query']}")
PY
"$work/env/bin/python" -c 'import importlib.util as u; assert u.find_spec("torch") is None, "torch must not be needed"'
echo "wheel: $(basename "$wheel"), $(du -h "$wheel" | cut -f1)"
