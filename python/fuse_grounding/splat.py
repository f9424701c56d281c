"""3D Gaussian splatting on CPU or GPU: the official model and training, resumed while views arrive.

```python
trainer = splat.Trainer(splat.Gaussians.from_points(xyz, rgb), splat.TrainerConfig())
trainer.add_view(image, camera)
trainer.refine(1000)
image, alpha, depth = splat.render(trainer.gaussians, camera)
```

World: right-handed, z up, metres. Whatever the caller can put right raises `InputError`.

`device` is `cpu`, `gpu`, or `auto`: a real GPU if there is one, else the CPU. A GPU that the CPU emulates is
refused, unless FUSE_SOFTWARE_GPU is 1 (for tests), and never taken by `auto`. Same seed and calls: same bits
for any number of threads at one SIMD level, or on one GPU: `device_name` and `Trainer.device` say which.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from fuse_grounding import _core
from fuse_grounding._core import Camera
from fuse_grounding.arguments import Count, Flag, Fraction, Natural, Positive, device_wish, instance_of, whole
from fuse_grounding.errors import InputError

__all__ = [
    "Gaussians",
    "RefineStats",
    "Trainer",
    "TrainerConfig",
    "checkpoint_note",
    "device_name",
    "map_format",
    "psnr",
    "quality",
    "render",
    "ssim",
]


@dataclass(frozen=True)
class TrainerConfig:
    """Settings of a `Trainer`: the supplement's ("3D Gaussian Splatting"), else the original's.

    The bounds are checked by `Trainer`, and by `config.MapConfig`, which takes these fields over.
    """

    position_rate: Positive = 1.6e-4
    """Position rate at the start, times the scene's extent (supplement)."""
    position_rate_end: Positive = 1.6e-6
    """Position rate at the end of its schedule (supplement)."""
    position_steps: Count = 30_000
    """Iterations over which the position rate falls, log-linearly."""
    feature_rate: Positive = 2.5e-3
    """Rate of the constant harmonic; the others have a twentieth (supplement)."""
    opacity_rate: Positive = 2.5e-2
    """Rate of the opacity's logit (supplement)."""
    scale_rate: Positive = 5e-3
    """Rate of the scales' logarithm (supplement)."""
    rotation_rate: Positive = 1e-3
    """Rate of the quaternions (supplement)."""
    lambda_dssim: Fraction = 0.2
    """Weight of D-SSIM in the loss."""
    degree: Annotated[int, Field(ge=0, le=3)] = 3
    """Highest degree of the spherical harmonics (supplement)."""
    degree_interval: Count = 1000
    """Iterations after which the degree rises by one."""
    densify_start: Natural = 500
    """Gaussians are cloned, split and removed only after this iteration (supplement)."""
    densify_end: Natural = 15_000
    """And only before this one (supplement)."""
    densify_interval: Count = 100
    """Iterations between two densifications (supplement)."""
    densify_gradient: Positive = 2e-4
    """Mean gradient of the projected position from which a Gaussian is cloned or split."""
    dense_fraction: Positive = 0.01
    """Times the scene's extent: larger Gaussians are split, smaller ones cloned."""
    prune_opacity: Fraction = 0.005
    """Gaussians less opaque are removed."""
    prune_fraction: Positive | None = None
    """Times the scene's extent: larger Gaussians are removed once opacities have been reset; None: none are.
    The original's 0.1 fits cameras spread as wide as the scene; here it removes walls and floor."""
    prune_radius: Positive | None = None
    """The same by radius on an image, pixels; None: never (in the original the test has no effect)."""
    opacity_reset_interval: Count = 3000
    """Iterations between two resets of the opacities (supplement)."""
    opacity_reset_margin: Natural = 1000
    """A reset within the last so many iterations of a call waits for the next call, since the map takes that
    long to heal: refinements of 400 iterations never reset, long trainings do; ours."""
    max_gaussians: Natural = 40_000
    """No Gaussians are added beyond this number, which keeps a refinement within seconds; ours."""
    fine_iterations: Natural | None = None
    """So many iterations at the end of a call look at the views at full resolution, those before at half,
    which costs a third; None: all at full resolution, as in the original."""
    matched_low_pass: Flag = False
    """Views at half the resolution are drawn with a narrower low-pass in their wider pixels, nearer to the
    means of full pixels, so that Gaussians shrink less there, to grow again at full resolution; ours."""
    step_iterations: Count = 1
    """Iterations of the original that one step stands for: so many times fewer steps, and all that is due by
    iteration comes as often in a call as ever; ours."""
    rate_gain: Positive = 1.0
    """Times all learning rates: larger steps where there are fewer; ours."""
    favour_new: Natural = 0
    """In the first so many steps after new views came to a trained map, every second looks at these; 0: in
    shuffled rounds only, as in the original."""
    extent: Positive | None = None
    """Extent of the scene, metres; None: 1.1 times the largest distance of a camera from their mean."""
    background: tuple[Fraction, Fraction, Fraction] = (0.0, 0.0, 0.0)
    """RGB behind everything, in [0, 1]."""
    seed: Natural = 0
    """Order of the views and places of split Gaussians."""

    @classmethod
    def official(cls) -> TrainerConfig:
        """Every setting as in the original; what is ours is off."""
        return cls(**OFFICIAL)


OFFICIAL: dict[str, Any] = {
    "prune_fraction": 0.1,
    "opacity_reset_margin": 0,
    "max_gaussians": 2**31 - 1,
    "fine_iterations": None,
    "matched_low_pass": False,
    "step_iterations": 1,
    "rate_gain": 1.0,
    "favour_new": 0,
}
"""Where the original differs from the defaults. It has no limit on Gaussians; this one is out of reach."""


@dataclass(frozen=True)
class RefineStats:
    """What a call of `Trainer.refine` did."""

    iterations: int
    total_iterations: int
    loss_first: float
    """Mean loss of the first tenth of the call."""
    loss: float
    """Mean loss of the last tenth."""
    gaussians: int
    cloned: int
    split: int
    pruned: int
    opacity_resets: int
    seconds: float
    stage_seconds: dict[str, float]


def _triples(name: str, values: ArrayLike) -> NDArray[np.float32]:
    """(N, 3) float32; positions of any float type, colours also uint8 (scaled to [0, 1])."""
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "fu":
        raise InputError(
            f"{name} must be a (N, 3) array of floats{' or uint8' if name == 'rgb' else ''}, "
            f"found {array.dtype} array of shape {array.shape}"
        )
    if array.dtype.kind == "u":
        if name != "rgb" or array.dtype != np.uint8:
            raise InputError(f"{name} must be a (N, 3) array of floats, found {array.dtype}")
        return array.astype(np.float32) / np.float32(255)
    return np.ascontiguousarray(array, dtype=np.float32)


class Gaussians:
    """A set of anisotropic 3D Gaussians with view-dependent colour. Read-only.

    `from_points` and `from_ply` make one; `Trainer.gaussians` returns one.
    """

    def __init__(self, inner: _core.Gaussians):
        self._inner = inner

    @classmethod
    def from_points(cls, xyz: ArrayLike, rgb: ArrayLike) -> Gaussians:
        """Gaussians at points, initialised as in the original (scale from the three nearest, opacity 0.1).

        `xyz` (N, 3) metres; `rgb` (N, 3) uint8, or floats in [0, 1]. Raises InputError for no points,
        other shapes or types, and values that are not finite.
        """
        return cls(_core.Gaussians.from_points(_triples("xyz", xyz), _triples("rgb", rgb)))

    @classmethod
    def from_ply(cls, path: str | os.PathLike[str]) -> Gaussians:
        """Reads a PLY as the original 3DGS writes it. Raises InputError that names the file and its fault."""
        return cls(_core.Gaussians.from_ply(os.fspath(path)))

    def save_ply(self, path: str | os.PathLike[str]) -> None:
        """Writes a PLY as the original 3DGS does, whole or not at all."""
        self._inner.save_ply(os.fspath(path))

    @classmethod
    def from_spz(cls, path: str | os.PathLike[str]) -> Gaussians:
        """Reads an SPZ (Niantic's, versions 2 and 3). Raises InputError that names the file and its fault."""
        return cls(_core.Gaussians.from_spz(os.fspath(path)))

    def save_spz(self, path: str | os.PathLike[str]) -> None:
        """Writes an SPZ (version 3), about a tenth of the PLY and a little coarser; whole or not at all."""
        self._inner.save_spz(os.fspath(path))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Gaussians:
        """Reads a .ply or .spz, by the suffix. Raises InputError for another, and as the readers do."""
        return cls.from_spz(path) if map_format(path) == "spz" else cls.from_ply(path)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a .ply or .spz, by the suffix. Raises InputError for another, and as the writers do."""
        if map_format(path) == "spz":
            self.save_spz(path)
        else:
            self.save_ply(path)

    @cached_property
    def parameters(self) -> NDArray[np.float32]:
        """(N, 59) float32, read-only: position, log scale, quaternion (w first), opacity logit, harmonics.

        Made once, at the first use (they are stored in blocks of eight); other properties are views of it.
        """
        array = self._inner.parameters()
        array.flags.writeable = False
        return array

    @property
    def blocks(self) -> NDArray[np.float32]:
        """(ceil(N / 8), 59, 8) float32, read-only: the memory itself, without a copy.

        Row `i` of `parameters` is `blocks[i // 8, :, i % 8]`; lanes past the end mean nothing.
        """
        return self._inner.blocks()

    @property
    def positions(self) -> NDArray[np.float32]:
        """(N, 3) float32 metres, a read-only view of `parameters`."""
        return self.parameters[:, :3]

    def __len__(self) -> int:
        return len(self._inner)

    def __repr__(self) -> str:
        return f"Gaussians({len(self)})"


def render(
    gaussians: Gaussians,
    camera: Camera,
    background: Sequence[float] | None = None,
    device: str = "cpu",
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Image (H, W, 3) in [0, 1], alpha (H, W) in [0, 1], depth (H, W) metres; float32.

    Depth is the mean along the optical axis of what is drawn, 0 where nothing is. `background` is
    RGB in [0, 1], default black. Raises FuseError if a GPU fails.
    """
    device_wish(device)
    instance_of("gaussians", gaussians, Gaussians)
    instance_of("camera", camera, Camera)
    rgb = np.asarray((0.0, 0.0, 0.0) if background is None else background)
    if rgb.shape != (3,) or rgb.dtype.kind not in "fiu":
        raise InputError(f"background must be three numbers in [0, 1], found {background!r}")
    return _core.render_gaussians(gaussians._inner, camera, tuple(rgb.tolist()), device)


class Trainer:
    """Fits Gaussians to views that arrive one by one; moments and statistics carry over between them.

    Ctrl-C ends a refinement after the iteration that it fell into; the trainer stays usable.
    """

    def __init__(self, gaussians: Gaussians, config: TrainerConfig | None = None, device: str = "cpu"):
        device_wish(device)
        instance_of("gaussians", gaussians, Gaussians)
        self.config = config if config is not None else TrainerConfig()
        instance_of("config", self.config, TrainerConfig)
        self._inner = _core.SplatTrainer(gaussians._inner, asdict(self.config), device)

    def add_view(self, image: NDArray[np.uint8], camera: Camera) -> int:
        """Adds an (H, W, 3) uint8 image with its camera; returns the view's index."""
        instance_of("camera", camera, Camera)
        return self._inner.add_view(image, camera)

    def set_camera(self, index: int, camera: Camera) -> None:
        """Replaces a view's camera, after a bundle adjustment for example."""
        instance_of("camera", camera, Camera)
        self._inner.set_camera(whole("index", index), camera)

    def add_points(self, xyz: ArrayLike, rgb: ArrayLike) -> int:
        """Adds Gaussians at newly found points; returns how many (`max_gaussians` limits them)."""
        return self._inner.add_points(_triples("xyz", xyz), _triples("rgb", rgb))

    def refine(self, iterations: int, following: int = 0) -> RefineStats:
        """Runs more iterations over all views; without `favour_new` every view comes once before any again.

        `following` more are to come in later calls: together they do, bit for bit, what one long call does,
        if the calls' lengths are multiples of `step_iterations`.
        """
        stats: dict[str, Any] = self._inner.refine(
            whole("iterations", iterations), whole("following", following)
        )
        return RefineStats(**stats)

    def fork(self) -> Trainer:
        """A twin that goes its own way from here; pictures of views are shared, not copied."""
        twin = copy.copy(self)
        twin._inner = self._inner.fork()
        return twin

    def save_checkpoint(self, path: str | os.PathLike[str], note: str = "") -> None:
        """Writes the whole state of the training, whole or not at all; `note` is kept for the caller."""
        self._inner.save_checkpoint(os.fspath(path), note)

    def load_checkpoint(self, path: str | os.PathLike[str]) -> str:
        """Continues where a checkpoint was written; returns its note.

        The trainer must have the settings and the views, in their order, of the one that wrote it. Raises
        InputError that says what differs, or that the file is damaged; the trainer is then unchanged.
        """
        return self._inner.load_checkpoint(os.fspath(path))

    @property
    def device(self) -> str:
        """What it runs on, as `cpu (avx2+fma)` or `gpu (NVIDIA L4, Vulkan)`: what decides the last bits."""
        return self._inner.device()

    @property
    def gaussians(self) -> Gaussians:
        """A copy of the Gaussians as they are now."""
        return Gaussians(self._inner.gaussians())

    @property
    def iteration(self) -> int:
        """Iterations since the trainer was made."""
        return self._inner.progress()[0]

    @property
    def view_count(self) -> int:
        """Number of views."""
        return self._inner.progress()[1]


def map_format(path: str | os.PathLike[str]) -> str:
    """`ply` or `spz`, by the suffix. Raises InputError for another."""
    suffix = os.path.splitext(os.fspath(path))[1].lower()
    if suffix not in (".ply", ".spz"):
        raise InputError(f"{os.fspath(path)}: a map is a .ply or .spz file, found suffix {suffix!r}")
    return suffix[1:]


def ssim(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Structural similarity of two (H, W, 3) uint8 images, as the original 3DGS measures it."""
    return _core.ssim(a, b)


def quality(
    gaussians: Gaussians,
    camera: Camera,
    image: NDArray[np.uint8],
    background: Sequence[float] = (0.0, 0.0, 0.0),
) -> tuple[float, float]:
    """PSNR (decibel) and SSIM of a rendering, in 8 bits, against an (H, W, 3) uint8 image."""
    instance_of("gaussians", gaussians, Gaussians)
    instance_of("camera", camera, Camera)
    return _core.splat_quality(gaussians._inner, camera, image, tuple(background))


def psnr(a: NDArray[Any], b: NDArray[Any]) -> float:
    """Peak signal-to-noise ratio of two (H, W, 3) images, decibel; uint8, or floats in [0, 1]."""
    return _core.psnr(_image("a", a), _image("b", b))


def _image(name: str, image: NDArray[Any]) -> NDArray[np.float32]:
    array = np.asarray(image)
    if array.dtype == np.uint8:
        return array.astype(np.float32) / np.float32(255)
    if array.dtype.kind != "f":
        raise InputError(f"{name} must be a (H, W, 3) uint8 or float array, found {array.dtype}")
    return np.ascontiguousarray(array, dtype=np.float32)


def device_name(device: str = "auto") -> str:
    """What `device` takes on this machine, as `cpu (avx2+fma)` or `gpu (NVIDIA L4, Vulkan)`.

    Raises InputError for another wish than `cpu`, `gpu` and `auto`, and for `gpu` where there is none.
    """
    device_wish(device)
    return _core.splat_device(device)


def checkpoint_note(path: str | os.PathLike[str]) -> str:
    """The note of a checkpoint, whoever wrote it. Raises InputError for a file that is none."""
    return _core.checkpoint_note(os.fspath(path))
