"""The methods, a line each: policy, segmenter, knowledge, registration and map (or none), stopping.

A method of a user's own is named `package.module:factory` and needs no change here (docs/benchmark.md).
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fuse_grounding import chat, user_code
from fuse_grounding.config import Config
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.planning.amortized import Amortized, load_planner
from fuse_grounding.planning.explicit import Explicit
from fuse_grounding.planning.fixed import Fixed
from fuse_grounding.planning.gated import Gated
from fuse_grounding.planning.protocol import Policy, check_policy
from fuse_grounding.planning.random_walk import RandomWalk
from fuse_grounding.planning.sweep import Sweep
from fuse_grounding.planning.vlm import Vlm
from fuse_grounding.registry import Registry, unknown

STOPPING = ("patience", "one view", "policy")


@dataclass(frozen=True)
class Method:
    """A named way of searching.

    `policy` makes one from the configuration and the episode's index; `maps` says whether it takes
    seed views, registers and maps; `stopping` is `patience` (with the budget), `one view`, which is the
    policy's doing, or `policy`: it alone (with the budget) ends the search, and the last view is returned.
    `segmenter`, `knowledge`, `registration` and `patience` replace what is configured where the method is
    defined by them. `source` is the file of a user's own.
    """

    name: str
    policy: Callable[[Config, int], Policy]
    maps: bool = False
    stopping: str = "patience"
    summary: str = ""
    segmenter: str | None = None
    knowledge: str | None = None
    registration: str | None = None
    patience: int | None = None
    source: Path | None = None

    def __post_init__(self) -> None:
        """Raises InputError for a way of stopping that does not exist."""
        if self.stopping not in STOPPING:
            raise InputError(f"method `{self.name}`: {unknown('stopping', str(self.stopping), [*STOPPING])}")

    def first_policy(self, config: Config) -> Policy:
        """The first episode's policy, held against the protocol. Raises InputError, also for what a maker of
        a user's own raises."""
        whose = f"method `{self.name}`" + ("" if self.source is None else f" ({self.source.name})")
        try:
            return check_policy(self.policy(config, 0), f"{whose}: ")
        except Exception as error:
            if self.source is None or isinstance(error, InputError):
                raise
            raise InputError(
                f"{whose}: its policy cannot be made: {type(error).__name__}: {error}; "
                "expected a function of the configuration and the episode's index"
            ) from error

    def settle(self, config: Config) -> Config:
        """`config` as this method runs it. Raises InputError for a setting that does not exist."""
        fixed: dict[str, dict[str, Any]] = {
            "segmenter": {"name": self.segmenter},
            "knowledge": {"source": self.knowledge},
            "registration": {"backend": self.registration},
            "stopping": {"patience": self.patience},
        }
        if self.stopping == "policy":
            fixed["stopping"]["rule"] = config.stopping.rule or "policy"
            fixed["return_"] = {"view": config.return_.view or "final"}
        given = {name: {k: v for k, v in section.items() if v is not None} for name, section in fixed.items()}
        return config.with_(**{name: section for name, section in given.items() if section})


METHODS: Registry[Method] = Registry("method")


def _add(name: str, policy: Callable[[Config, int], Policy], **parts: Any) -> None:
    METHODS.add(name, Method(name, policy, **parts))


def _fuse(config: Config, episode: int) -> Policy:
    return Gated(load_planner(config), Explicit("explicit", config), config)


def _amortized(config: Config, episode: int) -> Policy:
    planner = load_planner(config)
    if planner is None:
        raise InputError(
            f"method `amortized` needs a planner, and planner.name = {config.planner.name!r} brings none: "
            "none of that name ships; planner.weights names one of your own"
        )
    return Amortized(planner, config)


_add(
    "static",
    lambda config, episode: Fixed("static", "here"),
    maps=False,
    stopping="one view",
    summary="the start view decides",
)
_add(
    "canonical",
    lambda config, episode: Fixed("canonical", "canonical"),
    maps=False,
    stopping="one view",
    summary="one view from above the scene's centre decides",
)
_add(
    "random",
    lambda config, episode: RandomWalk(config.random.seed + episode),
    maps=False,
    summary="uniform over the feasible actions",
)
_add(
    "sweep",
    lambda config, episode: Sweep(),
    maps=False,
    summary="further down, then around the table: sees nothing",
)
_add(
    "vlm",
    lambda config, episode: Vlm(chat.opened(config.vlm, "vlm"), config.vlm, config.camera),
    maps=False,
    stopping="policy",
    summary="a vision-language model sees colour and depth, moves, and stops (docs/language-models.md)",
)
_add(
    "semantic_only",
    lambda config, episode: Explicit("semantic_only", config),
    maps=False,
    summary="regions scored by the semantic map alone",
)
_add(
    "geometry_only",
    lambda config, episode: Explicit("geometry_only", config),
    maps=True,
    summary="regions scored by geometric uncertainty alone",
)
_add(
    "explicit",
    lambda config, episode: Explicit("explicit", config),
    maps=True,
    summary="regions scored by semantic evidence plus geometric uncertainty",
)
_add("amortized", _amortized, maps=False, summary="the learned planner alone")
_add("fuse", _fuse, maps=True, summary="confidence gate between amortised and explicit planning")
_add(
    "fuse_oracle",
    _fuse,
    maps=True,
    summary="the same with the episode's target label instead of candidates",
    knowledge="oracle",
)


def find(name: str) -> Method:
    """The method of that name, or what the factory `package.module:factory` makes.

    Raises InputError that suggests a near name, and for a factory that is not there or makes no method.
    """
    if ":" in name:
        return _own(name)
    if name not in METHODS.names():
        raise InputError(f"{unknown('method', name, METHODS.names())}, or package.module:factory")
    return METHODS.get(name)


def resolve(config: Config) -> tuple[Method, Config]:
    """The configured method, and the configuration as that method runs it. Raises InputError."""
    method = find(config.method)
    return method, method.settle(config)


def _own(reference: str) -> Method:
    factory = user_code.find("method", reference, "factory")
    who = f"method `{reference}`"
    if not (inspect.isroutine(factory) or inspect.isclass(factory)):  # a partial has no file of its own
        raise InputError(f"{who} is a {type(factory).__name__}, expected a function that makes a Method")
    try:
        made = factory()
    except FuseError:
        raise
    except Exception as error:
        raise InputError(f"{who} cannot be made: {type(error).__name__}: {error}") from error
    if not isinstance(made, Method):
        raise InputError(
            f"{who} made a {type(made).__name__}, expected a fuse_grounding.benchmark.methods.Method"
        )
    if not isinstance(made.name, str) or not re.fullmatch(r"[A-Za-z0-9_.-]+", made.name):
        raise InputError(f"{who} calls itself `{made.name}`, expected letters, digits, `_`, `-` and `.`")
    if made.name in METHODS.names():
        raise InputError(f"{who} calls itself `{made.name}`, which is a method of FUSE's own")
    return replace(made, source=user_code.source_file(factory))
