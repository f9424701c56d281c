"""CLIP as an `Encoder`: pictures, patches and words in one space.

Through transformers (`ClipEncoder`), or from two ONNX files without torch (`clip_onnx`); both see the same
pixels. As in the supplement, "Amortized Planner", a picture is resized to the model's square, whatever its
shape, and normalised as CLIP is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fuse_grounding.errors import InputError
from fuse_grounding.extras import require
from fuse_grounding.perception import checkpoint, torch_models
from fuse_grounding.perception.prompts import check_picture, check_texts, quoted

PACKAGES = ("torch", "transformers")
_MEAN = (0.48145466, 0.4578275, 0.40821073)
_DEVIATION = (0.26862954, 0.26130258, 0.27577711)


@dataclass(frozen=True)
class Pixels:
    """How a picture becomes the network's input; the defaults are CLIP's, a folder may say otherwise."""

    size: int
    mean: tuple[float, ...] = _MEAN
    deviation: tuple[float, ...] = _DEVIATION

    @classmethod
    def of(cls, root: Path, size: int) -> Pixels:
        """With mean and deviation of a folder's preprocessor_config.json, if it has one."""
        path = root / "preprocessor_config.json"
        if not path.is_file():
            return cls(size)
        given = checkpoint.read_json(path)
        try:
            mean = tuple(float(x) for x in given.get("image_mean", _MEAN))
            deviation = tuple(float(x) for x in given.get("image_std", _DEVIATION))
        except (TypeError, ValueError):
            mean, deviation = (), ()
        if len(mean) != 3 or len(deviation) != 3 or min(deviation) <= 0:
            raise InputError(f"checkpoint file {path}: image_mean and image_std must be three numbers each")
        return cls(size, mean, deviation)

    def __call__(self, rgb: np.ndarray) -> np.ndarray:
        """(1, 3, size, size) float32 of (H, W, 3) uint8. Raises InputError."""
        rgb = check_picture(rgb)
        how = cv2.INTER_AREA if min(rgb.shape[:2]) > self.size else cv2.INTER_CUBIC
        small = cv2.resize(rgb, (self.size, self.size), interpolation=how).astype(np.float32) / 255
        mean, deviation = np.asarray(self.mean, np.float32), np.asarray(self.deviation, np.float32)
        return np.asarray((small - mean) / deviation).transpose(2, 0, 1)[None]


def normalised(vectors: np.ndarray) -> np.ndarray:
    """float32 rows of length 1."""
    vectors = np.asarray(vectors, np.float32)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def grid(patches: np.ndarray, source: Path) -> np.ndarray:
    """(h, w, D) of the (h * w, D) patches of a square picture. Raises InputError where they are no square."""
    side = round(len(patches) ** 0.5)
    if side * side != len(patches):
        raise InputError(f"{source} gives {len(patches)} patches, which are not those of a square picture")
    return patches.reshape(side, side, -1)


def check_lengths(texts: Sequence[str], count: Callable[[str], int], longest: int) -> list[str]:
    """Raises InputError for a text of more tokens than the network reads: it would be cut silently."""
    for text in check_texts("texts", texts):
        if (tokens := count(text)) > longest:
            raise InputError(
                f"the text {quoted(text)} is too long for CLIP: {tokens} tokens, it reads {longest}"
            )
    return list(texts)


def files(root: Path) -> list[Path]:
    """Files of a transformers checkpoint of CLIP that decide results. Raises InputError."""
    checkpoint.model_type(root / "config.json", ("clip",))
    beside = root / "preprocessor_config.json"
    return [
        *checkpoint.weight_files(root),
        root / "config.json",
        *checkpoint.tokenizer_files(root),
        *([beside] if beside.is_file() else []),
    ]


class ClipEncoder:
    """CLIP through transformers; implements `Encoder`.

    `root`: checkpoint folder; `device`: `cpu`, `cuda` or `auto`. Raises InputError for checkpoints that are
    missing, damaged or another model's, and without the packages of the extra `clip`.
    """

    name = "clip"

    def __init__(self, root: Path, device: str = "cpu", setting: str = "encoder.device") -> None:
        for package in PACKAGES:
            require(package, "clip", "CLIP")
        files(root)
        self._torch, library = require("torch", "clip", "CLIP"), require("transformers", "clip", "CLIP")
        self.device = torch_models.choose(device, setting)
        with torch_models.quietly():
            self._model = torch_models.pretrained(library.CLIPModel, root, "CLIP").to(self.device)
            self._tokenizer = torch_models.loaded(library.CLIPTokenizer, root, "the tokenizer")
        self._root, config = root, self._model.config
        self._pixels = Pixels.of(root, int(config.vision_config.image_size))
        self._longest = int(config.text_config.max_position_embeddings)

    def image(self, rgb: np.ndarray) -> np.ndarray:
        """See `Encoder`: of the class token."""
        with self._torch.inference_mode():
            seen = self._look(rgb).pooler_output
            return normalised(self._model.visual_projection(seen).cpu().numpy()[0])

    def patches(self, rgb: np.ndarray) -> np.ndarray:
        """See `Encoder`: the last layer's tokens, normalised and projected as the class token is."""
        with self._torch.inference_mode():
            tokens = self._model.vision_model.post_layernorm(self._look(rgb).last_hidden_state[:, 1:])
            vectors = self._model.visual_projection(tokens).cpu().numpy()[0]
        return grid(normalised(vectors), self._root)

    def text(self, texts: Sequence[str]) -> np.ndarray:
        """See `TextEncoder`. Raises InputError for a text of more tokens than the network reads."""
        texts = check_lengths(texts, lambda text: len(self._tokenizer(text)["input_ids"]), self._longest)
        if not texts:
            return np.zeros((0, int(self._model.config.projection_dim)), np.float32)
        tokens = self._tokenizer(
            texts, padding="max_length", max_length=self._longest, return_tensors="pt"
        ).to(self.device)
        with self._torch.inference_mode():
            said = self._model.text_model(
                input_ids=tokens["input_ids"], attention_mask=tokens["attention_mask"]
            ).pooler_output
            return normalised(self._model.text_projection(said).cpu().numpy())

    def _look(self, rgb: np.ndarray) -> Any:
        pixels = self._torch.from_numpy(self._pixels(rgb)).to(self.device)
        return self._model.vision_model(pixel_values=pixels)
