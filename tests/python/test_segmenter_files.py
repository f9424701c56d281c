"""Files of the segmenter that are sound and do not belong together: other labels, other networks, parts."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fuse_grounding.config import SegmenterConfig
from fuse_grounding.errors import InputError
from fuse_grounding.perception import EmbeddedSegmenter, crops
from fuse_grounding.perception.doors import open_segmenter
from fuse_grounding.perception.embedded import DEFAULT_PATH, crops_path

WEIGHTS = DEFAULT_PATH.parent


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the three files, as copy.onnx, copy_crops.onnx and copy.json."""
    path = tmp_path / "copy.onnx"
    path.write_bytes(DEFAULT_PATH.read_bytes())
    crops_path(path).write_bytes(crops_path(DEFAULT_PATH).read_bytes())
    path.with_suffix(".json").write_bytes(DEFAULT_PATH.with_suffix(".json").read_bytes())
    return path


def edited(copy: Path, edit: Callable[[dict[str, Any]], object]) -> None:
    """Changes the settings."""
    settings = json.loads(DEFAULT_PATH.with_suffix(".json").read_text())
    edit(settings)
    copy.with_suffix(".json").write_text(json.dumps(settings))


def resigned(copy: Path, name: str, content: bytes) -> None:
    """Puts another network in, with its right hash: only a look inside tells."""
    (copy if name == "network" else crops_path(copy)).write_bytes(content)
    edited(copy, lambda settings: settings["sha256"].update({name: hashlib.sha256(content).hexdigest()}))


def test_a_copy_is_as_good(copy: Path):
    assert EmbeddedSegmenter(copy).labels == EmbeddedSegmenter().labels
    edited(copy, lambda settings: settings["sha256"].pop("crops"))
    crops_path(copy).unlink()  # weights without a second network
    assert EmbeddedSegmenter(copy).labels == EmbeddedSegmenter().labels


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (lambda labels: labels.pop(0), "44 labels of copy.json: its `verdict` is 47 wide, expected 46 wide"),
        (lambda labels: labels.pop(), "44 labels of copy.json: its `verdict` is 47 wide, expected 46 wide"),
        (
            lambda labels: labels.insert(3, "teaspoon"),
            "46 labels of copy.json: its `verdict` is 47 wide, expected 48 wide",
        ),
        (lambda labels: labels.clear(), "0 labels of copy.json: its `verdict` is 47 wide, expected 2 wide"),
    ],
)
def test_labels_that_the_network_does_not_have_are_refused(copy: Path, edit: Any, sentence: str):
    edited(copy, lambda settings: edit(settings["labels"]))
    with pytest.raises(InputError) as caught:
        EmbeddedSegmenter(copy)
    assert str(caught.value) == f"{copy} does not fit the {sentence}"
    with pytest.raises(InputError, match="does not fit the"):
        open_segmenter(SegmenterConfig(weights=copy))


def test_another_picture_size_is_refused(copy: Path):
    edited(copy, lambda settings: settings["input"].update(width=320))
    with pytest.raises(
        InputError,
        match=r"copy\.onnx is another network: it takes image \[1, 480, 640, 3\] and gives heat, verdict, "
        r"masks, expected image \[1, 480, 320, 3\] and heat, verdict, masks",
    ):
        EmbeddedSegmenter(copy)


def second_network(width: int, told: bool) -> bytes:
    """Takes what the second network takes and gives `logits` (N, width), or (1, width) without saying so."""
    onnx = pytest.importorskip("onnx")
    helper, kind = onnx.helper, onnx.TensorProto
    numbers: dict[str, np.ndarray]
    if told:
        nodes = [helper.make_node("MatMul", ["geometry", "weights"], ["logits"])]
        numbers = {"weights": np.ones((crops.GEOMETRY, width), np.float32)}
    else:  # how many are not zero is known when it runs
        nodes = [
            helper.make_node("ReduceSum", ["geometry"], ["sum"], keepdims=0),
            helper.make_node("Exp", ["sum"], ["positive"]),
            helper.make_node("Mul", ["ones", "positive"], ["some"]),
            helper.make_node("NonZero", ["some"], ["places"]),
            helper.make_node("Cast", ["places"], ["logits"], to=kind.FLOAT),
        ]
        numbers = {"ones": np.ones(width, np.float32)}
    graph = helper.make_graph(
        nodes,
        "second",
        [
            helper.make_tensor_value_info("crops", kind.UINT8, ["n", *crops.SIZE[::-1], 4]),
            helper.make_tensor_value_info("geometry", kind.FLOAT, ["n", crops.GEOMETRY]),
        ],
        [helper.make_tensor_value_info("logits", kind.FLOAT, ["n", width if told else "wide"])],
        [onnx.numpy_helper.from_array(array, name) for name, array in numbers.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    content: bytes = model.SerializeToString()
    return content


@pytest.mark.parametrize("told", [True, False])
def test_a_second_network_of_other_labels_is_refused(copy: Path, told: bool):
    resigned(copy, "crops", second_network(46, told))
    assert len(EmbeddedSegmenter(copy).labels) == 45
    for width in (45, 47):
        resigned(copy, "crops", second_network(width, told))
        with pytest.raises(InputError) as caught:
            EmbeddedSegmenter(copy)
        assert str(caught.value) == (
            f"{crops_path(copy)} does not fit the 45 labels of copy.json: "
            f"its `logits` is {width} wide, expected 46 wide"
        )


@pytest.mark.parametrize(
    ("name", "other", "sentence"),
    [
        ("network", "segmenter_crops", r"/copy\.onnx is another network: it takes crops \["),
        (
            "network",
            "encoder",
            r"/copy\.onnx is another network: .* and gives embedding, patches, expected image",
        ),
        (
            "network",
            "planner",
            r"/copy\.onnx is another network: it takes image \[1, 512\], object \[1, 512\] and",
        ),
        (
            "crops",
            "segmenter",
            "copy_crops.onnx is another network: it takes image and gives heat, verdict, masks",
        ),
        (
            "crops",
            "encoder",
            r"copy_crops\.onnx is another network: it takes image and gives embedding, patches",
        ),
        (
            "crops",
            "planner_summary",
            r"copy_crops\.onnx is another network: it takes summary and gives values",
        ),
    ],
)
def test_a_network_of_another_kind_is_refused(copy: Path, name: str, other: str, sentence: str):
    resigned(copy, name, (WEIGHTS / f"{other}.onnx").read_bytes())
    with pytest.raises(InputError, match=sentence) as caught:
        EmbeddedSegmenter(copy)
    expected = {
        "network": "expected image [1, 480, 640, 3] and heat, verdict, masks",
        "crops": "expected crops, geometry and logits",
    }
    assert str(caught.value).endswith(expected[name])


@pytest.mark.parametrize("name", ["network", "crops"])
def test_parts_of_a_file_are_refused_by_name(copy: Path, name: str):
    path = copy if name == "network" else crops_path(copy)
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], whole[:-1], whole + b"\0", b""):
        path.write_bytes(content)
        with pytest.raises(
            InputError,
            match=rf"{path.name} is damaged or not the file that copy\.json describes: SHA-256 \w{{12}}… of "
            rf"{len(content)} bytes, expected \w{{12}}…",
        ):
            EmbeddedSegmenter(copy)
    for content in (whole[: len(whole) // 2], b"not onnx", b""):
        resigned(copy, name, content)
        with pytest.raises(InputError, match=rf"{path.name} is not a usable ONNX file"):
            EmbeddedSegmenter(copy)
    path.unlink()
    with pytest.raises(InputError, match=rf"cannot read the segmenter's weights .*{path.name}: No such file"):
        EmbeddedSegmenter(copy)
