"""The one configuration: every default is the paper's constant, with its source beside it.

`Config.load(path, overrides)` reads TOML and applies `section.key=value` overrides. Anything that
is not understood is refused with the file, the key, what was found and what was expected.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from fuse_grounding.arguments import Count, Flag, Fraction, Natural, Positive, Section
from fuse_grounding.config_chat import LlmConfig, VlmConfig
from fuse_grounding.config_text import explain, merge, parse_override, read
from fuse_grounding.errors import InputError
from fuse_grounding.splat import OFFICIAL, TrainerConfig


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


class SearchConfig(Section):
    """What explicit search and the learned planner choose among."""

    revisit: bool = False
    """Whether a view that was seen before may be chosen though new ones are in reach. The paper does not
    forbid it; chosen on development episodes (docs/models/planner.md)."""


class GateConfig(Section):
    """When the amortised planner is trusted."""

    eta: Fraction = 0.6
    """Normalised entropy up to which the amortised branch decides. Supplement, "Confidence Gate" (there 0.8);
    chosen by `fuse tune gate` on five development episodes, where the four values nearly tie (gate.json)."""
    temperature: Positive = 0.1
    """Softmax temperature. Supplement, "Confidence Gate" (the text says 1, at which the gate never opens)."""


class PlannerConfig(Section):
    """The learned planner of `amortized` and `fuse`."""

    name: Literal["plain", "summary", "none"] = "plain"
    """`plain`: picture, object, action (supplement, "Amortized Planner Architecture"); `summary`, ours: pitch
    and where the candidates are in the picture; `none`: every decision of `fuse` is explicit."""
    weights: Path | None = None
    """Another ONNX file of the same kind; none: the shipped one."""


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
    rule: Literal["patience", "patience_once_found", "policy"] | None = None
    """`patience`; the same, but counting from the first observation that has a score on (ours: as long as
    nothing was found, there is nothing to be content with); or the policy alone. The budget ends a search in
    any case. None: as the method is defined, which is `patience`, and for `vlm` the policy (supplement, "VLM
    Active")."""


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
    within_reach: bool = True
    """Weigh U_geo in E by each pixel's depth proximity (`stopping.near_m`, `far_m`), where there is a depth
    picture. Ours; in the paper's E a blank wall, of which SSNR says nothing (0 dB), outweighs the table."""


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


_Share = Annotated[float, Field(ge=0, le=1)]


class SensorConfig(Section):
    """What a real camera makes of the exact pictures of the tabletop world; docs/sensor.md has the model.

    Everything is off by default: the paper's simulator has no noise. Bounds are `fuse_render::Sensor`'s.
    """

    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 0
    """Chooses the noise, with episode and viewpoint: a view that is seen again is the same. Ours."""
    exposure_stops: Annotated[float, Field(ge=-8, le=8)] = 0.0
    """Linear light times 2^stops. Ours."""
    exposure_jitter_stops: Annotated[float, Field(ge=0, le=4)] = 0.0
    """Standard deviation of what each view's exposure is off by, stops. Ours."""
    defocus_px: Annotated[float, Field(ge=0, le=16)] = 0.0
    """Diameter of the disc that a point becomes, pixels (geometric optics). Ours."""
    motion_px: Annotated[float, Field(ge=0, le=64)] = 0.0
    """Length of the streak that a point becomes, pixels. Ours."""
    motion_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    """Direction of the streak: 0 along the rows, 90 along the columns. Ours."""
    shot_noise: _Share = 0.0
    """Standard deviation at white: 1 / sqrt(electrons at white). EMVA Standard 1288, linear camera model."""
    read_noise: _Share = 0.0
    """Standard deviation of what does not depend on light, share of white. EMVA Standard 1288."""
    depth_noise_m: _Share = 0.0
    """a of the depth's standard deviation a + b z^2, metres. Form: Khoshelham and Elberink, 2012."""
    depth_noise_per_m: _Share = 0.0
    """b of it, 1/m; they measured 0.0014 for the first Kinect (a = 0)."""
    depth_edge_dropout: _Share = 0.0
    """Chance that a pixel beside a jump of the depth is lost. Ours."""
    depth_step_per_m: _Share = 0.0
    """Step of inverse depth, 1/m. Khoshelham and Elberink, 2012: 0.00285 for the first Kinect."""


class KnowledgeConfig(Section):
    """From a query to candidate labels."""

    source: str = "graph"
    """`graph`; `plain`, text similarity of verb and label; `oracle`; `direct`, the verb itself; or `llm`."""
    top_k: Count = 5
    """Candidates kept, best first. Ours."""
    oracle: Literal["target", "valid"] = "target"
    """Tells the episode's target label (supplement, "Oracle-Label FUSE"), or every valid one."""
    open_vocabulary: Literal["leave_out", "nearest"] = "leave_out"
    """What becomes of a label that the segmenter does not know: left out, or replaced by the nearest known
    one by `encoder`; either is announced and recorded. `direct` always replaces. Ours."""
    llm: LlmConfig = LlmConfig()
    """The language model behind `llm`. Paper, "Robustness to Affordance Knowledge Sources"."""


class SegmenterConfig(Section):
    """Finding the candidates in a picture. docs/models/doors.md says how to bring your own."""

    name: str = "embedded"
    """`embedded` ships with the package; `embedded_patches` looks through FUSE's own encoder; `sam3` (the
    paper's) and `clip_patches` (its ablation) need checkpoints; an entry point's name, or
    `package.module:Class`, is yours."""
    weights: Path | None = None
    """Checkpoint folder or file; none: the shipped one, which `embedded` alone has."""
    device: Literal["cpu", "cuda", "auto"] = "cpu"
    """Where torch runs, if the segmenter uses it; `auto`: CUDA where there is one. What was taken is in the
    record. Ours."""
    threshold: Fraction | None = None
    """Scores below are left out; none: the segmenter's own. Not in the paper."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Settings of a segmenter of your own, handed to it as they are."""


class EncoderConfig(Section):
    """Words and pictures as vectors: what the nearest known label is, and what the learned planner reads."""

    name: str = "auto"
    """`embedded` is FUSE's own; `lexical` compares letters; `auto`: the first where its weights are, else the
    second; `clip` needs a checkpoint; an entry point's name, or `package.module:Class`, is yours. A learned
    planner reads with `embedded` whatever this is (supplement: CLIP ViT-B/16)."""
    weights: Path | None = None
    """encoder.onnx with its files beside it, or a checkpoint folder; none: the shipped one, of `embedded`."""
    device: Literal["cpu", "cuda", "auto"] = "cpu"
    """As `segmenter.device`."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Settings of an encoder of your own, handed to it as they are."""


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
    """Which view is returned; seed views never are (supplement, "3D Gaussian Splatting")."""

    include_initial: bool = True
    """Whether the start view may be returned. Not in the paper."""
    view: Literal["best", "final"] | None = None
    """The highest-scoring view, or the last one. None: as the method is defined, which is the last one for
    `vlm` (supplement, "VLM Active")."""


class Config(Section):
    """All settings of an agent."""

    method: str = "fuse"
    """What searches; `fuse_grounding.benchmark.methods` lists them. `package.module:factory` is yours."""
    camera: CameraConfig = CameraConfig()
    budget: BudgetConfig = BudgetConfig()
    search: SearchConfig = SearchConfig()
    gate: GateConfig = GateConfig()
    planner: PlannerConfig = PlannerConfig()
    stopping: StoppingConfig = StoppingConfig()
    ssnr: SsnrConfig = SsnrConfig()
    explicit: ExplicitConfig = ExplicitConfig()
    evidence: EvidenceConfig = EvidenceConfig()
    registration: RegistrationConfig = RegistrationConfig()
    map: MapConfig = MapConfig()
    render: RenderConfig = RenderConfig()
    sensor: SensorConfig = SensorConfig()
    knowledge: KnowledgeConfig = KnowledgeConfig()
    segmenter: SegmenterConfig = SegmenterConfig()
    encoder: EncoderConfig = EncoderConfig()
    metric: MetricConfig = MetricConfig()
    random: RandomConfig = RandomConfig()
    canonical: CanonicalConfig = CanonicalConfig()
    vlm: VlmConfig = VlmConfig()
    return_: ReturnConfig = Field(default=ReturnConfig(), alias="return")

    @classmethod
    def load(cls, path: str | Path | None = None, overrides: Iterable[str] = ()) -> Config:
        """Defaults, then the TOML file, then `section.key=value` overrides, later ones winning.

        Raises InputError naming file (or `--set`), key, what was found and what was expected.
        """
        values = read(Path(path)) if path is not None else {}
        origin = str(path) if path is not None else "config"
        cls.from_dict(values, origin)  # blames the file for its own mistakes, before any override
        for text in overrides:
            override = parse_override(text)
            cls.from_dict(override, f"--set {text}")
            merge(values, override)
        return cls.from_dict(values, origin)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], origin: str = "config") -> Config:
        """Checks a nested mapping. Raises InputError as `load` does."""
        try:
            config = cls.model_validate(values)
        except ValidationError as error:
            raise InputError(f"{origin}: {explain(error, cls)}") from None
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
        merge(values, {("return" if k == "return_" else k): v for k, v in sections.items()})
        return Config.from_dict(values)
