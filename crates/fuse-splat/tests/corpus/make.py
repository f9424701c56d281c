"""Remakes the corpus from `../data`: python crates/fuse-splat/tests/corpus/make.py

Each file is one that a reader must take, or one that it must refuse: `expected.txt` says which, and
with what words.
"""

import gzip
import json
import struct
from pathlib import Path

HERE = Path(__file__).parent
DATA = HERE.parent / "data"
EXPECTED: list[tuple[str, str]] = []


def put(name: str, content: bytes | str, expected: str = "ok") -> None:
    """Writes a file and what its reader says to it."""
    (HERE / name).write_bytes(content.encode() if isinstance(content, str) else content)
    EXPECTED.append((name, expected))


def ply() -> None:
    """Properties, counts and numbers of every kind."""
    big, text = (DATA / "big_endian.ply").read_bytes(), (DATA / "ascii.ply").read_text()
    put("ply/big_endian.ply", big)
    put("ply/ascii.ply", text)
    head, body = (DATA / "scene.ply").read_bytes().split(b"end_header\n", 1)
    few = head.replace(b"vertex 40", b"vertex 3") + b"end_header\n" + body[: 3 * 248]
    put("ply/little_endian.ply", few)

    lines = text.splitlines()
    end = lines.index("end_header")
    rest = [i for i, line in enumerate(lines[:end]) if " f_rest_" in line]
    first = next(i for i, line in enumerate(lines) if line.startswith("property"))
    columns = {i - first for i in rest}
    rows = [" ".join(w for k, w in enumerate(r.split()) if k not in columns) for r in lines[end + 1 :]]
    plain = "\n".join([line for i, line in enumerate(lines[:end]) if i not in rest] + ["end_header", *rows])
    put("ply/degree_0.ply", plain + "\n")
    faces = plain.replace("end_header", "element face 1\nproperty list uchar int vertex_indices\nend_header")
    put("ply/faces.ply", faces + "\n3 0 1 2\n", "element `face` found, expected one element `vertex`")
    put("ply/comments.ply", plain.replace("element", "comment x\nelement", 1) + "\n")
    put("ply/double.ply", plain.replace("property float x", "property double x") + "\n")

    def bad(name: str, old: str, new: str, expected: str) -> None:
        assert old in text
        put(f"ply/{name}.ply", text.replace(old, new, 1), expected)

    bad("no_opacity", "property float opacity", "property float haze", "property `opacity` is missing")
    bad("zero", "vertex 3", "vertex 0", "0 vertices")
    bad("billion", "vertex 3", "vertex 1000000000", "1000000000 vertices")
    bad("negative", "vertex 3", "vertex -3", "vertex count `-3` is not a whole number")
    bad("strange_format", "format ascii 1.0", "format utf8 1.0", "format `utf8` unknown")
    bad("no_end", "end_header", "the_end", "no `end_header`")
    put("ply/nan.ply", few[:-4] + struct.pack("<f", float("nan")), "`rot_3` of vertex 2 is NaN")
    put("ply/short.ply", few[:-1], "3 vertices of 248 bytes announced")
    put("ply/empty.ply", b"", "does not begin with `ply`")


def spz() -> None:
    """Versions, degrees, lengths."""
    for version in (2, 3):
        put(f"spz/niantic_v{version}.spz", (DATA / f"niantic_v{version}.spz").read_bytes())
    whole = gzip.decompress((DATA / "niantic_v3.spz").read_bytes())

    def packed(content: bytes) -> bytes:
        return gzip.compress(content, 6, mtime=0)

    header = struct.unpack("<IIIBBBB", whole[:16])
    magic, version, count, degree, bits, flags, zero = header

    def named(name: str, expected: str = "ok", body: bytes = whole[16:], **changed: int) -> None:
        values = {"magic": magic, "version": version, "count": count, "degree": degree, "bits": bits}
        values |= {"flags": flags, "zero": zero, **changed}
        put(f"spz/{name}.spz", packed(struct.pack("<IIIBBBB", *values.values()) + body), expected)

    named("degree_0", body=whole[16 : 16 + count * 20], degree=0)
    named("extensions", body=whole[16:] + b"vendor", flags=flags | 2)
    named("version_1", "SPZ version 1 found, versions 2 and 3 are read", version=1)
    named("degree_9", "harmonics of degree 9 found", degree=9)
    named("bits_40", "40 bits behind the point found", bits=40)
    named("zero", "no Gaussians", count=0)
    named("billion", "1000000000 Gaussians announced in a file of", count=1_000_000_000)
    named("short", "truncated", body=whole[16:-1])
    named("long", "more bytes follow", body=whole[16:] + b"x")
    named("no_magic", "does not begin with `NGSP`", magic=1)
    half = (DATA / "niantic_v3.spz").read_bytes()
    put("spz/half.spz", half[: len(half) // 2], "truncated or broken")
    # Version 4 is not wrapped in gzip: its magic number comes first.
    put("spz/version_4.spz", struct.pack("<III", magic, 4, count) + bytes(40), "version 4 or later")
    put("spz/not_gzip.spz", b"PK\x03\x04" + bytes(60), "not compressed with gzip")


def colmap_text() -> None:
    """`NAME-what.txt` stands for `NAME.txt` of the photo set."""
    files = {p.stem: p.read_text() for p in (DATA / "colmap_text" / "sparse" / "0").glob("*.txt")}
    for name, text in files.items():
        put(f"colmap_text/{name}-whole.txt", text)

    def camera(name: str, model: str, expected: str = "ok") -> None:
        put(f"colmap_text/cameras-{name}.txt", f"3 {model}\n", expected)

    camera("radial", "SIMPLE_RADIAL 32 24 27.7 16 12 0.05")
    camera("opencv", "OPENCV 32 24 27.7 27.7 16 12 0.1 0.01 0.001 -0.001")
    camera("fisheye", "OPENCV_FISHEYE 32 24 27.7 27.7 16 12 0 0 0 0", "OPENCV_FISHEYE")
    camera("unknown", "HOLGA 32 24 27.7 16 12", "camera model `HOLGA` unknown")
    camera("few", "PINHOLE 32 24 27.7 27.7", "camera model PINHOLE has 4 parameters, found 2")
    camera("huge", "PINHOLE 99999999999 24 27.7 27.7 16 12", "camera 3")
    put("colmap_text/cameras-none.txt", "# nothing\n", "cameras.txt lacks")
    put("colmap_text/cameras-twice.txt", 2 * "3 PINHOLE 32 24 27.7 27.7 16 12\n", "camera 3 is there twice")
    images = files["images"]
    put("colmap_text/images-none.txt", "# nothing\n", "no views found")
    put("colmap_text/images-escapes.txt", images.replace("view 001", "../view 001"), "leaves the data folder")
    put("colmap_text/images-absolute.txt", images.replace("view 001", "/view 001"), "leaves the data folder")
    put("colmap_text/images-twice.txt", images.replace("view 001", "view 002"), "is listed twice")
    put("colmap_text/images-missing.txt", images.replace("view 001", "view 009"), "view 009.png")
    put(
        "colmap_text/images-singular.txt", "1 0 0 0 0 0 0 1 3 view 000.png\n\n", "its quaternion has length 0"
    )
    put("colmap_text/points3D-none.txt", "# nothing\n", "no points found")
    put("colmap_text/points3D-nan.txt", "1 nan 0 0 1 2 3 0.5\n", "expected finite numbers")
    put("colmap_text/points3D-latin.txt", b"1 0 0 0 1 2 3 \xff\n", "is not UTF-8")


def colmap_binary() -> None:
    """`NAME-what.bin` stands for `NAME.bin` of the photo set."""
    files = {p.stem: p.read_bytes() for p in (DATA / "colmap_binary" / "sparse" / "0").glob("*.bin")}
    for name, content in files.items():
        put(f"colmap_binary/{name}-whole.bin", content)
        put(f"colmap_binary/{name}-short.bin", content[:-1], f"{name}.bin")
        put(f"colmap_binary/{name}-billion.bin", struct.pack("<Q", 10**9) + content[8:], f"{name}.bin")
        put(f"colmap_binary/{name}-long.bin", content + b"more", "4 bytes follow the last of the")
    put("colmap_binary/points3D-none.bin", struct.pack("<Q", 0), "no points found")
    put("colmap_binary/images-none.bin", struct.pack("<Q", 0), "no views found")
    cameras = bytearray(files["cameras"])
    cameras[12:16] = struct.pack("<i", 77)
    put("colmap_binary/cameras-unknown.bin", bytes(cameras), "camera model number 77 unknown")


def nerfstudio() -> None:
    """Each stands for `transforms.json` of the photo set."""
    whole = json.loads((DATA / "nerfstudio" / "transforms.json").read_text())
    frame = whole["frames"][0]

    def named(name: str, expected: str = "ok", **changed: object) -> None:
        values = {k: v for k, v in {**whole, **changed}.items() if v is not None}
        put(f"nerfstudio/{name}.json", json.dumps(values), expected)

    def one(name: str, expected: str = "ok", **changed: object) -> None:
        named(name, expected, frames=[{**frame, **changed}])

    named("whole")
    named("instant_ngp", fl_x=None, fl_y=None, cx=None, cy=None, camera_angle_x=1.05, aabb_scale=16)
    named("no_size", w=None, h=None)
    named("no_points", ply_file_path=None)
    named("distorted", k1=0.05, k2=-0.01, p1=0.001, p2=0.001)
    one("own_intrinsics", fl_x=25.0, fl_y=25.0, w=32, h=24)
    one("no_suffix", file_path="images/view 000")
    named("no_frames", "`frames` is empty", frames=[])
    named("fisheye", "camera_model OPENCV_FISHEYE is not supported", camera_model="OPENCV_FISHEYE")
    named("no_focal", "neither `fl_x` nor `camera_angle_x`", fl_x=None)
    named("half_pixel", "expected a whole number of pixels", w=32.5)
    one("escapes", "leaves the data folder", file_path="images/../../view 000.png")
    one("absolute", "leaves the data folder", file_path="/etc/hostname")
    one("missing", "view 009.png", file_path="images/view 009.png")
    one("singular", "is no rigid pose", transform_matrix=[[0.0] * 4] * 3 + [[0.0, 0.0, 0.0, 1.0]])
    one("three_columns", "four rows of four numbers", transform_matrix=[[1.0] * 3] * 4)
    put("nerfstudio/not_json.json", "{", "not the JSON that was expected")
    put("nerfstudio/deep.json", "[" * 2000, "not the JSON that was expected")


for reader in (ply, spz, colmap_text, colmap_binary, nerfstudio):
    (HERE / reader.__name__).mkdir(exist_ok=True)
    reader()
lines = sorted(f"{name}\t{expected}\n" for name, expected in EXPECTED)
(HERE / "expected.txt").write_text("".join(lines))
