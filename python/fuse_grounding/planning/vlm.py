"""VLM Active: a vision-language model moves the camera (supplement, "VLM Active").

Each decision sends the picture and its depth, the labels to look for, loop position and pitch, the feasible
actions and the latest decisions; the reply is a status, one horizontal and one pitch action, and whether the
target is visible, centred and reachable. It ends the search by `stop` while it says that the target is
visible. A reply that does not fit, or none after all attempts, is a decision to stay and go on, in branch
`vlm_invalid`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from fuse_grounding.chat import Chat, Message, NoReply
from fuse_grounding.config import CameraConfig
from fuse_grounding.config_chat import VlmConfig
from fuse_grounding.errors import FuseError, InputError
from fuse_grounding.knowledge.protocol import Confidant
from fuse_grounding.planning.protocol import Decision, Situation
from fuse_grounding.record import HOSTED, Stopwatch

# In the order of the fifteen actions: index 5 (pitch) + horizontal. The camera's own left.
HORIZONTAL = ("move_left_20", "move_left_10", "stay", "move_right_10", "move_right_20")
PITCH = ("pitch_up", "pitch_keep", "pitch_down")
STAY = 7
_FEASIBLE, _VALID, _INVALID = "feasible_actions", "vlm", "vlm_invalid"

SYSTEM = f"""\
You steer a camera that looks at a cluttered table, to find one object and see it well enough to pick it \
up. The camera stands on a closed loop around the table and faces its centre. The loop has discrete \
positions, 10 degrees apart; at each, the camera is tilted down by one of a few angles.

You see a colour picture and the depth of the same pixels (white is near, dark is far, black is unknown), \
and are told in JSON: `targets`, labels of objects of which one is wanted; `loop_position`; `pitch_deg`, the \
tilt downwards; `{_FEASIBLE}`, for each pitch action the horizontal actions that are possible with it; \
`history`, your latest decisions, oldest first, each with the position and tilt at which it was made.

Reply in JSON:
- `status`: `stop` only if a target is visible, in the middle of the picture, and near enough to be grasped; \
else `continue`, to search on or to get a better view;
- `horizontal`: one of {", ".join(HORIZONTAL)}: where the camera moves along the loop, in degrees; \
`move_left` is towards the left of the picture;
- `pitch`: one of {", ".join(PITCH)}: `pitch_down` tilts the camera further down;
- `target_visible`, `target_centered`, `target_reachable`: what holds of a target in this picture.
An action that is not feasible is not carried out.
"""


class Reply(BaseModel):
    """A decision of the model."""

    model_config = ConfigDict(extra="forbid")

    status: Literal["stop", "continue"]
    horizontal: Literal["stay", "move_left_10", "move_right_10", "move_left_20", "move_right_20"]
    pitch: Literal["pitch_keep", "pitch_up", "pitch_down"]
    target_visible: bool
    target_centered: bool
    target_reachable: bool

    @property
    def action(self) -> int:
        """Index of the fifteen."""
        return 5 * PITCH.index(self.pitch) + HORIZONTAL.index(self.horizontal)


class Vlm:
    """Asks a model for every action, and whether to stop; made for one episode."""

    start: Literal["here"] = "here"
    planner = None

    def __init__(self, chat: Chat, config: VlmConfig, camera: CameraConfig):
        self._chat, self._config, self._camera = chat, config, camera
        self._history: list[dict[str, Any]] = []
        self._failures = 0
        self._target: str | None = None

    def consult(self, world: Confidant | None) -> str | None:
        """See `Consulting.consult`: asks for the target's label where `vlm.labels` is `oracle`."""
        if self._config.labels != "oracle":
            return None
        if world is None:
            raise InputError("vlm.labels = oracle needs an episode that knows its target; use `candidates`")
        self._target = world.oracle_target()
        return "vlm: the world was asked for the episode's target, and the model is told its label"

    def decide(self, situation: Situation, clock: Stopwatch) -> Decision:
        """One question. The wait for the model is the clock's stage `api`.

        Raises FuseError after `vlm.failures` questions in a row without any reply, and InputError where
        the endpoint cannot be asked.
        """
        with clock("plan"):
            messages = self._messages(situation)
            try:
                answer = self._chat.ask(messages, Reply, lambda: clock(HOSTED))
            except NoReply as error:
                self._failures += 1
                if self._failures == self._config.failures:
                    raise FuseError(f"{error}; the last {self._failures} questions had no reply") from None
                return self._invalid(situation, f"no reply: {error}")
            self._failures = 0
            short = answer.key[:16]
            if answer.value is None:
                return self._invalid(situation, f"reply {short} does not fit: {answer.fault}")
            reply = answer.value
            notes: tuple[str, ...] = ()
            if answer.constraint == "prompt" and self._config.constraint == "auto":
                notes = ("vlm: the server takes no schema (response_format); it was put into the prompt",)
            if reply.status == "stop" and reply.target_visible:
                return Decision(None, _VALID, reason=f"the model stopped (reply {short})", notes=notes)
            if not situation.feasible[reply.action]:
                what = f"{reply.horizontal} with {reply.pitch} is not feasible"
                return self._invalid(situation, f"reply {short}: {what}", notes)
            self._remember(situation, reply.model_dump())
            return Decision(reply.action, _VALID, reason=f"{_seen(reply)} (reply {short})", notes=notes)

    def _invalid(self, situation: Situation, why: str, notes: tuple[str, ...] = ()) -> Decision:
        """No motion, and on."""
        self._remember(situation, {"status": "continue", "horizontal": "stay", "pitch": "pitch_keep"})
        self._history[-1]["note"] = "your reply was invalid; the camera did not move"
        return Decision(STAY, _INVALID, reason=f"{why}; no motion", notes=notes)

    def _remember(self, situation: Situation, decision: dict[str, Any]) -> None:
        self._history.append({"step": situation.index, **self._place(situation), **decision})
        del self._history[: max(0, len(self._history) - self._config.history)]

    def _place(self, situation: Situation) -> dict[str, Any]:
        pitch = situation.pitch_index
        return {
            "loop_position": situation.node,
            "pitch_deg": None if pitch is None else self._camera.pitches_deg[pitch],
        }

    def _messages(self, situation: Situation) -> list[Message]:
        candidates = [c.label for c in situation.candidates]
        told = {
            "targets": candidates if self._target is None else [self._target],
            "loop_positions": self._camera.nodes,
            **self._place(situation),
            _FEASIBLE: feasible_actions(situation.feasible),
            "history": self._history,
        }
        parts: list[str | np.ndarray] = [json.dumps(told), "Colour:", situation.rgb]
        if situation.depth is None:
            parts.append("The depth is not known.")
        else:
            depth = depth_picture(situation.depth, self._config.near_m, self._config.far_m)
            parts += [f"Depth, white at {self._config.near_m:g} m, dark at {self._config.far_m:g} m:", depth]
        return [Message("system", (SYSTEM,)), Message("user", tuple(parts))]


def feasible_actions(feasible: Sequence[bool] | np.ndarray) -> dict[str, list[str]]:
    """Pitch action -> horizontal actions that go with it, of a (15,) mask."""
    rows = {
        pitch: [name for i, name in enumerate(HORIZONTAL) if feasible[5 * row + i]]
        for row, pitch in enumerate(PITCH)
    }
    return {pitch: names for pitch, names in rows.items() if names}


def depth_picture(depth: np.ndarray, near_m: float, far_m: float) -> np.ndarray:
    """(H, W) uint8 of metres: 255 up to `near_m`, falling evenly to 32 from `far_m` on; 0 where unknown."""
    known = np.isfinite(depth) & (depth > 0)
    share = np.clip((far_m - np.where(known, depth, far_m)) / (far_m - near_m), 0.0, 1.0)
    return np.where(known, np.rint(32 + 223 * share), 0).astype(np.uint8)


def _seen(reply: Reply) -> str:
    holds = [name for name in ("visible", "centered", "reachable") if getattr(reply, f"target_{name}")]
    stopping = "stop without a visible target, so " if reply.status == "stop" else ""
    return f"{stopping}continue: target {', '.join(holds) or 'not visible'}"
