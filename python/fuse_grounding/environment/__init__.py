"""Worlds to look at: episodes, the tabletop, and what an agent may see of them."""

from fuse_grounding.environment.blind import Blind
from fuse_grounding.environment.episodes import (
    Episode,
    episodes_path,
    load_episodes,
    load_generation,
    make_episode,
    save_episodes,
    scene_names,
)
from fuse_grounding.environment.protocol import Environment, Observation
from fuse_grounding.environment.replay import ReplayEnvironment
from fuse_grounding.environment.sets import SETS, generate_set
from fuse_grounding.environment.tabletop import TabletopEnvironment, Target, render_device

__all__ = [
    "SETS",
    "Blind",
    "Environment",
    "Episode",
    "Observation",
    "ReplayEnvironment",
    "TabletopEnvironment",
    "Target",
    "episodes_path",
    "generate_set",
    "load_episodes",
    "load_generation",
    "make_episode",
    "render_device",
    "save_episodes",
    "scene_names",
]
