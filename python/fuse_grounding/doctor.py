"""What this machine has, what is missing, and how to get it."""

from __future__ import annotations

import importlib.metadata as metadata
import importlib.util
import os
import platform
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fuse_grounding import _core, splat
from fuse_grounding.chat.cache import default_folder
from fuse_grounding.config import Config
from fuse_grounding.config_chat import ChatConfig
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.perception import embedded, embedded_encoder
from fuse_grounding.perception.doors import ENCODER_GROUP, ENCODERS, SEGMENTER_GROUP, SEGMENTERS, settled
from fuse_grounding.perception.own import entry_points, load
from fuse_grounding.planning import amortized
from fuse_grounding.registry import Registry

PACKAGE = Path(__file__).parent
REINSTALL = "reinstall fuse-grounding: the file belongs to the package"


@dataclass(frozen=True)
class Check:
    """One line of the report; `hint` says what to do when it is not `ok`; some things are not `needed`."""

    name: str
    ok: bool
    found: str
    hint: str = ""
    needed: bool = True


def _package(name: str, hint: str = "", required: bool = True) -> Check:
    try:
        return Check(name, True, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Check(name, False, "not installed", hint or f"pip install {name}", needed=required)


def _shipped(name: str, path: Path) -> Check:
    if not path.exists():
        return Check(name, False, f"{path.name} is missing", REINSTALL)
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    size = sum(p.stat().st_size for p in files)
    return Check(name, size > 0, f"{len(files)} file(s), {size / 1e6:.1f} MB", REINSTALL)


def _weights(config: Config) -> list[Check]:
    """A line each for the shipped segmenter, encoder and planners: opened as an episode opens them, which
    holds each file against the SHA-256 that its JSON file records."""
    folder = PACKAGE / "weights"
    segmenter, encoder = folder / embedded.DEFAULT_PATH.name, folder / embedded_encoder.DEFAULT_PATH.name
    planners = [folder / amortized.shipped(kind).name for kind in amortized.KINDS]
    return [
        _intact("segmenter", embedded.EmbeddedSegmenter, [segmenter], [embedded.crops_path(segmenter)]),
        _intact(
            "encoder", embedded_encoder.EmbeddedEncoder, [encoder], [encoder.with_suffix(".safetensors")]
        ),
        _configured(config, _intact("planner", amortized.Network, planners)),
    ]


def _intact(
    part: str, opened: Callable[[Path], object], networks: Sequence[Path], others: Sequence[Path] = ()
) -> Check:
    """Whether shipped networks can be opened; `others` are the files that are read with them."""
    name, files = f"{part} weights", [*networks, *others]
    try:
        for network in networks:
            opened(network)
    except InputError as error:
        return Check(name, False, f"{error}", REINSTALL)
    size = sum(path.stat().st_size for path in files)
    names = ", ".join(path.name for path in files)
    return Check(name, True, f"{names}: {size / 1e6:.1f} MB, SHA-256 as recorded")


def _configured(config: Config, shipped: Check) -> Check:
    """The planners' line with the configured one, which may be a file of the user's own, and the gate."""
    chosen = config.planner
    if chosen.name == "none":
        told = "none is configured: `fuse` decides explicitly"
    else:
        whence = f" from {chosen.weights}" if chosen.weights else ""
        told = f"`{chosen.name}`{whence} is configured, gate.eta {config.gate.eta:g}"
    if shipped.ok and chosen.weights:
        try:
            amortized.load_planner(config)
        except InputError as error:
            hint = "planner.weights is a file of `fuse train planner`; leave it out for the shipped one"
            return replace(shipped, ok=False, found=f"{error}; {told}", hint=hint)
    return replace(shipped, found=f"{shipped.found}; {told}")


def _memory() -> Check:
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    except (ValueError, OSError, AttributeError):
        return Check("memory", True, "unknown")
    return Check("memory", total >= 4, f"{total:.1f} GiB", "an episode needs about 2 GiB")


def _disk() -> Check:
    free = shutil.disk_usage(Path.cwd()).free / 2**30
    return Check("free disk", free >= 1, f"{free:.1f} GiB here", "a run folder takes a few MB")


def _gpu() -> Check:
    """A GPU is never needed: without one, the line says what was found and why it is not taken. One that is
    there but fails is told, since `auto` does not pass it over."""
    try:
        auto = splat.device_name("auto")
    except FuseError as error:
        return Check("gpu", False, f"{error}", "`auto` and `gpu` fail with it; `cpu` works")
    try:
        return Check("gpu", True, f"`auto` takes {auto}; `gpu` takes {splat.device_name('gpu')}")
    except FuseError as error:
        return Check("gpu", True, f"{error}; maps are trained on {auto}")


def installed(package: str) -> bool:
    """Whether a package can be imported."""
    try:
        return importlib.util.find_spec(package) is not None
    except ValueError:  # kept from being imported
        return False


def _doors(kind: str, doors: Registry[Any], chosen: Any) -> list[Check]:
    """A line for each segmenter or encoder of ours. Only the chosen one is needed."""
    return [
        _door(kind, name, doors.get(name), chosen if chosen.name == name else None) for name in doors.names()
    ]


def _door(kind: str, name: str, door: Any, chosen: Any | None) -> Check:
    title = f"{kind} {name}"
    absent = {route: [p for p in route.packages if not installed(p)] for route in door.routes}
    if absent and all(absent.values()):
        found = "; ".join(f"{route.name} needs {', '.join(names)}" for route, names in absent.items())
        extras = " or ".join(f"'fuse-grounding[{route.extra}]'" for route in absent)
        return Check(title, False, found, f"pip install {extras}", needed=chosen is not None)
    ways = " or ".join(route.name for route, names in absent.items() if not names)
    through = f"through {ways}, " if ways else ""
    if chosen is None and door.routes:
        hint = f"name its folder: --weights or --set {kind}.weights=DIR"
        return Check(title, False, f"{through}no checkpoint folder is named", hint, needed=False)
    settings = chosen or door.defaults
    try:
        files, route = door.files(settings), door.way(settings)
    except InputError as error:
        hint = "docs/models/doors.md says what belongs in the folder"
        return Check(title, False, f"{through}{error}", hint, needed=chosen is not None)
    if route is None:
        return Check(title, True, f"{len(files)} file(s)" if files else "needs nothing")
    if absent[route]:
        missing = f"{len(files)} file(s) for {route.name}, which needs {', '.join(absent[route])}"
        return Check(title, False, missing, f"pip install 'fuse-grounding[{route.extra}]'")
    return Check(title, True, f"through {route.name}, {len(files)} file(s)")


def _own(kind: str, group: str, doors: Registry[Any], chosen: Any) -> list[Check]:
    """A line for each entry point, and for the class that is chosen."""
    theirs = entry_points(group)
    if chosen.name not in doors.names():
        theirs.setdefault(chosen.name, chosen.name)
    checks = []
    for name, value in theirs.items():
        try:
            load(kind, value)
            checks.append(Check(f"{kind} {name}", True, f"{value} can be loaded"))
        except InputError as error:
            hint = "docs/models/doors.md has an example"
            checks.append(Check(f"{kind} {name}", False, f"{error}", hint, needed=name == chosen.name))
    return checks


def _models(config: Config) -> list[Check]:
    """A line for each language model: whether an endpoint is named. None is asked."""
    return [
        _model("knowledge.llm", config.knowledge.llm, config.knowledge.source == "llm"),
        _model("vlm", config.vlm, config.method == "vlm"),
    ]


def _model(section: str, chosen: ChatConfig, needed: bool) -> Check:
    title = f"language model {section}"
    missing = [f"{section}.{name}" for name in ("base_url", "model") if not getattr(chosen, name)]
    if missing:
        found = "no endpoint is configured" if len(missing) == 2 else f"{missing[0]} is not set"
        hint = f"--set {missing[0]}=... (docs/language-models.md)"
        return Check(title, False, found, hint, needed=needed)
    found = f"`{chosen.model}` at {chosen.base_url}"
    if chosen.offline:
        return Check(title, True, f"{found}: offline, from {chosen.cache or default_folder()}")
    if not installed("urllib3"):
        return Check(
            title, False, f"{found}: needs urllib3", "pip install 'fuse-grounding[llm]'", needed=needed
        )
    if chosen.key_env and not os.environ.get(chosen.key_env, "").strip():
        hint = f"export {chosen.key_env}=..."
        return Check(title, False, f"{found}: {chosen.key_env} is not set", hint, needed=needed)
    key = f"with the key in {chosen.key_env}" if chosen.key_env else "without a key"
    return Check(title, True, f"{found}, {key} (not called)")


def examine(config: Config | None = None) -> list[Check]:
    """All checks, in the order of the report; `config` says which parts must be usable."""
    config = config or Config()
    encoder = settled(config.encoder)
    return [
        Check("fuse-grounding", True, _core.__version__),
        Check("python", True, f"{platform.python_version()} on {platform.system()} {platform.machine()}"),
        Check("processors", True, f"{os.cpu_count()} threads, SIMD level {_core.simd_level}"),
        _gpu(),
        _memory(),
        _disk(),
        *(
            _package(n)
            for n in ("numpy", "opencv-python-headless", "onnxruntime", "pycolmap", "pydantic", "safetensors")
        ),
        _package("torch", "pip install 'fuse-grounding[train]' (only to train networks)", required=False),
        *_doors("segmenter", SEGMENTERS, config.segmenter),
        *_own("segmenter", SEGMENTER_GROUP, SEGMENTERS, config.segmenter),
        *_doors("encoder", ENCODERS, encoder),
        *_own("encoder", ENCODER_GROUP, ENCODERS, encoder),
        *_models(config),
        _shipped("objects", PACKAGE / "data" / "objects"),
        _shipped("scenes", PACKAGE / "data" / "scenes.json"),
        *_weights(config),
    ]
