"""Episodes: reading, making and writing them, and the stage that they play on."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from fuse_grounding._core import Stage, read_episodes, recognised_categories, write_episodes
from fuse_grounding.arguments import instance_of, whole
from fuse_grounding.errors import InputError

DATA = Path(__file__).parent.parent / "data"
"""Objects, scenes, tables and episode sets that come with the package."""

DEFAULT_SCENE = "dev_kitchen"

EPISODE_VERBS = (
    *("cut", "scoop", "pour", "sip", "stir", "spread", "pound", "write", "wipe", "measure", "tighten"),
)
"""Verbs that episodes ask for: those that the shipped network's categories serve in several ways or by
name. A network that knows more categories allows more; until then recorded sets keep their bytes."""


@dataclass(frozen=True)
class Episode:
    """One search: a query, a laid table, a start. `text` is its JSON, which is what is true of it."""

    text: str = field(repr=False)

    @cached_property
    def data(self) -> dict[str, Any]:
        """The JSON as a dictionary; see `fuse episodes show`."""
        return json.loads(self.text)

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
def _validity() -> dict[str, list[str]]:
    """Verb -> valid categories that can be on the table: the ground truth of episodes, read by no
    knowledge source."""
    path = DATA / "validity.json"
    known = set(recognised_categories())
    try:
        verbs = json.loads(path.read_text(encoding="utf-8"))["verbs"]
        return {
            verb: [c for c, entry in verbs[verb].items() if entry["valid"] and c in known]
            for verb in EPISODE_VERBS
        }
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path} is not a validity table: {error!r}") from error


@cache
def _asked() -> dict[str, list[str]]:
    """Verb -> the words that it is asked with, for every verb that a query may mean."""
    verbs = json.loads((DATA / "affordances.json").read_text(encoding="utf-8"))["verbs"]
    return {verb: list(entry["queries"]) for verb, entry in verbs.items()}


@cache
def _queries() -> dict[str, list[str]]:
    """The same for verbs that some category can serve."""
    return {verb: _asked()[verb] for verb, valid in _validity().items() if valid and verb in _asked()}


def scene_names() -> list[str]:
    """Names of all scenes."""
    return [name for name, _, _, _ in stage().scenes()]


def make_episode(verb: str, scene: str | None = None, seed: int = 0, *, query: str | None = None) -> Episode:
    """A fresh episode for a verb. The same arguments give the same episode.

    `scene` defaults to dev_kitchen; `query` to the first phrase that asks for the verb. Objects are
    those of the scene's split. Raises InputError for an unknown scene or verb.
    """
    seed = whole("seed", seed, 0, 2**53 - 1)
    scene = DEFAULT_SCENE if scene is None else scene
    instance_of("verb", verb, str)
    instance_of("scene", scene, str)
    if verb not in _validity() and verb in _asked():
        raise InputError(
            f"`{verb}` is known, but no episode asks for it yet; "
            f"verbs with episodes: {', '.join(_validity())}"
        )
    words = query or next(iter(_queries().get(verb, ())), verb)
    text, _ = stage().make_episode(_validity(), scene, verb, words, seed, f"{scene}_{verb}_{seed}")
    return Episode(text)


def make_episodes(split: str, count: int, seed: int) -> tuple[list[Episode], dict[str, int]]:
    """A set over the split's scenes and all verbs, and how many layouts were thrown away, by reason."""
    made = stage().make_episodes(_validity(), _queries(), split, count, seed)
    rejected: dict[str, int] = {}
    for _, reasons in made:
        for reason, times in reasons.items():
            rejected[reason] = rejected.get(reason, 0) + times
    return [Episode(text) for text, _ in made], rejected


def episodes_path(name: str | Path) -> Path:
    """A file, or the shipped set of that name. Raises InputError when neither exists."""
    path = Path(name)
    shipped = DATA / "episodes" / f"{name}.json.gz"
    if not path.exists() and shipped.exists():
        return shipped
    if not path.is_file():
        known = ", ".join(sorted(p.name.removesuffix(".json.gz") for p in shipped.parent.glob("*.json.gz")))
        raise InputError(f"no episode file {path}, and no shipped set of that name (there are: {known})")
    return path


def load_episodes(name: str | Path, *, validate: bool = True) -> list[Episode]:
    """Episodes of a .json.gz file, or of a shipped set by name (`dev`). Raises InputError."""
    path = episodes_path(name)
    try:
        episodes = [Episode(text) for text in read_episodes(path)]
        for episode in episodes if validate else ():
            stage().validate(episode.text)
    except InputError as error:
        raise _of_file(path, error) from None
    return episodes


def _of_file(path: Path, error: InputError) -> InputError:
    """The error with the file's name, where it speaks of an episode alone."""
    return error if str(path) in str(error) else InputError(f"{path}: {error}")


def save_episodes(path: Path, episodes: Sequence[Episode]) -> None:
    """Writes a .json.gz file, whole or not at all. Raises InputError when it cannot be written."""
    write_episodes(path, [episode.text for episode in episodes])
