"""The methods: policy, whether it registers and maps, what it knows. One line each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fuse_grounding import chat
from fuse_grounding.config import Config
from fuse_grounding.errors import InputError
from fuse_grounding.planning.amortized import Amortized, load_planner
from fuse_grounding.planning.explicit import Explicit
from fuse_grounding.planning.fixed import Fixed
from fuse_grounding.planning.gated import Gated
from fuse_grounding.planning.protocol import Policy
from fuse_grounding.planning.random_walk import RandomWalk
from fuse_grounding.planning.vlm import Vlm
from fuse_grounding.registry import Registry


@dataclass(frozen=True)
class Method:
    """A named way of searching.

    `policy` makes one from the configuration and the episode's index; `maps` says whether it takes
    seed views, registers and maps; `stopping` is `patience` (with the budget), `one view`, or `policy`:
    it alone (with the budget) ends the search, and the last view is returned; `knowledge` replaces the
    configured source where the method is defined by it.
    """

    name: str
    policy: Callable[[Config, int], Policy]
    maps: bool
    stopping: str
    summary: str
    knowledge: str | None = None


METHODS: Registry[Method] = Registry("method")


def _add(
    name: str,
    policy: Callable[[Config, int], Policy],
    *,
    maps: bool,
    stopping: str = "patience",
    summary: str,
    knowledge: str | None = None,
) -> None:
    METHODS.add(name, Method(name, policy, maps, stopping, summary, knowledge))


def _fuse(config: Config, episode: int) -> Policy:
    return Gated(load_planner(config), Explicit("explicit", config), config.gate)


def _amortized(config: Config, episode: int) -> Policy:
    planner = load_planner(config)
    if planner is None:
        raise InputError(
            f"method `amortized` needs a planner, and planner.name = {config.planner.name!r} brings none: "
            "none of that name ships; planner.weights names one of your own"
        )
    return Amortized(planner)


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


def resolve(config: Config) -> tuple[Method, Config]:
    """The configured method, and the configuration as that method runs it. Raises InputError."""
    method = METHODS.get(config.method)
    if method.knowledge is not None:
        config = config.with_(knowledge={"source": method.knowledge})
    if method.stopping == "policy":
        rule, view = config.stopping.rule or "policy", config.return_.view or "final"
        config = config.with_(stopping={"rule": rule}, return_={"view": view})
    return method, config
