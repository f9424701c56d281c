"""The plots of a dataset card, as PNG files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fuse_grounding.environment import Episode
from fuse_grounding.errors import InputError
from fuse_grounding.extras import require

_BLUE, _ORANGE = "#3b6ea5", "#d9822b"


def draw(
    name: str, episodes: Sequence[Episode], counted: dict[str, np.ndarray], out: Path
) -> list[tuple[str, str]]:
    """Writes the plots into `out`; a caption and a file name for each.

    Raises InputError without matplotlib.
    """
    require("matplotlib", "plot", "fuse episodes card")
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    drawn = []
    with pyplot.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        for caption, part, make in (
            ("verbs, categories, scenes", "contents", lambda: _contents(pyplot, episodes)),
            (
                "where the search starts and what is hidden",
                "start",
                lambda: _start(pyplot, episodes, counted),
            ),
            ("the start against the best view", "views", lambda: _views(pyplot, counted)),
        ):
            figure = make()
            path = out / f"{name}_{part}.png"
            try:
                # Without the version of the program that drew them, pictures stay alike.
                figure.savefig(path, dpi=100, metadata={"Software": None})
            except OSError as error:
                raise InputError(f"cannot write {path}: {error.strerror}") from None
            pyplot.close(figure)
            drawn.append((caption, path.name))
    return drawn


def _whole_numbers() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(integer=True)


def _bars(axes: Any, counts: Counter[str], title: str, color: str = _BLUE) -> None:
    names = sorted(sorted(counts, reverse=True), key=lambda n: counts[n])
    slim = min(0.8, 0.08 * len(names))  # few bars need not fill the field
    axes.barh([n.replace("_", " ") for n in names], [counts[n] for n in names], slim, color=color)
    axes.margins(y=0.01 if len(names) >= 10 else 0.1)
    axes.xaxis.set_major_locator(_whole_numbers())
    axes.set_title(title)
    axes.set_xlabel("episodes")


def _contents(pyplot: Any, episodes: Sequence[Episode]) -> Any:
    figure, ((verbs, targets), (scenes, others)) = pyplot.subplots(
        2, 2, figsize=(10, 11), height_ratios=(1, 1.2), layout="constrained"
    )
    _bars(verbs, Counter(e.verb for e in episodes), "verbs")
    _bars(targets, Counter(e.categories[e.data["target"]] for e in episodes), "categories of targets")
    _bars(scenes, Counter(e.scene_id for e in episodes), "scenes")
    on_table = Counter(c for e in episodes for c in set(e.categories.values()))
    _bars(others, on_table, "categories on the table", _ORANGE)
    others.tick_params(axis="y", labelsize=7)
    targets.tick_params(axis="y", labelsize=7)
    return figure


def _counts(axes: Any, values: np.ndarray, label: str) -> None:
    axes.hist(values, np.arange(values.min() - 0.5, values.max() + 1.5), color=_BLUE, rwidth=0.9)
    axes.set_xlabel(label)
    axes.set_ylabel("episodes")
    axes.xaxis.set_major_locator(_whole_numbers())
    axes.yaxis.set_major_locator(_whole_numbers())


def _start(pyplot: Any, episodes: Sequence[Episode], counted: dict[str, np.ndarray]) -> Any:
    figure, axes = pyplot.subplots(2, 3, figsize=(11, 6), layout="constrained")
    _counts(axes[0, 0], counted["distractors"], "distractors")
    _counts(axes[0, 1], counted["near misses"], "near misses among them")
    _counts(axes[0, 2], counted["valid objects"], "valid objects on the table")
    axes[1, 0].hist(100 * counted["visible share at the start"], np.arange(5, 61, 5), color=_BLUE, rwidth=0.9)
    axes[1, 0].set_xlabel("target visible at the start, %")
    axes[1, 0].set_ylabel("episodes")
    axes[1, 0].yaxis.set_major_locator(_whole_numbers())
    _counts(axes[1, 1], counted["moves to the first good view"], "moves to the first good view")
    starts = np.zeros((3, 36))
    for e in episodes:
        starts[e.start[1], e.start[0]] += 1
    image = axes[1, 2].imshow(starts, aspect="auto", cmap="Blues", origin="lower")
    axes[1, 2].set_yticks([0, 1, 2], ["15°", "30°", "45°"])
    axes[1, 2].set_xlabel("ring node of the start (10° each)")
    axes[1, 2].set_ylabel("pitch down")
    figure.colorbar(image, ax=axes[1, 2], label="episodes", ticks=_whole_numbers())
    return figure


def _views(pyplot: Any, counted: dict[str, np.ndarray]) -> Any:
    figure, (shares, pixels) = pyplot.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    shares.scatter(
        100 * counted["visible share at the start"],
        100 * counted["visible share in the best view"],
        s=14,
        alpha=0.6,
        color=_BLUE,
    )
    shares.axhline(80, color="grey", lw=0.8, ls="--")
    shares.set_xlabel("target visible at the start, %")
    shares.set_ylabel("target visible in the best view, %")
    pixels.scatter(
        np.maximum(counted["pixels at the start"], 1),
        counted["pixels in the best view"],
        s=14,
        alpha=0.6,
        color=_ORANGE,
    )
    pixels.axhline(500, color="grey", lw=0.8, ls="--")
    pixels.set_xscale("log")
    pixels.set_yscale("log")
    pixels.set_xlabel("pixels of the target at the start")
    pixels.set_ylabel("pixels of the target in the best view")
    return figure
