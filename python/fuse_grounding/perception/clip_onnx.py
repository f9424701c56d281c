"""CLIP from two ONNX files and a tokenizer.json: an `Encoder` without torch.

`image.onnx` takes `pixel_values` (1, 3, S, S) float32 and gives `image_embeds` (1, D) and `patch_embeds`
(1, h * w, D), the projected tokens of the patches; `text.onnx` takes `input_ids` (N, L) int64 and gives
`text_embeds` (N, D). docs/models/doors.md has the lines that export them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding.errors import InputError
from fuse_grounding.extras import require
from fuse_grounding.perception import onnx
from fuse_grounding.perception.clip import Pixels, check_lengths, grid, normalised

PACKAGES = ("tokenizers",)
IMAGE, TEXT, TOKENIZER = "image.onnx", "text.onnx", "tokenizer.json"


def files(root: Path) -> list[Path]:
    """The files of a folder that decide results, tensors beside the networks too. Raises InputError."""
    for name in (IMAGE, TEXT, TOKENIZER):
        if not (root / name).is_file():
            raise InputError(
                f"checkpoint file {root / name} is missing: CLIP in ONNX is {IMAGE}, {TEXT}, {TOKENIZER}"
            )
    beside = root / "preprocessor_config.json"
    networks = [path for name in (IMAGE, TEXT) for path in sorted(root.glob(f"{name}*"))]
    return [*networks, root / TOKENIZER, *([beside] if beside.is_file() else [])]


class OnnxClipEncoder:
    """CLIP through ONNX Runtime on the CPU; implements `Encoder`. Raises InputError as `ClipEncoder` does."""

    name = "clip"

    def __init__(self, root: Path, threads: int = 2) -> None:
        require("tokenizers", "clip-onnx", "CLIP in ONNX")
        files(root)
        self._root, self._tokenizer = root, _tokenizer(root / TOKENIZER)
        self._image = onnx.session(root / IMAGE, ["pixel_values"], ["image_embeds", "patch_embeds"], threads)
        self._text = onnx.session(root / TEXT, ["input_ids"], ["text_embeds"], threads)
        self._pixels = Pixels.of(root, _fixed(self._image, root / IMAGE, "(1, 3, S, S)"))
        self._longest = _fixed(self._text, root / TEXT, "(N, L)")

    def image(self, rgb: np.ndarray) -> np.ndarray:
        """See `Encoder`."""
        return normalised(self._look(rgb, "image_embeds")[0])

    def patches(self, rgb: np.ndarray) -> np.ndarray:
        """See `Encoder`."""
        return grid(normalised(self._look(rgb, "patch_embeds")[0]), self._root / IMAGE)

    def text(self, texts: Sequence[str]) -> np.ndarray:
        """See `TextEncoder`. Raises InputError for a text of more tokens than the network reads."""
        texts = check_lengths(texts, lambda text: len(self._tokenizer.encode(text).ids), self._longest)
        rows = []
        for text in texts:  # one by one: the exported batch may be fixed
            ids = self._tokenizer.encode(text).ids
            # What stands after the end of the text is never looked at; CLIP pads with the end itself.
            padded = np.array([ids + [ids[-1]] * (self._longest - len(ids))], np.int64)
            rows.append(self._run(self._text, {"input_ids": padded}, "text_embeds", self._root / TEXT)[0])
        return normalised(np.stack(rows)) if rows else np.zeros((0, 0), np.float32)

    def _look(self, rgb: np.ndarray, what: str) -> np.ndarray:
        return self._run(self._image, {"pixel_values": self._pixels(rgb)}, what, self._root / IMAGE)

    def _run(self, session: Any, inputs: dict[str, np.ndarray], output: str, path: Path) -> np.ndarray:
        try:
            return np.asarray(session.run([output], inputs)[0])
        except Exception as error:
            raise InputError(f"{path} fails: {' '.join(str(error).split())[:300]}") from None


def _tokenizer(path: Path) -> Any:
    tokenizers = require("tokenizers", "clip-onnx", "CLIP in ONNX")
    try:
        made = tokenizers.Tokenizer.from_file(str(path))
    except Exception as error:
        raise InputError(f"{path} is not a tokenizer: {' '.join(str(error).split())[:200]}") from None
    made.no_truncation()
    made.no_padding()
    return made


def _fixed(session: Any, path: Path, expected: str) -> int:
    """The last length of the input's shape, which must be a number. Raises InputError."""
    shape = session.get_inputs()[0].shape
    fits = len(shape) == len(expected.split(","))
    if (
        not fits
        or not isinstance(shape[-1], int)
        or (len(shape) == 4 and (shape[1] != 3 or shape[2] != shape[3]))
    ):
        raise InputError(f"{path} takes an input of shape {shape}, expected {expected} with a fixed size")
    return int(shape[-1])
