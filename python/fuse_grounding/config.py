"""The one configuration: every default is the paper's constant, with its source beside it.

`Config.load(path, overrides)` reads TOML and applies `section.key=value` overrides. Anything that
is not understood is refused with the file, the key, what was found and what was expected.
"""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from fuse_grounding.arguments import Count, Flag, Fraction, Natural, Positive
from fuse_grounding.errors import InputError
from fuse_grounding.splat import OFFICIAL, TrainerConfig

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


class Section(BaseModel):
    """A frozen group of settings; unknown keys are errors."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True, populate_by_name=True
    )


class CameraConfig(Section):
    """What pictures look like and where they are taken."""

    width: Count = 640
    """Pixels. Supplement, "3D Gaussian Splatting": 640x480."""
    height: Count = 480
    """Pixels. Supplement, "3D Gaussian Splatting": 640x480."""
    hfov_deg: Annotated[float, Field(gt=1, lt=170)] = 60.0
    """Horizontal field of view, degrees. Not in the paper; at 90 few objects reach 500 px."""
    nodes: Literal[36] = 36
    """Positions on the ring. Supplement, "Camera and Action Space"."""
    pitches_deg: tuple[float, float, float] = (15.0, 30.0, 45.0)
    """Downward tilts. Supplement, "Camera and Action Space"."""
    seed_offsets: tuple[int, ...] = Field(default=(-2, -1, 1, 2), min_length=1)
    """Ring nodes of the seed views, relative to the start. Four views: supplement; their places: ours."""
    seed_pitch_index: Annotated[int, Field(ge=0, le=2)] = 1
    """Pitch of the seed views: the middle one. Ours."""


class BudgetConfig(Section):
    """How long an episode may last."""

    actions: Natural = 30
    """Online actions T; one more observation is scored. Paper, "Implementation Details"."""


class GateConfig(Section):
    """When the amortised planner is trusted."""

    eta: Fraction = 0.8
    """Normalised entropy up to which the amortised branch decides. Supplement, "Confidence Gate"."""
    temperature: Positive = 0.1
    """Softmax temperature. Supplement, "Confidence Gate" (the text says 1, at which the gate never opens)."""


class PlannerConfig(Section):
    """The learned planner of `amortized` and `fuse`."""

    name: Literal["plain", "extended", "none"] = "plain"
    """`plain`: picture, object, action (supplement, "Amortized Planner Architecture"); `extended`: also pitch
    and where the candidates are in the picture, ours; `none`: every decision of `fuse` is explicit."""
    weights: Path | None = None
    """Another ONNX file of the same kind; none: the shipped one."""


class EncoderConfig(Section):
    """Pictures and labels as vectors, for the learned planner."""

    weights: Path | None = None
    """Another encoder.onnx with its files beside it; none: the shipped one. The paper uses CLIP ViT-B/16."""


class StoppingConfig(Section):
    """Grounding score and patience."""

    patience: Count = 5
    """Observations K without improvement that end the search. Paper, "Implementation Details"."""
    weights: tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]] = (0.7, 0.3)
    """(segmentation score, depth proximity). Supplement, "Depth-Proximity Stopping Rule" (text: 1, 1)."""
    min_region_px: Count = 500
    """Smaller regions cannot set the score. Supplement, "Depth-Proximity Stopping Rule"."""
    near_m: Positive = 0.3
    """Depth at which proximity is 1. Supplement, "Depth-Proximity Stopping Rule"."""
    far_m: Positive = 1.2
    """Depth at which proximity is 0. Supplement, "Depth-Proximity Stopping Rule"."""


class SsnrConfig(Section):
    """Structural signal-to-noise ratio between observation and rendering."""

    alpha: Fraction = 0.8
    """Largest geometric uncertainty. Supplement, "Semantic and Geometric Evidence"."""
    normalization: Literal["decibel", "spatial"] = "decibel"
    """Clipped decibels (supplement) or spatial minimum and maximum (paper, evidence-map equation)."""
    gray_range: Literal[1, 255] = 1
    """Largest grey value; matters against epsilon = 1e-8 only. Not in the paper."""
    gradient: Literal["magnitude", "vector"] = "magnitude"
    """Difference of gradient magnitudes (supplement) or of gradient vectors (paper)."""
    missing_db: Annotated[float, Field(ge=-30, le=30)] = 0.0
    """SSNR where there is no rendering. Supplement: the SSNR map is set to zero."""
    render: Literal["after", "before"] = "after"
    """Whether the rendering is taken after or before this step's refinement. Algorithm 1: after."""
    float_render: bool = False
    """Compare the rendering unquantised, instead of in 8 bits like the observation. Ours."""


class ExplicitConfig(Section):
    """Explicit evidence exploration."""

    field: Literal["evidence", "uncertainty"] = "evidence"
    """Plan with E = S + U_geo (supplement) or with U_func = 1 - S + U_geo (paper, functional uncertainty)."""
    coupled: Literal["union", "quadrant", "mean"] = "union"
    """Region of a coupled action. Supplement: "combine"; a mean never wins, a quadrant always."""
    stride: Literal["one", "two"] = "one"
    """One- and two-node moves share a region and tie; this one is taken. Not in the paper."""
    noop: bool = False
    """Whether staying put may be chosen. Ours: it would be scored by the whole image."""
    every_step: bool = False
    """Also compute the evidence of the last view, where nothing is decided."""


class EvidenceConfig(Section):
    """Fusion of semantic evidence and geometric uncertainty."""

    semantic_weight: Annotated[float, Field(ge=0)] = 1.0
    """w_s. Supplement, "Semantic and Geometric Evidence"."""
    geometric_weight: Annotated[float, Field(ge=0)] = 1.0
    """w_g. Supplement, "Semantic and Geometric Evidence"."""
    normalize_semantic: bool = False
    """Stretch S to [0, 1] (paper, text) instead of keeping the scores (supplement)."""


class RegistrationConfig(Section):
    """Placing views in the map's frame."""

    backend: Literal["colmap", "posed"] = "colmap"
    """COLMAP v3.13.0 (supplement), or the poses known from robot or simulator."""
    profile: Literal["fast", "paper"] = "fast"
    """The measured live recipe, or the supplement's settings."""
    on_failure: Literal["posed_fallback", "error"] = "posed_fallback"
    """A view that COLMAP cannot place: its known pose, recorded as such, or an error. Ours."""


class MapConfig(Section, TrainerConfig):  # type: ignore[misc]  # frozen too: by `model_config`
    """3D Gaussian splatting: `splat.TrainerConfig`'s settings, checked here, and when to optimise."""

    schedule: Literal["fast", "official"] = "fast"
    """`official`: trainer's settings that are not given are those of `splat.TrainerConfig.official`. Ours."""
    device: Literal["cpu", "gpu", "auto"] = "cpu"
    """As `splat.Trainer`'s: what was taken is in the record. At one SIMD level, the CPU gives everybody the
    same map. Ours."""
    fine_iterations: int | None = Field(default=240, ge=0)
    """As there, and so are the next three; docs/performance.md has their measurements. Ours."""
    matched_low_pass: Flag = True
    step_iterations: Count = 3
    rate_gain: Positive = 3.0
    initial_iterations: Count = 1000
    """Optimisation over the seed views. Supplement, "3D Gaussian Splatting"."""
    incremental_iterations: Count = 400
    """Optimisation after each explicit-planning observation. Supplement, "3D Gaussian Splatting"."""
    add_points: bool = True
    """Start new Gaussians at points that registration finds later. Ours."""

    @model_validator(mode="before")
    @classmethod
    def _schedule(cls, given: Any) -> Any:
        official = isinstance(given, Mapping) and given.get("schedule") == "official"
        return {**OFFICIAL, **given} if official else given


class RenderConfig(Section):
    """Pictures of the tabletop world."""

    device: Literal["cpu", "gpu", "auto"] = "cpu"
    """As `TabletopEnvironment`'s: what was taken is in the record. The CPU shows everybody the same. Ours."""


class KnowledgeConfig(Section):
    """From a query to candidate labels."""

    source: str = "graph"
    """`graph`, `oracle` or `direct`."""
    top_k: Count = 5
    """Candidates kept, best first. Ours."""
    oracle: Literal["target", "valid"] = "target"
    """Tells the episode's target label (supplement, "Oracle-Label FUSE"), or every valid one."""


class SegmenterConfig(Section):
    """Finding the candidates in a picture."""

    name: str = "embedded"
    """The network that ships with the package. The paper uses SAM3."""
    weights: Path | None = None
    """Another ONNX file of the same design; none: the shipped one."""


class MetricConfig(Section):
    """Success and the returned mask."""

    iou: Annotated[float, Field(gt=0, le=1)] = 0.5
    """IoU with any valid target that counts as success. Supplement, "Metric Computation"."""
    select: Literal["instance", "fused"] = "instance"
    """Mask at the best view: highest-scoring instance (supplement) or the one with the best fused score."""


class RandomConfig(Section):
    """The random baseline."""

    seed: Natural = 2
    """Base seed; the episode's index is added. Supplement, "Random Active"."""


class CanonicalConfig(Section):
    """The canonical baseline."""

    mode: Literal["top_down"] = "top_down"
    """A fixed camera above the scene's centre. Supplement, "Canonical View"."""


class ReturnConfig(Section):
    """Which views may be returned; seed views never are (supplement, "3D Gaussian Splatting")."""

    include_initial: bool = True
    """Whether the start view may be returned. Not in the paper."""


class Config(Section):
    """All settings of an agent."""

    method: str = "fuse"
    """Policy with its stopping; `fuse_grounding.benchmark.methods` lists them."""
    camera: CameraConfig = CameraConfig()
    budget: BudgetConfig = BudgetConfig()
    gate: GateConfig = GateConfig()
    planner: PlannerConfig = PlannerConfig()
    encoder: EncoderConfig = EncoderConfig()
    stopping: StoppingConfig = StoppingConfig()
    ssnr: SsnrConfig = SsnrConfig()
    explicit: ExplicitConfig = ExplicitConfig()
    evidence: EvidenceConfig = EvidenceConfig()
    registration: RegistrationConfig = RegistrationConfig()
    map: MapConfig = MapConfig()
    render: RenderConfig = RenderConfig()
    knowledge: KnowledgeConfig = KnowledgeConfig()
    segmenter: SegmenterConfig = SegmenterConfig()
    metric: MetricConfig = MetricConfig()
    random: RandomConfig = RandomConfig()
    canonical: CanonicalConfig = CanonicalConfig()
    return_: ReturnConfig = Field(default=ReturnConfig(), alias="return")

    @classmethod
    def load(cls, path: str | Path | None = None, overrides: Iterable[str] = ()) -> Config:
        """Defaults, then the TOML file, then `section.key=value` overrides, later ones winning.

        Raises InputError naming file (or `--set`), key, what was found and what was expected.
        """
        values = _read(Path(path)) if path is not None else {}
        origin = str(path) if path is not None else "config"
        cls.from_dict(values, origin)  # blames the file for its own mistakes, before any override
        for text in overrides:
            override = _parse_override(text)
            cls.from_dict(override, f"--set {text}")
            _merge(values, override)
        return cls.from_dict(values, origin)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], origin: str = "config") -> Config:
        """Checks a nested mapping. Raises InputError as `load` does."""
        try:
            config = cls.model_validate(values)
        except ValidationError as error:
            raise InputError(f"{origin}: {_explain(error)}") from None
        if config.stopping.near_m >= config.stopping.far_m:
            stopping = config.stopping
            raise InputError(
                f"{origin}: `stopping.near_m` must be below `stopping.far_m`, "
                f"found {stopping.near_m} and {stopping.far_m}"
            )
        return config

    def to_dict(self) -> dict[str, Any]:
        """Nested plain values (JSON), the inverse of `from_dict`."""
        return self.model_dump(mode="json", by_alias=True)

    def with_(self, **sections: Mapping[str, Any] | str) -> Config:
        """A copy with some settings changed: `config.with_(knowledge={"source": "oracle"})`."""
        values = self.to_dict()
        _merge(values, {("return" if k == "return_" else k): v for k, v in sections.items()})
        return Config.from_dict(values)


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"config file {path} does not exist") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"config file {path} cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"config file {path} is not valid TOML: {error}") from None


def _parse_override(text: str) -> dict[str, Any]:
    key, equals, value = text.partition("=")
    parts = [p.strip() for p in key.split(".")]
    if not equals or not all(parts):
        raise InputError(f"--set {text}: expected section.key=value, such as gate.eta=0.7")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()  # a bare word, such as graph
    for part in reversed(parts):
        parsed = {part: parsed}
    return parsed


def _merge(into: dict[str, Any], values: Mapping[str, Any]) -> None:
    for key, value in values.items():
        if isinstance(value, Mapping) and isinstance(into.get(key), dict):
            _merge(into[key], value)
        else:
            into[key] = dict(value) if isinstance(value, Mapping) else value


def _explain(error: ValidationError) -> str:
    """The first complaint as one sentence: key, found, expected."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        known = _keys_beside(first["loc"])
        near = difflib.get_close_matches(str(first["loc"][-1]), known, n=1)
        return f"unknown key `{key}`; " + (
            f"did you mean `{near[0]}`?" if near else f"known here: {', '.join(known)}"
        )
    expected = (first["msg"][0].lower() + first["msg"][1:]).removeprefix("input should be ")
    if first["type"] == "model_type":
        expected = "a table of settings"
    return f"`{key}`: found {first['input']!r}, expected: {expected}"


def _keys_beside(loc: tuple[int | str, ...]) -> list[str]:
    """Keys that the section of a wrong key knows."""
    model: Any = Config
    for part in loc[:-1]:
        fields = {(f.alias or name): f for name, f in model.model_fields.items()}
        if part not in fields:
            return []
        kind = fields[str(part)].annotation
        model = next((t for t in (kind, *get_args(kind)) if isinstance(t, type)), kind)
    return [f.alias or name for name, f in model.model_fields.items()]
