"""Amortised planning: a small network says what every action is worth, without touching the map.

    Q(x, a; o) = MLP([image(x), text(o), embedding(a)]),   1056 → 512 → 512 → 1

o is the candidate whose text is most like the picture (supplement, "Amortized Planner Architecture"). The
planner `summary`, ours, reads `planning.summary` instead of vectors, and needs no encoder. An ONNX file holds
all 15 actions at once; the JSON beside it says which kind it is, what it was trained on and, `plain`, with
which encoder.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fuse_grounding.config import Config
from fuse_grounding.errors import InputError
from fuse_grounding.perception import embedded_encoder, onnx
from fuse_grounding.perception.embedded_encoder import EmbeddedEncoder
from fuse_grounding.perception.protocol import Encoder
from fuse_grounding.planning.context import nearest_candidate
from fuse_grounding.planning.options import options
from fuse_grounding.planning.protocol import Decision, Planner, Situation
from fuse_grounding.planning.summary import NAMES, summarize
from fuse_grounding.record import Stopwatch

SCHEMA_VERSION = 1
KINDS = ("plain", "summary")
WEIGHTS = Path(__file__).resolve().parent.parent / "weights"


def shipped(kind: str) -> Path:
    """Where the shipped planner of a kind is, if it is."""
    return WEIGHTS / ("planner.onnx" if kind == "plain" else f"planner_{kind}.onnx")


@dataclass(frozen=True)
class Settings:
    """What `planner.json` says: the kind, the SHA-256 of the transitions that it was trained on, and where it
    reads vectors, their length and the SHA-256 of the encoder's two files."""

    kind: str
    dimensions: int
    encoder: dict[str, str]
    transitions: str


class Network:
    """The network alone: vectors in, values out.

    `path`: an ONNX file with its JSON beside it. Raises InputError for files that are missing, damaged, or of
    something else.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.settings, weights = _read(path)
        size = self.settings.dimensions
        takes = {"image": (1, size), "object": (1, size)}
        if self.settings.kind == "summary":
            takes = {"summary": (1, len(NAMES))}
        self._session = onnx.session(path, takes, {"values": (15,)}, 1, weights)

    def values(self, **inputs: np.ndarray) -> np.ndarray:
        """`image` and `object`, unit vectors (D,), or `summary` (29,), as the kind is → (15,) float32."""
        feed = {name: array[None].astype(np.float32) for name, array in inputs.items()}
        return self._session.run(["values"], feed)[0]


class AmortizedPlanner:
    """A network with the encoder that it was trained on, if it reads with one; implements `Planner`."""

    def __init__(self, network: Network, encoder: Encoder | None, config: Config) -> None:
        self._network, self._encoder, self._config = network, encoder, config

    @property
    def name(self) -> str:
        """How the record calls it: its kind."""
        return self._network.settings.kind

    def values(self, situation: Situation) -> np.ndarray:
        """(15,) float32 predicted utility of each action."""
        if self._encoder is None:
            return self._network.values(summary=summarize(situation, self._config))
        image = self._encoder.image(situation.rgb)
        labels = [candidate.label for candidate in situation.candidates]
        context = self._encoder.text([nearest_candidate(self._encoder, image, labels)])[0]
        return self._network.values(image=image, object=context)


class Amortized:
    """The option that the planner values most; the map is never asked."""

    start: Literal["here"] = "here"

    def __init__(self, planner: Planner, config: Config) -> None:
        self._planner, self._config = planner, config

    @property
    def planner(self) -> str:
        """The planner's name."""
        return self._planner.name

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        """The best option; ties go to the lowest index."""
        with clock("predict"):
            values = np.where(options(situation, self._config), self._planner.values(situation), np.nan)
        return Decision(int(np.nanargmax(values)), "amortized", values)


@dataclass(frozen=True)
class Files:
    """The files behind a planner: its own, and those of the encoder that it reads with, if it does."""

    planner: Path
    encoder: tuple[Path, ...]


def planner_files(config: Config) -> Files | None:
    """Those of the configured planner; None where no planner is loaded.

    The encoder of `plain` is the embedded one, with `encoder.weights` unless these are another encoder's.
    Raises InputError where a file is missing.
    """
    path = config.planner.weights or shipped(config.planner.name)
    if config.planner.name == "none" or not (config.planner.weights or path.exists()):
        return None
    for file in (path, path.with_suffix(".json")):
        if not file.is_file():
            raise InputError(f"planner weights {file} (planner.weights) do not exist")
    if config.planner.name == "summary":
        return Files(path, ())
    weights = config.encoder.weights if config.encoder.name in ("auto", "embedded") else None
    return Files(path, embedded_encoder.files(weights))


def load_planner(config: Config) -> AmortizedPlanner | None:
    """The configured planner; None under `planner.name = "none"`, or where none ships.

    Raises InputError for weights that are missing, damaged, of another kind or of another encoder.
    """
    files = planner_files(config)
    if files is None:
        return None
    network = _opened(files.planner)
    if network.settings.kind != config.planner.name:
        raise InputError(
            f"planner weights {network.path} are of a planner `{network.settings.kind}`, "
            f"planner.name asks for `{config.planner.name}`"
        )
    if not files.encoder:
        return AmortizedPlanner(network, None, config)
    encoder = embedded_encoder.opened(files.encoder[0])
    _fits(network, encoder)
    return AmortizedPlanner(network, encoder, config)


@cache
def _opened(path: Path) -> Network:
    """Read once in a process: every episode makes a policy of its own."""
    return Network(path)


def _fits(network: Network, encoder: EmbeddedEncoder) -> None:
    for name, digest in encoder.settings.sha256.items():
        if network.settings.encoder.get(name) != digest:
            raise InputError(
                f"{network.path} was trained with another encoder than {encoder.path} (its {name} differs); "
                "train it anew, or give encoder.weights"
            )
    if encoder.dimensions != network.settings.dimensions:
        raise InputError(
            f"{network.path} was trained on vectors of {network.settings.dimensions} dimensions, "
            f"the encoder `{encoder.name}` gives {encoder.dimensions}"
        )


def _read(path: Path) -> tuple[Settings, bytes]:
    beside = path.with_suffix(".json")
    contents: list[bytes] = []
    for file in (path, beside):
        try:
            contents.append(file.read_bytes())
        except FileNotFoundError:
            raise InputError(f"planner weights {file} (planner.weights) do not exist") from None
        except OSError as error:
            raise InputError(f"planner weights {file} cannot be read: {error.strerror}") from None
    try:
        d: dict[str, Any] = json.loads(contents[1])
        if d["schema_version"] != SCHEMA_VERSION:
            raise InputError(f"{beside} has schema version {d['schema_version']}, expected {SCHEMA_VERSION}")
        settings = Settings(
            kind=str(d["kind"]),
            dimensions=int(d["dimensions"]),
            encoder={name: str(digest) for name, digest in d["encoder"].items()},
            transitions=str(d["transitions"]["sha256"]),
        )
        expected = str(d["sha256"])
        if settings.kind not in KINDS:
            raise InputError(f"{beside}: `kind` must be {' or '.join(KINDS)}, found `{settings.kind}`")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{beside} is not a planner's settings file: {type(error).__name__} {error}"
        ) from None
    found = hashlib.sha256(contents[0]).hexdigest()
    if found != expected:
        raise InputError(
            f"{path} is damaged or not the file that {beside.name} describes: "
            f"SHA-256 {found[:12]}… of {len(contents[0])} bytes, expected {expected[:12]}…"
        )
    return settings, contents[0]
