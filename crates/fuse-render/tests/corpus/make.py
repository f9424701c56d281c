"""Remakes the corpus: python crates/fuse-render/tests/corpus/make.py

Each model file is one that a reader must take, or one that it must refuse: `expected.txt` says which,
and with what words.
"""

from __future__ import annotations

import base64
import copy
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
EXPECTED: list[tuple[str, str]] = []
Json = dict[str, Any]


def put(name: str, content: bytes | str, expected: str | None = "ok") -> None:
    """Writes a file and what its reader says to it; None: a file beside a model."""
    path = HERE / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    if expected is not None:
        EXPECTED.append((name, expected))


def png(width: int, height: int, claimed: int | None = None) -> bytes:
    """A grey PNG, or one whose header claims another width."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", claimed or width, height, 8, 0, 0, 0, 0)
    rows = b"".join(b"\0" + bytes((40 * (x + y)) % 256 for x in range(width)) for y in range(height))
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


def floats(*values: float) -> bytes:
    """Little-endian 32-bit."""
    return struct.pack(f"<{len(values)}f", *values)


# A tetrahedron: positions 0 to 47, texture coordinates 48 to 79, indices 80 to 103, a picture from 104.
POINTS = floats(0, 0, 0, 0.1, 0, 0, 0, 0.1, 0, 0, 0, 0.1)
UVS = floats(0, 0, 1, 0, 0, 1, 1, 1)
FACES = struct.pack("<12H", 0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2)
PICTURE = png(4, 4)
DATA = POINTS + UVS + FACES + PICTURE


def document() -> Json:
    """The JSON of the tetrahedron."""
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "scale": [1, 2, 1]}, {"mesh": 0, "translation": [0.1, 0, 0]}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}
        ],
        "materials": [
            {
                "name": "paint",
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0.1},
            }
        ],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 4,
                "type": "VEC3",
                "min": [0, 0, 0],
                "max": [1, 1, 1],
            },
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 32},
            {"buffer": 0, "byteOffset": 80, "byteLength": 24},
            {"buffer": 0, "byteOffset": 104, "byteLength": len(PICTURE)},
        ],
        "buffers": [{"byteLength": len(DATA)}],
    }


def glb(json_: Json, data: bytes = DATA, kind: bytes = b"JSON", claimed: int | None = None) -> bytes:
    """The container of a document and its data."""
    text = json.dumps(json_).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    body = struct.pack("<I", claimed or len(text)) + kind + text
    body += struct.pack("<I", len(data)) + b"BIN\0" + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def edited(edit: Callable[[Json], Any]) -> Json:
    """The tetrahedron's JSON, changed."""
    made = copy.deepcopy(document())
    edit(made)
    return made


def glb_files() -> None:
    """What a binary file can hold, and what can be wrong with it."""

    def say(name: str, expected: str, edit: Callable[[Json], Any], data: bytes = DATA) -> None:
        put(f"glb/{name}.glb", glb(edited(edit), data), expected)

    def view(d: Json, data: bytes, **accessor: Any) -> int:
        """Adds data after the picture; returns its accessor."""
        d["bufferViews"].append({"buffer": 0, "byteOffset": len(DATA), "byteLength": len(data)})
        d["accessors"].append({"bufferView": len(d["bufferViews"]) - 1, **accessor})
        d["buffers"][0]["byteLength"] = len(DATA) + len(data)
        return len(d["accessors"]) - 1

    whole = glb(document())
    put("glb/whole.glb", whole)
    put("glb/empty.glb", b"", "it is empty")
    put("glb/header.glb", whole[:9], "a GLB header has 12")
    put("glb/half.glb", whole[: len(whole) // 2], "it is truncated: its header says")
    put("glb/version.glb", b"glTF\1" + whole[5:], "its GLB version is 1, expected 2")
    put("glb/chunk.glb", glb(document(), claimed=1 << 30), "chunk 0 claims 1073741824 bytes")
    put("glb/first.glb", glb(document(), kind=b"XXXX"), "its first chunk is")
    put("glb/none.glb", b"glTF" + struct.pack("<II", 2, 12), "holds no JSON chunk")
    text = b"{]  "
    put(
        "glb/json.glb",
        b"glTF" + struct.pack("<III", 2, 24, 4) + b"JSON" + text,
        "it is not glTF 2.0",
    )
    attributes = ("meshes", 0, "primitives", 0)

    def primitive(d: Json) -> Json:
        at: Any = d
        for key in attributes:
            at = at[key]
        return at

    say("old", "its version is", lambda d: d["asset"].update(version="1.0"))
    say("count", "reaches beyond its buffer view", lambda d: d["accessors"][0].update(count=5_000_000))
    say("many", "more than 10000000 vertices", lambda d: d["accessors"][0].update(count=4_000_000_000))
    say("short", "buffer 0 is truncated", lambda d: d["buffers"][0].update(byteLength=10**9))
    say("view", "reaches beyond its buffer", lambda d: d["bufferViews"][0].update(byteOffset=2**40))
    say("nan", "is not finite", lambda d: None, floats(float("nan")) + DATA[4:])
    say("vertex", "a triangle uses vertex 77", lambda d: None, DATA[:80] + b"\x4d\0" + DATA[82:])
    say("cycle", "do not form a tree", lambda d: d["nodes"][1].update(children=[0]))
    say("scene", "it has no scene", lambda d: (d.pop("scene"), d.pop("scenes")))
    say("bare", "ok", lambda d: (primitive(d).pop("material"), primitive(d)["attributes"].pop("TEXCOORD_0")))
    say("points", "it has no triangles, only 1 primitives", lambda d: primitive(d).update(mode=0))
    say("strip", "ok", lambda d: primitive(d).update(mode=5))
    say("fan", "ok", lambda d: primitive(d).update(mode=6))
    say("doubles", "expected Vec3", lambda d: d["accessors"][0].update(type="VEC2"))
    say("unlit", "ok", lambda d: d["materials"][0].update(extensions={"KHR_materials_unlit": {}}))
    gloss = {"diffuseFactor": [0.5, 0.4, 0.3, 1], "glossinessFactor": 0.7, "diffuseTexture": {"index": 0}}
    say(
        "gloss",
        "ok",
        lambda d: d["materials"][0].update(extensions={"KHR_materials_pbrSpecularGlossiness": gloss}),
    )
    turned = {"index": 0, "extensions": {"KHR_texture_transform": {"scale": [2, 2], "rotation": 1}}}
    say(
        "turned",
        "ok",
        lambda d: (
            d["materials"][0]["pbrMetallicRoughness"].update(baseColorTexture=turned),
            d.update(extensionsRequired=["KHR_texture_transform"], extensionsUsed=["KHR_texture_transform"]),
        ),
    )
    for name, extension in {
        "draco": "KHR_draco_mesh_compression",
        "meshopt": "EXT_meshopt_compression",
        "basisu": "KHR_texture_basisu",
        "gpu": "EXT_mesh_gpu_instancing",
    }.items():
        say(
            name,
            extension,
            lambda d, e=extension: d.update(extensionsRequired=[e], extensionsUsed=[e]),  # type: ignore[misc]
        )
    say("optional", "ok", lambda d: d.update(extensionsUsed=["KHR_draco_mesh_compression"]))
    say("noimage", "has no image", lambda d: d["textures"][0].pop("source"))
    say("notpicture", "neither a PNG nor a JPEG", lambda d: None, DATA[:104] + b"x" * len(PICTURE))
    wide = png(1, 1, claimed=20_000)
    say(
        "wide",
        "is larger than 8192x8192",
        lambda d: (
            d["bufferViews"][3].update(byteLength=len(wide)),
            d["buffers"][0].update(byteLength=104 + len(wide)),
        ),
        DATA[:104] + wide,
    )
    quantised = struct.pack("<16h", *(32767 * v for v in (0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0)))
    say(
        "quantised",
        "ok",
        lambda d: (
            primitive(d)["attributes"].update(
                POSITION=view(
                    d,
                    quantised,
                    componentType=5122,
                    count=4,
                    type="VEC3",
                    normalized=True,
                    min=[0, 0, 0],
                    max=[1, 1, 1],
                )
            ),
            d["bufferViews"][-1].update(byteStride=8),
            d.update(extensionsRequired=["KHR_mesh_quantization"], extensionsUsed=["KHR_mesh_quantization"]),
        ),
        DATA + quantised,
    )
    moved = struct.pack("<HH3f", 3, 0, 0, 0, 0.3)

    def sparse(d: Json, index: int = 0) -> None:
        d["bufferViews"].append({"buffer": 0, "byteOffset": len(DATA) + index, "byteLength": 2})
        d["bufferViews"].append({"buffer": 0, "byteOffset": len(DATA) + 4, "byteLength": 12})
        d["accessors"][0]["sparse"] = {
            "count": 1,
            "indices": {"bufferView": 4, "componentType": 5123},
            "values": {"bufferView": 5},
        }
        d["buffers"][0]["byteLength"] = len(DATA) + 16

    say("sparse", "ok", sparse, DATA + moved)
    far = struct.pack("<HH3f", 999, 0, 0, 0, 0.3)
    say("sparsefar", "replaces element 999, but there are 4", sparse, DATA + far)
    say(
        "nothing",
        "sparse over nothing",
        lambda d: (sparse(d), d["accessors"][0].pop("bufferView")),
        DATA + moved,
    )
    deep = [{"children": [i + 1]} for i in range(2000)] + [{"mesh": 0}]
    say("deep", "ok", lambda d: d.update(nodes=deep))
    say(
        "skinned",
        "ok",
        lambda d: (
            d["nodes"][1].update(skin=0),
            d.update(skins=[{"joints": [0]}], animations=[{"channels": [], "samplers": []}]),
        ),
    )
    shared = [{"mesh": 0} for _ in range(40)]
    say("shared", "ok", lambda d: (d.update(nodes=shared), d["scenes"][0].update(nodes=list(range(40)))))


def gltf_files() -> None:
    """Data in URIs and files beside."""

    def text(uri: str | None, edit: Callable[[Json], Any] = lambda d: None) -> str:
        made = edited(edit)
        if uri is not None:
            made["buffers"][0]["uri"] = uri
        return json.dumps(made)

    inline = "data:application/octet-stream;base64," + base64.b64encode(DATA).decode()
    put("gltf/data.bin", DATA, None)
    put("gltf/inline.gltf", text(inline))
    put("gltf/beside.gltf", text("data.bin"))
    put("gltf/base64.gltf", text("data:application/octet-stream;base64,@@@@"), "a data URI is damaged")
    put("gltf/missing.gltf", text("gone.bin"), 'it refers to "gone.bin", which cannot be read')
    for name, uri in {
        "parent": "../data.bin",
        "escaped": "%2e%2e/data.bin",
        "absolute": "/etc/hostname",
        "web": "https://example.org/data.bin",
        "windows": "..\\\\data.bin",
    }.items():
        put(f"gltf/{name}.gltf", text(uri), "only files in its own folder are read")
    put("gltf/nobin.gltf", text(None), "its binary chunk is missing")
    put("gltf/notjson.gltf", "solid cube", "it is not glTF 2.0")
    put("gltf/nested.gltf", "[" * 5000, "it is not glTF 2.0")
    beside = {"images": [{"uri": "gone.png"}]}
    put("gltf/image.gltf", text(inline, lambda d: d.update(beside)), '"gone.png", which cannot be read')


def obj_files() -> None:
    """Faces of every kind."""
    points = "v 0 0 0\nv 0.1 0 0\nv 0.1 0.1 0\nv 0 0.1 0\n"
    put("obj/good.mtl", "newmtl red\nKd 0.5 0.25 0.125\nNs 30\nmap_Kd t.png\n", None)
    put("obj/bad.mtl", "newmtl red\nKd a b c\n", None)
    put("obj/lost.mtl", "newmtl red\nmap_Kd gone.png\n", None)
    put("obj/t.png", PICTURE, None)
    rich = points + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 1\n"
    put("obj/whole.obj", "mtllib good.mtl\n" + rich + "o a\nusemtl red\nf 1/1/1 2/2/1 3/3/1 4/4/1\n")
    put("obj/back.obj", points + "f -4 -3 -2\n")
    put("obj/normals.obj", rich + "f 1//1 2//1 3//1\n")
    put("obj/polygon.obj", points + "v -0.1 0.05 0\nf 1 2 3 4 5\n")
    put("obj/nomtl.obj", "mtllib gone.mtl\n" + points + "usemtl red\nf 1 2 3\n")
    put("obj/zero.obj", points + "f 0 1 2\n", "line 5: a face uses vertex 0, but there are 4 in the file")
    put("obj/beyond.obj", points + "f 1 2 9\n", "a face uses vertex 9, but there are 4 in the file")
    put("obj/before.obj", points + "f -9 2 3\n", "a face uses vertex -9, but there are 4 above it")
    put("obj/uv.obj", points + "f 1/1 2/2 3/3\n", "a face uses texture coordinate 1, but there are 0")
    put("obj/word.obj", points + "f one two three\n", 'line 5: a face\'s corner "one"')
    put("obj/two.obj", points + "f 1 2\n", "a face of 2 corners, expected at least 3")
    put("obj/nan.obj", "v 0 nan 0\n" + points + "f 1 2 3\n", "line 1: a vertex with the number")
    put("obj/few.obj", "v 0 0\n" + points + "f 1 2 3\n", "a vertex of 2 numbers, expected 3")
    put("obj/cloud.obj", points, "it has no triangles: 4 vertices and no face")
    put("obj/empty.obj", "", "it is empty")
    put("obj/binary.obj", b"v \xff\xfe 0\n", "it is not text")
    put("obj/mtl.obj", "mtllib bad.mtl\n" + points + "f 1 2 3\n", "its material file is damaged")
    put(
        "obj/outside.obj",
        "mtllib ../good.mtl\n" + points + "f 1 2 3\n",
        "only files in its own folder are read",
    )
    put(
        "obj/picture.obj",
        "mtllib lost.mtl\n" + points + "usemtl red\nf 1 2 3\n",
        "texture gone.png is missing",
    )


if __name__ == "__main__":
    glb_files()
    gltf_files()
    obj_files()
    (HERE / "expected.txt").write_text("".join(f"{name}\t{words}\n" for name, words in sorted(EXPECTED)))
