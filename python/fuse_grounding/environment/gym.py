"""The Gymnasium environment `fuse_grounding/Tabletop-v0`; docs/gymnasium.md says what it rewards."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np

from fuse_grounding.arguments import device_wish, whole
from fuse_grounding.config import SensorConfig
from fuse_grounding.environment.episodes import Episode, check_threads, load_episodes
from fuse_grounding.environment.protocol import Observation
from fuse_grounding.environment.tabletop import TabletopEnvironment, sensor_settings
from fuse_grounding.errors import InputError
from fuse_grounding.extras import require

gymnasium = require("gymnasium", "gym", "fuse_grounding/Tabletop-v0")
from gymnasium import spaces  # noqa: E402  # after the error that names the extra

HEIGHT, WIDTH = 480, 640
NODES, PITCHES, ACTIONS = 36, 3, 15
FARTHEST_M = 100.0
"""Bound of depths and camera coordinates, metres; rooms are a few metres wide."""
LONGEST_QUERY = 200
"""Bytes of UTF-8. Bytes, because Gymnasium's shared memory hands out `Text` as it was at the start."""
SEEN_FRACTION, SEEN_PIXELS = 0.8, 500
"""A view that shows this much of a valid object ends the search: every episode has one."""
STEP_COST = 0.01


def observation_space() -> spaces.Dict:
    """What `reset` and `step` observe; shapes and units in docs/gymnasium.md."""
    turn, shift = np.full((4, 3), 1.0), np.full((4, 1), FARTHEST_M)
    bound = np.hstack([turn, shift])
    return spaces.Dict(
        {
            "rgb": spaces.Box(0, 255, (HEIGHT, WIDTH, 3), np.uint8),
            "depth": spaces.Box(0.0, FARTHEST_M, (HEIGHT, WIDTH), np.float32),
            "pose": spaces.Box(-bound, bound, (4, 4), np.float64),
            "node": spaces.Discrete(NODES),
            "pitch": spaces.Discrete(PITCHES),
            "query": spaces.Box(0, 255, (LONGEST_QUERY,), np.uint8),
            "action_mask": spaces.MultiBinary(ACTIONS),
        }
    )


class TabletopGym(gymnasium.Env):  # type: ignore[name-defined]
    """The tabletop as a Gymnasium environment: a camera on a ring that has to find a hidden object.

    `episodes`: a shipped set, a .json.gz file, or episodes; `reset` takes one at random, or the one of
    `options={"episode_id": ...}`. An action that `action_mask` forbids leaves the camera where it is.
    `device` and `sensor` are `TabletopEnvironment`'s. Raises InputError for episodes that cannot be read and
    for unknown options.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012  # Gymnasium's

    def __init__(
        self,
        episodes: str | Path | Sequence[Episode] = "dev",
        render_mode: str | None = None,
        device: str = "cpu",
        sensor: SensorConfig | Mapping[str, Any] | None = None,
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise InputError(f'render_mode must be "rgb_array" or None, found {render_mode!r}')
        self.render_mode = render_mode
        self._device = device_wish(device)
        self._sensor = sensor_settings(sensor)
        self.observation_space = observation_space()
        self.action_space = spaces.Discrete(ACTIONS)
        # Checked against the objects when one is played: a vector environment makes one only to look at its
        # spaces, and forks afterwards, which no thread survives.
        self._source = str(episodes) if isinstance(episodes, str | Path) else "episodes"
        taken = (
            load_episodes(episodes, validate=False) if isinstance(episodes, str | Path) else list(episodes)
        )
        self._episodes = {episode.episode_id: _checked(episode) for episode in taken}
        if not self._episodes:
            raise InputError("episodes is empty: there is nothing to play")
        self._world: TabletopEnvironment | None = None
        self._first: Observation | None = None
        self._seen: Observation | None = None
        self._sights: dict[tuple[int, int], tuple[float, float, int]] = {}

    @property
    def episode_ids(self) -> list[str]:
        """What `options={"episode_id": ...}` may name."""
        return list(self._episodes)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts an episode; the same seed takes the same one."""
        super().reset(seed=seed)
        episode = self._choose(options or {})
        check_threads()
        if self._world is None or self._world.episode is not episode:
            self._world = self._open(episode)
            self._sights = {}
            self._first = self._world.observe()
        self._world.reset()
        self._seen = self._first
        return self._observation(), self._info(refused=False)

    def step(self, action: Any) -> tuple[dict[str, Any], SupportsFloat, bool, bool, dict[str, Any]]:
        """Moves the camera; rewards what it sees more of a valid object."""
        world = self._playing()
        action = whole("action", action, 0, ACTIONS - 1)
        before, _, _ = self._sight(world)
        refused = not world.action_mask()[action]
        if not refused and action != ACTIONS // 2:
            world.act(action)
            self._seen = world.observe()
        after, _, _ = self._sight(world)
        found = self._found(world)
        reward = after - before - STEP_COST + float(found)
        return self._observation(), reward, found, False, self._info(refused)

    def render(self) -> np.ndarray | None:
        """(480, 640, 3) uint8: what the camera sees, with the query written below."""
        if self.render_mode is None:
            return None
        from fuse_grounding import visualize

        world, seen = self._playing(), self._seen
        assert seen is not None
        fraction = self._sight(world)[1]
        caption = f'"{world.episode.query}"   node {seen.node}, pitch {seen.pitch_index}, {fraction:.0%} seen'
        return visualize.captioned(seen.rgb, caption)

    def close(self) -> None:
        """Forgets the world."""
        self._world = self._first = self._seen = None

    def _open(self, episode: Episode) -> TabletopEnvironment:
        try:
            return TabletopEnvironment(episode, self._device, sensor=self._sensor)
        except InputError as error:
            raise InputError(f"{self._source}: {error}") from None

    def _choose(self, options: Mapping[str, Any]) -> Episode:
        unknown = [name for name in options if name != "episode_id"]
        if unknown:
            raise InputError(f"unknown option `{unknown[0]}` of reset; known: episode_id")
        if "episode_id" not in options:
            return self._episodes[self.episode_ids[int(self.np_random.integers(len(self._episodes)))]]
        name = options["episode_id"]
        if name not in self._episodes:
            near = difflib.get_close_matches(str(name), self.episode_ids, n=3) or self.episode_ids[:3]
            raise InputError(
                f"no episode {name!r} among the {len(self._episodes)} of this environment; "
                f"there are {', '.join(near)}, …"
            )
        return self._episodes[name]

    def _playing(self) -> TabletopEnvironment:
        if self._world is None:
            raise InputError("call reset before step or render: no episode is being played")
        return self._world

    def _sight(self, world: TabletopEnvironment) -> tuple[float, float, int]:
        """Of the valid object that is seen best from here: sight, visible fraction, pixels.

        sight = fraction · min(1, pixels / 500), from the counts that the episode was made with.
        """
        if world.viewpoint not in self._sights:
            views = [
                (float(t.fraction[world.viewpoint]), int(t.visible_px[world.viewpoint]))
                for t in world.true_targets()
            ]
            sights = [(f * min(1.0, pixels / SEEN_PIXELS), f, pixels) for f, pixels in views]
            self._sights[world.viewpoint] = max(sights)
        return self._sights[world.viewpoint]

    def _found(self, world: TabletopEnvironment) -> bool:
        _, fraction, pixels = self._sight(world)
        return fraction >= SEEN_FRACTION and pixels >= SEEN_PIXELS

    def _observation(self) -> dict[str, Any]:
        world, seen = self._playing(), self._seen
        assert seen is not None
        assert seen.depth is not None
        assert seen.camera is not None
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = seen.camera.rotation, seen.camera.translation
        return {
            "rgb": seen.rgb.copy(),  # staying put must not hand out the same array twice
            "depth": np.minimum(seen.depth, np.float32(FARTHEST_M)),
            "pose": pose,
            "node": np.int64(seen.node or 0),
            "pitch": np.int64(seen.pitch_index or 0),
            "query": _padded(world.episode.query),
            "action_mask": world.action_mask().astype(np.int8),
        }

    def _info(self, refused: bool) -> dict[str, Any]:
        world = self._playing()
        _, fraction, pixels = self._sight(world)
        return {
            "action_mask": world.action_mask().astype(np.int8),
            "episode_id": world.episode.episode_id,
            "query": world.episode.query,
            "is_success": self._found(world),
            "refused": refused,
            "visible_fraction": fraction,
            "visible_px": pixels,
        }


def _padded(query: str) -> np.ndarray:
    """(200,) uint8: UTF-8, then zeros."""
    return np.frombuffer(query.encode().ljust(LONGEST_QUERY, b"\0"), np.uint8).copy()


def _checked(episode: Episode) -> Episode:
    """Raises InputError for a query that the observation space has no room for."""
    if len(episode.query.encode()) > LONGEST_QUERY:
        raise InputError(
            f"episode {episode.episode_id}: its query has {len(episode.query.encode())} bytes, "
            f"expected at most {LONGEST_QUERY}"
        )
    return episode
