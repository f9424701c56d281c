"""24 observations of a set with the masks that the shipped segmenter returns: chosen by a seed, not by looks.

Every label is prompted; each object found is outlined and named with its most likely label and score.

    python benches/segmenter_sheet.py --out F.jpg [--episodes eval] [--seed 0] [--weights F.onnx]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from fuse_grounding.environment import TabletopEnvironment, load_episodes
from fuse_grounding.perception.embedded import EmbeddedSegmenter

COUNT, COLUMNS, SIZE = 24, 4, (480, 360)
LEAST_SCORE = 0.3
COLOURS = ((40, 40, 230), (230, 120, 30), (40, 170, 40), (200, 40, 200), (30, 170, 230), (170, 150, 20))


def tile(segmenter: EmbeddedSegmenter, rgb: np.ndarray, head: str) -> np.ndarray:
    """A picture (480, 640, 3) with what was found in it, as BGR of `SIZE`."""
    found = segmenter.candidates(np.ascontiguousarray(rgb))
    picture = rgb[..., ::-1].copy()
    words = []
    for k, mask in enumerate(found.masks):
        best = int(found.scores[k].argmax())
        if found.scores[k, best] < LEAST_SCORE:
            continue
        colour = COLOURS[k % len(COLOURS)]
        outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        picture[mask] = (0.65 * picture[mask] + 0.35 * np.array(colour)).astype(np.uint8)
        cv2.drawContours(picture, outlines, -1, colour, 2)
        rows, columns = np.nonzero(mask)
        text = f"{segmenter.labels[best]} {found.scores[k, best]:.2f}"
        words.append((text, int(columns.mean()) - 30, int(rows.min()) - 4))
    picture = cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA)
    factor = SIZE[0] / rgb.shape[1]
    for text, x, y in [(t, int(x * factor), int(y * factor)) for t, x, y in words] + [(head, 4, SIZE[1] - 6)]:
        at = (min(max(x, 2), SIZE[0] - 90), max(y, 10))
        for colour, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.38, colour, width, cv2.LINE_AA)
    return picture


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--episodes", default="eval")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--weights")
    arguments = parser.parse_args()
    segmenter = EmbeddedSegmenter(arguments.weights)
    episodes, rng = load_episodes(arguments.episodes), np.random.default_rng(arguments.seed)
    tiles = []
    for k in sorted(rng.choice(len(episodes), COUNT, replace=len(episodes) < COUNT)):
        node, pitch = int(rng.integers(36)), int(rng.integers(3))
        rgb = TabletopEnvironment(episodes[k]).render_at(node, pitch).rgb
        tiles.append(tile(segmenter, rgb, f"{episodes[k].episode_id}, node {node}, pitch {15 + 15 * pitch}"))
    sheet = np.vstack([np.hstack(tiles[i : i + COLUMNS]) for i in range(0, COUNT, COLUMNS)])
    cv2.imwrite(str(arguments.out), sheet, [cv2.IMWRITE_JPEG_QUALITY, 85])
    print(f"{arguments.out}: {COUNT} observations of {arguments.episodes}, seed {arguments.seed}")


if __name__ == "__main__":
    main()
