"""CPU or GPU: what is taken, what is refused, that both draw the same, that it is recorded.

The GPU's tests run on a real one, else on Mesa's software driver (tests/vulkan.sh installs it).
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from test_splat import camera, picture, scene

from fuse_grounding import doctor, mapping, splat
from fuse_grounding._core import simd_level
from fuse_grounding.agent import Agent
from fuse_grounding.config import Config
from fuse_grounding.environment import TabletopEnvironment, load_episodes, render_device
from fuse_grounding.environment.gym import TabletopGym
from fuse_grounding.errors import InputError
from fuse_grounding.reconstruction.training import TrainOptions

CPU = f"cpu ({simd_level})"
EMULATORS = ("llvmpipe", "lavapipe", "swiftshader", "basic render")


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of the GPU that the test runs on."""
    monkeypatch.setenv("FUSE_SOFTWARE_GPU", "1")
    try:
        return splat.device_name("gpu")
    except InputError as error:
        pytest.skip(f"{error}")


def emulated(name: str) -> bool:
    return any(e in name.lower() for e in EMULATORS)


def test_the_cpu_is_named_with_its_level() -> None:
    assert splat.device_name("cpu") == CPU
    assert splat.Trainer(scene()).device == CPU


@pytest.mark.parametrize("wish", ["cuda", "", "GPU", None])
def test_another_wish_is_refused_by_name(wish) -> None:
    sentence = f"device must be `auto`, `cpu` or `gpu`, found .?{wish}"
    for call in (
        lambda: splat.device_name(wish),
        lambda: splat.Trainer(scene(), device=wish),
        lambda: splat.render(scene(), camera(), device=wish),
    ):
        with pytest.raises(InputError, match=sentence):
            call()


def test_auto_takes_no_emulated_gpu_and_gpu_only_if_allowed(gpu: str, monkeypatch: pytest.MonkeyPatch):
    taken = splat.device_name("auto")
    assert splat.Trainer(scene(), device="auto").device == taken
    if not emulated(gpu):
        assert taken == gpu
        return
    assert taken == CPU
    monkeypatch.delenv("FUSE_SOFTWARE_GPU")
    with pytest.raises(InputError, match=r"no GPU was found, only .*; set FUSE_SOFTWARE_GPU=1"):
        splat.Trainer(scene(), device="gpu")
    line = next(c for c in doctor.examine() if c.name == "gpu")
    assert line.ok
    assert "which the CPU emulates" in line.found
    assert line.found.endswith(f"maps are trained on {CPU}")


WITHOUT = """
from fuse_grounding import splat
from fuse_grounding.errors import InputError
print(splat.device_name("auto"))
try:
    splat.device_name("gpu")
except InputError as error:
    print(error)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="drivers are hidden through Vulkan's loader, Linux only")
def test_without_a_driver_the_cpu_works_and_a_gpu_is_refused() -> None:
    hidden = {k: "/nowhere.json" for k in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")}
    environment = {**os.environ, **hidden, "FUSE_SOFTWARE_GPU": "1"}
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT], env=environment, capture_output=True, text=True, check=True
    )
    auto, refusal = done.stdout.splitlines()
    assert auto == CPU
    assert refusal.startswith("no GPU was found: no adapter offers Vulkan")


def test_both_draw_the_same(gpu: str) -> None:
    gaussians, view = scene(2000), camera(160, 120)
    drawn = splat.render(gaussians, view, [0.1, 0.2, 0.3], "gpu")
    expected = splat.render(gaussians, view, [0.1, 0.2, 0.3])
    assert [a.shape for a in drawn] == [(120, 160, 3), (120, 160), (120, 160)]
    assert np.ptp(expected[0]) > 0.3
    for name, a, b in zip(("image", "alpha"), drawn, expected, strict=False):
        close = (np.abs(a - b) <= 2 / 255).reshape(120 * 160, -1).all(1)
        assert close.mean() >= 0.999, name
    solid = expected[1] > 0.1
    assert (np.abs(drawn[2] - expected[2])[solid] < 0.01).mean() >= 0.999


def test_training_on_the_gpu_learns_and_stops_at_ctrl_c(gpu: str) -> None:
    truth, view = scene(), camera()
    start = splat.Gaussians.from_points(truth.positions, np.full((len(truth), 3), 0.5))
    trainer = splat.Trainer(start, device="gpu")
    assert trainer.device == gpu
    trainer.add_view(picture(truth, view), view)
    stats = trainer.refine(40)
    assert stats.loss < 0.8 * stats.loss_first
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            trainer.refine(1_000_000)
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, before)
    assert 40 < trainer.iteration < 1_000_000
    assert trainer.refine(1).total_iterations == trainer.iteration


def test_what_maps_are_trained_on_is_announced_and_recorded(gpu: str) -> None:
    auto = splat.device_name("auto")
    fallback = "no real GPU was found, " if auto == CPU else ""
    for wish, taken, why in (("cpu", CPU, ""), ("gpu", gpu, ""), ("auto", auto, fallback)):
        config = Config().with_(map={"device": wish})
        agent = Agent(config)
        assert agent.provenance["device"] == taken
        sentences = [] if wish == "cpu" else [f"map.device {wish}: {why}the map is trained on {taken}"]
        assert mapping.check(config.map) == sentences
        told = agent.start("cut a piece of rope").record.announcements
        assert [t for t in told if t.startswith("map.device")] == sentences
    with pytest.raises(InputError, match=r"`map\.device`: found 'cuda', expected"):
        Config().with_(map={"device": "cuda"})


def test_the_world_looks_the_same_on_both(gpu: str) -> None:
    episode = load_episodes("dev")[0]
    cpu, other = TabletopEnvironment(episode), TabletopEnvironment(episode, device="gpu")
    assert (cpu.device, other.device) == (CPU, gpu)
    expected, drawn = cpu.observe(), other.observe()
    assert expected.instance is not None
    assert drawn.instance is not None
    assert (expected.instance == drawn.instance).mean() >= 0.999
    assert len(np.unique(drawn.instance)) > 5
    off = np.abs(expected.rgb.astype(int) - drawn.rgb).max(2)
    assert (off <= 3).mean() >= 0.99
    assert np.array_equal(drawn.rgb, other.observe().rgb)
    gym = TabletopGym([episode], device="gpu")
    assert np.array_equal(gym.reset()[0]["rgb"], drawn.rgb)


@pytest.mark.parametrize("wish", ["cuda", None])
def test_another_wish_to_render_on_is_refused_by_name(wish) -> None:
    episode = load_episodes("dev")[0]
    for call in (
        lambda: TabletopEnvironment(episode, device=wish),
        lambda: TabletopGym([episode], device=wish),
        lambda: render_device(wish),
    ):
        with pytest.raises(InputError, match=f"device must be `auto`, `cpu` or `gpu`, found .?{wish}"):
            call()


def test_what_the_world_is_rendered_on_is_announced_and_recorded(gpu: str) -> None:
    for wish, taken in (("cpu", CPU), ("gpu", gpu), ("auto", render_device("auto"))):
        agent = Agent(Config(method="static").with_(render={"device": wish}))
        assert agent.provenance["render_device"] == taken
        told = agent.start("cut a piece of rope").record.announcements
        sentences = [t for t in told if t.startswith("render.device")]
        assert len(sentences) == (wish != "cpu")
        assert all(t.endswith(f"the world is rendered on {taken}") for t in sentences)


def test_a_checkpoint_of_another_device_is_refused(gpu: str, tmp_path: Path) -> None:
    path, view = tmp_path / "c", camera()
    there, here = splat.Trainer(scene(), device="cpu"), splat.Trainer(scene(), device="gpu")
    for trainer in (there, here):
        trainer.add_view(picture(scene(), view), view)
    there.save_checkpoint(path, "a note")
    with pytest.raises(InputError) as caught:
        here.load_checkpoint(path)
    assert f"written on {CPU}, this training runs on {gpu}; it would not continue" in str(caught.value)
    assert splat.checkpoint_note(path) == "a note"


def test_the_official_schedule_is_the_original_whatever_the_length() -> None:
    for iterations in (300, 7000):
        official = TrainOptions(iterations=iterations, schedule="official").config()
        assert official == splat.TrainerConfig.official()
    assert TrainOptions(schedule="official", max_gaussians=9).config().max_gaussians == 9
    assert TrainOptions(iterations=300).config().position_steps == 300
    with pytest.raises(InputError, match="schedule must be `fast` or `official`, found `slow`"):
        TrainOptions(schedule="slow").config()
