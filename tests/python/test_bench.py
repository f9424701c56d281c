from __future__ import annotations

import json
import re
import resource
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from fuse_grounding.benchmark import identity
from fuse_grounding.benchmark.metrics import METRICS
from fuse_grounding.benchmark.store import HEADER, RESULTS, ResultStore, load
from fuse_grounding.cli.bench_console import summary
from fuse_grounding.config import Config
from fuse_grounding.environment import Episode
from fuse_grounding.errors import FuseError, InputError

PROVENANCE: dict[str, Any] = {
    "sha256": {"segmenter": "5e" * 32},
    "packages": {"numpy": "2.0.0", "onnxruntime": "1.2.3"},
    "simd_level": "avx2",
    "device": "cpu (avx2)",
    "render_device": "cpu (avx2)",
    "perception": {"segmenter": "cpu (torch)"},
    "commit": "c0ffee",
}
MEASURED: dict[str, Any] = {
    **{metric.name: 1.0 for metric in METRICS},
    "success": True,
    "seed_motions": 0,
    "branches": {"random": 1},
    "calls": {"segment": 2},
    "timings": {"segment": 1.0},
    "wall_seconds": 1.5,
    "concurrent": False,
}
EPISODES = [Episode('{"episode_id": "a", "seed": 1}'), Episode('{"episode_id": "b", "seed": 2}')]


def open_store(
    folder: Path,
    resume: bool = True,
    config: Config | None = None,
    episodes: Sequence[Episode] = EPISODES,
    methods: Sequence[str] = ("static", "random"),
    **provenance: Any,
) -> ResultStore:
    whence = {**PROVENANCE, **provenance}
    decided = identity.identity(config or Config(), episodes, dict.fromkeys(methods, whence))
    return ResultStore(folder, decided, whence, resume)


def row(method: str, episode: str, status: str = "ok", **more: Any) -> dict[str, Any]:
    index = [e.episode_id for e in EPISODES].index(episode)
    told = {"index": index, "method": method, "episode_id": episode, "scene": "dev_kitchen", "verb": "cut"}
    return {**told, "status": status, **(MEASURED if status == "ok" else {"error": "broke"}), **more}


def lines(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / RESULTS).read_text().splitlines()]


def test_a_killed_benchmark_resumes_without_loss_or_repetition(tmp_path: Path):
    folder = tmp_path / "b"
    with open_store(folder, resume=False) as first:
        first.append(row("static", "b", iou=0.5))
        first.append(row("random", "a", status="error", error="broke"))
    with (folder / RESULTS).open("a") as file:
        file.write('{"method": "static", "episode_id": "b", "sta')  # killed while writing
    with open_store(folder, commit="another", config=Config().with_(method="static")) as again:
        assert again.announcements == [
            f"{folder / RESULTS}: the last line (3) was not written to its end; "
            "it is left out, and what has no result is run"
        ]
        assert again.done("static", "b") == lines(folder)[0]
        assert again.done("static", "a") is None
        assert again.done("random", "a") is None  # tried again, and known until then
        assert [r["status"] for r in again.rows] == ["error", "ok"]
        again.append(row("random", "a", iou=0.1))
        again.append(row("static", "a", iou=0.25))
        assert len(lines(folder)) == 4
        again.finish()
    found = lines(folder)
    assert [(r["method"], r["episode_id"]) for r in found] == [
        ("random", "a"),
        ("static", "a"),
        ("static", "b"),
    ]
    assert [r["commit"] for r in found] == ["another", "another", "c0ffee"]
    assert load(folder)[1] == found
    assert [run["commit"] for run in load(folder)[0]["earlier"]] == ["c0ffee"]


def test_a_folder_is_written_by_one_process_at_a_time(tmp_path: Path):
    with (
        open_store(tmp_path / "b"),
        pytest.raises(InputError, match="another benchmark is writing to"),
    ):
        open_store(tmp_path / "b")
    open_store(tmp_path / "b").close()


def test_a_full_disk_leaves_whole_lines(tmp_path: Path):
    store = open_store(tmp_path / "b")
    store.append(row("static", "a"))
    before = (tmp_path / "b" / RESULTS).read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 20, hard))
    try:
        with pytest.raises(FuseError, match=r"File too large; the 1 results in it are whole: .* --resume"):
            store.append(row("static", "b"))
        resource.setrlimit(resource.RLIMIT_FSIZE, (20, hard))
        whole = r"put in order: File too large; the 1 results in it are whole: .* go on with --resume"
        with pytest.raises(FuseError, match=whole):
            store.finish()
        with pytest.raises(InputError, match="cannot be written: File too large"):
            open_store(tmp_path / "c")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (tmp_path / "b" / RESULTS).read_bytes() == before
    store.append(row("static", "b"))
    assert len(lines(tmp_path / "b")) == 2
    assert list((tmp_path / "c").iterdir()) == []


def test_a_folder_of_another_benchmark_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "b"
    with open_store(folder, resume=False) as store:
        store.append(row("static", "a"))
    before = (folder / HEADER).read_text(), (folder / RESULTS).read_text()
    with pytest.raises(InputError, match="exists and is not empty; use --resume"):
        open_store(folder, resume=False)
    swapped = [Episode('{"episode_id": "b", "seed": 2}'), Episode('{"episode_id": "a", "seed": 1}')]
    others: list[tuple[dict[str, Any], str]] = [
        (
            {"config": Config().with_(gate={"eta": 0.7})},
            r"with other settings \(`config\.gate\.eta` is 0\.6 there and 0\.7 here\)",
        ),
        (
            {"episodes": EPISODES[:1]},
            r"over other episodes \(`episodes\.b` is \w{12} there and missing here\)",
        ),
        (
            {"episodes": [EPISODES[0], Episode('{"episode_id": "b", "seed": 3}')]},
            r"over other episodes \(`episodes\.b` is \w{12} there and \w{12} here\)",
        ),
        ({"episodes": swapped}, r"over other episodes \(episode 0 is `a` there and `b` here\)"),
        (
            {"sha256": {"segmenter": "77" * 32}},
            r"with other weights \(`weights\.segmenter` is 5e5e5e5e5e5e there and 777777777777 here, "
            r"method `static`\)",
        ),
        (
            {"packages": {"numpy": "2.1.0", "onnxruntime": "1.2.3"}},
            r"with other packages \(`packages\.numpy` is '2\.0' there and '2\.1' here, .*\)",
        ),
        (
            {"packages": {"numpy": "2.0.0", "onnxruntime": "1.2.4"}},
            r"with other packages \(`packages\.onnxruntime` is '1\.2\.3' .*\)",
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
        changed.setattr(identity, "RESULTS_VERSION", 1000)
        with pytest.raises(
            InputError, match=r"by another version of the code \(`results_version` is \d+ there and 1000 here"
        ):
            open_store(folder)
    assert ((folder / HEADER).read_text(), (folder / RESULTS).read_text()) == before
    version = identity.IDENTITY_VERSION
    headless = f'{{"identity": {{"identity_version": {version}, "methods": {{}}}}}}'
    three = headless.replace("{}", '{"static": 3}, "episodes": {}, "config": {}')
    for text in ('{"identity": 3}', '{"identity": {"code": 1}}', headless, three, "[]", "{"):
        whole = text.replace("{", '{"schema_version": 3, "provenance": {}, ', 1) if len(text) > 2 else text
        (folder / HEADER).write_text(whole)
        with pytest.raises(InputError, match=r"missing or broken|describes its runs otherwise"):
            open_store(folder)
        with pytest.raises(InputError, match=r"missing or broken|has identity_version None, expected"):
            load(folder)
    (folder / HEADER).write_text('{"schema_version": 1, "identity": {}, "provenance": {}}')
    with pytest.raises(InputError, match="schema_version 1, expected 3"):
        open_store(folder)
    (folder / HEADER).unlink()
    with pytest.raises(InputError, match=r"bench\.json is missing or broken"):
        open_store(folder)


def test_repairs_of_packages_methods_and_episodes_may_be_added(tmp_path: Path):
    with open_store(tmp_path / "b", resume=False, methods=["static"]) as store:
        store.append(row("static", "a"))
    more = [*EPISODES, Episode('{"episode_id": "c", "seed": 3}')]
    repaired = {**PROVENANCE["packages"], "numpy": "2.0.7"}
    planner = {**PROVENANCE["sha256"], "planner": "11" * 32}
    with open_store(tmp_path / "b", episodes=more, methods=["random"], packages=repaired, sha256=planner):
        pass
    with open_store(tmp_path / "b", episodes=more, methods=["static"]) as store:
        assert store.done("static", "a") is not None
        assert set(load(tmp_path / "b")[0]["identity"]["methods"]) == {"static", "random"}


def test_a_stamp_names_all_that_decides_a_row():
    one = identity.identity(Config(), EPISODES, {"static": PROVENANCE, "random": PROVENANCE})
    assert identity.stamp(one, "static", "a") != identity.stamp(one, "random", "a")
    assert identity.stamp(one, "static", "a") != identity.stamp(one, "static", "b")
    alone = identity.identity(Config(), EPISODES[:1], {"static": PROVENANCE})
    assert identity.stamp(alone, "static", "a") == identity.stamp(one, "static", "a")
    other = identity.identity(Config().with_(gate={"eta": 0.5}), EPISODES, {"static": PROVENANCE})
    assert identity.stamp(other, "static", "a") != identity.stamp(one, "static", "a")


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
    counted = identity.identity(Config(), [], {})["config"]
    assert set(settings_of(counted)) == known - set(identity.RUNTIME_SETTINGS)
    assert all(identity.RUNTIME_SETTINGS.values())


def test_resuming_a_folder_without_results_starts_afresh(tmp_path: Path):
    (tmp_path / "note").write_text("x")
    store = open_store(tmp_path)
    store.append(row("static", "a"))
    assert len(lines(tmp_path)) == 1


def test_a_broken_line_is_repaired_at_the_end_and_reported_elsewhere(tmp_path: Path):
    with open_store(tmp_path) as store:
        store.append(row("static", "a"))
        store.append(row("static", "b"))
    one, two, _ = (tmp_path / RESULTS).read_bytes().split(b"\n")
    stamped = json.loads(one)
    unknown = json.dumps({**stamped, "episode_id": "z"}).encode()
    swapped = json.dumps({**stamped, "identity": "0" * 16}).encode()
    for content, message in [
        (one[:-9] + b"\n" + two + b"\n", "line 1: not a result"),
        (one + b"\n\0\0\n" + two + b"\n", "line 2: not a result"),
        (
            one + b"\n" + json.dumps(row("static", "b")).encode() + b"\n",
            r"line 2: not a result \(`identity` is missing\)",
        ),
        (one + b"\n7\n", r"line 2: not a result \(found 7, expected an object\)"),
        (b"[" * 100_000 + b"\n" + two + b"\n", r"line 1: not a result \(broken JSON\)"),
        (one + b"\n" + unknown + b"\n", "line 2: `static` on `z` is no part of this benchmark"),
        (one + b"\n" + swapped + b"\n", "line 2: a result of another run"),
    ]:
        (tmp_path / RESULTS).write_bytes(content)
        for read in (lambda: open_store(tmp_path), lambda: load(tmp_path)):
            with pytest.raises(InputError, match=rf"results\.jsonl, {message}"):
                read()
        assert (tmp_path / RESULTS).read_bytes() == content
    for torn, how in [
        (two, "was not written to its end"),
        (two[:5] + b"\n", "is broken"),
        (b"\xff\0\n", "is broken"),
    ]:
        (tmp_path / RESULTS).write_bytes(one + b"\n" + torn)
        with open_store(tmp_path) as store:
            assert [r["episode_id"] for r in store.rows] == ["a"]
            assert f"the last line (2) {how}" in store.announcements[0]
        assert (tmp_path / RESULTS).read_bytes() == one + b"\n"


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("status", "done", "found 'done', expected: 'ok' or 'error'"),
        ("method", ["static"], r"found \['static'\], expected: a valid string"),
        ("index", 1, "found 1, expected: 0, the place of `a`"),
        ("index", -2, "found -2, expected: 0, the place of `a`"),
        ("index", False, "found False, expected: a valid integer"),
        ("success", "yes", "found 'yes', expected: a valid boolean"),
        ("success", 1, "found 1, expected: a valid boolean"),
        ("iou", "NaN", "found 'NaN', expected: a valid number"),
        ("iou", float("nan"), "found nan, expected: a finite number"),
        ("iou", None, "found None, expected: a valid number"),
        ("iou", 10**400, "found 1000"),
        ("online_actions", None, "found None, expected: a valid number"),
        ("runtime_seconds", "1 s", "found '1 s', expected: a valid number"),
        ("final_score", "0.5", "found '0.5', expected: a valid number"),
        ("timings", [], r"found \[\], expected: a valid dictionary"),
        ("timings.segment", None, "found None, expected: a valid number"),
        ("calls", None, "found None, expected: a valid dictionary"),
        ("calls.segment", 1.5, "found 1.5, expected: a valid integer"),
        ("branches", 3, "found 3, expected: a valid dictionary"),
        ("trace", 0, "found 0, expected: a valid list"),
    ],
)
def test_a_damaged_field_is_named_with_what_was_found(tmp_path: Path, field: str, value: Any, told: str):
    with open_store(tmp_path) as store:
        stamped = store.append(row("static", "a"))
        store.append(row("static", "b"))
    name, _, inner = field.partition(".")
    damaged = {**stamped, name: {inner: value} if inner else value}
    refused(tmp_path, damaged, rf"`{field}`: {told}")


def refused(folder: Path, first: dict[str, Any], told: str) -> None:
    """A folder whose first line became `first` is neither gone on with nor read, and stays as it is."""
    _, second = (folder / RESULTS).read_text().splitlines()
    content = f"{json.dumps(first)}\n{second}\n"
    (folder / RESULTS).write_text(content)
    for read in (lambda: open_store(folder), lambda: load(folder)):
        with pytest.raises(InputError, match=rf"line 1: not a result \({told}.*\); the file was changed"):
            read()
    assert (folder / RESULTS).read_text() == content


@pytest.mark.parametrize("field", [*MEASURED, "index", "status", "scene", "verb"])
def test_a_missing_field_is_named(tmp_path: Path, field: str):
    with open_store(tmp_path) as store:
        stamped = store.append(row("static", "a"))
        store.append(row("static", "b"))
    refused(tmp_path, {k: v for k, v in stamped.items() if k != field}, f"`{field}` is missing")


def test_metrics_that_may_be_none_are_those_of_the_documentation(tmp_path: Path):
    text = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text()
    (sentences,) = re.findall(r"\*\*None\.\*\*(.*?)No other metric", text, re.S)
    named = set(re.findall(r"`(\w+)` (?:is None|where|for)", sentences))
    assert len(named) == 3
    for metric in METRICS:
        folder = tmp_path / metric.name
        with open_store(folder) as store:
            stamped = store.append({**row("static", "a"), metric.name: None})
            store.append(row("static", "b"))
        if metric.name in named:
            assert load(folder)[1][0] == stamped
        else:
            refused(folder, stamped, f"`{metric.name}`: found None, expected: ")


def test_an_error_has_its_message_and_counts_as_a_failure_alone(tmp_path: Path):
    with open_store(tmp_path) as store:
        stamped = store.append(row("static", "a", "error"))
        store.append(row("static", "b"))
    assert load(tmp_path)[1][0] == stamped
    for field, value in (("success", True), ("iou", "NaN"), ("error", None)):
        refused(tmp_path, {**stamped, field: value}, f"`{field}`: found {value!r}, expected: ")


def test_the_summary_counts_errors_as_failures():
    timings = {"segment": 1.0, "refine": 3.0}
    common: dict[str, Any] = {"online_actions": 4, "total_steps": 8, "wall_seconds": 5.0, "timings": timings}
    rows = [
        row("explicit", "a", success=True, iou=0.9, **common),
        row("explicit", "b", success=False, iou=0.1, **common),
        row("explicit", "b", status="error"),
        row("static", "a", success=True, iou=1.0, **common),
    ]
    s = summary("explicit", rows)
    assert (s["episodes"], s["errors"]) == (3, 1)
    assert s["success"] == pytest.approx(1 / 3)  # an error is a failure
    assert s["iou"] == pytest.approx(1 / 3)
    assert s["online_actions"] == 4
    assert s["shares"] == {"refine": 0.75, "segment": 0.25}
    assert list(s["shares"]) == ["refine", "segment"]
    assert summary("random", [row("random", "a", "error", success=False, iou=0.0)]) == {
        "method": "random",
        "episodes": 1,
        "errors": 1,
    }
