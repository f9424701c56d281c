"""The shipped segmenter on objects that nobody here made: scans, artists' meshes, low-poly kits, bare shapes.

Each object lies in the middle of the development scene's table in its likeliest resting pose, seven shipped
development objects around it, and is seen from six places, 30 and 45 degrees down. By style: how well any
mask covers it, and, where its category is one that the network knows, whether the most likely label of that
mask is right. Nothing is tuned on it.

    python benches/real_objects.py --objects DIR [--weights F.onnx] [--sheet F.jpg] [--json]

DIR has `manifest.csv` (columns id, category, style, glb) and the files it names.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from fuse_grounding import _core
from fuse_grounding.environment import load_episodes
from fuse_grounding.environment.episodes import DATA
from fuse_grounding.errors import InputError
from fuse_grounding.perception.embedded import EmbeddedSegmenter
from fuse_grounding.training.segmenter_score import overlaps

SAME = {
    "books": "book",
    "bottle": "water_bottle",
    "cup": "mug",
}
"""Categories of the manifest under the name that the catalogue has for them."""
VIEWS = [(node, pitch) for node in range(0, 36, 6) for pitch in (1, 2)]
LEAST_PIXELS = 500
AROUND = tuple(f"{c}_dev_0" for c in ("mug", "sponge", "fork", "stapler", "bowl", "ruler", "can"))
TABLE, RADIUS = 0.76, 0.45
"""Height of the development scene's table and distance of what lies around, metres."""
SHEET_COLUMNS, SHEET_SIZE = 8, (240, 180)


def pictures(row: dict[str, str], folder: Path) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """(480, 640, 3) pictures and (480, 640) masks of one object in the views that show enough of it."""
    one = _core.ImportedObject(folder / row["glb"], row["category"], "dev", 1.0, None, row["id"])
    episode = json.loads(load_episodes("dev")[0].text)
    catalogue = json.loads((DATA / "objects" / "catalogue.json").read_text())["objects"]
    around = {o["id"]: o for o in catalogue if o["id"] in AROUND}
    placed = [placement(1, one.record(), 0.0, 0.0)]
    for k, name in enumerate(AROUND):
        angle = 2 * np.pi * k / len(AROUND)
        placed.append(placement(k + 2, around[name], RADIUS * np.cos(angle), RADIUS * np.sin(angle)))
    episode["objects"] = placed
    episode |= {
        "target": 1,
        "valid_target_ids": [1],
        "distractor_ids": [o["instance_id"] for o in placed[1:]],
    }
    with tempfile.TemporaryDirectory() as library:
        one.save(library, b"", [], True)
        stage = _core.Stage(DATA / "objects", DATA / "scenes.json", [library])
        world = _core.World(json.dumps(episode), stage)
        for node, pitch in VIEWS:
            rgb, _, ids = world.render(node, pitch)
            if np.count_nonzero(ids == 1) >= LEAST_PIXELS:
                yield rgb, ids == 1


def placement(instance: int, record: dict, x: float, y: float) -> dict:
    """An object of an episode, in its likeliest resting pose on the table at (x, y) metres."""
    pose = record["resting"][0]
    return {
        "instance_id": instance,
        "model_id": record["id"],
        "category": record["category"],
        "translation": [x, y, TABLE + pose["height"]],
        "rotation": dict(zip("xyzw", pose["quaternion"], strict=True)),
    }


def seen(
    segmenter: EmbeddedSegmenter, rgb: np.ndarray, truth: np.ndarray
) -> tuple[float, str, np.ndarray | None]:
    """The best mask's overlap with an object, that mask, and its label where it overlaps by half."""
    found = segmenter.candidates(np.ascontiguousarray(rgb))
    if not len(found.masks):
        return 0.0, "", None
    iou = overlaps(found.masks, truth[None])[:, 0]
    best = int(iou.argmax())
    label = segmenter.labels[int(found.scores[best].argmax())] if iou[best] >= 0.5 else ""
    return float(iou[best]), label, found.masks[best]


def drawn(rgb: np.ndarray, mask: np.ndarray | None, text: str) -> np.ndarray:
    """A small picture with the mask's outline and a line of text."""
    picture = rgb[..., ::-1].copy()
    if mask is not None:
        outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, outlines, -1, (0, 0, 255), 3)
    picture = cv2.resize(picture, SHEET_SIZE, interpolation=cv2.INTER_AREA)
    cv2.putText(picture, text, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(picture, text, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255, 255, 255), 1, cv2.LINE_AA)
    return picture


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--objects", type=Path, required=True)
    parser.add_argument("--weights")
    parser.add_argument("--sheet", type=Path, help="one view of every object of a known category")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    segmenter = EmbeddedSegmenter(arguments.weights)
    with (arguments.objects / "manifest.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    styles: dict[str, list[tuple[str, str, float, str]]] = {}
    tiles, refused = [], []
    for row in rows:
        category = SAME.get(row["category"], row["category"])
        try:
            views = list(pictures(row, arguments.objects))
        except InputError as error:
            refused.append(f"{row['id']}: {error}")
            continue
        for k, (rgb, truth) in enumerate(views):
            overlap, label, mask = seen(segmenter, rgb, truth)
            styles.setdefault(row["style"], []).append((row["id"], category, overlap, label))
            if k == 2 and category in segmenter.labels:
                tiles.append(drawn(rgb, mask, f"{category}: {label or 'nothing'}"))
    figures = {style: summary(found, segmenter.labels) for style, found in sorted(styles.items())}
    if arguments.sheet is not None:
        tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % SHEET_COLUMNS)
        lines = [np.hstack(tiles[i : i + SHEET_COLUMNS]) for i in range(0, len(tiles), SHEET_COLUMNS)]
        cv2.imwrite(str(arguments.sheet), np.vstack(lines))
    if arguments.json:
        print(json.dumps({"styles": figures, "refused": refused}, indent=1))
        return
    print(f"{'style':20} objects  views  IoU any label  found  known: objects  views  label right")
    for style, f in figures.items():
        print(
            f"{style:20} {f['objects']:7d}  {f['views']:5d}  {f['iou_any_label']:13.3f}  {f['found']:5.3f}"
            f"  {f['known_objects']:14d}  {f['known_views']:5d}  {f['label_right']:11.3f}"
        )
    for line in refused:
        print(f"left out: {line}")


def summary(found: list[tuple[str, str, float, str]], labels: tuple[str, ...]) -> dict[str, float | int]:
    """Means over the views of a style; `found`: share of views with a mask that overlaps by half."""
    known = [f for f in found if f[1] in labels]
    return {
        "objects": len({f[0] for f in found}),
        "views": len(found),
        "iou_any_label": float(np.mean([f[2] for f in found])),
        "found": float(np.mean([f[2] >= 0.5 for f in found])),
        "known_objects": len({f[0] for f in known}),
        "known_views": len(known),
        "label_right": float(np.mean([f[3] == f[1] for f in known])) if known else float("nan"),
    }


if __name__ == "__main__":
    main()
