"""Puts an agent together from its configuration: the one place that names concrete parts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fuse_grounding import knowledge, mapping, splat
from fuse_grounding.benchmark.methods import resolve
from fuse_grounding.benchmark.provenance import provenance
from fuse_grounding.config import Config, RegistrationConfig, SegmenterConfig
from fuse_grounding.environment import render_device
from fuse_grounding.mapping import GaussianMap, PointRegistrar
from fuse_grounding.parts import Parts, Spatial
from fuse_grounding.perception.embedded import DEFAULT_PATH, EmbeddedSegmenter
from fuse_grounding.perception.embedded_encoder import EmbeddedEncoder
from fuse_grounding.perception.patches import PatchSegmenter
from fuse_grounding.perception.protocol import Segmenter
from fuse_grounding.planning.amortized import planner_files
from fuse_grounding.planning.explicit import evidence_maps
from fuse_grounding.registration import ColmapRegistrar, PosedRegistrar
from fuse_grounding.registry import Registry

SEGMENTERS: Registry[Callable[[SegmenterConfig], tuple[Segmenter, Path]]] = Registry("segmenter")
"""By name: what makes it, with the file of its weights."""


def _embedded(config: SegmenterConfig) -> tuple[Segmenter, Path]:
    weights = config.weights or DEFAULT_PATH
    return EmbeddedSegmenter(weights), weights


def _embedded_patches(config: SegmenterConfig) -> tuple[Segmenter, Path]:
    encoder = EmbeddedEncoder(config.weights)
    known = encoder.settings
    return PatchSegmenter(encoder, [*known.labels, known.background], known.scale), encoder.path


SEGMENTERS.add("embedded", _embedded)
SEGMENTERS.add("embedded_patches", _embedded_patches)


def make_registrar(config: RegistrationConfig) -> PointRegistrar:
    """A fresh registrar."""
    if config.backend == "posed":
        return PosedRegistrar()
    return ColmapRegistrar(profile=config.profile, on_failure=config.on_failure)


def assemble(config: Config) -> tuple[Parts, Config]:
    """All parts of an agent, with the configuration as its method runs it.

    Raises InputError for unknown names and missing or broken weights.
    """
    method, config = resolve(config)
    source = knowledge.make(config.knowledge)
    make_segmenter = SEGMENTERS.get(config.segmenter.name)
    # What cannot run says so before anything else is loaded.
    plans = method.policy(config, 0).planner not in (None, "none")
    announcements = mapping.check(config.map) if method.maps else []
    rendered_on = render_device(config.render.device)
    if config.render.device != "cpu":
        why = "no real GPU was found, " if rendered_on.startswith("cpu") else ""
        announcements.append(
            f"render.device {config.render.device}: {why}the world is rendered on {rendered_on}"
        )
    segmenter, weights = make_segmenter(config.segmenter)

    # Taken once: what the record names is what every map of the run is trained on.
    device = splat.device_name(config.map.device if method.maps else "cpu")
    map_config = config.map.model_copy(update={"device": device.split(" ")[0]})

    def spatial() -> Spatial | None:
        if not method.maps:
            return None
        registrar = make_registrar(config.registration)
        return Spatial(registrar, GaussianMap(registrar, map_config))

    parts = Parts(
        understand=knowledge.parse,
        knowledge=source,
        segmenter=segmenter,
        policy=lambda episode: method.policy(config, episode),
        spatial=spatial,
        look=lambda situation, rendered: evidence_maps(situation, rendered, config),
        provenance=provenance(
            device,
            rendered_on,
            segmenter=weights,
            **(planner_files(config) if plans else {}),
        ),
        announcements=announcements,
    )
    return parts, config
