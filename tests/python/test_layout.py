"""The invariants of ARCHITECTURE.md: what must never be where."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "python" / "fuse_grounding"
CRATES = ROOT / "crates"

# Files over the budget that are one thing and stay so, with the reason in ARCHITECTURE.md.
LINE_BUDGET = 400
LONG_FILES = {"crates/fuse-splat/src/cpu/loss.rs"}


def python_files(folder: Path = PACKAGE) -> list[Path]:
    return sorted(folder.rglob("*.py"))


def rust_files(crate: str) -> list[Path]:
    return sorted((CRATES / crate / "src").rglob("*.rs"))


def imports(path: Path) -> set[str]:
    """Absolute names of all modules that a file imports, wherever the import stands."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def calls(path: Path) -> set[str]:
    return {
        ast.unparse(node.func) for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)
    }


def test_only_the_command_line_prints_or_exits():
    for path in python_files():
        if "cli" in path.relative_to(PACKAGE).parts:
            continue
        found = calls(path) & {"print", "sys.exit", "exit", "os._exit"}
        assert not found, f"{path.relative_to(ROOT)} calls {sorted(found)}"


def test_the_agent_meets_the_world_through_protocols():
    concrete = [
        "fuse_grounding.environment.tabletop",
        "fuse_grounding.perception.embedded",
        "fuse_grounding.registration.colmap",
        "fuse_grounding._core",
    ]
    assert not imports(PACKAGE / "agent.py") & set(concrete)


def test_running_never_needs_torch():
    for path in python_files():
        if "training" in path.parts:
            continue
        assert not {n.split(".")[0] for n in imports(path)} & {"torch", "transformers", "ray"}, path


def test_knowledge_never_reads_the_validity_table():
    for path in python_files(PACKAGE / "knowledge"):
        if path.name != "judge.py":
            assert "validity" not in path.read_text(), f"{path.name} may not see what judges it"


def test_only_the_chat_endpoint_opens_connections():
    opening = {"urllib.request", "http.client", "socket", "ftplib", "requests", "httpx", "aiohttp", "openai"}
    for path in python_files():
        inside = path == PACKAGE / "chat" / "endpoint.py"
        if "training" in path.parts:
            continue
        assert inside or not imports(path) & opening, path
        assert inside or 'require("urllib3"' not in path.read_text(), path


def test_only_the_bindings_know_python():
    for crate in CRATES.iterdir():
        names = (crate / "Cargo.toml").read_text()
        assert crate.name == "fuse-py" or not re.search(r"^(pyo3|numpy)\b", names, re.M), crate.name


@pytest.mark.parametrize(
    ("crate", "allowed"),
    [
        ("fuse-camera", set()),
        ("fuse-render", {"fuse-camera"}),
        ("fuse-splat", {"fuse-camera"}),
        ("fuse-evidence", {"fuse-camera"}),
        ("fuse-env", {"fuse-camera", "fuse-render"}),
    ],
)
def test_arrows_between_crates_run_downward(crate: str, allowed: set[str]):
    text = (CRATES / crate / "Cargo.toml").read_text()
    section = text.split("[dependencies]")[1].split("\n[")[0]
    used = set(re.findall(r"^(fuse-\w+)", section, re.M))
    assert used <= allowed, f"{crate} depends on {sorted(used - allowed)}"


def test_vector_intrinsics_and_unsafe_are_confined():
    """`unsafe` stands only where the SIMD levels are, and once where an array's memory is lent."""
    for crate in ("fuse-render", "fuse-splat", "fuse-env", "fuse-py"):
        for path in rust_files(crate):
            found = re.findall(r"\bunsafe\s*(?:\{|fn|impl)", path.read_text())
            lent = path == CRATES / "fuse-py/src/array.rs"
            assert len(found) == int(lent), path.relative_to(ROOT)


def test_only_gpu_modules_name_wgpu():
    for path in CRATES.glob("*/src/**/*.rs"):
        if path.stem != "gpu" and path.parent.name != "gpu":
            assert not re.search(r"\b(wgpu|naga)\b", path.read_text()), path.relative_to(ROOT)
    for manifest in CRATES.glob("*/Cargo.toml"):
        default = re.search(r"^default\s*=.*", manifest.read_text(), re.M)
        assert not default or "gpu" not in default[0], f"{manifest.parent.name} needs no GPU stack by default"


def test_files_stay_readable():
    long = {
        str(path.relative_to(ROOT)): n
        for path in [*python_files(), *CRATES.glob("*/src/**/*.rs")]
        if (n := len(path.read_text().splitlines())) > LINE_BUDGET
    }
    assert set(long) <= LONG_FILES, long
    named = (ROOT / "ARCHITECTURE.md").read_text()
    assert all(f"`{name}`" in named for name in LONG_FILES), "ARCHITECTURE.md lists the long files"


def test_the_shipped_set_stays_small():
    size = sum(p.stat().st_size for p in (PACKAGE / "data").rglob("*") if p.is_file())
    assert size <= 40e6, f"{size / 1e6:.1f} MB of data"
    weights = sum(p.stat().st_size for p in (PACKAGE / "weights").rglob("*") if p.is_file())
    assert weights <= 30e6, f"{weights / 1e6:.1f} MB of weights"
