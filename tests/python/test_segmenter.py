import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from fuse_grounding import _core
from fuse_grounding.errors import InputError
from fuse_grounding.perception import EmbeddedSegmenter, Segmenter, crops
from fuse_grounding.perception.embedded import DEFAULT_PATH, crops_path
from fuse_grounding.training import segmenter_data as data
from fuse_grounding.training.segmenter_score import calibration_error, evaluate, isotonic

LABELS = ("a_ball", "a_box")


@pytest.fixture(scope="module")
def segmenter() -> EmbeddedSegmenter:
    return EmbeddedSegmenter()


@pytest.fixture(scope="module")
def pictures() -> list[data.Picture]:
    """Objects and surfaces of the development range: the network never saw their like."""
    known = EmbeddedSegmenter().labels
    return [
        (rgb, ids, [o for o in objects if o["category"] in known])
        for rgb, ids, objects in _core.randomized_pictures(77, 48, split="dev", amodal=True)
    ]


def test_finds_what_it_never_saw_and_its_scores_mean_something(segmenter, pictures):
    typed: Segmenter = segmenter
    assert set(typed.labels or ()) <= {name for name, _ in _core.object_categories()}
    score = evaluate(segmenter, pictures, 0.05)
    plain = score.select(visible=0.8, pixels=1500)
    assert len(plain) >= 40
    assert np.mean([o.returned_iou for o in plain]) > 0.7
    assert np.mean([o.first_label == o.category for o in plain]) > 0.65
    scores, right = np.array(score.scores), np.array(score.right)
    sure, unsure = right[scores >= 0.8].mean(), right[scores < 0.3].mean()
    assert sure > 0.75 > 0.3 > unsure
    assert calibration_error(scores, right) < 0.12


def test_only_prompted_labels_come_back_best_first_at_full_size(segmenter, pictures):
    rgb = pictures[0][0]
    everything = segmenter.segment(rgb, segmenter.labels)
    assert everything == sorted(everything, key=lambda d: -d.score)
    assert all(d.mask.shape == (480, 640) and d.mask.dtype == bool and d.mask.any() for d in everything)
    assert all(0.0 <= d.score <= 1.0 for d in everything)
    label = everything[0].label
    alone = segmenter.segment(rgb, [label, label])
    assert [d.score for d in alone] == [d.score for d in everything if d.label == label]
    assert segmenter.segment(rgb, []) == []
    # What a caller does with a mask must not reach the remembered result.
    with pytest.raises(ValueError, match="read-only"):
        alone[0].mask[:] = False


def test_two_instances_agree_bit_for_bit_and_a_changed_picture_is_seen(segmenter, pictures):
    rgb = pictures[1][0].copy()
    first = segmenter.segment(rgb, segmenter.labels)
    second = EmbeddedSegmenter(threads=2).segment(rgb, segmenter.labels)
    assert [(d.label, d.score) for d in first] == [(d.label, d.score) for d in second]
    assert all(np.array_equal(a.mask, b.mask) for a, b in zip(first, second, strict=True))
    rgb[:] = 128
    assert not [d for d in segmenter.segment(rgb, segmenter.labels) if d.score > 0.5]


@pytest.mark.parametrize("shape", [(48, 64), (333, 500), (700, 200)])
def test_any_picture_size_gives_masks_of_that_size(segmenter, pictures, shape):
    import cv2

    small = cv2.resize(pictures[2][0], shape[::-1], interpolation=cv2.INTER_AREA)
    assert segmenter.candidates(small).masks.shape[1:] == shape


def test_wrong_arguments_are_named(segmenter):
    rgb = np.zeros((480, 640, 3), np.uint8)
    with pytest.raises(InputError, match="does not know the label `rocket`; it knows: knife, scissors"):
        segmenter.segment(rgb, ["knife", "rocket"])
    with pytest.raises(InputError, match="sequence of labels, found the string `knife`"):
        segmenter.segment(rgb, "knife")
    with pytest.raises(InputError, match=r"uint8 array, found float32 array of shape \(480, 640, 3\)"):
        segmenter.segment(rgb.astype(np.float32), ["knife"])
    with pytest.raises(InputError, match=r"found uint8 array of shape \(480, 640\)"):
        segmenter.segment(rgb[..., 0], ["knife"])
    with pytest.raises(InputError, match="found NoneType"):
        segmenter.segment(None, ["knife"])
    with pytest.raises(InputError, match="at least 32 pixels"):
        segmenter.segment(rgb[:8], ["knife"])
    with pytest.raises(InputError, match="threads must be"):
        EmbeddedSegmenter(threads=0)


def test_damaged_files_are_refused_by_name(tmp_path: Path):
    weights, settings = DEFAULT_PATH.read_bytes(), DEFAULT_PATH.with_suffix(".json").read_text()
    copy = tmp_path / "copy.onnx"
    with pytest.raises(InputError, match=r"cannot read .*copy\.onnx"):
        EmbeddedSegmenter(copy)
    copy.write_bytes(weights[: len(weights) // 2])
    with pytest.raises(InputError, match=r"cannot read .*copy\.json"):
        EmbeddedSegmenter(copy)
    described = copy.with_suffix(".json")
    described.write_text(settings)
    with pytest.raises(InputError, match=r"copy\.onnx is damaged or not the file that copy\.json describes"):
        EmbeddedSegmenter(copy)
    copy.write_bytes(weights)
    for broken in (settings[:100], "{}", settings.replace('"schema_version": 2', '"schema_version": 1')):
        described.write_text(broken)
        with pytest.raises(InputError, match=r"copy\.json"):
            EmbeddedSegmenter(copy)
    import hashlib

    copy.write_bytes(b"not onnx")
    described.write_text(
        settings.replace(hashlib.sha256(weights).hexdigest(), hashlib.sha256(b"not onnx").hexdigest())
    )
    with pytest.raises(InputError, match=r"copy\.onnx is not a usable ONNX file"):
        EmbeddedSegmenter(copy)


def test_randomised_pictures_repeat_and_tell_the_truth():
    first = _core.randomized_pictures(5, 2, width=160, height=120, amodal=True)
    longer = _core.randomized_pictures(5, 5, width=160, height=120, amodal=True)
    assert len(first) == 2
    assert len(longer) == 5
    for a, b in zip(first, longer, strict=False):
        assert np.array_equal(a[0], b[0])
        assert np.array_equal(a[1], b[1])
        assert a[2] == b[2]
    for _, ids, objects in longer:
        counts = np.bincount(ids.reshape(-1))
        assert {o["id"]: o["visible_px"] for o in objects} == {i: n for i, n in enumerate(counts) if i and n}
        assert all(o["unoccluded_px"] >= o["visible_px"] for o in objects)
    # Another layout, another picture.
    assert not np.array_equal(longer[0][0], longer[4][0])
    with pytest.raises(InputError, match="found `eval`"):
        _core.randomized_pictures(5, 1, split="eval")
    with pytest.raises(InputError):
        _core.randomized_pictures(5, 1, width=0)


def test_isotonic_map_rises_and_repairs_overconfidence():
    rng = np.random.default_rng(0)
    raw = rng.random(20000)
    right = rng.random(20000) < raw**2
    x, y = isotonic(raw, right)
    assert x == sorted(x)
    assert y == sorted(y)
    assert len(x) <= 26
    assert np.abs(np.interp(raw, x, y) - raw**2).mean() < 0.02
    assert calibration_error(np.interp(raw, x, y), right) < 0.01 < 0.1 < calibration_error(raw, right)


def toy(seed: int, count: int) -> list[data.Picture]:
    """Bright discs and boxes on grey."""
    pictures = []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        rgb, ids = np.full((96, 128, 3), 90, np.uint8), np.zeros((96, 128), np.uint8)
        y, x = np.mgrid[:96, :128]
        objects = []
        for i in (1, 2):
            cx, cy, r = rng.integers(20, 108), rng.integers(20, 76), 14
            ball = rng.random() < 0.5
            inside = (x - cx) ** 2 + (y - cy) ** 2 < r * r if ball else (abs(x - cx) < r) & (abs(y - cy) < r)
            rgb[inside], ids[inside] = (230, 60, 60) if ball else (60, 60, 230), i
            objects.append(
                {"id": i, "category": LABELS[0 if ball else 1], "visible_px": 0, "unoccluded_px": 0}
            )
        pictures.append((rgb, ids, [o for o in objects if (ids == o["id"]).any()]))
    return pictures


def test_shards_resume_and_refuse_damage(tmp_path: Path):
    asked: list[int] = []

    def render(seed: int, count: int) -> list[data.Picture]:
        asked.append(seed)
        return toy(seed, count)

    data.write_shards(tmp_path, 128, render, 40, lambda _: None)
    data.write_shards(tmp_path, 192, render, 40, lambda _: None)
    assert asked == [40, 41, 42]
    shards = data.Shards(tmp_path, LABELS, 192)
    assert len(shards) == 192
    assert len(data.Shards(tmp_path, LABELS, 64)) == 64
    assert np.array_equal(shards[64][0], toy(41, 1)[0][0])
    sample = data.make_sample(
        shards[3], shards.category_of_id(shards[3][2]), (128, 96), np.random.default_rng(1)
    )
    assert sample.image.shape == (96, 128, 3)
    assert (sample.heat == 1).sum() == len(sample.cells) > 0
    (tmp_path / "shard_00001" / "ids.npy").write_bytes(b"junk")
    with pytest.raises(InputError, match="shard_00001"):
        data.Shards(tmp_path, LABELS, 192)
    with pytest.raises(InputError, match="no rendered shards"):
        data.Shards(tmp_path / "empty", LABELS, 64)


def test_a_turned_crop_shows_the_object_as_large_as_it_fits_and_its_heavy_end_on_one_side():
    rgb = np.full((200, 300, 3), 40, np.uint8)
    hammer = np.zeros((200, 300), bool)
    hammer[90:96, 60:200] = True
    hammer[70:116, 200:215] = True
    rgb[hammer] = (200, 100, 50)
    seen = []
    for turn in range(4):
        mask, picture = np.rot90(hammer, turn), np.ascontiguousarray(np.rot90(rgb, turn))
        frame = crops.frame_of(mask)
        seen.append(crops.crop(picture, mask, frame))
        assert seen[-1].shape == (96, 128, 4)
        covered = seen[-1][..., 3] > 127
        # Its area, and colour where its mask is.
        assert covered.sum() == pytest.approx(hammer.sum() * frame.scale**2, rel=0.06)
        assert np.abs(seen[-1][covered][:, :3].astype(int).mean(0) - (200, 100, 50)).max() < 12
        columns = np.nonzero(covered.any(0))[0]
        assert columns[-1] - columns[0] == pytest.approx(128 / crops.MARGIN, abs=3)
        assert np.allclose(
            frame.geometry[[0, 1, 2, 3, 7]], crops.frame_of(hammer).geometry[[0, 1, 2, 3, 7]], atol=1e-5
        )
    for other in seen[1:]:
        assert np.abs(other.astype(int) - seen[0]).mean() < 4


def test_a_crop_at_the_edge_and_one_of_a_single_pixel_are_whole():
    rgb, mask = np.full((48, 64, 3), 200, np.uint8), np.zeros((48, 64), bool)
    mask[0, 0] = True
    image = crops.crop(rgb, mask, crops.frame_of(mask))
    assert image[..., 3].max() > 0
    # Outside of the picture: grey, no mask.
    assert tuple(image[0, 0]) == (127, 127, 127, 0)
    mask[:] = True
    assert crops.crop(rgb, mask, crops.frame_of(mask))[48, 64, 3] == 255


def first_network(pictures: data.Shards, device: str = "cpu"):
    """A toy run, and what makes the batch of a step."""
    from fuse_grounding.training import segmenter as training

    config = training.TrainConfig(
        steps=50, crop=(64, 64), batch=4, part=2, warmup=4, pretrained=False, seed=3, device=device
    )
    return training.Training(LABELS, config), training.batches(pictures, config)


def second_network(pictures: data.Shards, device: str = "cpu"):
    from fuse_grounding.training import classifier

    config = classifier.ClassifierConfig(
        steps=50, batch=8, warmup=4, seed=3, pretrained=False, workers=2, device=device
    )
    return classifier.ClassifierTraining(LABELS, config), classifier.batches(pictures, config)


def _networks(steps: int, folder: Path, pictures: data.Shards):
    from fuse_grounding.training import loop

    (run, batches), (second, crop_batches) = first_network(pictures), second_network(pictures)
    loop.train(run, batches, steps, folder, "network", lambda _: None)
    loop.train(second, crop_batches, steps, folder, "crops", lambda _: None)
    return run, second


def test_training_learns_resumes_to_the_same_bits_and_exports(tmp_path: Path):
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    from fuse_grounding.training import segmenter_export as export

    os.environ.setdefault("OMP_NUM_THREADS", "1")
    data.write_shards(tmp_path / "data", 64, toy, 0, lambda _: None)
    pictures = data.Shards(tmp_path / "data", LABELS, 64)
    _networks(25, tmp_path / "run", pictures)
    run, second = _networks(50, tmp_path / "run", pictures)
    assert (run.step, second.step) == (50, 50)
    whole, whole_second = _networks(50, tmp_path / "whole", pictures)
    for resumed, uninterrupted in ((run, whole), (second, whole_second)):
        for k, v in uninterrupted.average.weights.items():
            assert v.equal(resumed.average.weights[k]), k
    for name in ("network", "crops"):
        log = [json.loads(line) for line in (tmp_path / "run" / f"{name}.jsonl").read_text().splitlines()]
        assert [line["step"] for line in log] == [25, 50]
        key, share = ("mask", 0.85) if name == "network" else ("loss", 1.0)
        assert log[1][key] < share * log[0][key]
    path = tmp_path / "toy.onnx"
    first = export.to_onnx(run.averaged(), (128, 96))
    export.write(path, first, export.crops_to_onnx(second.averaged()), LABELS, (128, 96), {"steps": run.step})
    assert path.stat().st_size + crops_path(path).stat().st_size < 15e6
    with pytest.raises(InputError, match="train it for longer"):
        export.calibrate(path, toy(9, 2), "toys")
    found = EmbeddedSegmenter(path).candidates(toy(9, 1)[0][0])
    assert found.masks.shape[1:] == (96, 128)
    assert found.scores.shape == (len(found.masks), 2)
    # What runs is what was trained, up to half precision.
    import torch

    rgb, ids, objects = toy(11, 1)[0]
    masks = [ids == o["id"] for o in objects]
    frames = [crops.frame_of(mask) for mask in masks]
    image = np.stack([crops.crop(rgb, m, f) for m, f in zip(masks, frames, strict=True)])
    geometry = np.stack([f.geometry for f in frames])
    # Nothing copies a map to pad it.
    import onnx

    for file in (path, crops_path(path)):
        assert not any(node.op_type == "Pad" for node in onnx.load(file).graph.node)
    session = onnxruntime.InferenceSession(crops_path(path).read_bytes(), providers=["CPUExecutionProvider"])
    ran = session.run(None, {"crops": image, "geometry": geometry})[0]
    with torch.no_grad():
        meant = second.averaged()(torch.from_numpy(image), torch.from_numpy(geometry)).numpy()
    assert np.abs(ran - meant).max() < 0.02
    # Weights of a network that knows fewer labels are a start.
    from fuse_grounding.training import classifier
    from fuse_grounding.training import segmenter as training
    from fuse_grounding.training.loop import same_run

    wider = training.Training(("a_box", "new", "a_ball"), replace(run.config, start="0f"), path)
    assert all(name.startswith("verdict") for name in wider.fresh)
    assert wider.net.dense_class.weight[2].allclose(run.averaged().dense_class.weight[0], atol=1e-2)
    wider_second = classifier.ClassifierTraining(("new", *LABELS), replace(second.config, start="0f"), path)
    assert wider_second.fresh == []
    out, before = wider_second.net.out.weight, second.averaged().out.weight
    assert out[1:].allclose(before, atol=1e-2)
    assert not out[0].allclose(before[0], atol=1e-2)
    with pytest.raises(InputError, match="other labels"):
        same_run(run.state(), ("b",), {}, tmp_path)
    with pytest.raises(InputError, match=r"trained with steps 50, not 60"):
        same_run(run.state(), LABELS, {"steps": 60}, tmp_path)
    (tmp_path / "run" / "network.pt").write_bytes(b"junk")
    with pytest.raises(InputError, match="not a checkpoint"):
        _networks(60, tmp_path / "run", pictures)
