"""Crops of single objects, turned along their long axis and enlarged, for the classifier of crops.

A fork across the whole picture is seven pixels wide; what tells it from a spoon needs all of them. A crop
holds the object as large as it fits, long things lying, their heavier end always on the same side.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

SIZE = (128, 96)
"""Width and height of a crop, pixels."""
MARGIN = 1.25
"""Extent of the crop over that of the object."""
LARGEST_SCALE = 4.0
TURNED_FROM = 1.5
"""Elongation from which an object is turned; rounder ones stay upright."""
GEOMETRY = 8


@dataclass(frozen=True)
class Frame:
    """Where a crop is taken: `center` (x, y) pixels, `angle` radians from x towards y, `scale` crop over
    picture; and what the crop no longer shows of the object: its `geometry` (GEOMETRY,) float32.
    """

    center: tuple[float, float]
    angle: float
    scale: float
    geometry: np.ndarray


def frame_of(mask: np.ndarray) -> Frame:
    """The frame of `mask` (H, W) bool, which must not be empty."""
    height = mask.shape[0]
    rows, columns = np.nonzero(mask.any(1))[0], np.nonzero(mask.any(0))[0]
    top, left = int(rows[0]), int(columns[0])
    inside = np.argwhere(mask[top : int(rows[-1]) + 1, left : int(columns[-1]) + 1])
    y, x = inside.T.astype(np.float64) + np.array([[top + 0.5], [left + 0.5]])
    mx, my = x.mean(), y.mean()
    dx, dy = x - mx, y - my
    # A twelfth: the variance of a pixel.
    xx, yy, xy = (dx * dx).mean() + 1 / 12, (dy * dy).mean() + 1 / 12, (dx * dy).mean()
    spread = np.sqrt((xx - yy) ** 2 + 4 * xy * xy)
    long, short = np.sqrt((xx + yy + spread) / 2), np.sqrt(max((xx + yy - spread) / 2, 1 / 12))
    axis = 0.5 * np.arctan2(2 * xy, xx - yy)
    angle = 0.0
    if long > TURNED_FROM * short:
        along = dx * np.cos(axis) + dy * np.sin(axis)
        angle = axis if (along**3).mean() >= 0 else axis + np.pi
    c, s = np.cos(angle), np.sin(angle)
    u, v = dx * c + dy * s, dy * c - dx * s
    (u0, u1), (v0, v1) = (u.min(), u.max()), (v.min(), v.max())
    middle_u, middle_v = (u0 + u1) / 2, (v0 + v1) / 2
    scale = min(SIZE[0] / (MARGIN * (u1 - u0 + 1)), SIZE[1] / (MARGIN * (v1 - v0 + 1)), LARGEST_SCALE)
    geometry = np.array(
        [
            np.log(long / 30),
            np.log(short / 10),
            np.log(len(x) / 2000) / 2,
            long / (long + 3 * short),
            np.cos(2 * axis),
            np.sin(2 * axis),
            my / height - 0.5,
            len(x) / (4 * np.sqrt(3) * long * np.sqrt(3) * short),
        ],
        np.float32,
    )
    return Frame((mx + middle_u * c - middle_v * s, my + middle_u * s + middle_v * c), angle, scale, geometry)


def crop(rgb: np.ndarray, mask: np.ndarray, frame: Frame) -> np.ndarray:
    """(96, 128, 4) uint8: colour and mask (0 to 255, soft at its edge) of `rgb` (H, W, 3) in `frame`."""
    height, width = mask.shape
    reach = 0.5 * np.hypot(*SIZE) / frame.scale + 2
    x0, x1 = int(max(frame.center[0] - reach, 0)), int(min(frame.center[0] + reach + 1, width))
    y0, y1 = int(max(frame.center[1] - reach, 0)), int(min(frame.center[1] + reach + 1, height))
    part: np.ndarray = np.empty((y1 - y0, x1 - x0, 4), np.uint8)
    part[..., :3] = rgb[y0:y1, x0:x1]
    part[..., 3] = mask[y0:y1, x0:x1]
    part[..., 3] *= 255
    if frame.scale < 0.75:
        # Sampling alone would skip pixels.
        shrink = max(1.3 * frame.scale, 0.1)
        size = (max(1, round(part.shape[1] * shrink)), max(1, round(part.shape[0] * shrink)))
        sx, sy = size[0] / part.shape[1], size[1] / part.shape[0]
        part = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
    else:
        sx = sy = 1.0
    c, s = np.cos(frame.angle), np.sin(frame.angle)
    # Crop to part; pixel centres are at half-integers, OpenCV's at integers.
    turn = np.array([[c * sx, -s * sx], [s * sy, c * sy]]) / frame.scale
    origin = np.array([(frame.center[0] - x0) * sx, (frame.center[1] - y0) * sy])
    offset = origin - turn @ (np.array(SIZE) / 2 - 0.5) - 0.5
    return cv2.warpAffine(
        part,
        np.hstack([turn, offset[:, None]]),
        SIZE,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(127, 127, 127, 0),
    )
