"""The encoder that ships with FUSE: CLIP's interface, small, on the CPU by ONNX Runtime.

Pictures go through a network (`encoder.onnx`); labels are a sum over a table of word pieces
(`encoder.safetensors`), so unknown words have a place, too. `encoder.json` says what belongs together.
An image vector has two orthogonal halves: what is in the picture, in the space of the texts, and where it is,
which no text sees. How it was made: docs/models/encoder.md.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fuse_grounding import tensors
from fuse_grounding.errors import InputError
from fuse_grounding.perception import onnx
from fuse_grounding.perception.last_picture import LastPicture
from fuse_grounding.perception.prompts import check_picture, check_texts, quoted
from fuse_grounding.perception.wordpiece import UNKNOWN, WordPiece

SCHEMA_VERSION = 1
TEXT_KIND = "text table"
DEFAULT_PATH = Path(__file__).resolve().parent.parent / "weights" / "encoder.onnx"
STRIDE = 16
GREY = 127


@dataclass(frozen=True)
class Settings:
    """What `encoder.json` says: input size (width, height), labels trained on, the scale that turns cosines
    of patches into logits, the phrase for what is no object, and the digests of `network` and `text`."""

    size: tuple[int, int]
    labels: tuple[str, ...]
    scale: float
    background: str
    sha256: dict[str, str]


class TextTable:
    """Vectors of word pieces: a text is their mean, of unit length, turned into the common space.

    `path`: a safetensors file; `vocabulary` its pieces as UTF-8 lines, `table` (V, d) int8 with a `step` a
    row (V,) float16, `projection` (D, d) float32 with orthonormal columns. Raises InputError for another
    file.
    """

    def __init__(self, path: Path):
        arrays, _ = tensors.load(path, TEXT_KIND, SCHEMA_VERSION)
        tensors.expect(
            path,
            arrays,
            {
                "vocabulary": ("uint8", ("bytes",)),
                "table": ("int8", ("pieces", "inner")),
                "step": ("float16", ("pieces",)),
                "projection": ("float32", ("dimensions", "inner")),
            },
        )
        self._table, self._step = arrays["table"], arrays["step"].astype(np.float32)
        self._projection = arrays["projection"]
        pieces = arrays["vocabulary"].tobytes().decode(errors="replace").split("\n")
        if len(pieces) != len(self._table) or UNKNOWN not in pieces:
            raise InputError(f"{path}: `vocabulary` has {len(pieces)} pieces for {len(self._table)} vectors")
        self._pieces = WordPiece(pieces)
        self._known: dict[str, np.ndarray] = {}

    @property
    def dimensions(self) -> int:
        """Length of the vectors."""
        return len(self._projection)

    def __call__(self, texts: Sequence[str]) -> np.ndarray:
        """(N, D) float32 of unit length; see `TextEncoder.text`."""
        rows = [self._one(text) for text in check_texts("texts", texts)]
        return np.stack(rows) if rows else np.zeros((0, self.dimensions), np.float32)

    def _one(self, text: str) -> np.ndarray:
        if text not in self._known:
            ids = self._pieces.ids(text)
            if not ids:
                raise InputError(f"the text {quoted(text)} has no visible character")
            inner = (self._table[ids] * self._step[ids, None]).mean(0)
            vector = self._projection @ (inner / max(float(np.linalg.norm(inner)), 1e-12))
            self._known[text] = vector.astype(np.float32)
        return self._known[text]


class EmbeddedEncoder:
    """The shipped encoder; implements `Encoder`.

    `path`: an ONNX file with its .json and .safetensors beside it; the shipped one when None. Raises
    InputError for files that are missing, damaged or do not belong together.
    """

    name = "embedded"

    def __init__(self, path: str | Path | None = None, threads: int = 2) -> None:
        if not isinstance(threads, int) or threads < 1:
            raise InputError(f"threads must be a whole number from 1, found {threads!r}")
        self.path = DEFAULT_PATH if path is None else Path(path)
        self.settings, weights = read_settings(self.path)
        self._table = TextTable(self.path.with_suffix(".safetensors"))
        self.dimensions = self._table.dimensions
        width, height = self.settings.size
        takes = {"image": (1, height, width, 3)}
        gives = {
            "embedding": (1, self.dimensions),
            "patches": (1, height // STRIDE, width // STRIDE, self.dimensions),
        }
        self._session = onnx.session(self.path, takes, gives, threads, weights)
        self._seen = LastPicture(self._look)

    def text(self, texts: Sequence[str]) -> np.ndarray:
        """See `TextEncoder.text`."""
        return self._table(texts)

    def image(self, rgb: np.ndarray) -> np.ndarray:
        """(D,) float32 of unit length; see `Encoder.image`."""
        return self._seen(check_picture(rgb))[0].copy()

    def patches(self, rgb: np.ndarray) -> np.ndarray:
        """(h, w, D) float32 of unit length, a patch for every 16 pixels of the network's input."""
        return self._seen(check_picture(rgb))[1].copy()

    def _look(self, rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """One run of the network."""
        picture, (w, h) = letterbox(rgb, self.settings.size)
        embedding, patches = self._session.run(["embedding", "patches"], {"image": picture[None]})
        seen = patches[0, : -(-h // STRIDE), : -(-w // STRIDE)]
        return embedding[0], np.ascontiguousarray(seen)


def files(path: Path | None) -> tuple[Path, ...]:
    """The files of an encoder that decide results: `path` (None: the shipped one) and those beside it.

    Raises InputError where one is missing.
    """
    path = path or DEFAULT_PATH
    found = (path, path.with_suffix(".safetensors"), path.with_suffix(".json"))
    for file in found:
        if not file.is_file():
            raise InputError(f"the encoder's file {file} is missing")
    return found


def opened(path: Path | None) -> EmbeddedEncoder:
    """An encoder that is read once in a process, as long as its files stay as they are."""
    return _opened(path or DEFAULT_PATH, tuple((f.stat().st_mtime_ns, f.stat().st_size) for f in files(path)))


@cache
def _opened(path: Path, seen: tuple[tuple[int, int], ...]) -> EmbeddedEncoder:
    return EmbeddedEncoder(path)


def letterbox(rgb: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, tuple[int, int]]:
    """The picture in the upper left of a grey one of `size` (width, height), as large as it fits; its size
    there."""
    height, width = rgb.shape[:2]
    scale = min(size[0] / width, size[1] / height)
    inner = (max(1, round(width * scale)), max(1, round(height * scale)))
    picture = np.full((size[1], size[0], 3), GREY, np.uint8)
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    picture[: inner[1], : inner[0]] = cv2.resize(rgb, inner, interpolation=how)
    return picture, inner


def read_settings(path: Path) -> tuple[Settings, bytes]:
    """`encoder.json` and the network's bytes, both files checked by their hashes.

    Raises InputError that names the file and what is wrong.
    """
    beside, table = path.with_suffix(".json"), path.with_suffix(".safetensors")
    contents: dict[str, bytes] = {}
    for name, file in (("network", path), ("text", table), ("settings", beside)):
        try:
            contents[name] = file.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read the encoder's file {file}: {error.strerror}") from None
    try:
        d: dict[str, Any] = json.loads(contents["settings"])
        if d["schema_version"] != SCHEMA_VERSION:
            raise InputError(f"{beside} has schema version {d['schema_version']}, expected {SCHEMA_VERSION}")
        settings = Settings(
            size=(int(d["input"]["width"]), int(d["input"]["height"])),
            labels=tuple(str(label) for label in d["labels"]),
            scale=float(d["scale"]),
            background=str(d["background"]),
            sha256={name: str(d["sha256"][name]) for name in ("network", "text")},
        )
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{beside} is not an encoder's settings file: {type(error).__name__} {error}"
        ) from None
    for name, file in (("network", path), ("text", table)):
        found, wanted = hashlib.sha256(contents[name]).hexdigest(), settings.sha256[name]
        if found != wanted:
            raise InputError(
                f"{file} is damaged or not the file that {beside.name} describes: "
                f"SHA-256 {found[:12]}… of {len(contents[name])} bytes, expected {wanted[:12]}…"
            )
    return settings, contents["network"]
