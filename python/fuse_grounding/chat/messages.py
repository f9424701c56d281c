"""What is said to a model: words and pictures, as the protocol wants them and as a cache knows them."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from fuse_grounding.errors import FuseError

Part = str | np.ndarray
"""Words, or a picture: (H, W, 3) RGB or (H, W) grey, uint8."""


@dataclass(frozen=True, eq=False)
class Message:
    """One turn of a conversation."""

    role: Literal["system", "user", "assistant"]
    parts: tuple[Part, ...]


def wire(messages: Sequence[Message]) -> list[dict[str, Any]]:
    """`messages` of a chat-completions request; pictures are PNG data URLs in `image_url` parts."""
    return [{"role": m.role, "content": _content(m.parts, _data_url)} for m in messages]


def canonical(messages: Sequence[Message]) -> list[dict[str, Any]]:
    """The same with digests of pixels for pictures: equal for equal pictures, however they are packed."""
    return [{"role": m.role, "content": _content(m.parts, _digest)} for m in messages]


def _content(parts: Sequence[Part], picture: Any) -> str | list[dict[str, Any]]:
    # Mere words as a string: servers that know no pictures often take nothing else.
    if len(parts) == 1 and isinstance(parts[0], str):
        return parts[0]
    return [
        {"type": "text", "text": part}
        if isinstance(part, str)
        else {"type": "image_url", "image_url": {"url": picture(part)}}
        for part in parts
    ]


def _data_url(picture: np.ndarray) -> str:
    bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR) if picture.ndim == 3 else picture
    done, data = cv2.imencode(".png", bgr)
    if not done:
        raise FuseError(f"a picture of shape {picture.shape} could not be encoded as PNG")
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode()


def _digest(picture: np.ndarray) -> str:
    shape = "x".join(str(n) for n in picture.shape)
    return f"{shape} sha256 {hashlib.sha256(np.ascontiguousarray(picture).tobytes()).hexdigest()}"
