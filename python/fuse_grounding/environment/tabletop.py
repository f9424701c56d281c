"""The tabletop world: an episode's scene, rendered, with a camera that moves along the ring."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fuse_grounding import _core
from fuse_grounding._core import Camera, World, action_mask, apply_action, seed_viewpoints
from fuse_grounding.arguments import device_wish, whole
from fuse_grounding.config import Config, SensorConfig
from fuse_grounding.environment.episodes import Episode, stage
from fuse_grounding.environment.protocol import Observation

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Target:
    """A valid object and what the 108 viewpoints see of it, for metrics.

    `position` (3,) metres is the middle of its box; `visible_px` and `unoccluded_px` (36, 3) count the
    pixels that show it, and that would show it if it stood alone.
    """

    instance: int
    label: str
    position: np.ndarray
    least_pixels: float
    most_pixels: float
    least_distance: float
    most_distance: float
    visible_px: np.ndarray
    unoccluded_px: np.ndarray

    @property
    def fraction(self) -> np.ndarray:
        """(36, 3): visible over unoccluded pixels, 0 where it is out of the picture."""
        return self.visible_px / np.maximum(self.unoccluded_px, 1)


def render_device(device: str = "auto") -> str:
    """What `device` renders on here, as `cpu (avx2+fma)` or `gpu (NVIDIA L4, Vulkan)`.

    Raises InputError for another wish than `cpu`, `gpu` and `auto`, and for `gpu` where there is none.
    """
    return _core.render_device(device_wish(device))


def sensor_settings(sensor: SensorConfig | Mapping[str, Any] | None) -> SensorConfig:
    """Settings of `Config.sensor`, from a mapping too; None is a sensor that is off. Raises InputError."""
    if isinstance(sensor, SensorConfig):
        return sensor
    return Config.from_dict({"sensor": {} if sensor is None else sensor}, "sensor").sensor


class TabletopEnvironment:
    """An episode to act in. `episode` is what it plays; observations carry true instance ids.

    `device` renders: `cpu`, the same bits for everybody; `gpu`, whose pixels differ here and there by a
    rounding; `auto`, a real GPU if there is one, else the CPU. `sensor` (docs/sensor.md) is what colours and
    depth of all observations go through; ids, normals and masks stay exact. Raises InputError for `gpu` where
    there is none, and for settings of the sensor that are unknown or out of range.
    """

    def __init__(
        self,
        episode: Episode,
        device: str = "cpu",
        *,
        sensor: SensorConfig | Mapping[str, Any] | None = None,
    ):
        self.episode = episode
        self.sensor = sensor_settings(sensor)
        self.device = render_device(device)
        """What it renders on, by name."""
        self._world = World(episode.text, stage(), device, self.sensor.model_dump_json())
        self._viewpoint = episode.start
        self._statistics: list[dict[str, Any]] | None = episode.statistics

    @property
    def viewpoint(self) -> tuple[int, int]:
        """Node and pitch index of where the camera is."""
        return self._viewpoint

    def reset(self) -> None:
        """Moves the camera back to the episode's start."""
        self._viewpoint = self.episode.start

    def observe(self) -> Observation:
        """The view from where the camera is now."""
        return self.render_at(*self._viewpoint)

    def render_at(self, node: int, pitch_index: int) -> Observation:
        """The view from any viewpoint. Raises InputError for one that does not exist."""
        camera = self.camera_at(node, pitch_index)
        return Observation(*self._world.render(node, pitch_index), camera, node, pitch_index)

    def photograph(self, camera: Camera) -> Observation:
        """The view of any camera, on the ring or not; it has no place there."""
        return Observation(*self._world.render_camera(camera), camera)

    def camera_at(self, node: int, pitch_index: int) -> Camera:
        """The camera of any viewpoint. Raises InputError for one that does not exist."""
        return self._world.camera(whole("node", node), whole("pitch_index", pitch_index))

    def canonical_observation(self) -> Observation:
        """The view straight down on the middle of the scene; it has no place on the ring."""
        return self.photograph(self._world.canonical_camera())

    def action_mask(self) -> np.ndarray:
        """(15,) bool: which actions are possible from here."""
        return action_mask(*self._viewpoint)

    def act(self, action: int) -> None:
        """Moves the camera. Raises InputError for an action that is masked or out of range."""
        self._viewpoint = apply_action(*self._viewpoint, whole("action", action))

    def seed_observations(self) -> Sequence[Observation]:
        """The views from one and two nodes to either side of here, 30 degrees down."""
        return [self.render_at(*viewpoint) for viewpoint in seed_viewpoints(*self._viewpoint)]

    # -- what only metrics and the oracle may ask ------------------------------------------------

    def oracle_target(self) -> str:
        """Category of the sampled target."""
        return self.episode.categories[self.episode.data["target"]]

    def oracle_valid(self) -> Sequence[str]:
        """Categories of all valid objects on the table, the target's first."""
        labels = (self.episode.categories[i] for i in self.episode.data["valid_target_ids"])
        return tuple(dict.fromkeys(labels))

    def true_instances(self, node: int | None, pitch_index: int | None) -> np.ndarray:
        """(480, 640) uint32 ids at a viewpoint, without a picture; of the canonical view for None."""
        return self._world.depth_ids(self.true_camera(node, pitch_index))[1]

    def true_camera(self, node: int | None, pitch_index: int | None) -> Camera:
        """The exact camera at a viewpoint; of the canonical view for None."""
        if node is None or pitch_index is None:
            return self._world.canonical_camera()
        return self.camera_at(node, pitch_index)

    def depth_ids(self, node: int, pitch_index: int) -> tuple[np.ndarray, np.ndarray]:
        """(480, 640) float32 exact depth in metres and (480, 640) uint32 ids, without a picture."""
        return self._world.depth_ids(self.camera_at(node, pitch_index))

    def normals(self, node: int, pitch_index: int) -> np.ndarray:
        """(480, 640, 3) float32: unit normals at a viewpoint's pixel centres, zeros where nothing was hit.

        In the camera's frame (x right, y down, z forward), facing the camera; of the triangles, not smoothed.
        """
        return self._world.normals(whole("node", node), whole("pitch_index", pitch_index))

    def amodal_mask(self, instance: int, node: int, pitch_index: int) -> np.ndarray:
        """(480, 640) bool: the pixels that an instance would cover at a viewpoint if it stood alone.

        Raises InputError for an id that no object on the table has.
        """
        place = whole("node", node), whole("pitch_index", pitch_index)
        return self._world.amodal_mask(whole("instance", instance), *place)

    def true_targets(self) -> Sequence[Target]:
        """The valid objects, the sampled target first.

        Their pixels are counted by rendering where the episode brings no statistics; that is logged.
        """
        if self._statistics is None:
            _log.warning(
                "episode %s has no statistics with it: pixels are counted in 108 views, which takes a moment",
                self.episode.episode_id,
            )
            self._statistics = json.loads(stage().statistics(self.episode.text))
        return [
            Target(
                instance=s["instance_id"],
                label=self.episode.categories[s["instance_id"]],
                position=np.asarray(s["position_m"], np.float64),
                least_pixels=s["pixels_min"],
                most_pixels=s["pixels_max"],
                least_distance=s["distance_min_m"],
                most_distance=s["distance_max_m"],
                visible_px=np.asarray(s["visible_px"]).reshape(36, 3),
                unoccluded_px=np.asarray(s["unoccluded_px"]).reshape(36, 3),
            )
            for s in self._statistics
        ]
