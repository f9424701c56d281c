from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from fuse_grounding.benchmark import identity
from fuse_grounding.benchmark.store import HEADER, RESULTS, ResultStore
from fuse_grounding.cli.bench import summary
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode
from fuse_grounding.errors import InputError

PROVENANCE: dict[str, Any] = {
    "sha256": {"segmenter": "5e" * 32},
    "packages": {"numpy": "2.0.0"},
    "simd_level": "avx2",
    "device": "cpu (avx2)",
    "render_device": "cpu (avx2)",
    "perception": {"segmenter": "cpu (torch)"},
    "commit": "c0ffee",
}
EPISODES = [Episode('{"episode_id": "a", "seed": 1}'), Episode('{"episode_id": "b", "seed": 2}')]


def open_store(
    folder: Path,
    resume: bool = True,
    config: Config | None = None,
    episodes: Sequence[Episode] = EPISODES,
    **provenance: Any,
) -> ResultStore:
    whence = {**PROVENANCE, **provenance}
    return ResultStore(folder, identity.identity(config or Config(), episodes, whence), whence, resume)


def row(method: str, episode: str, status: str = "ok", **more: Any) -> dict[str, Any]:
    return {"method": method, "episode_id": episode, "status": status, **more}


def test_a_killed_benchmark_resumes_without_loss_or_repetition(tmp_path: Path):
    folder = tmp_path / "b"
    store = open_store(folder, resume=False)
    store.append(row("static", "a", iou=0.5))
    store.append(row("random", "a", status="failed", error="broke"))
    with (folder / RESULTS).open("a") as file:
        file.write('{"method": "static", "episode_id": "b", "sta')  # killed while writing
    again = open_store(folder, commit="another", config=Config().with_(method="static"))
    assert again.done("static", "a")
    assert not again.done("static", "b")
    assert not again.done("random", "a")  # failed runs are tried again
    again.append(row("static", "b", iou=0.25))
    lines = [json.loads(line) for line in (folder / RESULTS).read_text().splitlines()]
    assert [(r["method"], r["episode_id"]) for r in lines] == [("static", "a"), ("static", "b")]


def test_a_folder_of_another_benchmark_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "b"
    open_store(folder, resume=False).append(row("static", "a"))
    before = (folder / HEADER).read_text(), (folder / RESULTS).read_text()
    with pytest.raises(InputError, match="exists and is not empty; use --resume"):
        open_store(folder, resume=False)
    others: list[tuple[dict[str, Any], str]] = [
        (
            {"config": Config().with_(gate={"eta": 0.7})},
            r"with other settings \(`config\.gate\.eta` is 0\.8 there and 0\.7 here\)",
        ),
        (
            {"episodes": EPISODES[:1]},
            r"over other episodes \(`episodes\.b` is \w{12} there and missing here\)",
        ),
        (
            {"episodes": [EPISODES[0], Episode('{"episode_id": "b", "seed": 3}')]},
            r"over other episodes \(`episodes\.b` is \w{12} there and \w{12} here\)",
        ),
        (
            {"sha256": {"segmenter": "77" * 32}},
            r"with other weights \(`weights\.segmenter` is 5e5e5e5e5e5e there and 777777777777 here\)",
        ),
        (
            {"packages": {"numpy": "2.1.0"}},
            r"with other packages \(`packages\.numpy` is '2\.0\.0' .*\)",
        ),
        (
            {"simd_level": "avx512"},
            r"at another SIMD level \(`simd_level` is 'avx2' .*\)",
        ),
        (
            {"device": "gpu (NVIDIA L4, Vulkan)"},
            r"on another device \(`device` is 'cpu \(avx2\)' there .*\)",
        ),
        (
            {"render_device": "gpu (NVIDIA L4, Vulkan)"},
            r"with pictures of another device \(`render_device` is 'cpu \(avx2\)' there .*\)",
        ),
        (
            {"perception": {"segmenter": "cuda (NVIDIA H100, torch)"}},
            r"with a segmenter or encoder on another device \(`perception\.segmenter` is 'cpu .*\)",
        ),
    ]
    for other, how in others:
        with pytest.raises(InputError, match=rf"made {how}; results of two runs must not be mixed"):
            open_store(folder, **other)
    with monkeypatch.context() as changed:
        changed.setattr(identity, "code_digest", lambda package: "0" * 64)
        with pytest.raises(InputError, match=r"made by another version of the code \(`code` is \w{12} there"):
            open_store(folder)
    assert ((folder / HEADER).read_text(), (folder / RESULTS).read_text()) == before
    for text in ('{"schema_version": 2, "identity": 3}', '{"schema_version": 2}', "[]", "{"):
        (folder / HEADER).write_text(text)
        with pytest.raises(InputError, match=r"missing or broken|describes its runs otherwise"):
            open_store(folder)
    (folder / HEADER).write_text('{"schema_version": 1, "identity": {}}')
    with pytest.raises(InputError, match="schema_version 1, expected 2"):
        open_store(folder)
    (folder / HEADER).unlink()
    with pytest.raises(InputError, match=r"bench\.json is missing or broken"):
        open_store(folder)


def settings_of(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """`section.key` -> value."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        inner = value if isinstance(value, dict) else {}
        flat |= settings_of(inner, f"{prefix}{key}.") if inner else {prefix + key: value}
    return flat


def test_every_setting_is_identity_unless_it_is_listed_with_its_reason():
    known = set(settings_of(Config().to_dict()))
    assert set(identity.RUNTIME_SETTINGS) < known
    counted = identity.identity(Config(), [], PROVENANCE)["config"]
    assert set(settings_of(counted)) == known - set(identity.RUNTIME_SETTINGS)
    assert all(identity.RUNTIME_SETTINGS.values())


def test_the_code_that_can_run_in_an_episode_is_identity(tmp_path: Path):
    for name in ("agent.py", "planning/explicit.py", "cli/app.py", "training/loss.py", "_core.abi3.so"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("one")
    first = identity.code_digest(tmp_path)
    for name in ("cli/app.py", "training/loss.py"):
        (tmp_path / name).write_text("two")
    assert identity.code_digest(tmp_path) == first
    seen = {first}
    for name in ("agent.py", "planning/explicit.py", "_core.abi3.so"):
        (tmp_path / name).write_text("two")
        seen.add(identity.code_digest(tmp_path))
    assert len(seen) == 4


def test_resuming_a_folder_without_results_starts_afresh(tmp_path: Path):
    (tmp_path / "note").write_text("x")
    store = open_store(tmp_path)
    store.append(row("static", "a"))
    assert len((tmp_path / RESULTS).read_text().splitlines()) == 1


def test_lines_changed_by_hand_are_not_believed(tmp_path: Path):
    open_store(tmp_path).append(row("static", "a"))
    whole = (tmp_path / RESULTS).read_text()
    for added, message in [
        ("not json\n", "not a result"),
        (json.dumps(row("static", "b")) + "\n", "not a result"),  # not stamped
        (json.dumps(row("static", "b", identity="0" * 16)) + "\n", "a result of another run"),
    ]:
        (tmp_path / RESULTS).write_text(whole + added)
        with pytest.raises(InputError, match=rf"results\.jsonl, line 2: {message}"):
            open_store(tmp_path)


def test_the_summary_is_of_runs_that_went_through():
    timings = {"segment": 1.0, "refine": 3.0}
    common: dict[str, Any] = {"online_actions": 4, "total_steps": 8, "wall_seconds": 5.0, "timings": timings}
    rows = [
        row("explicit", "a", success=True, iou=0.9, **common),
        row("explicit", "b", success=False, iou=0.1, **common),
        row("explicit", "c", status="failed", error="broke"),
        row("static", "a", success=True, iou=1.0, **common),
    ]
    s = summary("explicit", rows)
    assert (s["episodes"], s["failed"], s["success"]) == (2, 1, 0.5)
    assert s["iou"] == pytest.approx(0.5)
    assert s["shares"] == {"refine": 0.75, "segment": 0.25}
    assert list(s["shares"]) == ["refine", "segment"]
    assert summary("random", rows) == {"method": "random", "episodes": 0, "failed": 0}
