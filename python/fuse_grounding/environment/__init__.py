"""Worlds to look at: episodes, the tabletop, and what an agent may see of them."""

from fuse_grounding.environment.blind import Blind
from fuse_grounding.environment.episodes import (
    Episode,
    episodes_path,
    load_episodes,
    make_episode,
    make_episodes,
    save_episodes,
    scene_names,
)
from fuse_grounding.environment.protocol import Environment, Observation
from fuse_grounding.environment.replay import ReplayEnvironment
from fuse_grounding.environment.tabletop import TabletopEnvironment, Target, render_device

__all__ = [
    "Blind",
    "Environment",
    "Episode",
    "Observation",
    "ReplayEnvironment",
    "TabletopEnvironment",
    "Target",
    "episodes_path",
    "load_episodes",
    "make_episode",
    "make_episodes",
    "render_device",
    "save_episodes",
    "scene_names",
]
