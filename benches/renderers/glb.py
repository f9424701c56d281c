"""Reads and writes the GLB files of this project with NumPy and Pillow alone, so that peers need no other
package of ours. Models are z up here and y up in the files, as glTF wants it."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

DTYPES = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


@dataclass(frozen=True)
class Part:
    """Triangles of one material: `positions`, unit `normals` (N, 3), `uvs` (N, 2), v downwards, float32;
    `triangles` (M, 3) uint32; linear base `color` (3,); `texture` (H, W, 3) uint8 sRGB or None."""

    positions: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    triangles: np.ndarray
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    texture: np.ndarray | None = None
    roughness: float = 0.8
    metallic: float = 0.0


def read(path: Path) -> list[Part]:
    """The parts of a file that `save_glb` or `write` made: one node, plain accessors."""
    data = path.read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    head: dict[str, Any] = json.loads(data[20 : 20 + length])
    blob = data[28 + length :]

    def view(index: int) -> bytes:
        v = head["bufferViews"][index]
        return blob[v.get("byteOffset", 0) :][: v["byteLength"]]

    def array(index: int) -> np.ndarray:
        a = head["accessors"][index]
        width = WIDTHS[a["type"]]
        flat = np.frombuffer(view(a["bufferView"]), DTYPES[a["componentType"]], a["count"] * width)
        return flat.reshape(a["count"], width)

    images = [np.array(Image.open(io.BytesIO(view(i["bufferView"]))).convert("RGB")) for i in head["images"]]
    parts = []
    for primitive in (p for mesh in head["meshes"] for p in mesh["primitives"]):
        material = head["materials"][primitive["material"]]["pbrMetallicRoughness"]
        texture = material.get("baseColorTexture")
        at = primitive["attributes"]
        parts.append(
            Part(
                array(at["POSITION"]) @ _TO_Z_UP.T,
                array(at["NORMAL"]) @ _TO_Z_UP.T,
                array(at["TEXCOORD_0"]),
                array(primitive["indices"]).reshape(-1, 3).astype(np.uint32),
                tuple(material["baseColorFactor"][:3]),
                None if texture is None else images[head["textures"][texture["index"]]["source"]],
                material["roughnessFactor"],
                material["metallicFactor"],
            )
        )
    return parts


_TO_Z_UP = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float32)


def write(path: Path, parts: Sequence[Part]) -> None:
    """Writes parts; textures become PNG."""
    head: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": []}],
        "samplers": [{"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497}],
    }
    names = ("materials", "textures", "images", "accessors", "bufferViews")
    head |= {name: [] for name in names}
    blob = bytearray()
    drawn: dict[int, int] = {}

    def view(data: bytes) -> int:
        blob.extend(bytes(-len(blob) % 4))
        head["bufferViews"].append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        blob.extend(data)
        return len(head["bufferViews"]) - 1

    def accessor(values: np.ndarray, kind: str, code: int) -> int:
        entry: dict[str, Any] = {"bufferView": view(values.tobytes()), "componentType": code}
        entry |= {"count": len(values), "type": kind}
        if kind == "VEC3":
            entry |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        head["accessors"].append(entry)
        return len(head["accessors"]) - 1

    def texture(image: np.ndarray) -> int:
        if id(image) not in drawn:
            file = io.BytesIO()
            Image.fromarray(image).save(file, "png")
            head["images"].append({"bufferView": view(file.getvalue()), "mimeType": "image/png"})
            head["textures"].append({"sampler": 0, "source": len(head["images"]) - 1})
            drawn[id(image)] = len(head["textures"]) - 1
        return drawn[id(image)]

    for part in parts:
        material: dict[str, Any] = {"baseColorFactor": [*part.color, 1.0], "metallicFactor": part.metallic}
        material["roughnessFactor"] = part.roughness
        if part.texture is not None:
            material["baseColorTexture"] = {"index": texture(part.texture)}
        head["materials"].append({"pbrMetallicRoughness": material})
        attributes = {
            "POSITION": accessor((part.positions @ _TO_Z_UP).astype(np.float32), "VEC3", 5126),
            "NORMAL": accessor((part.normals @ _TO_Z_UP).astype(np.float32), "VEC3", 5126),
            "TEXCOORD_0": accessor(part.uvs.astype(np.float32), "VEC2", 5126),
        }
        indices = accessor(part.triangles.astype(np.uint32).reshape(-1, 1), "SCALAR", 5125)
        primitive = {"attributes": attributes, "indices": indices, "material": len(head["materials"]) - 1}
        head["meshes"][0]["primitives"].append(primitive)
    blob.extend(bytes(-len(blob) % 4))
    head["buffers"] = [{"byteLength": len(blob)}]
    text = json.dumps(head).encode()
    text += b" " * (-len(text) % 4)
    size = 28 + len(text) + len(blob)
    chunks = struct.pack("<III", 0x46546C67, 2, size) + struct.pack("<II", len(text), 0x4E4F534A) + text
    path.write_bytes(chunks + struct.pack("<II", len(blob), 0x004E4942) + blob)


def split(part: Part) -> Part:
    """Each triangle in four, at the middles of its edges: the same shape and look, four times the count."""
    a, b, c = part.triangles.T
    edges = np.sort(np.concatenate([np.stack(e, 1) for e in ((a, b), (b, c), (c, a))]), axis=1)
    unique, which = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = (len(part.positions) + which.reshape(3, -1)).astype(np.uint32)

    def middles(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, (values[unique[:, 0]] + values[unique[:, 1]]) / 2]).astype(np.float32)

    normals = middles(part.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    corners = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    triangles = np.concatenate([np.stack(t, 1) for t in corners]).astype(np.uint32)
    return replace(
        part,
        positions=middles(part.positions),
        normals=normals,
        uvs=middles(part.uvs),
        triangles=triangles,
    )
