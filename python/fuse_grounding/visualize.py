"""Pictures for people: heat maps over the picture, the grounded mask, the four panels side by side.

Everything is BGR uint8, as OpenCV writes it; inputs are RGB.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from fuse_grounding.errors import FuseError
from fuse_grounding.planning.protocol import EvidenceMaps

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_PANEL = (480, 360)
_BAR, _CAPTION = 56, 34
_INK, _PAPER, _ACCENT = (235, 235, 235), (32, 28, 26), (90, 220, 120)


def write(path: Path, image: np.ndarray) -> None:
    """Writes a PNG in one step. Raises FuseError naming the file when it cannot be written."""
    partial = path.with_name(f".{path.name}")
    done, data = cv2.imencode(".png", image)
    try:
        if not done:
            raise OSError("the picture could not be encoded")
        partial.write_bytes(data.tobytes())
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise FuseError(f"{path} cannot be written: {error}") from None


def picture(rgb: np.ndarray) -> np.ndarray:
    """(H, W, 3) RGB as OpenCV wants it."""
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)


def heat(rgb: np.ndarray, values: np.ndarray, top: float) -> np.ndarray:
    """`values` (H, W) from 0 (dark) to `top` (bright) over a dimmed grey picture, with a scale."""
    grey = cv2.cvtColor(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2BGR)
    level = np.clip(values / top, 0, 1)
    colours = cv2.applyColorMap(np.rint(level * 255).astype(np.uint8), cv2.COLORMAP_INFERNO)
    opacity = (0.25 + 0.55 * level)[..., None]  # where there is nothing, the picture shows
    image = np.rint(0.7 * (1 - opacity) * grey + opacity * colours).astype(np.uint8)
    return _scale(image, top)


def _scale(image: np.ndarray, top: float) -> np.ndarray:
    """Draws the colour scale into the lower right corner."""
    height, width = image.shape[:2]
    if width < 320:
        return image  # no room for it
    ramp = np.repeat(np.linspace(0, 255, 120).astype(np.uint8)[None], 12, axis=0)
    x, y = width - 120 - 46, height - 26
    cv2.rectangle(image, (x - 28, y - 8), (width - 6, height - 6), _PAPER, -1)
    image[y : y + 12, x : x + 120] = cv2.applyColorMap(ramp, cv2.COLORMAP_INFERNO)
    cv2.putText(image, "0", (x - 18, y + 11), _FONT, 0.45, _INK, 1, cv2.LINE_AA)
    cv2.putText(image, f"{top:.1f}", (x + 124, y + 11), _FONT, 0.45, _INK, 1, cv2.LINE_AA)
    return image


def mask_over(rgb: np.ndarray, mask: np.ndarray | None, caption: str) -> np.ndarray:
    """The picture with a mask tinted and outlined, and a caption on a bar below it."""
    image = picture(rgb)
    if mask is not None:
        tint = np.zeros_like(image)
        tint[:] = _ACCENT
        image[mask] = cv2.addWeighted(image, 0.5, tint, 0.5, 0)[mask]
        outline, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, outline, -1, _INK, 3, cv2.LINE_AA)
        cv2.drawContours(image, outline, -1, (40, 160, 40), 1, cv2.LINE_AA)
    return np.vstack([image, _text_bar(caption, image.shape[1], 40, 0.6)])


def captioned(rgb: np.ndarray, caption: str) -> np.ndarray:
    """(H, W, 3) RGB with the caption on a bar over its lowest 28 rows, so that it keeps its size."""
    image = rgb.copy()
    image[-28:] = _text_bar(caption, rgb.shape[1], 28, 0.5)[..., ::-1]
    return image


def overview(rgb: np.ndarray, maps: EvidenceMaps | None, mask: np.ndarray | None, title: str) -> np.ndarray:
    """Input, semantic evidence, geometric uncertainty and fused evidence, side by side under a title."""
    semantic = None if maps is None else maps.semantic
    geometric = None if maps is None else maps.geometric
    field = None if maps is None or maps.geometric is None else maps.field
    panels = [
        _panel(_outlined(rgb, mask), "input"),
        _panel(None if semantic is None else heat(rgb, semantic, 1.0), "semantic evidence"),
        _panel(None if geometric is None else heat(rgb, geometric, 0.8), "geometric uncertainty"),
        _panel(None if field is None else heat(rgb, field, 1.8), "fused evidence"),
    ]
    row = np.hstack(panels)
    return np.vstack([_text_bar(title, row.shape[1], _BAR, 0.85), row])


def _outlined(rgb: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    image = picture(rgb)
    if mask is not None:
        outline, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(image, outline, -1, _ACCENT, 2, cv2.LINE_AA)
    return image


def _panel(image: np.ndarray | None, name: str) -> np.ndarray:
    """One panel with its caption; a blank one where the method makes no such map."""
    panel = np.full((_PANEL[1], _PANEL[0], 3), 60, np.uint8)
    if image is None:
        cv2.putText(panel, "not made by this method", (110, 185), _FONT, 0.6, _INK, 1, cv2.LINE_AA)
    else:
        panel[:] = cv2.resize(image, _PANEL, interpolation=cv2.INTER_AREA)
    framed = cv2.copyMakeBorder(panel, 0, 0, 2, 2, cv2.BORDER_CONSTANT, value=_PAPER)  # a thin gap
    return np.vstack([framed, _text_bar(name, framed.shape[1], _CAPTION, 0.6)])


def _text_bar(text: str, width: int, height: int, scale: float) -> np.ndarray:
    """A dark bar with text, made smaller where it would not fit."""
    bar = np.full((height, width, 3), _PAPER, np.uint8)
    shown = text.encode("ascii", "replace").decode()
    (w, _), _ = cv2.getTextSize(shown, _FONT, scale, 1)
    scale = min(scale, scale * (width - 24) / max(w, 1))
    (_, h), _ = cv2.getTextSize(shown, _FONT, scale, 1)
    cv2.putText(bar, shown, (12, (height + h) // 2), _FONT, scale, _INK, 1, cv2.LINE_AA)
    return bar
