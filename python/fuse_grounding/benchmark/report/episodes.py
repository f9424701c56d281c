"""What the episodes of a report are like: where they play and how much of the target the start shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fuse_grounding.benchmark.identity import digest
from fuse_grounding.environment import Episode, load_episodes
from fuse_grounding.environment.episodes import shipped_sets
from fuse_grounding.errors import InputError


@dataclass(frozen=True)
class Nature:
    """Facts of one episode. `start_fraction`: visible over unoccluded pixels of the target at the start."""

    scene: str
    verb: str
    target: str
    start_fraction: float
    start: tuple[int, int]
    """Node and pitch index."""


def natures(
    wanted: Mapping[str, str], set_name: str, files: Sequence[str] = ()
) -> tuple[dict[str, Nature], str]:
    """Facts by episode id for those whose digest is the one that was run, and why others are missing.

    Looked for in the shipped set of that name and in `files` (.json.gz).
    """
    names = [n for n in shipped_sets() if n == set_name]
    found: dict[str, Nature] = {}
    for name in (*names, *files):
        for episode in load_episodes(name, validate=False):
            if wanted.get(episode.episode_id) == digest(episode.text.encode()):
                found[episode.episode_id] = _nature(name, episode)
    if len(found) == len(wanted):
        return found, ""
    return found, (
        f"{len(wanted) - len(found)} of {len(wanted)} episodes are in no shipped set as they were run; "
        "`--episodes FILE` names the file that has them"
    )


def _nature(name: str, episode: Episode) -> Nature:
    data = episode.data
    try:
        return Nature(
            episode.scene_id,
            episode.verb,
            episode.categories[data["target"]],
            float(data["start_fraction"]),
            episode.start,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{name}: episode {episode.episode_id} lacks {error}") from None
