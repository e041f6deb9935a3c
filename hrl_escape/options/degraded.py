"""Options degraded by known amounts, to measure learning against option quality.

All draws are functions of a seed and the state (episode key and number of primitives), so a resumed run repeats them.
"""

from __future__ import annotations

import dataclasses
import time
import zlib
from typing import Annotated

import numpy as np
from typing_extensions import Self

from hrl_escape.env.config import RobotConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.noise import philox
from hrl_escape.errors import PlanningFailed, PlanningReason
from hrl_escape.names import number_options
from hrl_escape.options.option import Option, OptionAction
from hrl_escape.options.option_sets import DEFAULT_SET, check_option_set
from hrl_escape.settings import Range, Settings

FAILURE, STOP, _MISSING = range(3)
"""Purposes of draws, a word of their counter: failure at the start, and early stop after a primitive."""


@dataclasses.dataclass(frozen=True)
class OptionDegradation(Settings):
    """Amounts of degradation.

    It makes the degraded options of a room: `OptionsEnv(env, OptionDegradation(failure=0.2))`.
    """

    _section = "degradation"
    failure: Annotated[float, Range(0, 1)] = 0.0
    """Probability that an option fails at its start, which costs one primitive."""
    early_stop: Annotated[float, Range(0, 1)] = 0.0
    """Probability of ending after each primitive."""
    detour: Annotated[int, Range(0, 1000)] = 0
    """Primitives wasted at the start of an option by turning left and right."""
    latency: Annotated[float, Range(0, 60, "s")] = 0.0
    """Seconds to sleep at the start of an option, to simulate slow planning."""
    missing: Annotated[float, Range(0, 1)] = 0.0
    """Probability that an option is always masked."""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Seed of all draws."""
    option_set: str = DEFAULT_SET
    """Name of the option set to degrade."""

    def check(self) -> None:
        """Check the name of the option set."""
        check_option_set(self.option_set)

    def __call__(self, instance: RoomInstance) -> tuple[Option, ...]:
        """Make the options of a room and degrade each."""
        from hrl_escape.options.meta_actions import make_meta_options  # loads the planners

        options = make_meta_options(instance, self.option_set)
        return tuple(DegradedOption(option, self, key)
                     for option, key in zip(options, number_options(len(options)), strict=True))

    def degrade(self, option: Option) -> Option:
        """Degrade one option of any kind. Its draws depend on its name."""
        return DegradedOption(option, self, option.name)

    def make_key(self, key: str) -> tuple[int, int]:
        """Return the key of an option's draws, two 32-bit words."""
        return self.seed, zlib.crc32(key.encode())

    def draw(self, key: str, purpose: int, episode: int, primitive: int) -> float:
        """Return a uniform number in (0, 1) for an option and a purpose at a primitive of an episode."""
        mask = 0xFFFFFFFF
        word, *_ = philox((primitive & mask, purpose, episode & mask, episode >> 32 & mask), self.make_key(key))
        return (word + 0.5) / 2**32

    def lacks(self, key: str) -> bool:
        """Return whether an option is missing."""
        return self.draw(key, _MISSING, 0, 0) < self.missing


class DegradedOption(Option):
    """An option with a degraded policy or termination; see `OptionDegradation`."""

    def __init__(self, inner: Option, degradation: OptionDegradation, key: str) -> None:
        super().__init__(inner.name)
        self.inner, self.degradation, self._key = inner, degradation, key
        self.instance, self.targets, self.about = inner.instance, inner.targets, inner.about
        self.is_markov = inner.is_markov and not (degradation.failure or degradation.detour)
        self._is_missing = degradation.lacks(key)
        self._wasted, self._inner_runs = 0, False

    def _draw(self, purpose: int, state: RoomState) -> float:
        return self.degradation.draw(self._key, purpose, state.noise_key, state.primitives)

    def initiation(self, state: RoomState) -> bool:
        """Return whether the inner option can start; false if this option is missing."""
        return not self._is_missing and self.inner.initiation(state)

    def make_run(self) -> Self:
        """Copy this option and a run of the inner option."""
        run = super().make_run()
        run.inner = self.inner.make_run()
        return run

    def start(self, state: RoomState) -> None:
        """Sleep, then fail or start. Raises `PlanningFailed`."""
        super().start(state)
        if self.degradation.latency:
            time.sleep(self.degradation.latency)
        self.report.planner_seconds += self.degradation.latency
        self._wasted, self._inner_runs = 0, False
        if self._draw(FAILURE, state) < self.degradation.failure:
            pose = (state.x, state.y, 0.0)
            raise PlanningFailed(PlanningReason.TIMEOUT, self.name, pose, advice="The degradation made it fail")
        if not self.degradation.detour:
            self._begin(state)

    def _begin(self, state: RoomState) -> None:
        self._inner_runs = True
        try:
            self.inner.start(state)
        finally:
            self.report.add(self.inner.report)
            self.inner.report = self.report  # from now on its planning counts in this option's report

    def policy(self, state: RoomState) -> OptionAction:
        """Return the inner option's primitive.

        Detours are not a function of the state, so `sample_action` makes them.
        """
        return self.inner.policy(state)

    def sample_action(self, state: RoomState, rng: np.random.Generator) -> OptionAction:
        """Make the detour first, then follow the inner option."""
        if self._wasted < self.degradation.detour:
            self._wasted += 1
            robot = RobotConfig() if self.instance is None else self.instance.robot
            to, fro = robot.actions.turns[:2]
            return to if self._wasted % 2 else fro
        if not self._inner_runs and not self.is_markov:
            self._begin(state)
        return self.inner.sample_action(state, rng)

    def termination(self, state: RoomState) -> float:
        """Return 1 for an early stop, otherwise the inner option's probability."""
        if self._draw(STOP, state) < self.degradation.early_stop:
            return 1.0
        return self.inner.termination(state) if self._inner_runs or self.is_markov else 0.0
