"""Size and orientation of a photo from its first bytes, without decoding it."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from fuse_grounding.errors import InputError

QUARTER_TURNS = {1: 0, 6: 1, 3: 2, 8: 3}
"""EXIF orientation -> quarter turns, clockwise, that put the stored picture upright."""
_ORIENTATION, _SHORT = 0x0112, 3
_PNG = b"\x89PNG\r\n\x1a\n"
_STANDALONE = {0x01, *range(0xD0, 0xD8)}
_SIZES = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_MOST_ENTRIES = 512


@dataclass(frozen=True)
class PhotoHeader:
    """`width` and `height` as stored, pixels; `quarter_turns` clockwise to stand upright."""

    width: int
    height: int
    quarter_turns: int = 0


def read_header(path: Path) -> PhotoHeader:
    """Raises InputError for what is no JPEG or PNG, is cut off, or is stored mirrored."""
    try:
        with path.open("rb") as file:
            start = file.read(8)
            if start == _PNG:
                width, height = struct.unpack(">8xII", file.read(16))
                return PhotoHeader(width, height)
            if start[:2] == b"\xff\xd8":
                file.seek(2)
                return _jpeg(file, path)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except struct.error:
        raise InputError(f"{path} is cut off: it ends before the size of the picture") from None
    raise InputError(f"{path} is no JPEG or PNG: it starts with {start!r}")


def _jpeg(file: BinaryIO, path: Path) -> PhotoHeader:
    orientation = 1
    while True:
        fill, marker = struct.unpack(">BB", file.read(2))
        if fill != 0xFF:
            raise InputError(f"{path} is a damaged JPEG: no marker at byte {file.tell() - 2}")
        while marker == 0xFF:
            (marker,) = struct.unpack(">B", file.read(1))
        if marker in _STANDALONE:
            continue
        (length,) = struct.unpack(">H", file.read(2))
        if marker in _SIZES:
            height, width = struct.unpack(">xHH", file.read(5))
            if orientation not in QUARTER_TURNS:
                raise InputError(
                    f"{path} is stored mirrored (EXIF orientation {orientation}); save it unmirrored"
                )
            return PhotoHeader(width, height, QUARTER_TURNS[orientation])
        if marker in (0xD9, 0xDA) or length < 2:
            raise InputError(f"{path} is a damaged JPEG: no size before its pixels")
        body = file.read(length - 2)
        if marker == 0xE1 and body[:6] == b"Exif\0\0":
            orientation = _orientation(body[6:]) or orientation


def _orientation(tiff: bytes) -> int | None:
    """The tag of the first directory; None where there is none, or none that can be read."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(tiff[:4])
    try:
        if order is None:
            return None
        (offset,) = struct.unpack_from(f"{order}I", tiff, 4)
        (count,) = struct.unpack_from(f"{order}H", tiff, offset)
        for entry in range(min(count, _MOST_ENTRIES)):
            tag, kind, _, value = struct.unpack_from(f"{order}HHIH", tiff, offset + 2 + 12 * entry)
            if tag == _ORIENTATION and kind == _SHORT and 1 <= value <= 8:
                return value
    except struct.error:
        pass
    return None


def with_exif(jpeg: bytes, focal_35mm: int, orientation: int = 1) -> bytes:
    """The JPEG with an EXIF segment as a phone writes it: orientation and 35 mm equivalent focal length."""
    exif_at = 8 + 2 + 2 * 12 + 4
    directory = struct.pack(
        ">HHHIHxxHHIII", 2, _ORIENTATION, _SHORT, 1, orientation, 0x8769, 4, 1, exif_at, 0
    )
    exif = struct.pack(">HHHIHxxI", 1, 0xA405, _SHORT, 1, focal_35mm, 0)
    body = b"Exif\0\0" + b"MM\0*" + struct.pack(">I", 8) + directory + exif
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:]
