"""Puts an agent together from its configuration: the one place that names concrete parts."""

from __future__ import annotations

from fuse_grounding import knowledge, mapping, splat
from fuse_grounding.benchmark.methods import resolve
from fuse_grounding.benchmark.provenance import provenance
from fuse_grounding.config import Config, EncoderConfig, RegistrationConfig, SegmenterConfig
from fuse_grounding.environment import render_device
from fuse_grounding.mapping import GaussianMap, PointRegistrar
from fuse_grounding.parts import Parts, Spatial
from fuse_grounding.perception.doors import Opened, open_encoder, open_segmenter, settled
from fuse_grounding.perception.protocol import Segmenter, TextEncoder
from fuse_grounding.planning.amortized import planner_files
from fuse_grounding.planning.explicit import evidence_maps
from fuse_grounding.registration import ColmapRegistrar, PosedRegistrar


def make_registrar(config: RegistrationConfig) -> PointRegistrar:
    """A fresh registrar."""
    if config.backend == "posed":
        return PosedRegistrar()
    return ColmapRegistrar(profile=config.profile, on_failure=config.on_failure)


class Shelf:
    """Opens each segmenter and encoder once, for several agents of one process."""

    def __init__(self) -> None:
        self._segmenters: dict[str, Opened[Segmenter]] = {}
        self._encoders: dict[str, Opened[TextEncoder]] = {}

    def segmenter(self, config: SegmenterConfig) -> Opened[Segmenter]:
        """The configured segmenter. Raises InputError."""
        key = config.model_dump_json()
        if key not in self._segmenters:
            self._segmenters[key] = open_segmenter(config)
        return self._segmenters[key]

    def encoder(self, config: EncoderConfig) -> Opened[TextEncoder]:
        """The configured encoder. Raises InputError."""
        key = config.model_dump_json()
        if key not in self._encoders:
            self._encoders[key] = open_encoder(config)
        return self._encoders[key]


def assemble(config: Config, shelf: Shelf | None = None) -> tuple[Parts, Config]:
    """All parts of an agent, with the configuration as its method runs it.

    Agents that are given the same `shelf` share networks. Raises InputError for unknown names and missing or
    broken weights.
    """
    shelf = shelf or Shelf()
    method, config = resolve(config)
    knowledge.make(config.knowledge)
    # What cannot run says so before anything is loaded.
    plans = method.first_policy(config).planner not in (None, "none")
    announcements = mapping.check(config.map) if method.maps else []
    rendered_on = render_device(config.render.device)
    if config.render.device != "cpu":
        why = "no real GPU was found, " if rendered_on.startswith("cpu") else ""
        announcements.append(
            f"render.device {config.render.device}: {why}the world is rendered on {rendered_on}"
        )
    asked, config = config.encoder.name, config.with_(encoder={"name": settled(config.encoder).name})
    if asked == "auto" and config.encoder.name == "lexical" and knowledge.compares(config.knowledge):
        announcements.append(
            "encoder: no weights of `embedded` are there; labels are compared by letters (`lexical`)"
        )
    encoder = shelf.encoder(config.encoder)
    segmenter = shelf.segmenter(config.segmenter)
    planner = planner_files(config) if plans else None

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
        knowledge=knowledge.make(config.knowledge, encoder.part),
        segmenter=segmenter.part,
        policy=lambda episode: method.policy(config, episode),
        spatial=spatial,
        look=lambda situation, rendered: evidence_maps(situation, rendered, config),
        provenance=provenance(
            device,
            rendered_on,
            {"segmenter": segmenter.device, "encoder": encoder.device},
            (*segmenter.packages, *encoder.packages),
            segmenter=segmenter.files,
            encoder=encoder.files,
            planner=() if planner is None else (planner.planner,),
            planner_encoder=() if planner is None else planner.encoder,
            method=() if method.source is None else (method.source,),
        ),
        announcements=announcements,
    )
    return parts, config
