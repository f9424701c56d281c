"""CLIP as encoder and as patch-level evidence, from transformers' folders and from ONNX files."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_checkpoints import LONGEST, SIDE, WIDTH, needs, write_clip, write_onnx_clip, write_tokenizer

from fuse_grounding.config import EncoderConfig, SegmenterConfig
from fuse_grounding.errors import InputError
from fuse_grounding.perception import Encoder
from fuse_grounding.perception.doors import open_encoder, open_segmenter
from fuse_grounding.perception.patches import PatchSegmenter

DOCS = Path(__file__).resolve().parents[2] / "docs" / "models" / "doors.md"
RGB = np.random.default_rng(5).integers(0, 255, (96, 128, 3), np.uint8)
LONG = "a" * 10_000


@pytest.fixture(params=["transformers", "onnx"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == "onnx":
        write_onnx_clip(tmp_path)
    else:
        write_clip(tmp_path)
    return tmp_path


def opened(folder: Path) -> Encoder:
    encoder: Any = open_encoder(EncoderConfig(name="clip", weights=folder)).part
    return encoder


def test_vectors_are_of_length_one_and_repeat(folder: Path):
    encoder = opened(folder)
    image, patches, text = encoder.image(RGB), encoder.patches(RGB), encoder.text(["a mug", "a 🦊", "a mug"])
    assert (image.shape, patches.shape, text.shape) == ((WIDTH,), (4, 4, WIDTH), (3, WIDTH))
    for vectors in (image, patches, text):
        assert vectors.dtype == np.float32
        assert np.linalg.norm(vectors, axis=-1) == pytest.approx(1, abs=1e-5)
    assert np.array_equal(text[0], text[2])
    assert not np.allclose(text[0], text[1])
    assert np.array_equal(opened(folder).patches(RGB), patches)
    assert encoder.text([]).shape[0] == 0
    with pytest.raises(InputError, match=r"`a{50}…` \(10000 characters\) is too long for CLIP: \d+ tokens"):
        encoder.text(["mug", LONG])
    with pytest.raises(InputError, match="must not be empty"):
        encoder.text([" "])
    for look in (encoder.image, encoder.patches):
        with pytest.raises(InputError, match="uint8 array, found float64"):
            look(RGB / 255)


def test_transformers_own_methods_give_the_same(tmp_path: Path):
    model = write_clip(tmp_path)
    import torch
    from transformers import CLIPImageProcessor, CLIPTokenizer

    encoder = opened(tmp_path)
    square = RGB[:SIDE, :SIDE]  # nothing to resize: the pixels must be the same
    pictures = CLIPImageProcessor(size={"height": SIDE, "width": SIDE}, do_center_crop=False)
    with torch.no_grad():
        pixels = pictures(square, return_tensors="pt")["pixel_values"]
        image = model.visual_projection(model.vision_model(pixel_values=pixels).pooler_output)[0].numpy()
        tokens = CLIPTokenizer.from_pretrained(tmp_path)(["a water bottle"], return_tensors="pt")
        text = model.text_projection(model.text_model(input_ids=tokens["input_ids"]).pooler_output)[0].numpy()
    assert encoder.image(square) == pytest.approx(image / np.linalg.norm(image), abs=1e-5)
    assert encoder.text(["a water bottle"])[0] == pytest.approx(text / np.linalg.norm(text), abs=1e-5)


def test_the_export_of_the_documentation_gives_the_same_vectors(tmp_path: Path, monkeypatch: Any):
    needs("torch", "transformers", "onnx", "onnxscript")
    write_clip(tmp_path / "clip")
    monkeypatch.chdir(tmp_path)
    (script,) = (
        s for s in re.findall(r"```python\n(.*?)```", DOCS.read_text(), re.S) if "torch.onnx.export" in s
    )
    exec(compile(script, str(DOCS), "exec"), {"__name__": "export"})
    ours, theirs = opened(tmp_path / "clip"), opened(tmp_path / "clip-onnx")
    assert theirs.image(RGB) == pytest.approx(ours.image(RGB), abs=1e-4)
    assert theirs.patches(RGB) == pytest.approx(ours.patches(RGB), abs=1e-4)
    texts = ["a mug", "a photo of a water bottle", "🦊"]
    assert theirs.text(texts) == pytest.approx(ours.text(texts), abs=1e-4)


class Painted:
    """An encoder whose patches say where the knife is: four by four, the knife in the upper left corner."""

    name = "painted"
    words = ("knife", "fork")

    def text(self, texts: Any) -> np.ndarray:
        return np.array(
            [
                [*(float(w in t) for w in self.words), float("knife" not in t and "fork" not in t)]
                for t in texts
            ],
            np.float32,
        )

    def image(self, rgb: np.ndarray) -> np.ndarray:
        return np.array([0, 0, 1], np.float32)

    def patches(self, rgb: np.ndarray) -> np.ndarray:
        grid = np.tile(np.array([0, 0, 1], np.float32), (4, 4, 1))
        grid[:2, :2] = grid[3, 3] = [1, 0, 0]
        return grid


def test_patch_evidence_by_hand():
    typed: Encoder = Painted()
    found = PatchSegmenter(typed).segment(np.zeros((80, 160, 3), np.uint8), ["fork", "knife"])
    assert [d.label for d in found] == ["knife", "knife"]
    large, small = sorted(found, key=lambda d: -d.mask.sum())
    assert large.mask[:40, :80].mean() > 0.95
    assert not large.mask[45:].any()
    assert small.mask[70:, 130:].all()
    assert all(0.5 <= d.score <= 1 for d in found)

    # One patch against four texts of background: exp(100 * 0.5) each against exp(100 * 0.49).
    class Unsure(Painted):
        def patches(self, rgb: np.ndarray) -> np.ndarray:
            return np.tile(np.array([0.49, 0, 0.5], np.float32), (2, 2, 1))

    expected = np.exp(49) / (np.exp(49) + 4 * np.exp(50))
    assert PatchSegmenter(Unsure()).maps(np.zeros((32, 32, 3), np.uint8), ["knife"]) == pytest.approx(
        expected, rel=1e-4
    )


def test_patch_evidence_through_the_door(folder: Path):
    opened_ = open_segmenter(SegmenterConfig(name="clip_patches", weights=folder, threshold=0.0))
    segmenter = opened_.part
    assert segmenter.labels is None
    found = segmenter.segment(RGB, ["mug", "water_bottle"])
    assert sorted(d.label for d in found) == ["mug", "water_bottle"]
    assert all(d.mask.shape == (96, 128) and d.mask.dtype == bool and d.mask.all() for d in found)
    assert found[0].score >= found[1].score
    assert segmenter.segment(RGB, []) == []
    many = [f"thing {i}" for i in range(200)]
    assert {d.label for d in segmenter.segment(RGB, many)} == set(many)
    assert [d.label for d in segmenter.segment(RGB, ["mug"] * 200)] == ["mug"]
    for label in ("🦊", "👩‍🍳", "刀", "Knife", "a\nb", "{}"):
        assert [d.label for d in segmenter.segment(RGB, [label, label])] == [label]
    said = r"the text `a photo of a a{37}…` \(10013 characters\) is too long for CLIP: \d+ tokens, it reads "
    with pytest.raises(InputError, match=f"{said}{LONGEST}"):
        segmenter.segment(RGB, [*many, LONG])
    for wrong, message in (
        (["mug", ""], "labels must not be empty, found ''"),
        (["mug", None], "labels must be strings, found NoneType"),
        (7, "labels must be a sequence of strings, found int"),
        (LONG, r"found the string `a{50}…` \(10000 characters\)"),
    ):
        with pytest.raises(InputError, match=message):
            segmenter.segment(RGB, wrong)  # type: ignore[arg-type]
    sure = open_segmenter(SegmenterConfig(name="clip_patches", weights=folder, threshold=1.0)).part
    assert sure.segment(RGB, ["mug"]) == []


def test_what_is_missing_or_foreign_in_an_onnx_folder_is_named(tmp_path: Path):
    write_onnx_clip(tmp_path)
    config = EncoderConfig(name="clip", weights=tmp_path)
    kept = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert open_encoder(config).device == "cpu (ONNX Runtime)"
    for name, content, message in [
        ("tokenizer.json", None, r"tokenizer\.json is missing"),
        ("tokenizer.json", b"{}", r"tokenizer\.json is not a tokenizer"),
        ("text.onnx", None, r"text\.onnx is missing"),
        ("text.onnx", kept["text.onnx"][:100], r"text\.onnx is not a usable ONNX file"),
        ("image.onnx", b"junk", r"image\.onnx is not a usable ONNX file"),
        (
            "image.onnx",
            kept["text.onnx"],
            r"image\.onnx is another network: it takes input_ids and gives text_embeds, expected",
        ),
    ]:
        if content is None:
            (tmp_path / name).unlink()
        else:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=message):
            open_encoder(config)
        (tmp_path / name).write_bytes(kept[name])
    with pytest.raises(InputError, match=r"encoder\.device is `cuda`, and CLIP in ONNX runs on the CPU"):
        open_encoder(EncoderConfig(name="clip", weights=tmp_path, device="cuda"))
    (tmp_path / "preprocessor_config.json").write_text('{"image_mean": [1, 2]}')
    with pytest.raises(
        InputError, match=r"preprocessor_config\.json: image_mean and image_std must be three"
    ):
        open_encoder(config)


def test_what_is_missing_or_foreign_in_a_transformers_folder_is_named(tmp_path: Path):
    write_clip(tmp_path)
    config = SegmenterConfig(name="clip_patches", weights=tmp_path)
    text = (tmp_path / "config.json").read_text()
    (tmp_path / "config.json").write_text(text.replace('"model_type": "clip",', '"model_type": "siglip",'))
    with pytest.raises(InputError, match="of type `siglip`, expected `clip`"):
        open_segmenter(config)
    changed = json.loads(text)
    changed["vision_config"]["hidden_size"] = 48
    (tmp_path / "config.json").write_text(json.dumps(changed))
    with pytest.raises(
        InputError, match=r"model\.safetensors are not the weights of CLIP: it has tensors of"
    ):
        open_segmenter(config)
    (tmp_path / "config.json").write_text(text)
    (tmp_path / "tokenizer.json").unlink()
    with pytest.raises(InputError, match="has no tokenizer"):
        open_segmenter(config)
    write_tokenizer(tmp_path, "vocab.json")  # the other way to write one
    assert open_segmenter(config).part.segment(RGB, ["mug"]) is not None
    with pytest.raises(InputError, match="encoder `clip` needs a checkpoint folder"):
        open_encoder(EncoderConfig(name="clip"))


def test_a_pickle_is_read_where_there_are_no_safetensors_and_runs_no_code(tmp_path: Path):
    model = write_clip(tmp_path)
    import torch

    expected = opened(tmp_path).image(RGB)
    (tmp_path / "model.safetensors").unlink()
    torch.save(model.state_dict(), tmp_path / "pytorch_model.bin")
    assert np.array_equal(opened(tmp_path).image(RGB), expected)

    class Harm:
        def __reduce__(self) -> Any:
            return Path.write_text, (tmp_path / "harmed", "x")

    torch.save({"a": Harm()}, tmp_path / "pytorch_model.bin")
    with pytest.raises(InputError, match=r"pytorch_model\.bin cannot be loaded"):
        opened(tmp_path)
    assert not (tmp_path / "harmed").exists()
