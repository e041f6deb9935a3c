"""A flat learner that looks ahead in a model of the room: along planned options, or along primitives at random.

It acts, explores and learns as `dqn` does, and for each primitive that it runs learns from one that it imagines. Where
moves lead is known from the start, as it is to a planner. What a touch does, and whether the exit lets the robot out,
is known once it has happened in that state of the puzzle: an imagined way ends before what is not known
(Sutton, Precup and Singh 1999, section 3.2: planning with models of options).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.replay import Experience, make_batch
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.agents.state import Kept
from hrl_escape.env.instance import Rectangle
from hrl_escape.options.execution import TraceStep
from studies.price.over_primitives import PrimitivesDQN, PrimitivesSettings, read_room

__all__ = ["LookaheadDQN", "LookaheadSettings", "list_events", "make_lookahead"]

EXIT = -1
Direction: TypeAlias = Literal["options", "random ways", "primitives"]
Event: TypeAlias = tuple[Any, int]
"""State of the puzzle, and bits of the targets touched anew in it, or `EXIT`."""


@dataclass(frozen=True, kw_only=True)
class LookaheadSettings(PrimitivesSettings):
    """Settings of `LookaheadDQN`, in addition to the settings of `dqn`."""

    looks_along: Direction = "options"
    """Imagined is a planned option, or random primitives for as long as one lasts. Each state learns from where
    the way ends; with `primitives` random ones are learned from as what is run, `n_step` at once."""


class LookaheadDQN(PrimitivesDQN):
    """`dqn` over primitives that imagines in `model`, a second environment of the same room."""

    Settings: ClassVar[type] = LookaheadSettings
    settings: LookaheadSettings  # pyright: ignore[reportIncompatibleVariableOverride]
    STATE = ("_ahead", "_rng", Kept("_known", pack=sorted, unpack=lambda known: {*map(tuple, known)}))

    def __init__(self, observation_space: gymnasium.Space, seed: int, settings: LookaheadSettings, model: Any) -> None:
        super().__init__(observation_space, seed, settings)
        self._model, self._rng = model, make_rng(seed, "lookahead")
        self._exit: Rectangle = model.unwrapped.instance.exit
        self._known: set[Event] = set()
        self._ahead = 0  # primitives imagined beyond those run

    def act(self, batch: Moments) -> Any:
        """Explore among primitives, as `dqn` does."""
        return super().act(batch._replace(action_mask=self.cut(batch.action_mask)))

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        """Note what the primitive did, learn from it, and imagine on from where it led."""
        ((step,),) = batch.trace
        self._known |= set(list_events(step, self._exit))
        logged = super().observe(batch._replace(
            action_mask=self.cut(batch.action_mask), next_action_mask=self.cut(batch.next_action_mask), trace=()))
        self._ahead -= 1
        if self._ahead < 0 and not (batch.terminated[0] or batch.truncated[0]):
            way = list(self.imagine(step.next_state))
            self._store(way, len(way) if self.settings.looks_along != "primitives" else self.settings.n_step)
            self._ahead += len(way)
        return logged

    def _store(self, way: Sequence[Experience], decisions: int) -> None:
        """Store the backups of some decisions from each state of a way, or of fewer up to its end."""
        for first, start in enumerate(way):
            joined = start
            for then in way[first + 1 : first + decisions]:
                joined = joined._replace(reward=joined.reward + joined.bootstrap * then.reward,
                                         bootstrap=joined.bootstrap * then.bootstrap,
                                         next_observation=then.next_observation, next_mask=then.next_mask)
            self.replay.add(make_batch(joined))

    def imagine(self, state: Any) -> Iterator[Experience]:
        """Primitives of one way from a state of the room, up to the first whose outcome is not known."""
        _, info = self._model.reset(options={"state": state._replace(primitives=0)})
        for action in self._choose_way(info["action_mask"]):
            *_, terminated, truncated, info = self._model.step(action)
            for number, step in enumerate(info["trace"], 1):
                if not self._known.issuperset(list_events(step, self._exit)):
                    return
                yield self._make_experience(step, terminated and number == len(info["trace"]))
            if terminated or truncated:
                return

    def _choose_way(self, action_mask: NDArray[np.int8]) -> Sequence[int]:
        """Actions of the model, one after the other: a legal option, or primitives."""
        settings = self.settings
        if settings.looks_along == "options":
            options = self.list_options(action_mask)
            return [int(self._rng.choice(options))] if len(options) else []
        return self._rng.integers(settings.primitives, size=self._rng.choice(settings.lengths)).tolist()

    def _make_experience(self, step: TraceStep, escapes: bool) -> Experience:
        settings, legal = self.settings, np.ones(self.settings.primitives, np.bool_)
        return Experience(self._encoder.encode(step.observation), legal, int(step.action),
                          step.reward * settings.reward_scale, 0.0 if escapes else self.gamma,
                          self._encoder.encode(step.next_observation), legal)


def list_events(step: TraceStep, exit_: Rectangle) -> Iterator[Event]:
    """Touches and ways into the exit, whose outcome no planner knows, with the puzzle's state before.

    A robot that is let out is in the exit, whether or not it came with this primitive.
    """
    before, after = step.state, step.next_state
    if touched := after.touching & ~before.touching:
        yield before.puzzle, touched
    if exit_.contains(after.x, after.y) and (before.puzzle != after.puzzle or not exit_.contains(before.x, before.y)):
        yield before.puzzle, EXIT


def make_lookahead(looks_along: Direction, env: Any, model: Any, seed: int,
                   settings: Mapping[str, Any]) -> LookaheadDQN:
    """Make the learner for an `OptionsEnv` with primitives and traces, with a second one of the same room as model."""
    changed = {**settings, "looks_along": looks_along}
    return LookaheadDQN(env.observation_space, seed, read_room(LookaheadSettings, model, changed), model)
