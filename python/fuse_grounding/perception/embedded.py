"""The segmenter that ships with FUSE: a small network, run by ONNX Runtime on the CPU.

One run of the network finds every object in a picture and says how likely it is each of the known
labels; prompting by label selects from that, so several labels cost one run. Two files belong together:
`segmenter.onnx` and `segmenter.json` (labels, input size, thresholds, calibration, hash).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from fuse_grounding.errors import InputError
from fuse_grounding.perception import onnx
from fuse_grounding.perception.prompts import check_labels, check_picture
from fuse_grounding.perception.protocol import Detection

SCHEMA_VERSION = 1
DEFAULT_PATH = Path(__file__).resolve().parent.parent / "weights" / "segmenter.onnx"
_INPUT, _OUTPUTS = "image", ("heat", "verdict", "masks")


@dataclass(frozen=True)
class Candidates:
    """Every object found in a picture, before labels are prompted, best first.

    `masks` (N, H, W) bool; `scores` (N, labels) in [0, 1]: the calibrated probability that the object is
    the label and its mask overlaps it by IoU ≥ 0.5; `raw` (N, labels): the same before calibration.
    """

    masks: np.ndarray
    scores: np.ndarray
    raw: np.ndarray


@dataclass(frozen=True)
class _Settings:
    labels: tuple[str, ...]
    size: tuple[int, int]
    temperature: float
    knots: tuple[np.ndarray, np.ndarray]
    min_heat: float
    min_score: float
    min_pixels: int
    nms_iou: float
    nms_inside: float


def _softmax(x: np.ndarray) -> np.ndarray:
    e = np.exp(x - x.max(-1, keepdims=True))
    return e / e.sum(-1, keepdims=True)


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-np.clip(x, -30.0, 30.0)))


def _read_settings(path: Path, weights: bytes, weights_path: Path) -> _Settings:
    """Checks `segmenter.json` against its weights; InputError names the file and what is wrong."""
    try:
        d = json.loads(path.read_text())
        if d["schema_version"] != SCHEMA_VERSION:
            raise InputError(f"{path} has schema version {d['schema_version']}, expected {SCHEMA_VERSION}")
        settings = _Settings(
            labels=tuple(str(label) for label in d["labels"]),
            size=(int(d["input"]["width"]), int(d["input"]["height"])),
            temperature=float(d["temperature"]),
            knots=(np.asarray(d["calibration"]["raw"], float), np.asarray(d["calibration"]["score"], float)),
            min_heat=float(d["thresholds"]["heat"]),
            min_score=float(d["thresholds"]["score"]),
            min_pixels=int(d["thresholds"]["pixels"]),
            nms_iou=float(d["thresholds"]["nms_iou"]),
            nms_inside=float(d["thresholds"]["nms_inside"]),
        )
        expected = str(d["sha256"])
    except OSError as e:
        raise InputError(f"cannot read the segmenter's settings {path}: {e.strerror}") from e
    except (KeyError, TypeError, ValueError) as e:
        if isinstance(e, InputError):
            raise
        raise InputError(f"{path} is not a segmenter's settings file: {type(e).__name__} {e}") from e
    found = hashlib.sha256(weights).hexdigest()
    if found != expected:
        raise InputError(
            f"{weights_path} is damaged or not the file that {path.name} describes: "
            f"SHA-256 {found[:12]}… of {len(weights)} bytes, expected {expected[:12]}…"
        )
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


class EmbeddedSegmenter:
    """Instances of prompted labels by the shipped network; implements `Segmenter`.

    `path`: an ONNX file with its JSON file beside it; the shipped one when None. Raises InputError for
    files that are missing, damaged or do not belong together.
    """

    def __init__(self, path: str | Path | None = None, threads: int = 2) -> None:
        if not isinstance(threads, int) or threads < 1:
            raise InputError(f"threads must be an integer of at least 1, found {threads!r}")
        weights_path = DEFAULT_PATH if path is None else Path(path)
        try:
            weights = weights_path.read_bytes()
        except OSError as e:
            raise InputError(f"cannot read the segmenter's weights {weights_path}: {e.strerror}") from e
        self._settings = _read_settings(weights_path.with_suffix(".json"), weights, weights_path)
        self._session = onnx.session(weights_path, [_INPUT], _OUTPUTS, threads, weights)
        self._cache: tuple[bytes, Candidates] | None = None

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
        rgb = check_picture(rgb)
        key = hashlib.blake2b(rgb.tobytes(), key=str(rgb.shape).encode()).digest()
        if self._cache is None or self._cache[0] != key:
            self._cache = (key, self._find(rgb))
        return self._cache[1]

    def _find(self, rgb: np.ndarray) -> Candidates:
        s = self._settings
        height, width = rgb.shape[:2]
        scale = min(s.size[0] / width, s.size[1] / height)
        inner = (max(1, round(width * scale)), max(1, round(height * scale)))
        picture = np.full((s.size[1], s.size[0], 3), 127, np.uint8)
        how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
        picture[: inner[1], : inner[0]] = cv2.resize(rgb, inner, interpolation=how)
        heat, verdict, logits = self._session.run(_OUTPUTS, {_INPUT: picture[None]})
        logits = logits[:, : max(1, inner[1] // 2), : max(1, inner[0] // 2)]
        inside = logits > 0
        area = np.count_nonzero(inside, axis=(1, 2))
        sound = np.nonzero((heat >= s.min_heat) & (area * 4 >= s.min_pixels * scale**2))[0]
        raw = _softmax(verdict[sound, :-1] / s.temperature)[:, :-1] * _sigmoid(verdict[sound, -1:])
        order = np.argsort(-raw.max(1, initial=0.0), kind="stable")
        kept = self._suppress(inside[sound[order]])
        chosen = order[kept]
        masks = np.zeros((len(kept), height, width), bool)
        for i, k in enumerate(sound[chosen]):
            _enlarge(logits[k], masks[i])
        # Detections share these.
        masks.setflags(write=False)
        return Candidates(masks, np.interp(raw[chosen], *s.knots), raw[chosen])

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
