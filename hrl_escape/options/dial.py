"""The option-quality dial: options made worse by known amounts, for robustness curves.

When does hierarchy stop paying as options get worse? `OptionDial` makes the meta-actions of a
room and degrades each: it fails, stops early, wastes time, plans slowly, or is missing. All
draws are functions of the dial's seed and of the state (its episode key and primitive count),
so a resumed run meets the same ones.
"""

from __future__ import annotations

import dataclasses
import time
import zlib

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.noise import philox
from hrl_escape.env.primitives import BASE_PRIMITIVES
from hrl_escape.env.settings import Settings, knob
from hrl_escape.errors import PlanningFailed, PlanningReason
from hrl_escape.options.option import Decision, Option

__all__ = ["DegradedOption", "OptionDial"]

_NAMES = [primitive.name for primitive in BASE_PRIMITIVES]
_TO, _FRO = _NAMES.index("turn-left"), _NAMES.index("turn-right")
_FAILURE, _STOP, _MISSING = range(3)


@dataclasses.dataclass(frozen=True)
class OptionDial(Settings):
    """How bad options are; call it with an instance to make them: `OptionsEnv(env, OptionDial(failure=0.2))`."""

    _section = "dial"
    failure: float = knob(0.0, "Probability that a run fails at its start; it then costs one primitive.", "", 0, 1)
    early_stop: float = knob(0.0, "Probability, after every primitive, of ending there.", "", 0, 1)
    detour: int = knob(0, "Primitives wasted at the start of every run (turning to and fro).", "", 0, 1000)
    latency: float = knob(0.0, "Time really slept at the start of every run, as if planning took longer.", "s", 0, 60)
    missing: float = knob(0.0, "Probability, for each option, that it is masked for ever.", "", 0, 1)
    seed: int = knob(0, "Of all draws.", "", 0, 2**31 - 1)
    flavour: str = knob("press", "Which meta-actions.", choices=("press", "press-with-ancestors"))

    def __call__(self, instance: RoomInstance) -> tuple[Option, ...]:
        """Make the room's meta-actions and degrade each."""
        from hrl_escape.options.synthesis import make_meta_options  # brings the planners in

        return tuple(self.degrade(option) for option in make_meta_options(instance, self.flavour))

    def degrade(self, option: Option) -> Option:
        """Degrade one option of any kind."""
        return DegradedOption(option, self)


class DegradedOption(Option):
    """An option that is worse than another one by what a dial says."""

    def __init__(self, inner: Option, dial: OptionDial) -> None:
        super().__init__(inner.name)
        self.inner, self.dial = inner, dial
        self.instance, self.targets = inner.instance, inner.targets
        self.is_markov = inner.is_markov and not (dial.failure or dial.detour)
        self._key = (dial.seed, zlib.crc32(inner.name.encode()))
        self._is_missing = self._draw(_MISSING, 0, 0) < dial.missing
        self._wasted, self._inner_runs = 0, False

    def _draw(self, purpose: int, episode: int, primitive: int) -> float:
        """A uniform number in (0, 1) for a purpose at a moment of an episode."""
        mask = 0xFFFFFFFF
        word, *_ = philox((primitive & mask, purpose, episode & mask, episode >> 32 & mask), self._key)
        return (word + 0.5) / 2**32

    def initiation(self, state: RoomState) -> bool:
        """Where the option itself may start; nowhere if it is missing."""
        return not self._is_missing and self.inner.initiation(state)

    def start(self, state: RoomState) -> None:
        """Sleep, then fail or begin. Raises `PlanningFailed`."""
        super().start(state)
        if self.dial.latency:
            time.sleep(self.dial.latency)
        self.report.planner_seconds += self.dial.latency
        self._wasted, self._inner_runs = 0, False
        if self._draw(_FAILURE, state.noise_key, state.primitives) < self.dial.failure:
            pose = (state.x, state.y, 0.0)
            raise PlanningFailed(PlanningReason.TIMEOUT, self.name, pose, advice="The option dial made it fail")
        if not self.dial.detour:
            self._begin(state)

    def _begin(self, state: RoomState) -> None:
        self._inner_runs = True
        try:
            self.inner.start(state)
        finally:
            self.report.add(self.inner.report)
            self.inner.report = self.report  # what it reports from now on is ours

    def policy(self, state: RoomState) -> Decision:
        """First the detour, then what the option itself does."""
        if self._wasted < self.dial.detour:
            self._wasted += 1
            return _TO if self._wasted % 2 else _FRO
        if not self._inner_runs and not self.is_markov:
            self._begin(state)
        return self.inner.policy(state)

    def termination(self, state: RoomState) -> float:
        """1 where it stops early, else the option's own probability."""
        if self._draw(_STOP, state.noise_key, state.primitives) < self.dial.early_stop:
            return 1.0
        return self.inner.termination(state) if self._inner_runs or self.is_markov else 0.0
