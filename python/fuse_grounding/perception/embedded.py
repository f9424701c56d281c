"""The segmenter that ships with FUSE: two small networks, run by ONNX Runtime on the CPU.

The first finds every object in a picture and says what it may be; the second looks again, at a crop of each
(`crops.py`), because what tells a fork from a spoon is too small for the first. Together they say how likely
an object is each of the known labels; prompting by label selects from that, so several labels cost one run.
Files that belong together: `segmenter.onnx`, `segmenter_crops.onnx` and `segmenter.json` (labels, input size,
thresholds, calibration, hashes). Weights whose settings name no second network run without it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fuse_grounding.errors import InputError
from fuse_grounding.perception import crops, onnx
from fuse_grounding.perception.last_picture import LastPicture
from fuse_grounding.perception.prompts import check_labels, check_picture
from fuse_grounding.perception.protocol import Detection

SCHEMA_VERSION = 2
DEFAULT_PATH = Path(__file__).resolve().parent.parent / "weights" / "segmenter.onnx"
# Objects of one picture that are looked at again, best first; there are rarely so many.
MOST = 24
_INPUT, _OUTPUTS = "image", ("heat", "verdict", "masks")
_CROPS, _LOGITS = ("crops", "geometry"), ("logits",)


@dataclass(frozen=True)
class Candidates:
    """Every object found in a picture, before labels are prompted, best first.

    `masks` (N, H, W) bool; `scores` (N, labels) in [0, 1]: the calibrated probability that the object is
    the label and its mask overlaps it by IoU ≥ 0.5; `raw` (N, labels): the same before calibration, from
    `first` and `second` (N, labels + 1), the logits of the two networks (last: none of them), and `quality`
    (N,), the logit of the mask's being good.
    """

    masks: np.ndarray
    scores: np.ndarray
    raw: np.ndarray
    first: np.ndarray
    second: np.ndarray
    quality: np.ndarray


@dataclass(frozen=True)
class _Settings:
    labels: tuple[str, ...]
    size: tuple[int, int]
    mixture: tuple[float, float]
    knots: tuple[np.ndarray, np.ndarray]
    min_heat: float
    min_score: float
    min_pixels: int
    nms_iou: float
    nms_inside: float
    sha256: dict[str, str]


def _softmax(x: np.ndarray) -> np.ndarray:
    e = np.exp(x - x.max(-1, keepdims=True))
    return e / e.sum(-1, keepdims=True)


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-np.clip(x, -30.0, 30.0)))


def mixed(
    first: np.ndarray, second: np.ndarray, quality: np.ndarray, mixture: tuple[float, float]
) -> np.ndarray:
    """(N, labels): what both networks say together, their logits weighted by `mixture`, times the quality."""
    return _softmax(mixture[0] * first + mixture[1] * second)[:, :-1] * _sigmoid(quality)[:, None]


def crops_path(weights: Path) -> Path:
    """Where the second network lies, beside the first."""
    return weights.with_name(weights.stem + "_crops.onnx")


def files(path: Path | None) -> tuple[Path, ...]:
    """The files of a segmenter that decide results: `path` (None: the shipped one) and those beside it.

    Raises InputError where one is missing.
    """
    path = path or DEFAULT_PATH
    if not path.is_file():
        raise InputError(f"cannot read the segmenter's weights {path}: there is no such file")
    settings = path.with_suffix(".json")
    second = (crops_path(path),) if "crops" in _read_settings(settings).sha256 else ()
    return (path, *second, settings)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as e:
        raise InputError(f"cannot read the segmenter's weights {path}: {e.strerror}") from e


def _read_settings(path: Path) -> _Settings:
    """Reads `segmenter.json`; InputError names the file and what is wrong."""
    try:
        d = json.loads(path.read_text())
        if d["schema_version"] != SCHEMA_VERSION:
            raise InputError(f"{path} has schema version {d['schema_version']}, expected {SCHEMA_VERSION}")
        settings = _Settings(
            labels=tuple(str(label) for label in d["labels"]),
            size=(int(d["input"]["width"]), int(d["input"]["height"])),
            mixture=(float(d["mixture"][0]), float(d["mixture"][1])),
            knots=(np.asarray(d["calibration"]["raw"], float), np.asarray(d["calibration"]["score"], float)),
            min_heat=float(d["thresholds"]["heat"]),
            min_score=float(d["thresholds"]["score"]),
            min_pixels=int(d["thresholds"]["pixels"]),
            nms_iou=float(d["thresholds"]["nms_iou"]),
            nms_inside=float(d["thresholds"]["nms_inside"]),
            sha256={"network": str(d["sha256"]["network"])}
            | {k: str(v) for k, v in d["sha256"].items() if k == "crops"},
        )
    except OSError as e:
        raise InputError(f"cannot read the segmenter's settings {path}: {e.strerror}") from e
    except (KeyError, TypeError, ValueError) as e:
        if isinstance(e, InputError):
            raise
        raise InputError(f"{path} is not a segmenter's settings file: {type(e).__name__} {e}") from e
    return settings


def _enlarge(logits: np.ndarray, mask: np.ndarray) -> None:
    """Fills `mask` (H, W) bool with where the enlarged `logits` are above zero."""
    h, w = logits.shape
    y_times, x_times = mask.shape[0] // h, mask.shape[1] // w
    if (h * y_times, w * x_times) != mask.shape:
        mask[:] = cv2.resize(logits, mask.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0
        return
    # By a whole factor the part that holds the object, with two pixels around it, gives the same bits.
    rows, columns = np.nonzero((logits > 0).any(1))[0], np.nonzero((logits > 0).any(0))[0]
    top, bottom = max(rows[0] - 2, 0), min(rows[-1] + 3, h)
    left, right = max(columns[0] - 2, 0), min(columns[-1] + 3, w)
    size = ((right - left) * x_times, (bottom - top) * y_times)
    part = cv2.resize(logits[top:bottom, left:right], size, interpolation=cv2.INTER_LINEAR)
    mask[top * y_times : bottom * y_times, left * x_times : right * x_times] = part > 0


def _verify(path: Path, weights: bytes, settings: Path, expected: str) -> None:
    """Raises InputError unless `settings` says that the hash of the file `path` is this one's."""
    found = hashlib.sha256(weights).hexdigest()
    if found != expected:
        raise InputError(
            f"{path} is damaged or not the file that {settings.name} describes: "
            f"SHA-256 {found[:12]}… of {len(weights)} bytes, expected {expected[:12]}…"
        )


def _check_width(
    path: Path, network: Any, output: str, expected: int, blank: dict[str, np.ndarray], labels: str
) -> None:
    """Raises InputError unless `output` is (…, `expected`); a file that leaves it open is run on `blank`."""
    (shape,) = (value.shape for value in network.get_outputs() if value.name == output)
    if not shape or not isinstance(shape[-1], int):
        try:
            shape = network.run([output], blank)[0].shape
        except Exception as e:
            raise InputError(f"{path} fails on zeros: {' '.join(str(e).split())[:300]}") from None
    if tuple(shape[-1:]) != (expected,):
        found = f"{shape[-1]} wide" if shape else "a single number"
        raise InputError(
            f"{path} does not fit the {labels}: its `{output}` is {found}, expected {expected} wide"
        )


class EmbeddedSegmenter:
    """Instances of prompted labels by the shipped network; implements `Segmenter`.

    `path`: an ONNX file with the second network and the JSON file beside it; the shipped one when None.
    Raises InputError for files that are missing, damaged, of other networks or do not belong together: the
    outputs' widths must be those of as many labels as the JSON file names.
    """

    def __init__(self, path: str | Path | None = None, threads: int = 2) -> None:
        if not isinstance(threads, int) or threads < 1:
            raise InputError(f"threads must be an integer of at least 1, found {threads!r}")
        weights_path = DEFAULT_PATH if path is None else Path(path)
        weights, described = _read(weights_path), weights_path.with_suffix(".json")
        self._settings = _read_settings(described)
        hashes, count = self._settings.sha256, len(self._settings.labels)
        labels = f"{count} labels of {described.name}"
        _verify(weights_path, weights, described, hashes["network"])
        width, height = self._settings.size
        takes = {_INPUT: (1, height, width, 3)}
        self._network = onnx.session(weights_path, takes, _OUTPUTS, threads, weights)
        blank = {_INPUT: np.zeros(takes[_INPUT], np.uint8)}
        _check_width(weights_path, self._network, "verdict", count + 2, blank, labels)
        self._second = None
        if "crops" in hashes:
            path = crops_path(weights_path)
            weights = _read(path)
            _verify(path, weights, described, hashes["crops"])
            self._second = onnx.session(path, _CROPS, _LOGITS, threads, weights)
            blank = {
                "crops": np.zeros((1, *crops.SIZE[::-1], 4), np.uint8),
                "geometry": np.zeros((1, crops.GEOMETRY), np.float32),
            }
            _check_width(path, self._second, "logits", count + 1, blank, labels)
        self._found = LastPicture(self._find)

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels that it knows."""
        return self._settings.labels

    def segment(self, rgb: np.ndarray, labels: Sequence[str]) -> list[Detection]:
        """Instances of `labels` in `rgb` (H, W, 3) uint8, best score first.

        An object of which the network is unsure is returned for several labels, each with its own score;
        scores below the threshold of the settings are left out. Masks are read-only. Raises
        UnknownLabelError, and InputError for a picture of the wrong shape or dtype.
        """
        known = self._settings.labels
        wanted = check_labels(labels, known)
        found = self.candidates(rgb)
        detections = []
        for label in wanted:
            column = found.scores[:, known.index(label)]
            for i in np.nonzero(column >= self._settings.min_score)[0]:
                detections.append(Detection(label, float(column[i]), found.masks[i]))
        # Stable: equal scores stay in the order of labels, then of objects.
        return sorted(detections, key=lambda d: -d.score)

    def candidates(self, rgb: np.ndarray) -> Candidates:
        """Every object of `rgb` (H, W, 3) uint8, whatever it is; the last picture's are remembered."""
        return self._found(check_picture(rgb))

    def _find(self, rgb: np.ndarray) -> Candidates:
        s = self._settings
        height, width = rgb.shape[:2]
        scale = min(s.size[0] / width, s.size[1] / height)
        inner = (max(1, round(width * scale)), max(1, round(height * scale)))
        picture = np.full((s.size[1], s.size[0], 3), 127, np.uint8)
        how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
        picture[: inner[1], : inner[0]] = cv2.resize(rgb, inner, interpolation=how)
        heat, verdict, logits = self._network.run(_OUTPUTS, {_INPUT: picture[None]})
        logits = logits[:, : max(1, inner[1] // 2), : max(1, inner[0] // 2)]
        inside = logits > 0
        area = np.count_nonzero(inside, axis=(1, 2))
        sound = np.nonzero((heat >= s.min_heat) & (area * 4 >= s.min_pixels * scale**2))[0]
        likely = (1.0 - _softmax(verdict[sound, :-1])[:, -1]) * _sigmoid(verdict[sound, -1])
        order = np.argsort(-likely, kind="stable")
        chosen = sound[order[self._suppress(inside[sound[order]])]][:MOST]
        masks = np.zeros((len(chosen), height, width), bool)
        for i, k in enumerate(chosen):
            _enlarge(logits[k], masks[i])
        first, quality = verdict[chosen, :-1], verdict[chosen, -1]
        second = self._look_again(rgb, masks)
        raw = mixed(first, second, quality, s.mixture)
        best = np.argsort(-raw.max(1, initial=0.0), kind="stable")
        masks = masks[best]
        # Detections share these.
        masks.setflags(write=False)
        return Candidates(
            masks, np.interp(raw[best], *s.knots), raw[best], first[best], second[best], quality[best]
        )

    def _look_again(self, rgb: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """(N, labels + 1): logits of the second network for the objects under `masks`, zeros without one."""
        if self._second is None or not len(masks):
            return np.zeros((len(masks), len(self.labels) + 1), np.float32)
        frames = [crops.frame_of(mask) for mask in masks]
        found: np.ndarray = self._second.run(
            _LOGITS,
            {
                "crops": np.stack([crops.crop(rgb, m, f) for m, f in zip(masks, frames, strict=True)]),
                "geometry": np.stack([f.geometry for f in frames]),
            },
        )[0]
        return found

    def _suppress(self, masks: np.ndarray) -> list[int]:
        """Positions of the masks (best first) that are not a better one's double or a part of it."""
        # Counted pair by pair: a matrix product would wake a pool of threads for a millisecond of work.
        coarse = np.ascontiguousarray(masks[:, ::2, ::2])
        area = np.maximum(np.count_nonzero(coarse, axis=(1, 2)), 1)
        kept: list[int] = []
        for i in range(len(coarse)):
            for k in kept:
                both = np.count_nonzero(coarse[i] & coarse[k])
                if (
                    both > self._settings.nms_iou * (area[i] + area[k] - both)
                    or both > self._settings.nms_inside * area[i]
                ):
                    break
            else:
                kept.append(i)
        return kept
