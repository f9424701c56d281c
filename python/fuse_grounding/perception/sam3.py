"""SAM3, the segmenter of the paper, through transformers: any text is a label.

The checkpoint folder holds transformers' layout (config.json, model.safetensors, tokenizer), of the image
model or of the video model that contains it, or the original `sam3.pt` with a tokenizer beside it
(`sam3_layout`). As in the supplement, the model is applied to each label by itself; what it makes of the
picture before any label is computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding.errors import InputError
from fuse_grounding.extras import require
from fuse_grounding.perception import checkpoint, torch_models
from fuse_grounding.perception.last_picture import LastPicture
from fuse_grounding.perception.prompts import check_labels, check_picture, quoted, words
from fuse_grounding.perception.protocol import Detection
from fuse_grounding.perception.sam3_layout import translate

PACKAGES = ("torch", "torchvision", "transformers")
ORIGINAL = "sam3.pt"
THRESHOLD = 0.5
"""Confidence that the original's processor asks of an instance."""
MASK_THRESHOLD = 0.5


def files(weights: Path | None) -> list[Path]:
    """The files of a SAM3 checkpoint that decide results. Raises InputError naming what is wrong."""
    root, original = _place(weights)
    found = [] if original is None else [original]
    if original is None:
        checkpoint.model_type(root / "config.json", ("sam3", "sam3_video"))
        found = checkpoint.weight_files(root)
    beside = (root / "config.json", root / "preprocessor_config.json")
    return [*found, *checkpoint.tokenizer_files(root), *(p for p in beside if p.is_file())]


def _place(weights: Path | None) -> tuple[Path, Path | None]:
    """The folder, and the original checkpoint if that is what there is to read; safetensors come first."""
    if weights is not None and weights.is_file():
        return weights.parent, weights
    root = checkpoint.folder(weights, "segmenter.weights", "segmenter `sam3`")
    if not (root / "config.json").is_file() and (root / ORIGINAL).is_file():
        return root, root / ORIGINAL
    if not list(root.glob("model.safetensors*")) and (root / ORIGINAL).is_file():
        return root, root / ORIGINAL
    return root, None


class Sam3Segmenter:
    """Instances of any labels by SAM3; implements `Segmenter`.

    `weights`: checkpoint folder, or the original file; `device`: `cpu`, `cuda` or `auto`; `threshold`: score
    from which an instance counts. Raises InputError for checkpoints that are missing, damaged or another
    model's, and without the packages of the extra `sam3`.
    """

    labels = None

    def __init__(self, weights: Path, device: str = "cpu", threshold: float = THRESHOLD) -> None:
        for package in PACKAGES:
            require(package, "sam3", "segmenter `sam3`")
        files(weights)
        self._torch = require("torch", "sam3", "segmenter `sam3`")
        library = require("transformers", "sam3", "segmenter `sam3`")
        self.device, self._threshold = torch_models.choose(device, "segmenter.device"), threshold
        root, original = _place(weights)
        with torch_models.quietly():
            if original is None:
                self._model = torch_models.pretrained(library.Sam3Model, root, "SAM3")
            else:
                self._model = _from_original(library, self._torch, root, original)
            self._model.to(self.device)
            self._processor = _processor(library, root, int(self._model.config.image_size))
        self._longest = int(self._model.config.text_config.max_position_embeddings)
        self._seen = LastPicture(self._look)

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        """See `Segmenter`. Raises InputError for a label of more tokens than the model reads."""
        rgb = check_picture(rgb)
        prompts = {label: self._tokens(label) for label in check_labels(labels, None)}
        detections = []
        with self._torch.inference_mode():
            for label, tokens in prompts.items():
                found = self._model(vision_embeds=self._seen(rgb), **tokens)
                (kept,) = self._processor.post_process_instance_segmentation(
                    found, self._threshold, MASK_THRESHOLD, target_sizes=[rgb.shape[:2]]
                )
                masks = kept["masks"].cpu().numpy().astype(bool)
                for score, mask in zip(kept["scores"].tolist(), masks, strict=True):
                    if mask.any():
                        detections.append(Detection(label, score, mask))
        # Stable: equal scores stay in the order of labels, then of the model's queries.
        return sorted(detections, key=lambda d: -d.score)

    def _tokens(self, label: str) -> dict[str, Any]:
        tokenizer, text = self._processor.tokenizer, words(label)
        count = len(tokenizer(text)["input_ids"])
        if count > self._longest:
            raise InputError(
                f"the label {quoted(label)} is too long for SAM3: {count} tokens, it reads {self._longest}"
            )
        tokens = tokenizer(text, padding="max_length", max_length=self._longest, return_tensors="pt")
        return {key: tokens[key].to(self.device) for key in ("input_ids", "attention_mask")}

    def _look(self, rgb: np.ndarray) -> Any:
        """What the image encoder makes of a picture."""
        pixels = self._processor.image_processor(rgb, return_tensors="pt")["pixel_values"]
        return self._model.get_vision_features(pixel_values=pixels.to(self.device))


def _processor(library: Any, root: Path, size: int) -> Any:
    """Processing of pictures, as the folder says or as the original does at the model's size, and of text."""
    pictures = library.Sam3ImageProcessor
    if (root / "preprocessor_config.json").is_file():
        images = torch_models.loaded(pictures, root, "preprocessor_config.json")
    else:
        images = pictures(size={"height": size, "width": size})
    return library.Sam3Processor(images, torch_models.loaded(library.CLIPTokenizer, root, "the tokenizer"))


def _from_original(library: Any, torch: Any, root: Path, original: Path) -> Any:
    """The model with the tensors of `sam3.pt`; of the released size unless a config.json says otherwise."""
    config = library.Sam3Config()
    if (root / "config.json").is_file():
        checkpoint.model_type(root / "config.json", ("sam3", "sam3_video"))
        config = torch_models.loaded(library.Sam3Config, root, "config.json")
    tensors = checkpoint.load_pickle(original, torch)
    with torch.device("meta"):
        wanted = library.Sam3Model(config).state_dict()
    ours, missing, foreign = translate(tensors, wanted)
    checkpoint.check_fit(original, "SAM3", missing, foreign)
    return torch_models.of_tensors(library.Sam3Model, config, ours)
