"""Which segmenter and which encoder: names to parts, with all that their results depend on.

What ships is in `SEGMENTERS` and `ENCODERS`; what is not there is an entry point of the groups below, or
`package.module:Class`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

from fuse_grounding.config import EncoderConfig, SegmenterConfig
from fuse_grounding.errors import InputError
from fuse_grounding.perception import (
    checkpoint,
    clip,
    clip_onnx,
    embedded,
    embedded_encoder,
    own,
    sam3,
    torch_models,
)
from fuse_grounding.perception.lexical import Lexical
from fuse_grounding.perception.patches import CLIP, Manner, PatchSegmenter
from fuse_grounding.perception.prompts import words
from fuse_grounding.perception.protocol import Encoder, Segmenter, TextEncoder
from fuse_grounding.registry import Registry, unknown

C = TypeVar("C", SegmenterConfig, EncoderConfig)
T = TypeVar("T")

SEGMENTER_GROUP = "fuse_grounding.segmenters"
ENCODER_GROUP = "fuse_grounding.encoders"
_RUNTIME = "cpu (ONNX Runtime)"
EMBEDDED_PATCHES_THRESHOLD = 0.35


@dataclass(frozen=True)
class Opened(Generic[T]):
    """A part with what its results depend on: files, distributions, and where it runs."""

    part: T
    files: tuple[Path, ...]
    packages: tuple[str, ...]
    device: str


@dataclass(frozen=True)
class Route:
    """A way to run a part: which packages it imports, and which extra brings them."""

    name: str
    packages: tuple[str, ...]
    extra: str


@dataclass(frozen=True)
class Door(Generic[C, T]):
    """A part that has a name.

    `defaults` are its settings; `files` finds the files of its checkpoint, quickly, or raises InputError;
    `open` makes the part; `routes` are the ways to run it, none where nothing has to be installed or named,
    and `way` is the one of a checkpoint.
    """

    defaults: C
    files: Callable[[C], tuple[Path, ...]]
    open: Callable[[C], Opened[T]]
    routes: tuple[Route, ...] = ()
    way: Callable[[C], Route | None] = lambda config: None


SEGMENTERS: Registry[Door[SegmenterConfig, Segmenter]] = Registry("segmenter")
ENCODERS: Registry[Door[EncoderConfig, TextEncoder]] = Registry("encoder")


def open_segmenter(config: SegmenterConfig) -> Opened[Segmenter]:
    """The configured segmenter. Raises InputError for unknown names and missing or broken weights."""
    name = _own_name(SEGMENTERS, SEGMENTER_GROUP, config.name)
    if name is None:
        return SEGMENTERS.get(config.name).open(config)
    made: Segmenter = own.make("segmenter", name, config)
    return _opened_own(own.CheckedSegmenter(made, config.name), made, config.weights)


def open_encoder(config: EncoderConfig) -> Opened[TextEncoder]:
    """The configured encoder of words, and of pictures unless it is `lexical`. Raises InputError."""
    config = settled(config)
    name = _own_name(ENCODERS, ENCODER_GROUP, config.name)
    if name is None:
        return ENCODERS.get(config.name).open(config)
    made: TextEncoder = own.make("encoder", name, config)
    return _opened_own(made, made, config.weights)


def settled(config: EncoderConfig) -> EncoderConfig:
    """`config` with what `auto` stands for on this machine."""
    if config.name != "auto":
        return config
    there = config.weights is not None or embedded_encoder.DEFAULT_PATH.is_file()
    return config.model_copy(update={"name": "embedded" if there else "lexical"})


def _own_name(registry: Registry[T], group: str, name: str) -> str | None:
    """`module:Class` of a part of the user's own; None for one that is ours. Raises InputError."""
    if ":" in name:
        return name
    theirs = own.entry_points(group)
    if name in registry.names():
        if name in theirs:
            raise InputError(f"the entry point {theirs[name]} takes the name `{name}`, which is FUSE's own")
        return None
    if name not in theirs:
        known = [*registry.names(), *theirs]
        raise InputError(f"{unknown(registry.kind, name, known)}, or package.module:Class")
    return theirs[name]


def _opened_own(part: T, made: object, weights: Path | None) -> Opened[T]:
    files, packages = own.sources(made)
    if weights is not None:
        if not weights.exists():
            raise InputError(f"weights {weights} do not exist")
        files += sorted(p for p in weights.rglob("*") if p.is_file()) if weights.is_dir() else [weights]
    return Opened(part, tuple(files), tuple(packages), "as it chooses")


# -- ours ----------------------------------------------------------------------------------------


def _embedded(config: SegmenterConfig) -> Opened[Segmenter]:
    if config.threshold is not None:
        raise InputError("segmenter.threshold is not for `embedded`: its threshold is part of its weights")
    files = embedded.files(config.weights)
    return Opened(embedded.EmbeddedSegmenter(files[0]), files, (), _RUNTIME)


def _embedded_patches(config: SegmenterConfig) -> Opened[Segmenter]:
    files = embedded_encoder.files(config.weights)
    eye = embedded_encoder.opened(config.weights)
    known = eye.settings
    contrast = tuple(words(text) for text in (*known.labels, known.background))
    threshold = EMBEDDED_PATCHES_THRESHOLD if config.threshold is None else config.threshold
    return Opened(PatchSegmenter(eye, Manner("{}", contrast, known.scale, threshold)), files, (), _RUNTIME)


def _embedded_encoder(config: EncoderConfig) -> Opened[TextEncoder]:
    files = embedded_encoder.files(config.weights)
    return Opened(embedded_encoder.opened(config.weights), files, (), _RUNTIME)


def _lexical(config: EncoderConfig) -> Opened[TextEncoder]:
    if config.weights is not None:
        raise InputError(f"encoder.weights {config.weights} is not for `lexical`, which has none")
    return Opened(Lexical(), (), (), "cpu")


def _sam3(config: SegmenterConfig) -> Opened[Segmenter]:
    files = tuple(sam3.files(config.weights))
    assert config.weights is not None
    threshold = sam3.THRESHOLD if config.threshold is None else config.threshold
    part = sam3.Sam3Segmenter(config.weights, config.device, threshold)
    return Opened(part, files, sam3.PACKAGES, torch_models.describe(part.device))


def _clip_root(weights: Path | None, section: str, who: str) -> tuple[Path, bool]:
    """The folder of a CLIP, and whether it is one of ONNX files."""
    root = checkpoint.folder(weights, f"{section}.weights", who)
    return root, (root / clip_onnx.IMAGE).is_file() or (root / clip_onnx.TEXT).is_file()


def _clip_files(weights: Path | None, section: str, who: str) -> tuple[Path, ...]:
    root, onnx = _clip_root(weights, section, who)
    return tuple(clip_onnx.files(root) if onnx else clip.files(root))


def _clip(weights: Path | None, device: str, section: str, who: str) -> Opened[Encoder]:
    root, onnx = _clip_root(weights, section, who)
    files = _clip_files(weights, section, who)
    if onnx:
        if device == "cuda":
            raise InputError(
                f"{section}.device is `cuda`, and CLIP in ONNX runs on the CPU; {root} holds ONNX files"
            )
        return Opened(clip_onnx.OnnxClipEncoder(root), files, clip_onnx.PACKAGES, _RUNTIME)
    encoder = clip.ClipEncoder(root, device, f"{section}.device")
    return Opened(encoder, files, clip.PACKAGES, torch_models.describe(encoder.device))


def _clip_patches(config: SegmenterConfig) -> Opened[Segmenter]:
    eye = _clip(config.weights, config.device, "segmenter", "segmenter `clip_patches`")
    manner = CLIP if config.threshold is None else replace(CLIP, threshold=config.threshold)
    return Opened(PatchSegmenter(eye.part, manner), eye.files, eye.packages, eye.device)


def _clip_encoder(config: EncoderConfig) -> Opened[TextEncoder]:
    found = _clip(config.weights, config.device, "encoder", "encoder `clip`")
    return Opened(found.part, found.files, found.packages, found.device)


_SAM3_ROUTE = Route("transformers", sam3.PACKAGES, "sam3")
_CLIP_ROUTES = (
    Route("transformers", clip.PACKAGES, "clip"),
    Route("ONNX Runtime", clip_onnx.PACKAGES, "clip-onnx"),
)

SEGMENTERS.add("embedded", Door(SegmenterConfig(), lambda c: embedded.files(c.weights), _embedded))
SEGMENTERS.add(
    "embedded_patches",
    Door(
        SegmenterConfig(name="embedded_patches"),
        lambda c: embedded_encoder.files(c.weights),
        _embedded_patches,
    ),
)
SEGMENTERS.add(
    "sam3",
    Door(
        SegmenterConfig(name="sam3"),
        lambda c: tuple(sam3.files(c.weights)),
        _sam3,
        (_SAM3_ROUTE,),
        lambda c: _SAM3_ROUTE,
    ),
)
SEGMENTERS.add(
    "clip_patches",
    Door(
        SegmenterConfig(name="clip_patches"),
        lambda c: _clip_files(c.weights, "segmenter", "segmenter `clip_patches`"),
        _clip_patches,
        _CLIP_ROUTES,
        lambda c: _CLIP_ROUTES[_clip_root(c.weights, "segmenter", "segmenter `clip_patches`")[1]],
    ),
)
ENCODERS.add(
    "embedded",
    Door(EncoderConfig(name="embedded"), lambda c: embedded_encoder.files(c.weights), _embedded_encoder),
)
ENCODERS.add("lexical", Door(EncoderConfig(name="lexical"), lambda c: (), _lexical))
ENCODERS.add(
    "clip",
    Door(
        EncoderConfig(name="clip"),
        lambda c: _clip_files(c.weights, "encoder", "encoder `clip`"),
        _clip_encoder,
        _CLIP_ROUTES,
        lambda c: _CLIP_ROUTES[_clip_root(c.weights, "encoder", "encoder `clip`")[1]],
    ),
)
