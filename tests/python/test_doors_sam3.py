"""SAM3 through the real loading and processing code, on tiny checkpoints in every layout."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_checkpoints import needs, sam3_model, write_clip, write_original_sam3, write_sam3, write_tokenizer

from fuse_grounding.config import SegmenterConfig
from fuse_grounding.errors import InputError
from fuse_grounding.perception import Detection, Segmenter
from fuse_grounding.perception.doors import open_segmenter
from fuse_grounding.perception.sam3 import Sam3Segmenter

needs("torch", "torchvision", "transformers")

RGB = np.random.default_rng(5).integers(0, 255, (96, 128, 3), np.uint8)
LOW = 0.05
"""Random weights are unsure of everything."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("sam3")
    write_sam3(root)
    return root


@pytest.fixture(scope="module")
def segmenter(folder: Path) -> Sam3Segmenter:
    return Sam3Segmenter(folder, threshold=LOW)


def same(a: list[Detection], b: list[Detection]) -> bool:
    return [(d.label, d.score) for d in a] == [(d.label, d.score) for d in b] and all(
        np.array_equal(x.mask, y.mask) for x, y in zip(a, b, strict=True)
    )


def test_masks_are_those_of_the_model_and_its_processor(folder: Path, segmenter: Sam3Segmenter):
    import torch
    from transformers import CLIPTokenizer, Sam3ImageProcessor, Sam3Model, Sam3Processor

    typed: Segmenter = segmenter
    found = typed.segment(RGB, ["water_bottle", "mug"])
    assert typed.labels is None
    assert {d.label for d in found} == {"water_bottle", "mug"}
    assert [d.score for d in found] == sorted((d.score for d in found), reverse=True)
    assert all(d.mask.shape == (96, 128) and d.mask.dtype == bool and d.mask.any() for d in found)
    # The long way round, picture and text together.
    model = Sam3Model.from_pretrained(folder).eval()
    pictures = Sam3ImageProcessor(size={"height": 112, "width": 112})
    processor = Sam3Processor(pictures, CLIPTokenizer.from_pretrained(folder))
    tokens = processor.tokenizer("water bottle", padding="max_length", max_length=24, return_tensors="pt")
    with torch.no_grad():
        outputs = model(**processor(images=RGB, return_tensors="pt"), **tokens)
    (expected,) = processor.post_process_instance_segmentation(outputs, LOW, target_sizes=[(96, 128)])
    scores = [d.score for d in found if d.label == "water_bottle"]
    assert scores == pytest.approx(
        sorted(
            (s for s, m in zip(expected["scores"].tolist(), expected["masks"], strict=True) if m.any()),
            reverse=True,
        ),
        abs=1e-5,
    )


def test_the_original_layout_gives_the_same_masks(tmp_path: Path, segmenter: Sam3Segmenter):
    model = sam3_model(write_tokenizer(tmp_path / "reference"))
    write_original_sam3(tmp_path / "original", model)
    expected = segmenter.segment(RGB, ["mug", "knife"])
    assert expected
    for weights in (tmp_path / "original", tmp_path / "original" / "sam3.pt"):
        assert same(Sam3Segmenter(weights, threshold=LOW).segment(RGB, ["mug", "knife"]), expected)
    # Beside safetensors, the original is not read.
    (tmp_path / "original" / "sam3.pt").rename(tmp_path / "reference" / "sam3.pt")
    model.save_pretrained(tmp_path / "reference")
    (tmp_path / "reference" / "sam3.pt").write_bytes(b"never opened")
    assert same(Sam3Segmenter(tmp_path / "reference", threshold=LOW).segment(RGB, ["mug", "knife"]), expected)


def test_the_video_model_contains_the_image_model(tmp_path: Path, folder: Path, segmenter: Sam3Segmenter):
    """What is published as `sam3` is the video model: the detector has a prefix, a tracker lies beside it."""
    from safetensors.torch import load_file, save_file
    from torch import ones

    tensors = {f"detector_model.{k}": v for k, v in load_file(folder / "model.safetensors").items()}
    write_tokenizer(tmp_path)
    save_file(
        {**tensors, "tracker_model.x": ones(2), "tracker_neck.y": ones(2)},
        tmp_path / "model.safetensors",
        metadata={"format": "pt"},
    )
    config = json.loads((folder / "config.json").read_text())
    video = {"model_type": "sam3_video", "architectures": ["Sam3VideoModel"], "detector_config": config}
    (tmp_path / "config.json").write_text(json.dumps(video))
    assert same(Sam3Segmenter(tmp_path, threshold=LOW).segment(RGB, ["mug"]), segmenter.segment(RGB, ["mug"]))


def test_a_picture_is_looked_at_once_and_a_changed_one_again(segmenter: Sam3Segmenter, monkeypatch):
    looks: list[int] = []
    looked = segmenter._model.get_vision_features

    def look(pixel_values: Any) -> Any:
        looks.append(1)
        return looked(pixel_values)

    monkeypatch.setattr(segmenter._model, "get_vision_features", look)
    picture = RGB.copy()
    first = segmenter.segment(picture, ["mug"])
    looks.clear()
    assert same(segmenter.segment(picture, ["mug", "mug"]), first)
    assert len(looks) <= 1
    looks.clear()
    picture[:48] = 0
    assert not same(segmenter.segment(picture, ["mug"]), first)
    assert len(looks) == 1


def test_labels_of_every_kind(segmenter: Sam3Segmenter):
    assert segmenter.segment(RGB, []) == []
    assert {d.label for d in segmenter.segment(RGB, ["🦊", "Messer für Käse"])} == {"🦊", "Messer für Käse"}
    many = [f"thing {i}" for i in range(200)]
    assert {d.label for d in segmenter.segment(RGB, many)} <= set(many)
    with pytest.raises(InputError, match=r"`a{50}…` \(10000 characters\) is too long for SAM3: \d+ tokens"):
        segmenter.segment(RGB, ["mug", "a" * 10_000])
    for wrong, message in (
        ([""], "must not be empty, found ''"),
        (["mug", " "], "must not be empty"),
        ("mug", "found the string `mug`"),
        ([3], "must be strings, found int"),
        (None, "found NoneType"),
    ):
        with pytest.raises(InputError, match=message):
            segmenter.segment(RGB, wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="uint8 array, found float64"):
        segmenter.segment(RGB / 255, ["mug"])


def damaged(folder: Path, tmp_path: Path, change: Any) -> Path:
    root = tmp_path / "damaged"
    shutil.copytree(folder, root)
    change(root)
    return root


def truncate(name: str, by: int = 100) -> Any:
    return lambda root: (root / name).write_bytes((root / name).read_bytes()[:-by])


def configure(**changes: Any) -> Any:
    def change(root: Path) -> None:
        config = json.loads((root / "config.json").read_text())
        (root / "config.json").write_text(json.dumps({**config, **changes}))

    return change


def wider(root: Path) -> None:
    config = json.loads((root / "config.json").read_text())
    config["detr_decoder_config"]["num_queries"] = 11
    (root / "config.json").write_text(json.dumps(config))


def deeper(root: Path) -> None:
    config = json.loads((root / "config.json").read_text())
    config["detr_encoder_config"]["num_layers"] = 3
    (root / "config.json").write_text(json.dumps(config))


def shallower(root: Path) -> None:
    config = json.loads((root / "config.json").read_text())
    config["detr_encoder_config"]["num_layers"] = 1
    (root / "config.json").write_text(json.dumps(config))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda root: (root / "tokenizer.json").unlink(),
            "has no tokenizer: expected tokenizer.json, or vocab",
        ),
        (lambda root: (root / "tokenizer.json").write_text("{}"), "the tokenizer in .* cannot be used"),
        (lambda root: (root / "model.safetensors").unlink(), "has no weights: expected model.safetensors"),
        (lambda root: (root / "config.json").unlink(), r"config\.json is missing"),
        (lambda root: (root / "config.json").write_text("{"), r"config\.json is not readable JSON"),
        (
            truncate("model.safetensors"),
            r"model\.safetensors is truncated or damaged: \d+ bytes, expected \d+",
        ),
        (lambda root: (root / "model.safetensors").write_bytes(b"x"), "truncated or not a safetensors file"),
        (configure(model_type="sam2"), "is of a model of type `sam2`, expected `sam3` or `sam3_video`"),
        (
            wider,
            r"are not the weights of SAM3: it has tensors of another model or size: detr_dec.*query",
        ),
        (deeper, r"are not the weights of SAM3: it lacks detr_encoder\.layers\.2.* and \d+ more"),
        (shallower, r"another model or size: detr_encoder\.layers\.1"),
    ],
)
def test_a_damaged_folder_is_refused_by_name(folder: Path, tmp_path: Path, change: Any, message: str):
    with pytest.raises(InputError, match=message):
        Sam3Segmenter(damaged(folder, tmp_path, change))


def test_a_damaged_original_is_refused_by_name(tmp_path: Path):
    import torch

    model = sam3_model(write_tokenizer(tmp_path / "any"))
    path = tmp_path / "o" / "sam3.pt"
    write_original_sam3(path.parent, model)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"sam3\.pt is not a PyTorch file of tensors alone"):
        Sam3Segmenter(path)

    class Harm:
        def __reduce__(self) -> Any:
            return Path.write_text, (tmp_path / "harmed", "x")

    torch.save({"model": Harm()}, path)
    with pytest.raises(InputError, match=r"tensors alone \(weights_only=True\)"):
        Sam3Segmenter(path)
    assert not (tmp_path / "harmed").exists()
    for content in ({"model": {"a": 1}}, [1, 2]):
        torch.save(content, path)
        with pytest.raises(InputError, match=r"sam3\.pt does not hold named tensors"):
            Sam3Segmenter(path)
    torch.save({"model": {"image_encoder.neck.0.weight": torch.ones(3)}}, path)
    with pytest.raises(
        InputError, match=r"sam3\.pt are not the weights of SAM3: it lacks detector\.backbone"
    ):
        Sam3Segmenter(path)


def test_the_door_needs_a_folder_and_a_device_that_is_there(folder: Path, tmp_path: Path):
    import torch

    with pytest.raises(
        InputError, match=r"segmenter `sam3` needs a checkpoint folder .* `segmenter\.weights`"
    ):
        open_segmenter(SegmenterConfig(name="sam3"))
    with pytest.raises(InputError, match=r"nowhere \(`segmenter\.weights`\) does not exist"):
        open_segmenter(SegmenterConfig(name="sam3", weights=tmp_path / "nowhere"))
    clip = tmp_path / "clip"
    write_clip(clip)
    with pytest.raises(InputError, match="of type `clip`, expected `sam3`"):
        open_segmenter(SegmenterConfig(name="sam3", weights=clip))
    opened = open_segmenter(SegmenterConfig(name="sam3", weights=folder, threshold=LOW))
    assert {p.name for p in opened.files} == {"model.safetensors", "config.json", "tokenizer.json"}
    assert opened.device == "cpu (torch)"
    assert set(opened.packages) == {"torch", "torchvision", "transformers"}
    assert opened.part.segment(RGB, ["mug"])
    if not torch.cuda.is_available():
        with pytest.raises(
            InputError, match=r"`segmenter\.device` is `cuda`, and torch finds no CUDA device"
        ):
            open_segmenter(SegmenterConfig(name="sam3", weights=folder, device="cuda"))
