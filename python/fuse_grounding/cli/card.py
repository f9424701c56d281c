"""A set's dataset card: what is in it, how hard it is, how it was made; `card_plots` has the pictures."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from fuse_grounding._core import kin_categories, statistics_path
from fuse_grounding.cli import card_plots
from fuse_grounding.environment import Episode, episodes_path, load_episodes, load_generation
from fuse_grounding.environment.episodes import (
    knobs,
    phrasings,
    stage,
    valid_categories,
)
from fuse_grounding.environment.sets import SETS, timing_path
from fuse_grounding.errors import InputError
from fuse_grounding.record import write_atomically

KNOBS: dict[str, str] = {
    "start_fraction": "bounds of the target's visible share at the start",
    "start_unoccluded_px": "pixels it would have there if it stood alone, at least",
    "least_moves": "actions from the start to the first good view, at least",
    "near_misses": "distractors that look or are handled like it, at most",
    "tall_occluders": "distractors tall enough to hide something, at most",
    "tall_from_m": "height from which a thing is tall, metres",
    "second_target": "chance of a further valid object, for each of two",
    "distractors": "fewest and most distractors; none: as the scene says",
    "good_px": "visible pixels in some reachable view, at least",
    "good_fraction": "visible share in that view, at least",
}
TURNS: tuple[tuple[str, Any], ...] = (
    ("start_fraction", [0.05, 0.2]),
    ("start_fraction", [0.4, 0.6]),
    ("start_unoccluded_px", 2000),
    ("least_moves", 1),
    ("least_moves", 4),
    ("near_misses", 0),
    ("near_misses", 8),
    ("tall_occluders", 0),
    ("tall_occluders", 8),
    ("second_target", 0.0),
    ("second_target", 1.0),
    ("distractors", [7, 8]),
    ("distractors", [13, 14]),
    ("good_px", 2000),
    ("good_fraction", 0.95),
)
"""Settings that the card compares with the defaults."""


def near_misses(episode: Episode) -> int:
    """Distractors that are of a kin with the target and not valid."""
    valid = set(valid_categories()[episode.verb])
    target = episode.categories[episode.data["target"]]
    kin = {c for group in kin_categories() if target in group for c in group} - valid
    return sum(episode.categories[i] in kin for i in episode.data["distractor_ids"])


def figures(episodes: Sequence[Episode]) -> dict[str, np.ndarray]:
    """What the card counts, one value an episode."""
    data = [e.data for e in episodes]
    return {
        "distractors": np.array([len(d["distractor_ids"]) for d in data]),
        "valid objects": np.array([len(d["valid_target_ids"]) for d in data]),
        "near misses": np.array([near_misses(e) for e in episodes]),
        "visible share at the start": np.array([d["start_fraction"] for d in data]),
        "visible share in the best view": np.array([d["best_fraction"] for d in data]),
        "pixels at the start": np.array([d["start_px"] for d in data]),
        "pixels in the best view": np.array([d["best_px"] for d in data]),
        "moves to the first good view": np.array([d["moves_to_good_view"] for d in data]),
    }


def write_card(file: str, out: Path, each: int) -> Path:
    """Writes out/NAME.md and its plots; `each` episodes are made for each setting of a knob.

    Raises InputError.
    """
    path = episodes_path(file)
    episodes, generation = load_episodes(file), load_generation(file)
    if not episodes:
        raise InputError(f"{path} has no episodes")
    name = path.name.removesuffix(".json.gz")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make folder {out}: {error.strerror}") from None
    counted = figures(episodes)
    plots = card_plots.draw(name, episodes, counted, out)
    parts = [
        f"# The episode set `{name}`",
        _summary(name, path, episodes, generation),
        _made(path, generation),
        "## What is in it",
        *(f"![{caption}]({file_name})" for caption, file_name in plots[:1]),
        _counts(episodes),
        "## How hard it is",
        _quantiles(counted),
        *(f"![{caption}]({file_name})" for caption, file_name in plots[1:]),
    ]
    if each:
        parts.append(_turns(generation, each))
    target = out / f"{name}.md"
    try:
        write_atomically(target, "\n\n".join(p for p in parts if p) + "\n")
    except OSError as error:
        raise InputError(f"cannot write {target}: {error.strerror}") from None
    return target


def _summary(name: str, path: Path, episodes: Sequence[Episode], generation: dict[str, Any] | None) -> str:
    purpose = f" It is {SETS[name].purpose}." if name in SETS and generation is not None else ""
    verbs, scenes = {e.verb for e in episodes}, {e.scene_id for e in episodes}
    return (
        f"{len(episodes)} searches for {len(verbs)} verbs in {len(scenes)} scenes; scenes and objects are "
        f"those of split `{episodes[0].split}`.{purpose} Everything below is written by "
        f"`fuse episodes card {name}`; [the world](../world.md) says what the words mean."
    )


def _made(path: Path, generation: dict[str, Any] | None) -> str:
    rows = [("file", f"`{path.name}`, {path.stat().st_size / 1e3:.0f} kB, SHA-256 `{_sha(path)}`")]
    beside = statistics_path(path)
    if beside.is_file():
        rows.append(
            ("statistics", f"`{beside.name}`, {beside.stat().st_size / 1e3:.0f} kB, SHA-256 `{_sha(beside)}`")
        )
    if generation is not None:
        g = generation
        rows.append(
            (
                "made by",
                f"`fuse episodes generate --split {g['set']} --count {g['count']} --seed {g['seed']}"
                f"{_knob_options(g['difficulty'])} --out {path.name}`",
            )
        )
        seconds = _seconds(path)
        if seconds is not None:
            rows.append(
                (
                    "time",
                    f"{seconds['generate_seconds']:.0f} s on {seconds['threads']} threads, "
                    f"{seconds['generate_seconds'] / g['count']:.2f} s an episode",
                )
            )
        thrown = sum(g["rejected"].values())
        rows.append(("layouts thrown away", f"{thrown}, {thrown / g['count']:.2f} for each episode kept"))
    table = _table(("", ""), rows)
    if generation is None or not generation["rejected"]:
        return table
    reasons = sorted(generation["rejected"].items(), key=lambda item: -item[1])
    return f"{table}\n\n{_table(('thrown away because', 'times'), reasons)}"


def _sha(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] + "…"


def _seconds(path: Path) -> dict[str, Any] | None:
    noted = timing_path(path)
    return json.loads(noted.read_text(encoding="utf-8")) if noted.is_file() else None


def _knob_options(difficulty: dict[str, Any]) -> str:
    defaults = json.loads(knobs())
    turned = {k: v for k, v in difficulty.items() if v != defaults[k]}
    return "".join(f" --knob '{k}={json.dumps(v)}'" for k, v in turned.items())


def _counts(episodes: Sequence[Episode]) -> str:
    targets = Counter(e.categories[e.data["target"]] for e in episodes)
    shown = Counter(c for e in episodes for c in e.categories.values())
    return (
        f"{len(targets)} categories are a target at least once, {len(shown)} stand on a table; "
        f"{len({e.query for e in episodes})} different queries are asked."
    )


def _quantiles(counted: dict[str, np.ndarray]) -> str:
    rows = []
    for what, values in counted.items():
        low, tenth, middle, ninetieth, high = np.quantile(values, [0, 0.1, 0.5, 0.9, 1])
        digits = 2 if "share" in what else 0
        rows.append((what, *(f"{v:.{digits}f}" for v in (low, tenth, middle, ninetieth, high))))
    return _table(("an episode's", "least", "10 %", "median", "90 %", "most"), rows)


def _turns(generation: dict[str, Any] | None, each: int) -> str:
    """What each knob moves: medians over `each` fresh episodes for every setting."""
    split = "eval" if generation is None else generation["split"]
    asked = stage().plan_episodes("knob", split, phrasings(split), each, 55005)
    rows = [("(defaults)", "", *_turned(asked, {}))]
    rows += [(f"`{knob}`", f"`{json.dumps(value)}`", *_turned(asked, {knob: value})) for knob, value in TURNS]
    header = (
        *("knob", "set to", "share at start", "px at start", "share at best", "px at best"),
        *("near misses", "moves", "thrown away"),
    )
    meanings = _table(
        ("knob", "what it is", "default"),
        [(f"`{k}`", what, f"`{json.dumps(json.loads(knobs())[k])}`") for k, what in KNOBS.items()],
    )
    return (
        "## The knobs\n\n"
        + meanings
        + f"\n\nWhat they move: medians over {each} fresh episodes of split `{split}` "
        "for each setting, asked for alike (near misses: mean; thrown away: layouts for each episode "
        "kept).\n\n" + _table(header, rows)
    )


def _turned(asked: list[tuple[str, str, str, int, str]], difficulty: dict[str, Any]) -> tuple[str, ...]:
    made = stage().make_episodes(valid_categories(), asked, knobs(difficulty))
    data = [json.loads(text) for text, _, _ in made]
    thrown = sum(sum(reasons.values()) for _, _, reasons in made) / len(made)
    near = float(np.mean([near_misses(Episode(text)) for text, _, _ in made]))
    return (
        f"{median(d['start_fraction'] for d in data):.2f}",
        f"{median(d['start_px'] for d in data):.0f}",
        f"{median(d['best_fraction'] for d in data):.2f}",
        f"{median(d['best_px'] for d in data):.0f}",
        f"{near:.1f}",
        f"{median(d['moves_to_good_view'] for d in data):.0f}",
        f"{thrown:.1f}",
    )


def _table(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)
