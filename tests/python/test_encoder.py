"""The embedded encoder: text, pictures, patches; its files; its training."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_networks import SIZE, write_encoder

from fuse_grounding import _core, tensors
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.perception.embedded_encoder import DEFAULT_PATH, TEXT_KIND, EmbeddedEncoder, TextTable
from fuse_grounding.perception.patches import CLIP, Manner, PatchSegmenter
from fuse_grounding.perception.protocol import Encoder
from fuse_grounding.perception.wordpiece import WordPiece, words

# Words that are no label, with the labels that a reasonable person might take them for. Written down
# before any encoder had seen them.
KIN = {
    "cutter": "knife scissors box_cutter butter_knife",
    "cup": "mug measuring_cup wine_glass",
    "glass": "wine_glass mug water_bottle",
    "goblet": "wine_glass mug",
    "dish": "plate bowl tray",
    "saucer": "plate bowl tray mug",
    "jug": "pitcher water_bottle teapot mug",
    "kettle": "teapot pitcher",
    "flask": "water_bottle pitcher mug",
    "thermos": "water_bottle mug teapot",
    "torch": "flashlight candle",
    "lamp": "flashlight candle",
    "lantern": "flashlight candle",
    "strainer": "sieve colander",
    "sifter": "sieve colander",
    "dagger": "knife box_cutter butter_knife",
    "razor": "box_cutter knife scissors",
    "blade": "knife box_cutter scissors butter_knife",
    "shears": "scissors",
    "pincers": "pliers tongs",
    "tweezers": "tongs pliers scissors",
    "spanner": "wrench pliers screwdriver",
    "sledgehammer": "hammer mallet",
    "gavel": "mallet hammer",
    "crayon": "pencil marker pen",
    "ballpoint": "pen pencil marker",
    "highlighter": "marker pen",
    "rubber": "eraser",
    "notebook": "book",
    "novel": "book",
    "magazine": "book",
    "cloth": "towel sponge",
    "napkin": "towel plate",
    "washcloth": "towel sponge",
    "mop": "sponge towel scrub_brush",
    "yardstick": "ruler tape_measure",
    "beater": "whisk mallet hammer",
    "platter": "tray plate",
    "tin": "can",
    "paperclip": "binder_clip stapler",
    "skewer": "fork chopsticks knife",
    "cleaver": "knife box_cutter",
    "turner": "spatula",
    "candlestick": "candle",
    "duct tape": "tape_dispenser tape_measure",
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_encoder(tmp_path_factory.mktemp("encoder"))


@pytest.fixture(scope="module")
def encoder(files: Path) -> EmbeddedEncoder:
    return EmbeddedEncoder(files)


def copied(files: Path, folder: Path) -> Path:
    for suffix in (".onnx", ".json", ".safetensors"):
        (folder / f"copy{suffix}").write_bytes(files.with_suffix(suffix).read_bytes())
    return folder / "copy.onnx"


def picture(seed: int = 0, shape: tuple[int, int] = (480, 640)) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (*shape, 3), np.uint8)


# -- words ------------------------------------------------------------------------------------------


def test_words_are_cut_as_in_bert():
    assert words("Butter_Knife") == ["butter", "knife"]
    assert words("  Café\tau-lait!") == ["cafe", "au", "-", "lait", "!"]
    assert words("刀2") == ["刀", "2"]
    assert words("a\u200bb\x00c") == ["abc"]
    assert words(" \n") == []


def test_the_longest_pieces_are_taken_and_phrases_come_first():
    vocabulary = ["[UNK]", "spat", "##ula", "##u", "water", "bottle", "water bottle", "wat"]
    cut = WordPiece(vocabulary)

    def pieces(text: str) -> list[str]:
        return [vocabulary[i] for i in cut.ids(text)]

    assert pieces("spatula") == ["spat", "##ula"]
    assert pieces("spatux") == ["[UNK]"]
    assert pieces("the water_bottle") == ["[UNK]", "water bottle"]
    assert pieces("water spatula") == ["water", "spat", "##ula"]
    assert pieces("x" * 10_000) == ["[UNK]"]
    assert len(cut.ids("water " * 10_000)) == 64


# -- the encoder at run time --------------------------------------------------------------------------


def test_texts_and_pictures_are_unit_vectors_of_one_space(encoder: EmbeddedEncoder):
    typed: Encoder = encoder
    rgb = picture()
    texts = typed.text(["knife", "water_bottle", "🔪", "x" * 10_000, "a knife"] * 40)
    assert texts.shape == (200, encoder.dimensions)
    assert texts.dtype == np.float32
    image, patches = typed.image(rgb), typed.patches(rgb)
    assert image.shape == (512,)
    assert patches.shape == (SIZE[1] // 16, SIZE[0] // 16, 512)
    for vectors in (texts, image, patches):
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=-1), 1.0, atol=2e-6)
    # A phrase of the vocabulary is not the sum of its words.
    water, bottle, both = typed.text(["water", "bottle", "water bottle"])
    assert abs(float(both @ (water + bottle)) / np.linalg.norm(water + bottle)) < 0.99


@pytest.mark.parametrize(("shape", "seen"), [((480, 640), (4, 6)), ((100, 400), (2, 6)), ((333, 37), (4, 1))])
def test_any_picture_is_shown_whole_and_patches_cover_it(
    encoder: EmbeddedEncoder, shape: tuple[int, int], seen: tuple[int, int]
):
    assert encoder.patches(picture(0, shape)).shape[:2] == seen


def test_a_changed_picture_is_seen_and_what_is_handed_out_is_the_callers(encoder: EmbeddedEncoder):
    rgb = picture(1)
    first = encoder.image(rgb)
    expected = first.copy()
    first[:] = 0
    np.testing.assert_array_equal(encoder.image(rgb), expected)
    rgb[:240] = (255, 0, 0)
    assert not np.allclose(encoder.image(rgb), expected, atol=1e-3)


def test_wrong_arguments_of_the_encoder_are_named(encoder: EmbeddedEncoder):
    assert encoder.text([]).shape == (0, 512)
    with pytest.raises(InputError, match="found the string `knife`"):
        encoder.text("knife")
    with pytest.raises(InputError, match="the text `\u200b` has no visible character"):
        encoder.text(["knife", "\u200b"])
    with pytest.raises(InputError, match="texts must not be empty, found ' '"):
        encoder.text(["knife", " "])
    with pytest.raises(InputError, match="texts must be strings, found int"):
        encoder.text([3])  # type: ignore[list-item]
    with pytest.raises(InputError, match=r"found float64 array of shape \(480, 640, 3\)"):
        encoder.image(picture() / 255.0)
    with pytest.raises(InputError, match="at least 32 pixels"):
        encoder.patches(picture(0, (8, 640)))
    with pytest.raises(InputError, match="threads must be"):
        EmbeddedEncoder(encoder.path, threads=0)


def test_damaged_files_of_the_encoder_are_refused_by_name(files: Path, tmp_path: Path):
    with pytest.raises(InputError, match=r"cannot read the encoder's file .*none\.onnx"):
        EmbeddedEncoder(tmp_path / "none.onnx")
    for suffix in (".onnx", ".safetensors"):
        copy = copied(files, tmp_path).with_suffix(suffix)
        copy.write_bytes(copy.read_bytes()[:-7])
        with pytest.raises(InputError, match=rf"copy\{suffix} is damaged or not the file that copy\.json"):
            EmbeddedEncoder(copy.with_suffix(".onnx"))
    copy = copied(files, tmp_path)
    settings = copy.with_suffix(".json").read_text()
    for broken in (settings[:50], "{}", "[]", settings.replace('"schema_version": 1', '"schema_version": 9')):
        copy.with_suffix(".json").write_text(broken)
        with pytest.raises(InputError, match=r"copy\.json"):
            EmbeddedEncoder(copy)


def resigned(copy: Path, name: str, content: bytes) -> None:
    """Puts other bytes in, with their right hash: only a look inside tells."""
    import hashlib

    suffix = {"network": ".onnx", "text": ".safetensors"}[name]
    copy.with_suffix(suffix).write_bytes(content)
    settings = json.loads(copy.with_suffix(".json").read_text())
    settings["sha256"][name] = hashlib.sha256(content).hexdigest()
    copy.with_suffix(".json").write_text(json.dumps(settings))


def test_foreign_files_of_the_encoder_are_refused(files: Path, tmp_path: Path):
    from fuse_grounding.perception.embedded import DEFAULT_PATH as SEGMENTER

    copy = copied(files, tmp_path)
    resigned(copy, "network", SEGMENTER.read_bytes())
    with pytest.raises(InputError, match=r"copy\.onnx is another network: it takes"):
        EmbeddedEncoder(copy)
    resigned(copy, "network", b"not onnx")
    with pytest.raises(InputError, match=r"copy\.onnx is not a usable ONNX file"):
        EmbeddedEncoder(copy)
    copy = copied(files, tmp_path)
    text = files.with_suffix(".safetensors").read_bytes()
    other = tensors.encode("something", 1, {"a": np.zeros(3)}, {})
    newer = tensors.encode(TEXT_KIND, 7, {"a": np.zeros(3)}, {})
    short = tensors.encode(TEXT_KIND, 1, {"vocabulary": np.zeros(3, np.uint8)}, {})
    for content, sentence in (
        (text[:-9], "not a sound safetensors file"),
        (b"", "not a sound safetensors file"),
        (other, "holds no text table: its kind is `something`"),
        (newer, "has schema version 7, expected 1"),
        (short, "lacks the array `table`"),
    ):
        resigned(copy, "text", content)
        with pytest.raises(InputError, match=sentence):
            EmbeddedEncoder(copy)


def test_a_full_disk_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    import os

    def full(*_: Any) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FuseError, match=r"f\.safetensors cannot be written: No space left on device"):
        tensors.save(tmp_path / "f.safetensors", "kind", 1, {"a": np.zeros(3)}, {})
    assert list(tmp_path.iterdir()) == []


def test_tensors_are_the_same_bytes_whatever_the_order(tmp_path: Path):
    one: dict[str, np.ndarray] = {"b": np.arange(6).reshape(2, 3), "a": np.zeros(2, np.float16)}
    assert tensors.encode("k", 1, one, {"x": 1}) == tensors.encode(
        "k", 1, dict(reversed(one.items())), {"x": 1}
    )
    tensors.save(tmp_path / "t", "k", 1, {"turned": one["b"].T}, {"x": 1})
    arrays, note = tensors.load(tmp_path / "t", "k", 1)
    np.testing.assert_array_equal(arrays["turned"], one["b"].T)
    assert note == {"x": 1}


# -- evidence from patches ----------------------------------------------------------------------------


class Colours:
    """Patches of 40×40 pixels by colour: red is a knife, blue a mug, anything else background."""

    name = "colours"

    def image(self, rgb: np.ndarray) -> np.ndarray:
        return np.array([1, 0, 0], np.float32)

    def text(self, labels: Any) -> np.ndarray:
        table = {"knife": (1, 0, 0), "mug": (0, 1, 0)}
        return np.array([table.get(label, (0, 0, 1)) for label in labels], np.float32)

    def patches(self, rgb: np.ndarray) -> np.ndarray:
        cells = rgb[20::40, 20::40].astype(np.float32)
        plain = 255.0 - np.maximum(cells[..., 0], cells[..., 2])
        found = np.stack([cells[..., 0], cells[..., 2], plain], 2)
        return found / np.linalg.norm(found, axis=2, keepdims=True)


def test_patches_become_regions_of_the_prompted_label():
    rgb = np.zeros((480, 640, 3), np.uint8)
    rgb[80:160, 80:240] = (255, 0, 0)
    rgb[280:360, 400:480] = (255, 0, 0)
    rgb[80:160, 400:560] = (0, 0, 255)
    manner = Manner("{}", ("knife", "mug", "background"), 10.0, 0.35)
    segmenter = PatchSegmenter(Colours(), manner)
    found = segmenter.segment(rgb, ["knife"])
    assert [d.label for d in found] == ["knife", "knife"]
    assert all(0.35 < d.score <= 1.0 for d in found)
    assert found[0].score >= found[1].score
    truth = rgb[..., 0] > 0
    union = found[0].mask | found[1].mask
    assert np.count_nonzero(union & truth) / np.count_nonzero(union | truth) > 0.7
    assert not any(d.mask[120, 480] for d in found)
    assert segmenter.segment(rgb, []) == []
    with pytest.raises(InputError, match="found the string"):
        segmenter.segment(rgb, "knife")
    with pytest.raises(InputError, match="contrast is empty"):
        PatchSegmenter(Colours(), replace(CLIP, contrast=()))


def test_embedded_patches_is_a_segmenter_of_the_configuration(files: Path):
    from fuse_grounding.config import SegmenterConfig
    from fuse_grounding.perception.doors import open_segmenter

    opened = open_segmenter(SegmenterConfig(name="embedded_patches", weights=files, threshold=0.0))
    assert opened.files == (files, files.with_suffix(".safetensors"), files.with_suffix(".json"))
    assert opened.part.labels is None
    found = opened.part.segment(picture(), ["knife", "spanner"])
    assert sorted(d.label for d in found) == ["knife", "spanner"]
    assert all(d.mask.shape == (480, 640) for d in found)


def test_auto_is_the_embedded_encoder_where_there_are_weights_and_letters_elsewhere(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    from fuse_grounding.assembly import assemble
    from fuse_grounding.config import Config
    from fuse_grounding.perception import embedded_encoder

    config = Config().with_(method="static", knowledge={"open_vocabulary": "nearest"})
    monkeypatch.setattr(embedded_encoder, "DEFAULT_PATH", tmp_path / "encoder.onnx")
    parts, taken = assemble(config)
    assert taken.encoder.name == "lexical"
    assert set(parts.provenance["sha256"]) == {"segmenter"}
    assert [a for a in parts.announcements if "compared by letters (`lexical`)" in a]
    quiet, _ = assemble(config.with_(knowledge={"open_vocabulary": "leave_out"}))
    assert not [a for a in quiet.announcements if "lexical" in a]
    parts, taken = assemble(config.with_(encoder={"weights": str(files)}))
    assert taken.encoder.name == "embedded"
    assert set(parts.provenance["sha256"]) == {"segmenter", "encoder"}
    assert not [a for a in parts.announcements if "lexical" in a]
    copied(files, tmp_path)
    for suffix in (".onnx", ".json", ".safetensors"):
        (tmp_path / f"copy{suffix}").rename(tmp_path / f"encoder{suffix}")
    assert assemble(config)[1].encoder.name == "embedded"
    (tmp_path / "encoder.safetensors").unlink()
    with pytest.raises(InputError, match=r"encoder\.safetensors is missing"):
        assemble(config)
    with pytest.raises(InputError, match=r"encoder\.weights .* is not for `lexical`, which has none"):
        assemble(config.with_(encoder={"name": "lexical", "weights": str(files)}))


# -- training -----------------------------------------------------------------------------------------


class Blocks:
    """Pictures of one coloured block each: label 0 is red, 1 green; background is grey noise."""

    def __len__(self) -> int:
        return 8

    def __getitem__(self, index: int) -> Any:
        rng = np.random.default_rng(index)
        rgb = rng.integers(100, 140, (96, 128, 3), np.uint8)
        ids = np.zeros((96, 128), np.uint8)
        x, y = int(rng.integers(0, 80)), int(rng.integers(0, 56))
        ids[y : y + 36, x : x + 44] = 5
        label = index % 2
        rgb[ids == 5] = (220, 30, 30) if label == 0 else (30, 200, 30)
        table = np.full(256, 2, np.int64)
        table[5] = label
        return (rgb, ids, [{"id": 5, "category": "red", "visible_px": 1584, "unoccluded_px": 1584}]), table


def test_a_sample_says_what_is_where():
    from fuse_grounding.training.encoder_data import IGNORED, targets

    kinds = np.full((96, 128), 2, np.int64)
    kinds[0:32, 0:32] = 0  # upper left cell, four whole patches
    kinds[80:96, 96:100] = 1  # a quarter of one patch, in the lower right cell
    sample = targets(np.zeros((96, 128, 3), np.uint8), kinds, None, 2)
    assert (sample.patches[:2, :2] == 0).all()
    assert sample.patches[5, 6] == IGNORED
    assert sample.patches[3, 3] == 2
    np.testing.assert_allclose(sample.present, np.array([32.0, 8.0]) / 40.0, rtol=1e-6)
    assert np.argwhere(sample.cells).tolist() == [[0, 0], [11, 1]]
    about = targets(np.zeros((96, 128, 3), np.uint8), kinds, 1, 2)
    np.testing.assert_allclose(about.present, [0.2, 0.8], rtol=1e-6)
    nothing = targets(np.zeros((96, 128, 3), np.uint8), np.full((96, 128), 2), None, 2)
    assert nothing.present.sum() == 0


def test_a_killed_training_resumes_to_the_same_bits(tmp_path: Path):
    torch = pytest.importorskip("torch")
    from fuse_grounding.training import encoder as training
    from fuse_grounding.training import loop

    config = training.TrainConfig(steps=4, batch=2, size=(128, 96), warmup=2, pretrained=False)
    phrases = np.eye(3, 128, dtype=np.float32)[None].repeat(2, 0)
    pictures: Any = Blocks()
    lines: list[str] = []

    def run(out: Path, stop_at: int | None = None) -> Any:
        made = training.Training(("red", "green"), phrases, config)
        make = training.batches(pictures, 2, config)
        loop.train(made, make, stop_at or config.steps, out, "encoder", lines.append)
        return made

    whole = run(tmp_path / "whole")
    run(tmp_path / "parts", 2)
    resumed = run(tmp_path / "parts")
    assert resumed.step == whole.step == 4
    assert "resumed at step 2" in "".join(lines)
    for (name, a), b in zip(whole.net.state_dict().items(), resumed.net.state_dict().values(), strict=True):
        assert torch.equal(a, b), name
    assert all(torch.equal(whole.average.weights[k], v) for k, v in resumed.average.weights.items())
    checkpoint = tmp_path / "parts" / "encoder.pt"
    state = loop.load(checkpoint, {"step"})
    with pytest.raises(InputError, match=r"encoder\.pt was trained for other labels: red, blue"):
        whole.restore({**state, "labels": ["red", "blue"]}, checkpoint)
    with pytest.raises(InputError, match="was trained with steps 99, not 4"):
        whole.restore({**state, "config": {**state["config"], "steps": 99}}, checkpoint)
    checkpoint.write_bytes(checkpoint.read_bytes()[:1000])
    with pytest.raises(InputError, match=r"encoder\.pt is not a checkpoint"):
        run(tmp_path / "parts")


def test_an_exported_network_says_what_the_trained_one_says(tmp_path: Path, files: Path):
    torch = pytest.importorskip("torch")
    pytest.importorskip("onnx")
    from fuse_grounding.training import encoder_export as export
    from fuse_grounding.training.encoder_model import INNER, EncoderNet, rotation

    q = rotation()
    np.testing.assert_allclose(q.T @ q, np.eye(512), atol=1e-5)
    torch.manual_seed(0)
    net = EncoderNet(2)
    net.standardize(torch.randn(1, 3, 96, 128))
    pieces = ["[UNK]", "red", "green"]
    table = export.text_table(pieces, np.random.default_rng(0).standard_normal((3, INNER)).astype(np.float32))
    export.write(tmp_path / "e.onnx", net.eval(), table, ("red", "green"), (128, 96), "background", {})
    encoder = EmbeddedEncoder(tmp_path / "e.onnx")
    rgb = picture(3, (96, 128))
    with torch.no_grad():
        x = (torch.from_numpy(rgb).permute(2, 0, 1)[None].float() - 127) / 128
        views = net(x)
    what = views.pooled[0].numpy() @ q[:, :INNER].T
    np.testing.assert_allclose(encoder.image(rgb) @ what, 0.6**0.5, atol=5e-3)  # weights are halved
    np.testing.assert_allclose(
        encoder.patches(rgb) @ q[:, :INNER], views.semantic[0].permute(1, 2, 0).numpy(), atol=2e-2
    )
    # What is in the picture and where it is do not mix: texts see the first alone.
    where = views.layout[0].numpy() @ q[:, INNER:].T
    assert abs(float(encoder.text(["red"])[0] @ where)) < 1e-4


# -- what ships ---------------------------------------------------------------------------------------


def test_the_shipped_encoder_knows_labels_and_their_kin():
    labels = [name for name, _ in _core.object_categories()]
    text = TextTable(DEFAULT_PATH.with_suffix(".safetensors"))
    similarity = text(list(KIN)) @ text(labels).T
    nearest = [labels[i] for i in similarity.argmax(1)]
    right = [label in kin.split() for label, kin in zip(nearest, KIN.values(), strict=True)]
    assert sum(right) >= 0.55 * len(KIN)  # about one in twenty by chance
    files = [DEFAULT_PATH.with_suffix(s) for s in (".onnx", ".safetensors", ".json")]
    assert files[0].stat().st_size <= 8e6
    assert files[1].stat().st_size <= 6e6


def test_the_shipped_encoder_finds_the_label_of_what_it_never_saw():
    from fuse_grounding.training.encoder_score import evaluate

    labels = [name for name, _ in _core.object_categories()]
    score = evaluate(EmbeddedEncoder(), _core.randomized_pictures(78, 8, split="dev"), labels)
    assert len(score.crops) >= 30
    assert score.top(5) > 0.3  # 0.11 by chance
    assert score.mean_rank() < 15  # 23 by chance


def test_training_can_start_from_a_segmenters_backbone():
    torch = pytest.importorskip("torch")
    pytest.importorskip("onnx")
    from fuse_grounding.perception.embedded import DEFAULT_PATH
    from fuse_grounding.training import encoder as training
    from fuse_grounding.training import onnx_files

    config = training.TrainConfig(pretrained=False, start="its hash")
    phrases = np.eye(3, 128, dtype=np.float32)[None]
    made = training.Training(("red", "green"), phrases, config, DEFAULT_PATH)
    known, name = onnx_files.weights(DEFAULT_PATH), "backbone.blocks.9.expand.conv.weight"
    for net in (made.net.state_dict(), made.average.weights, made.averaged().state_dict()):
        assert torch.equal(net[name], known[name])


def test_training_refuses_to_start_from_a_file_without_that_backbone(tmp_path: Path):
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    from fuse_grounding.perception.embedded import DEFAULT_PATH, crops_path
    from fuse_grounding.training import encoder as training

    config = training.TrainConfig(pretrained=False, start="its hash")
    phrases = np.eye(3, 128, dtype=np.float32)[None]
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(DEFAULT_PATH.read_bytes()[:5000])
    cases = [
        (broken, r"broken\.onnx is not an ONNX file"),
        (tmp_path / "none.onnx", r"none\.onnx cannot be read: No such file"),
        (crops_path(DEFAULT_PATH), r"segmenter_crops\.onnx has no backbone of a segmenter"),
    ]
    for path, message in cases:
        with pytest.raises(InputError, match=message):
            training.Training(("red", "green"), phrases, config, path)
