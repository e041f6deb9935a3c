"""Options (I, pi, beta) of Sutton, Precup and Singh (1999), and those that need no planner.

An option starts where its initiation set allows, follows its policy, and ends when its
termination says so. What runs it, counts its primitives and makes one SMDP transition of
them is `options_env.py`; the options that plan are in `synthesis.py`.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import OptionError

__all__ = ["Decision", "LearnedOption", "Option", "OptionReport", "ScriptedOption"]


@dataclasses.dataclass
class OptionReport:
    """What an option tells about its present run, from `start` on.

    Attributes:
        planner_seconds: wall time spent planning.
        planner_calls: plans asked for, from the cache or made.
        cache_hits: those that came from the cache.
        replans: plans made because the state was not where the plan expected it.
        unavoidable: names of targets that the plan had to press on the way.
    """

    planner_seconds: float = 0.0
    planner_calls: int = 0
    cache_hits: int = 0
    replans: int = 0
    unavoidable: tuple[str, ...] = ()

    def add(self, other: OptionReport) -> None:
        """Add what a nested option reports."""
        self.planner_seconds += other.planner_seconds
        self.planner_calls += other.planner_calls
        self.cache_hits += other.cache_hits
        self.replans += other.replans
        self.unavoidable += other.unavoidable


class Option(ABC):
    """A temporally extended action.

    The one who runs it calls `start` once, then `policy(s)` and, at the state s' that the
    primitive led to, `termination(s')`, again and again. An option may keep what it likes
    between these calls (a plan, say), but then it is no function of the state and
    `is_markov` must stay false: intra-option learning relies on it.

    Attributes:
        name: stable name; a verb phrase or `meta-NN`.
        is_markov: policy and termination are functions of the state alone.
        instance: the room that the option was made for; None if it suits any.
        targets: indices of the targets it means to press; None where it makes no promise. Whatever else it
            presses is told in `info["option"]["also_pressed"]`.
        report: what the present run tells (planning time and so on).
    """

    name: str
    is_markov: bool = False
    instance: RoomInstance | None = None
    targets: tuple[int, ...] | None = None

    def __init__(self, name: str) -> None:
        self.name = name
        self.report = OptionReport()

    def initiation(self, state: RoomState) -> bool:
        """Say whether the option may start here. Cheap: it is asked at every decision."""
        del state
        return True

    def start(self, state: RoomState) -> None:
        """Begin a run here. May raise `PlanningFailed`; the decision then costs one primitive."""
        del state
        self.report = OptionReport()

    @abstractmethod
    def policy(self, state: RoomState) -> Decision:
        """Choose a primitive, or a lower option to run to its end before asking again."""

    @abstractmethod
    def termination(self, state: RoomState) -> float:
        """Probability beta(s') of ending at the state that was reached."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"


Decision: TypeAlias = int | Option


class ScriptedOption(Option):
    """Runs a fixed list of primitives, whatever happens (open loop)."""

    def __init__(self, name: str, actions: Sequence[int]) -> None:
        super().__init__(name)
        if not actions:
            raise OptionError(f"option {name!r} has no actions: give it at least one primitive")
        self.actions = tuple(int(action) for action in actions)
        self._done = 0

    def start(self, state: RoomState) -> None:
        """Begin with the first primitive."""
        super().start(state)
        self._done = 0

    def policy(self, state: RoomState) -> int:
        """The next primitive of the list."""
        action = self.actions[self._done]
        self._done += 1
        return action

    def termination(self, state: RoomState) -> float:
        """1 after the last primitive."""
        return float(self._done >= len(self.actions))


class LearnedOption(Option):
    """Follows a learned policy: a function from observation to primitive.

    Args:
        name: stable name.
        policy: observation -> primitive, a deterministic function.
        termination: state -> probability of ending there.
        observe: state -> the observation that the policy was trained on, such as
            `make_observer(instance, "features")`.
        initiation: state -> may it start there; None for anywhere.
    """

    is_markov = True

    def __init__(
        self,
        name: str,
        policy: Callable[[Any], int],
        termination: Callable[[RoomState], float],
        observe: Callable[[RoomState], Any],
        initiation: Callable[[RoomState], bool] | None = None,
    ) -> None:
        super().__init__(name)
        self._policy, self._termination, self._observe = policy, termination, observe
        self._initiation = initiation

    def initiation(self, state: RoomState) -> bool:
        """Where the given function allows."""
        return self._initiation is None or bool(self._initiation(state))

    def policy(self, state: RoomState) -> int:
        """The learned policy's primitive for what it observes here."""
        return int(self._policy(self._observe(state)))

    def termination(self, state: RoomState) -> float:
        """The given function's probability."""
        return float(self._termination(state))
