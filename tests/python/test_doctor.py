import json
import shutil
from pathlib import Path

import pytest
from tiny_networks import write_planner

from fuse_grounding import doctor
from fuse_grounding.cli.app import execute
from fuse_grounding.config import Config

WEIGHTS = doctor.PACKAGE / "weights"


def test_a_missing_file_is_named_with_what_to_do(tmp_path, monkeypatch):
    assert all(c.ok for c in doctor.examine() if c.needed), [c for c in doctor.examine() if not c.ok]
    monkeypatch.setattr(doctor, "PACKAGE", tmp_path)
    missing = {c.name: c for c in doctor.examine() if not c.ok and c.needed}
    parts = ("segmenter", "encoder", "planner")
    assert set(missing) == {"objects", "scenes", *(f"{part} weights" for part in parts)}
    assert "scenes.json is missing" in missing["scenes"].found
    for part in parts:
        assert f"{part}.onnx" in missing[f"{part} weights"].found
    assert all("reinstall" in check.hint for check in missing.values())


def planner_line(**settings) -> doctor.Check:
    return {c.name: c for c in doctor.examine(Config().with_(**settings))}["planner weights"]


def test_what_ships_is_held_against_its_hashes_and_the_planner_is_told():
    lines = {c.name: c for c in doctor.examine()}
    for part, files in (
        ("segmenter", "segmenter.onnx, segmenter_crops.onnx: "),
        ("encoder", "encoder.onnx, encoder.safetensors: "),
        ("planner", "planner.onnx, planner_summary.onnx: "),
    ):
        line = lines[f"{part} weights"]
        assert line.ok
        assert line.found.startswith(files)
        assert "MB, SHA-256 as recorded" in line.found
    config = Config()
    assert lines["planner weights"].found.endswith(
        f"; `{config.planner.name}` is configured, gate.eta {config.gate.eta:g}"
    )
    other = planner_line(planner={"name": "summary"}, gate={"eta": 0.75})
    assert other.found.endswith("; `summary` is configured, gate.eta 0.75")
    assert planner_line(planner={"name": "none"}).found.endswith(
        "none is configured: `fuse` decides explicitly"
    )


@pytest.mark.parametrize(
    "name",
    [
        "segmenter.onnx",
        "segmenter_crops.onnx",
        "encoder.onnx",
        "encoder.safetensors",
        "planner.onnx",
        "planner_summary.onnx",
    ],
)
def test_a_damaged_file_that_ships_is_named(name: str, tmp_path: Path, monkeypatch, capsys):
    shutil.copytree(WEIGHTS, tmp_path / "weights")
    (tmp_path / "data").symlink_to(doctor.PACKAGE / "data")
    monkeypatch.setattr(doctor, "PACKAGE", tmp_path)
    damaged = tmp_path / "weights" / name
    content = bytearray(damaged.read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    assert execute(["doctor", "--json"]) == 1
    (line,) = [c for c in json.loads(capsys.readouterr().out) if c["needed"] and not c["ok"]]
    assert line["name"] == f"{name.split('.')[0].split('_')[0]} weights"
    described = f"{damaged.stem.removesuffix('_crops')}.json"
    assert line["found"].startswith(
        f"{damaged} is damaged or not the file that {described} describes: SHA-256 "
    )
    assert line["hint"] == "reinstall fuse-grounding: the file belongs to the package"


def test_a_planner_of_ones_own_is_held_against_its_settings(tmp_path: Path):
    mine = write_planner(tmp_path / "mine.onnx", WEIGHTS / "encoder.onnx", "summary")
    settings = {"name": "summary", "weights": str(mine)}
    line = planner_line(planner=settings)
    assert line.ok
    assert f"`summary` from {mine} is configured" in line.found
    for wrong, message in (
        ({**settings, "name": "plain"}, "are of a planner `summary`, planner.name asks for `plain`"),
        ({**settings, "weights": str(tmp_path / "none.onnx")}, "none.onnx (planner.weights) do not exist"),
    ):
        line = planner_line(planner=wrong)
        assert not line.ok
        assert message in line.found
        assert "planner.weights" in line.hint
    mine.rename(tmp_path / "other.onnx")
    mine.with_suffix(".json").rename(tmp_path / "other.json")
    (tmp_path / "other.onnx").write_bytes(b"junk")
    line = planner_line(planner={**settings, "weights": str(tmp_path / "other.onnx")})
    assert not line.ok
    assert "other.onnx is damaged or not the file that other.json describes" in line.found


def test_language_models_are_told_without_being_asked(monkeypatch):
    def line(section, **settings):
        checks = {c.name: c for c in doctor.examine(Config().with_(**settings))}
        return checks[f"language model {section}"]

    default = line("vlm")
    assert (default.ok, default.needed, default.found) == (False, False, "no endpoint is configured")
    assert line("vlm", method="vlm").needed
    assert line("knowledge.llm", knowledge={"source": "llm"}).needed
    there = {"base_url": "http://127.0.0.1:9/v1", "model": "m"}  # nobody answers there
    assert line("vlm", vlm={"model": "m"}).found == "vlm.base_url is not set"
    assert line("vlm", vlm=there).found == "`m` at http://127.0.0.1:9/v1, without a key (not called)"
    keyed = {**there, "key_env": "SOME_KEY"}
    assert line("vlm", vlm=keyed).found.endswith("SOME_KEY is not set")
    monkeypatch.setenv("SOME_KEY", "sk-secret")
    told = line("vlm", vlm=keyed)
    assert told.ok
    assert "sk-secret" not in told.found
    assert "offline, from " in line("vlm", vlm={**keyed, "offline": True}).found
