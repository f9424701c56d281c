"""FUSE against other trainers of Gaussians on a CPU: one scene, one resolution, one table.

    python benches/peers.py --sources DIR            # checkouts in DIR: OpenSplat, torch-splatting, brush
    python benches/peers.py --sources DIR --reuse    # peers' figures from an earlier run, ours anew
    python benches/peers.py --sources DIR --only OpenSplat fuse --measure iterations

All train on 36 photos, 640x360, of a scene that is rendered here and registered by COLMAP, from the same
points, with two threads; six photos are held out. Peers' maps are drawn by our renderer, over the background
that they were trained with, and compared with the held-out photos by our PSNR.

- iterations: seconds an iteration at the same Gaussians without densification: from the points, and from
  OpenSplat's maps at 1,000 and 2,500 iterations where there are any. Wants a machine that does nothing else.
- quality: OpenSplat's own training for 2,500 iterations, at full resolution, and ours in both schedules.
  OpenSplat's time is its iterations times the seconds an iteration above; ours is the clock's.
- judge: the maps of a training of OpenSplat that was killed or still goes on, as far as it has come.

Results are kept in the build folder, one JSON a program and measurement.
"""

from __future__ import annotations

import argparse
import datetime
import json
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

from peers import brush, opensplat, scene, table, torch_splatting
from peers.process import Failed, environment, run

ITERATIONS, EVERY = 2500, 250
FAST = (100, 150, 200, 300, 400, 550, 700, 1000, 1400, 1900, 2500)
"""Lengths of whole `fast` trainings: its schedule depends on where it ends."""
TIMED = {table.OPENSPLAT: (25, 5), table.TORCH: (3, 1), table.BRUSH: (5, 15)}
"""Iterations that are timed, and before them those that are not; of Brush a short and a long run."""
BRUSH_MINUTES = 20.0
"""Its build is nearly 800 crates."""
OURS = Path(__file__).parent / "peers" / "ours.py"


class Store:
    """Measurements in JSON files; says which are from this run."""

    def __init__(self, folder: Path, reuse: bool):
        self.folder, self.reuse = folder, reuse
        self.fresh: set[tuple[str, str]] = set()
        folder.mkdir(parents=True, exist_ok=True)

    def _path(self, name: str, what: str) -> Path:
        return self.folder / f"{name}.{what}.json"

    def kept(self, name: str, what: str) -> bool:
        """Whether a peer's figures are there and wanted."""
        return self.reuse and name != "fuse" and self._path(name, what).is_file()

    def known(self, name: str) -> bool:
        """Whether an earlier run found that a peer cannot be measured."""
        return self._path(name, "failed").is_file()

    def put(self, name: str, what: str, value: dict[str, Any]) -> None:
        """Keeps a measurement with its date."""
        value = {**value, "date": datetime.datetime.now().isoformat(timespec="minutes")}
        self._path(name, what).write_text(json.dumps(value, indent=1))
        self.fresh.add((name, what))

    def all(self) -> dict[str, dict[str, Any]]:
        """Everything, by program and measurement."""
        found: dict[str, dict[str, Any]] = {}
        for path in sorted(self.folder.glob("*.json")):
            name, what, _ = path.name.rsplit(".", 2)
            value = json.loads(path.read_text())
            if what == "failed":
                found.setdefault(name, {})["failed"] = value["why"]
            else:
                found.setdefault(name, {})[what] = value
        return found

    def earlier(self) -> list[str]:
        """What the table has from earlier runs."""
        return [
            f"{name} ({what}, {value['date']})"
            for name, measured in self.all().items()
            for what, value in measured.items()
            if isinstance(value, dict) and (name, what) not in self.fresh
        ]

    def failed(self, name: str, why: str) -> None:
        """What the table says instead of figures."""
        self.put(name, "failed", {"why": why})

    def works(self, name: str) -> None:
        """Forgets an earlier failure."""
        self._path(name, "failed").unlink(missing_ok=True)


def ours(log: Path, *arguments: Any) -> Any:
    """`peers/ours.py` in a process of its own."""
    ran = run([sys.executable, OURS, *arguments], log, environment())
    found = json.loads(ran.lines[-1][1])
    return found | {"others": ran.others} if isinstance(found, dict) else found


def measure_opensplat(build: Path, sources: Path, measure: list[str], store: Store) -> None:
    """Both measurements of OpenSplat; a killed training's maps count as far as they go."""
    folder, name, photos = build / "opensplat", table.OPENSPLAT, build / "scene"
    program = opensplat.build(sources / "OpenSplat", folder)
    if "quality" in measure and not store.kept(name, "quality"):
        ran = opensplat.quality(program, photos, folder / "run", ITERATIONS, EVERY)
        store.put(name, "quality", {"peak_mib": ran.peak_mib, **judged(build)})
    elif "judge" in measure and opensplat.maps(folder / "run"):
        store.put(name, "quality", judged(build))
    if "iterations" in measure and not store.kept(name, "iterations"):
        count, discard = TIMED[name]
        found = opensplat.maps(folder / "run")
        starts: dict[int, Path | None] = {0: None} | {m: found[m] for m in table.MILESTONES if m in found}
        rows = [
            opensplat.iteration(program, photos, folder / "timed", start, at, count, discard)
            | {"after": at, "gaussians": gaussians_of(build, start)}
            for at, start in starts.items()
        ]
        store.put(name, "iterations", {"rows": rows})


def judged(build: Path) -> dict[str, Any]:
    """Held-out PSNR and size of every map that OpenSplat left."""
    maps = opensplat.maps(build / "opensplat" / "run")
    background = ",".join(str(v) for v in opensplat.BACKGROUND)
    found = ours(build / "ours" / "judge.log", "judge", build / "scene", background, *maps.values())
    return {"maps": {str(i): row for i, row in zip(maps, found, strict=True)}}


def gaussians_of(build: Path, ply: Path | None) -> int:
    """How many a training starts from."""
    from fuse_grounding.reconstruction.dataset import Dataset
    from fuse_grounding.splat import Gaussians

    return len(Gaussians.from_ply(ply)) if ply else len(Dataset(build / "scene" / "train", 1, 0).points()[0])


def measure_torch(build: Path, sources: Path, measure: list[str], store: Store) -> None:
    """Seconds an iteration; a whole training would take hours."""
    folder, name = build / "torch-splatting", table.TORCH
    copy = torch_splatting.build(sources / "torch-splatting", folder)
    if "iterations" in measure and not store.kept(name, "iterations"):
        row = torch_splatting.iteration(copy, build / "scene", folder, *TIMED[name])
        store.put(name, "iterations", {"rows": [row]})


def measure_brush(build: Path, sources: Path, measure: list[str], store: Store) -> None:
    """Seconds an iteration, on whatever adapter Vulkan offers."""
    folder, name = build / "brush", table.BRUSH
    program = brush.build(sources / "brush", folder, BRUSH_MINUTES)
    if "iterations" in measure and not store.kept(name, "iterations"):
        row = brush.iteration(program, build / "scene", folder, *TIMED[name])
        store.put(name, "iterations", {"rows": [row | {"gaussians": gaussians_of(build, None)}]})


def measure_ours(build: Path, measure: list[str], store: Store) -> None:
    """At OpenSplat's numbers of Gaussians, and whole trainings in both schedules."""
    log, photos = build / "ours", build / "scene"
    found = opensplat.maps(build / "opensplat" / "run")
    if "iterations" in measure:
        starts = [None, *(found[m] for m in table.MILESTONES if m in found)]
        rows = [ours(log / "iteration.log", "iteration", photos, *([s] if s else [])) for s in starts]
        store.put("fuse", "iterations", {"rows": rows})
    if "quality" in measure:
        official = ours(log / "official.log", "quality", photos, "official", ITERATIONS, "--every", 50)
        ends = [ours(log / "fast.log", "quality", photos, "fast", n) for n in FAST]
        fast = {"curve": [e["curve"][-1] for e in ends], "peak_mib": max(e["peak_mib"] for e in ends)}
        store.put("fuse", "quality", {"official": official, "fast": fast})


def disturbed(results: dict[str, dict[str, Any]]) -> list[str]:
    """Timings beside which other processes took more than a twentieth of a core: not to be trusted."""
    return [
        f"NOT QUIET: {row['others']:.2f} cores were taken by others while {name} was timed"
        for name, measured in results.items()
        for row in measured.get("iterations", {}).get("rows", [])
        if row.get("others", 0) > 0.05
    ]


def machine() -> str:
    """Processor, cores, revision of ours."""
    info = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").is_file() else []
    model = next((line.split(":")[1].strip() for line in info if line.startswith("model name")), "")
    cores = sum(line.startswith("processor") for line in info)
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=OURS.parent, capture_output=True, text=True, check=False
    ).stdout.strip()
    return f"{model or platform.processor()}, {cores} cores, FUSE {commit or 'unknown'}"


def main() -> None:
    """Builds, measures, prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sources", type=Path, required=True, help="folder with the peers' checkouts")
    names = [table.OPENSPLAT, table.TORCH, table.BRUSH, "fuse"]
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    parser.add_argument("--measure", nargs="+", choices=["iterations", "quality", "judge"])
    parser.add_argument("--reuse", action="store_true", help="keep peers' earlier figures")
    parser.add_argument("--build-dir", type=Path, default=Path("runs/peers"))
    parser.add_argument("--scene", default="train_workshop")
    options = parser.parse_args()
    measure = options.measure or ["quality", "iterations"]
    build = options.build_dir.resolve()
    scene.make(build / "scene", options.scene)
    store = Store(build / "results", options.reuse)
    sources = options.sources.resolve()
    peers = {table.OPENSPLAT: measure_opensplat, table.TORCH: measure_torch, table.BRUSH: measure_brush}
    for name, work in peers.items():
        if name not in options.only or (options.reuse and store.known(name)):
            continue
        try:
            if not any((sources / folder).is_dir() for folder in (name, name.lower())):
                raise Failed(f"no sources in {sources / name}")
            work(build, sources, measure, store)
            store.works(name)
        except (Failed, OSError) as error:
            store.failed(name, str(error))
    if "fuse" in options.only:
        measure_ours(build, measure, store)
    text = table.render(store.all())
    print(f"{machine()}\n\n{text}")
    if store.earlier():
        print("\nFrom earlier runs on this machine: " + "; ".join(store.earlier()) + ".")
    for line in disturbed(store.all()):
        print(line)
    (build / "table.md").write_text(text + "\n")
    (build / "table.json").write_text(json.dumps({"machine": machine(), "results": store.all()}, indent=1))


if __name__ == "__main__":
    main()
