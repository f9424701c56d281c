"""Episodes: reading, making and writing them, and the stage that they play on."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from fuse_grounding._core import (
    Stage,
    default_difficulty,
    read_episodes,
    read_statistics,
    statistics_path,
    write_episodes,
    write_statistics,
)
from fuse_grounding.arguments import instance_of, whole
from fuse_grounding.errors import InputError
from fuse_grounding.registry import unknown

DATA = Path(__file__).parent.parent / "data"
"""Objects, scenes, tables and episode sets that come with the package."""

DEFAULT_SCENE = "dev_kitchen"

HOLDING_OUT = ("eval",)
"""Splits whose queries are phrasings that no other split uses and no knowledge source lists."""

Asked = tuple[str, str, str, int, str]
"""Scene, verb, query, seed and id of an episode to be made."""


@dataclass(frozen=True)
class Episode:
    """One search: a query, a laid table, a start. `text` is its JSON, which is what is true of it.

    `statistics_text` is JSON too: what the 108 viewpoints see of each valid target, where that is known; it
    follows from the episode, so it is no part of what makes two of them equal.
    """

    text: str = field(repr=False)
    statistics_text: str | None = field(default=None, repr=False, compare=False)

    @cached_property
    def data(self) -> dict[str, Any]:
        """The JSON as a dictionary; see `fuse episodes show`."""
        return json.loads(self.text)

    @cached_property
    def statistics(self) -> list[dict[str, Any]] | None:
        """`statistics_text` as dictionaries, the sampled target first; None where it is not known."""
        return None if self.statistics_text is None else json.loads(self.statistics_text)

    @property
    def episode_id(self) -> str:
        """Unique in its set."""
        return self.data["episode_id"]

    @property
    def scene_id(self) -> str:
        """Name of the scene."""
        return self.data["scene_id"]

    @property
    def split(self) -> str:
        """train, dev or eval: of the scene and of the objects."""
        return self.data["split"]

    @property
    def seed(self) -> int:
        """What it was generated from."""
        return self.data["seed"]

    @property
    def query(self) -> str:
        """What is asked for, in words."""
        return self.data["query"]

    @property
    def verb(self) -> str:
        """The query's verb."""
        return self.data["verb"]

    @property
    def start(self) -> tuple[int, int]:
        """Node and pitch index of the first view."""
        return self.data["start_node"], self.data["start_pitch"]

    @property
    def categories(self) -> dict[int, str]:
        """Instance id -> category, of everything on the table."""
        return {o["instance_id"]: o["category"] for o in self.data["objects"]}


@cache
def stage() -> Stage:
    """The shipped objects and scenes; loaded once."""
    _threads_of.append(os.getpid())
    return Stage(DATA / "objects", DATA / "scenes.json")


_threads_of: list[int] = []
"""The process that started the native threads, once one has."""


def check_threads() -> None:
    """Raises InputError in a fork of a process that has loaded the stage.

    A fork has none of the threads that render, and would wait for them for ever.
    """
    if _threads_of and _threads_of[0] != os.getpid():
        raise InputError(
            "this process was forked from one that has rendered or made episodes, and has none of its "
            'threads; start it first, or with another context, such as AsyncVectorEnv(..., context="spawn")'
        )


@cache
def valid_categories() -> dict[str, list[str]]:
    """Verb -> valid categories: the ground truth of episodes, read by no knowledge source."""
    path = DATA / "validity.json"
    try:
        verbs = json.loads(path.read_text(encoding="utf-8"))["verbs"]
        table = {verb: [c for c, entry in row.items() if entry["valid"]] for verb, row in verbs.items()}
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path} is not a validity table: {error!r}") from error
    return {verb: valid for verb, valid in table.items() if valid}


@cache
def phrasings(split: str) -> dict[str, list[str]]:
    """Verb -> the words that it is asked with in a split; evaluation has phrasings of its own."""
    verbs = json.loads((DATA / "affordances.json").read_text(encoding="utf-8"))["verbs"]
    which = "queries_eval" if split in HOLDING_OUT else "queries"
    return {verb: list(verbs[verb][which]) for verb in valid_categories() if verb in verbs}


def scene_names() -> list[str]:
    """Names of all scenes."""
    return [name for name, _, _, _ in stage().scenes()]


def knobs(difficulty: Mapping[str, Any] | None = None) -> str:
    """Difficulty as JSON; values are checked when it is used. Raises InputError for an unknown knob."""
    defaults: dict[str, Any] = json.loads(default_difficulty())
    for name in difficulty or {}:
        if name not in defaults:
            raise InputError(unknown("difficulty", str(name), list(defaults)))
    return json.dumps({**defaults, **(difficulty or {})})


def make_episode(
    verb: str,
    scene: str | None = None,
    seed: int = 0,
    *,
    query: str | None = None,
    difficulty: Mapping[str, Any] | None = None,
) -> Episode:
    """A fresh episode for a verb, with its statistics. The same arguments give the same episode.

    `scene` defaults to dev_kitchen; `query` to the first phrase that asks for the verb. Objects are
    those of the scene's split. `difficulty` are knobs by name (docs/world.md). Raises InputError for an
    unknown scene, verb or knob.
    """
    seed = whole("seed", seed, 0, 2**53 - 1)
    scene = DEFAULT_SCENE if scene is None else scene
    instance_of("verb", verb, str)
    instance_of("scene", scene, str)
    words = query or next(iter(phrasings("train").get(verb, ())), verb)
    asked = (scene, verb, words, seed, f"{scene}_{verb}_{seed}")
    text, statistics, _ = stage().make_episode(valid_categories(), asked, knobs(difficulty))
    return Episode(text, statistics)


def shipped_sets() -> list[str]:
    """Names of the sets that come with the package."""
    names = (p.name.removesuffix(".json.gz") for p in (DATA / "episodes").glob("*.json.gz"))
    return sorted(name for name in names if not name.endswith(".statistics"))


def episodes_path(name: str | Path) -> Path:
    """A file, or the shipped set of that name. Raises InputError when neither exists."""
    path = Path(name)
    shipped = DATA / "episodes" / f"{name}.json.gz"
    if not path.exists() and shipped.exists():
        return shipped
    if not path.is_file():
        known = ", ".join(shipped_sets())
        raise InputError(f"no episode file {path}, and no shipped set of that name (there are: {known})")
    return path


def load_episodes(
    name: str | Path, *, validate: bool = True, statistics: str | Path | None = None
) -> list[Episode]:
    """Episodes of a .json.gz file, or of a shipped set by name (`dev`). Raises InputError.

    Their statistics come from `statistics`, or from the file beside it where there is one.
    """
    path = episodes_path(name)
    beside = statistics_path(path) if statistics is None else Path(statistics)
    if statistics is not None and not beside.is_file():
        raise InputError(f"no statistics file {beside}")
    try:
        texts, _ = read_episodes(path)
        counted = read_statistics(beside, path) if beside.is_file() else [None] * len(texts)
        episodes = [Episode(text, known) for text, known in zip(texts, counted, strict=True)]
        for episode in episodes if validate else ():
            stage().validate(episode.text)
    except InputError as error:
        raise _of_file(path, error) from None
    return episodes


def load_generation(name: str | Path) -> dict[str, Any] | None:
    """How a set was generated; None for one that was put together by hand. Raises InputError."""
    return json.loads(read_episodes(episodes_path(name))[1])


def _of_file(path: Path, error: InputError) -> InputError:
    """The error with the file's name, where it speaks of an episode alone."""
    return error if str(path) in str(error) else InputError(f"{path}: {error}")


def save_episodes(
    path: Path, episodes: Sequence[Episode], generation: Mapping[str, Any] | None = None
) -> None:
    """Writes a .json.gz file and its statistics beside it, each whole or not at all.

    Statistics are written where every episode has them; those of an earlier file of the name are taken away.
    Raises InputError when a file cannot be written.
    """
    beside = statistics_path(path)
    write_episodes(path, [e.text for e in episodes], json.dumps(generation))
    known = [(e.episode_id, e.statistics_text) for e in episodes if e.statistics_text is not None]
    if len(known) == len(episodes):
        write_statistics(beside, path, known)
    else:
        beside.unlink(missing_ok=True)
