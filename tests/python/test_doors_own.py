"""Choosing a segmenter or an encoder: names, classes, entry points, and what is recorded of them."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_checkpoints import needs, write_onnx_clip

from fuse_grounding import doctor
from fuse_grounding.agent import Agent
from fuse_grounding.benchmark.identity import difference, identity
from fuse_grounding.benchmark.provenance import sha256
from fuse_grounding.cli.app import execute
from fuse_grounding.config import Config, EncoderConfig, SegmenterConfig
from fuse_grounding.environment import TabletopEnvironment, make_episode
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.perception import doors
from fuse_grounding.perception.doors import open_encoder, open_segmenter

DOCS = Path(__file__).resolve().parents[2] / "docs" / "models" / "doors.md"
EXAMPLE = next(s for s in re.findall(r"```python\n(.*?)```", DOCS.read_text(), re.S) if "class Reddest" in s)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty working directory, whose modules are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and str(tmp_path) in str(sys.modules[name].__file__):
            del sys.modules[name]


def test_the_class_of_the_documentation_finds_what_is_red(here: Path):
    (here / "reddest.py").write_text(EXAMPLE)
    rgb = np.full((48, 64, 3), 90, np.uint8)
    rgb[10:20, 30:50] = (200, 40, 40)
    config = SegmenterConfig(name="reddest:Reddest", options={"margin": 40})
    opened = open_segmenter(config)
    (found,) = opened.part.segment(rgb, ["knife"])
    assert found.label == "knife"
    assert found.mask.sum() == 200
    assert opened.files == (here / "reddest.py",)
    dull = config.model_copy(update={"options": {"margin": 200}})
    assert open_segmenter(dull).part.segment(rgb, ["knife"]) == []


def test_a_whole_episode_by_the_class_of_the_documentation(here: Path, capsys: pytest.CaptureFixture[str]):
    (here / "reddest.py").write_text(EXAMPLE)
    arguments = ["run", "cut a rope", "--method", "static", "--segmenter", "reddest:Reddest", "--out", "run"]
    assert execute([*arguments, "--set", "segmenter.options.margin=20"]) == 0
    record = json.loads((here / "run" / "episode.json").read_text())
    assert record["config"]["segmenter"]["options"] == {"margin": 20}
    assert record["provenance"]["sha256"]["segmenter"] == sha256([here / "reddest.py"])
    assert "candidates" in capsys.readouterr().out


def test_other_weights_or_other_code_are_another_benchmark(here: Path):
    (here / "reddest.py").write_text(EXAMPLE)
    (here / "w").mkdir()
    (here / "w" / "a.bin").write_bytes(b"one")

    def made(**settings: Any) -> dict[str, Any]:
        given = {"name": "reddest:Reddest", "weights": "w", **settings}
        config = Config().with_(method="static", segmenter=given)
        return identity(config, [], {"static": Agent(config).provenance})

    first = made()
    assert difference(first, made()) is None
    moved = here / "elsewhere"
    (here / "w").rename(moved)
    assert difference(first, made(weights=str(moved))) is None  # where they lie is no part of it
    assert "with other settings" in str(difference(first, made(weights=str(moved), options={"margin": 9})))
    (moved / "a.bin").write_bytes(b"two")
    assert "with other weights (`weights.segmenter`" in str(difference(first, made(weights=str(moved))))
    (moved / "a.bin").write_bytes(b"one")
    (here / "reddest.py").write_text(EXAMPLE + "\n# changed\n")
    assert "with other weights (`weights.segmenter`" in str(difference(first, made(weights=str(moved))))
    with pytest.raises(InputError, match="weights gone do not exist"):
        made(weights="gone")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("mine:", "", "expected package.module:Class"),
        ("nowhere:Eye", "", "there is no module `nowhere` here or among the installed packages"),
        ("mine:Eye", "x = 1", "module `mine` has no `Eye`"),
        ("mine:x", "x = 1", "is a int, expected a class"),
        ("mine:Eye", "class Eye: pass", "has no method `segment`: it is no segmenter"),
        ("mine:Eye", "import not_there", "its module needs `not_there`, which is not installed"),
        ("mine:Eye", "def (", "its module cannot be imported: SyntaxError"),
        ("mine:Eye", "class Eye:\n def segment(self): 1", r"cannot be made: TypeError: .*takes no arguments"),
        (
            "mine:Eye",
            "class Eye:\n def __init__(self, config): pass\n def segment(self): 1",
            "has no `labels`: it is no segmenter",
        ),
    ],
)
def test_a_class_that_is_no_segmenter_is_told_why(here: Path, name: str, content: str, message: str):
    (here / "mine.py").write_text(content)
    with pytest.raises(InputError, match=message):
        open_segmenter(SegmenterConfig(name=name))


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        ("[3]", "returned a int, expected a Detection"),
        ("[Detection('a', 0.5, rgb[..., 0] > 3)][:0] or [Detection('a', 0.5, rgb)]", "expected a bool array"),
        (
            "[Detection('a', 0.5, rgb[:9, :9, 0] > 3)]",
            r"shape \(9, 9\), expected a bool array of shape \(48, 64\)",
        ),
        ("[Detection('a', 1.5, rgb[..., 0] > 3)]", "a score of 1.5, expected a number from 0 to 1"),
        ("[Detection('a', float('nan'), rgb[..., 0] > 3)]", "a score of nan"),
        ("[Detection('b', 0.5, rgb[..., 0] > 3)]", "the label `b`, which was not asked for"),
    ],
)
def test_what_a_class_returns_is_held_against_the_protocol(here: Path, returned: str, message: str):
    (here / "mine.py").write_text(
        "from fuse_grounding.perception import Detection\n"
        "class Eye:\n"
        " labels = None\n"
        " def __init__(self, config): pass\n"
        f" def segment(self, rgb, labels): return {returned}\n"
    )
    eye = open_segmenter(SegmenterConfig(name="mine:Eye")).part
    with pytest.raises(
        FuseError, match=f"segmenter `mine:Eye` returned .*{message}|segmenter `mine:Eye` {message}"
    ):
        eye.segment(np.zeros((48, 64, 3), np.uint8), ["a"])


def register(folder: Path, group: str, **points: str) -> None:
    """What installing a package with entry points leaves behind."""
    info = folder / "eyes-1.0.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: eyes\nVersion: 1.0\n")
    lines = "\n".join(f"{name} = {value}" for name, value in points.items())
    (info / "entry_points.txt").write_text(f"[{group}]\n{lines}\n")


def test_an_entry_point_is_a_name(here: Path, monkeypatch: pytest.MonkeyPatch):
    (here / "reddest.py").write_text(EXAMPLE)
    register(here, doors.SEGMENTER_GROUP, red="reddest:Reddest")
    monkeypatch.syspath_prepend(here)
    assert open_segmenter(SegmenterConfig(name="red")).part.labels is None
    with pytest.raises(
        InputError,
        match=r"unknown segmenter `rad`; did you mean `red`\? known: embedded, embedded_.*sam3.*red, or",
    ):
        open_segmenter(SegmenterConfig(name="rad"))
    checks = {c.name: c for c in doctor.examine()}
    assert checks["segmenter red"].ok
    register(here, doors.SEGMENTER_GROUP, sam3="reddest:Reddest")
    with pytest.raises(
        InputError, match="entry point reddest:Reddest takes the name `sam3`, which is FUSE's own"
    ):
        open_segmenter(SegmenterConfig(name="sam3"))


def test_an_encoder_of_ones_own_decides_what_is_near(here: Path):
    (here / "words.py").write_text(
        "import numpy as np\n"
        "class Words:\n"
        " name = 'mine'\n"
        " def __init__(self, config): pass\n"
        " def text(self, texts):\n"
        "  return np.array([[1, 0] if t in ('cut', 'sponge') else [0, 1] for t in texts], np.float32)\n"
    )
    assert open_encoder(EncoderConfig(name="words:Words")).part.name == "mine"
    config = Config().with_(method="static", encoder={"name": "words:Words"}, knowledge={"source": "direct"})
    session = Agent(config).start("cut a rope")
    assert session.hypotheses.labels == ("sponge",)
    assert session.record.candidates_replaced[0].encoder == "mine"
    assert session.record.provenance["sha256"]["encoder"] == sha256([here / "words.py"])


def test_without_its_packages_a_door_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """As on a machine without torch: `None` in `sys.modules` is how an import is made to fail."""
    for package in ("torch", "torchvision", "transformers", "tokenizers"):
        monkeypatch.setitem(sys.modules, package, None)
    (tmp_path / "config.json").write_text('{"model_type": "sam3"}')
    (tmp_path / "tokenizer.json").write_text("{}")
    (tmp_path / "model.safetensors").write_bytes((2).to_bytes(8, "little") + b"{}")
    for name, model, extra in (("sam3", "sam3", "sam3"), ("clip_patches", "clip", "clip")):
        (tmp_path / "config.json").write_text(json.dumps({"model_type": model}))
        with pytest.raises(
            InputError, match=rf"needs the optional package `torch`\n\nhint: pip .*\[{extra}\]"
        ):
            open_segmenter(SegmenterConfig(name=name, weights=tmp_path))
    for name in ("image.onnx", "text.onnx"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(InputError, match=r"`tokenizers`\n\nhint: pip install 'fuse-grounding\[clip-onnx\]'"):
        open_encoder(EncoderConfig(name="clip", weights=tmp_path))


def test_the_doctor_tells_what_is_usable_and_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def checks(**settings: Any) -> dict[str, doctor.Check]:
        return {c.name: c for c in doctor.examine(Config().with_(**settings))}

    plain = checks()
    assert plain["segmenter embedded"].ok
    assert plain["encoder lexical"].ok
    assert not plain["segmenter sam3"].ok
    assert not plain["segmenter sam3"].needed
    with monkeypatch.context() as absent:
        absent.setattr(doctor, "installed", lambda package: False)
        sam3 = checks(segmenter={"name": "sam3"})["segmenter sam3"]
        assert (sam3.ok, sam3.needed) == (False, True)
        assert sam3.found == "transformers needs torch, torchvision, transformers"
        assert sam3.hint == "pip install 'fuse-grounding[sam3]'"
    with monkeypatch.context() as present:
        present.setattr(doctor, "installed", lambda package: True)
        assert "no checkpoint folder is named" in checks()["segmenter clip_patches"].found
        empty = checks(segmenter={"name": "sam3", "weights": str(tmp_path)})["segmenter sam3"]
        assert not empty.ok
        assert "config.json is missing" in empty.found
    assert "no module `nowhere`" in checks(segmenter={"name": "nowhere:Eye"})["segmenter nowhere:Eye"].found
    needs("tokenizers", "onnx")
    write_onnx_clip(tmp_path / "clip")
    usable = checks(encoder={"name": "clip", "weights": str(tmp_path / "clip")})["encoder clip"]
    assert usable.ok, usable
    assert "3 file(s)" in usable.found
    assert execute(["doctor", "--segmenter", "sam3", "--weights", str(tmp_path / "clip"), "--json"]) == 1
    told = {c["name"]: c for c in json.loads(capsys.readouterr().out)}
    assert not told["segmenter sam3"]["ok"]


def test_an_episode_with_patches_records_the_weights(tmp_path: Path):
    needs("tokenizers", "onnx")
    write_onnx_clip(tmp_path)
    config = Config().with_(method="static", segmenter={"name": "clip_patches", "weights": str(tmp_path)})
    agent = Agent(config)
    grounded = agent.run(TabletopEnvironment(make_episode("cut", seed=1), "cpu"), "cut a rope")
    assert grounded.record.candidates_unknown == []
    whence = grounded.record.provenance
    files = [tmp_path / name for name in ("image.onnx", "text.onnx", "tokenizer.json")]
    assert whence["sha256"]["segmenter"] == sha256(files)
    assert whence["perception"] == dict.fromkeys(("segmenter", "encoder"), "cpu (ONNX Runtime)")
    assert "tokenizers" in whence["packages"]
