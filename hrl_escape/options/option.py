"""Options (I, pi, beta) of Sutton, Precup and Singh (1999), and the kinds that need no planner.

An option starts where its initiation set allows, follows its policy, and ends when its
termination says so. `options_env.py` runs it and makes one SMDP transition of its primitives;
options that plan are in `meta_actions.py`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import OptionError
from hrl_escape.planning.report import PlanningReport

__all__ = ["LearnedOption", "Option", "OptionAction", "ScriptedOption"]


class Option(ABC):
    """A temporally extended action.

    Its caller calls `start` once, then alternates `policy(s)` and `termination(s')`, where s' is the
    state that the primitive led to. An option may keep something between these calls (a plan, say),
    but then it is no function of the state and `is_markov` must stay false: intra-option learning
    relies on it.

    Attributes:
        name: stable name; a verb phrase or `meta-NN`.
        is_markov: policy and termination are functions of the state alone.
        instance: the room that the option was made for; None if it suits any.
        targets: indices of the targets it means to press; None if it makes no promise. All other targets that
            it presses are listed in `info["option"]["also_pressed"]`.
        about: name of the target or prop that it is about, or `exit`, as in the rows of the observation `objects`;
            None for an option about nothing in particular.
        report: planning done in the present run.
    """

    name: str
    is_markov: bool = False
    instance: RoomInstance | None = None
    targets: tuple[int, ...] | None = None
    about: str | None = None

    def __init__(self, name: str) -> None:
        self.name = name
        self.report = PlanningReport()

    def initiation(self, state: RoomState) -> bool:
        """Return whether the option may start here. Cheap: it is asked at every decision."""
        del state
        return True

    def start(self, state: RoomState) -> None:
        """Begin a run here. May raise `PlanningFailed`; the decision then costs one primitive."""
        del state
        self.report = PlanningReport()

    @abstractmethod
    def policy(self, state: RoomState) -> OptionAction:
        """Choose a primitive, or a lower option to run to its end before asking again."""

    @abstractmethod
    def termination(self, state: RoomState) -> float:
        """Probability beta(s') of ending at the state that was reached."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"


OptionAction: TypeAlias = int | Option
"""An option's action: a primitive, or a lower option to run to its end."""


class ScriptedOption(Option):
    """Fixed list of primitives, run open loop."""

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
        """Next primitive of the list."""
        action = self.actions[self._done]
        self._done += 1
        return action

    def termination(self, state: RoomState) -> float:
        """1 after the last primitive."""
        return float(self._done >= len(self.actions))


class LearnedOption(Option):
    """Learned policy: a function from observation to primitive.

    Args:
        name: stable name.
        policy: observation -> primitive, a deterministic function.
        termination: state -> probability of ending there.
        observe: state -> the observation that the policy was trained on, such as
            `make_observer(instance, "features")`.
        initiation: state -> whether it may start there; None for anywhere.
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
        """Ask the given function; without one, any state will do."""
        return self._initiation is None or bool(self._initiation(state))

    def policy(self, state: RoomState) -> int:
        """Primitive of the learned policy for the observation here."""
        return int(self._policy(self._observe(state)))

    def termination(self, state: RoomState) -> float:
        """Probability by the given function."""
        return float(self._termination(state))
