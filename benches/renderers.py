"""FUSE's renderer against what one would pick instead on a machine without a GPU: one scene, one table.

    python benches/renderers.py --install                 # peers into an environment of their own, once
    python benches/renderers.py                           # whatever is installed there
    python benches/renderers.py --peers-python PATH       # peers of another environment
    python benches/renderers.py --only FUSE MuJoCo        # rows whose names begin so

A brick room with a table and twelve textured objects, about 130,000 triangles, 640x480, 36 views of the
ring. Each renderer runs in a process of its own, with as many threads as it takes on this machine, and
draws the same GLB files with the same cameras (`renderers/scene.py`). Frames per second are means of the
rounds over all views; they include reading back to NumPy arrays, and neither loading nor set-up, which
is a column of its own. Ids and depths of every peer are compared with ours over all views: a wrong
camera or a missing object is said in the table. Ours keeps shadow and ambient occlusion from set-up, as
nothing in an episode moves; peers draw their shadow maps for each picture.

Peers that draw by OpenGL need Mesa's software driver: `apt-get install libegl1 libgl1 libgl1-mesa-dri`.
A peer that is not there gets a row that says so. Wants a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from renderers import runs, scene, table

VIEW = 3
"""Which of the views the sheet shows."""
FULL = (scene.WIDTH, scene.HEIGHT, 36)


def prepared(folder: Path, width: int, height: int, views: int) -> scene.Scene:
    """The scene; made anew where what makes it has changed."""
    from fuse_grounding.environment.episodes import DATA

    sources = [Path(scene.__file__).with_name(n) for n in ("scene.py", "room.py", "glb.py")]
    sources += [DATA / "scenes.json", DATA / "objects" / "catalogue.json"]
    digest = hashlib.sha256(b"".join(s.read_bytes() for s in sources) + f"{width} {height} {views}".encode())
    stamp = folder / "made.txt"
    if not stamp.is_file() or stamp.read_text() != digest.hexdigest():
        print("making the scene", file=sys.stderr)
        folder.mkdir(parents=True, exist_ok=True)
        scene.make(folder, width, height, views)
        stamp.write_text(digest.hexdigest())
    return scene.Scene.load(folder)


def compare(
    wanted: list[runs.Run], peers: Path, folder: Path, out: Path, rounds: int, limit: float, view: int = VIEW
) -> list[dict[str, Any]]:
    """Rows of the table; writes `sheet.png` into `out`. Pictures are compared with the first of ours."""
    rows, pictures, reference = [], [], None
    for k, run in enumerate(wanted):
        print(f"{run.name}, {run.light}", file=sys.stderr)
        kept = folder / f"pictures{k}.npz"
        row = runs.measure(run, peers, folder, kept, rounds, limit)
        rows.append(row)
        if "failed" in row:
            continue
        with np.load(kept) as stored:
            images = dict(stored)
        kept.unlink()
        if reference is None and run.ours:
            reference = images
        elif reference is not None:
            row["agreement"] = table.agreement(images, reference)
        if run.threads is None:
            pictures.append((f"{run.name}, {run.light}", images["rgb"][view]))
    if pictures:
        table.sheet(pictures).save(out / "sheet.png")
    return rows


def main() -> None:
    """Measures what is installed and prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--peers-python", type=Path, help="interpreter of an environment with the peers")
    parser.add_argument("--install", action="store_true", help="make that environment under build-dir first")
    parser.add_argument("--only", nargs="+", help="beginnings of names", metavar="NAME")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--limit", type=float, default=120.0, help="seconds for each renderer")
    parser.add_argument("--build-dir", type=Path, default=Path("runs/renderers"))
    parser.add_argument("--out", type=Path, help="folder for sheet.png (default: build-dir)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    options = parser.parse_args()
    build = options.build_dir.resolve()
    peers = options.peers_python or build / "venv" / "bin" / "python"
    if options.install:
        peers = runs.install(build / "venv")
    out = (options.out or build).resolve()
    out.mkdir(parents=True, exist_ok=True)
    drawn = prepared(build / "scene", *FULL)
    names = tuple(options.only or [""])
    wanted = [r for r in runs.RUNS if r.name.startswith(names)]
    if not wanted:
        parser.error(
            f"--only {' '.join(names)}: no renderer's name begins so; there are "
            + ", ".join(dict.fromkeys(r.name for r in runs.RUNS))
        )
    rows = compare(wanted, peers, build / "scene", out, options.rounds, options.limit)
    if options.json:
        print(json.dumps({"triangles": drawn.triangles, "rows": rows}, indent=1))
        return
    views, rounds = len(drawn.views), options.rounds
    print(f"{drawn.triangles:,} triangles, {FULL[0]}x{FULL[1]}, {views} views, mean of {rounds} rounds\n")
    print(table.render(rows))
    print(f"\nPictures: {out / 'sheet.png'}")


if __name__ == "__main__":
    main()
