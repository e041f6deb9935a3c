"""Options (I, pi, beta) of Sutton, Precup and Singh (1999), made from functions, tables and lists.

`options_env.py` runs options and makes one SMDP transition of their primitives. Learned options are in `learned.py`,
planned options in `meta_actions.py`.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import OptionError
from hrl_escape.planning.route import PlanningReport


class Option(ABC):
    """A temporally extended action.

    A state is what the domain of the environment returns: the full `RoomState` of a room, the observation of any other
    environment, or the result of your own `OptionDomain`.

    `OptionsEnv` calls `make_run` for each run, and `start` once on the result. It then alternates `sample_action(s)`,
    which calls `policy(s)`, and `termination(s')`, where s' is the state that the primitive led to. An option can keep
    data between these calls, such as a plan. Set them in `start`, and leave `is_markov` false, because intra-option
    learning relies on it. The option itself holds no data of a run, so several environments can share it.

    Attributes:
        name: stable name: a verb and its target, such as `press-button-1`.
        is_markov: true if policy and termination are functions of the state alone.
        instance: the room that the option was made for, or None if it suits any.
        targets: indices of the targets that it presses on purpose, or None without a promise. Other targets that it
            presses are marked in `info["also_pressed"]`.
        about: name of the target or prop that it is about, or `exit`, as in the rows of the observation `objects`, or
            None for none.
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

    def initiation(self, state: Any) -> bool:
        """Return whether the option can start here. Called at every decision, so it must be fast."""
        return True

    def make_run(self) -> Self:
        """Return the object that carries out one run: by default a shallow copy with its own report.

        Override it if a run changes objects that `start` does not create, such as an inner option.
        """
        run = copy.copy(self)
        run.report = PlanningReport()
        return run

    def start(self, state: Any) -> None:
        """Start a run at this state. If it raises `PlanningFailed`, the decision costs one primitive."""
        self.report = PlanningReport()

    def check_actions(self, state: Any, count: int) -> None:
        """Check the number of actions of the environment; called at each reset.

        Raises:
            OptionError: the option was made for another number of actions. By default any number is accepted.
        """
        del state, count

    @abstractmethod
    def policy(self, state: Any) -> Any:
        """Return a primitive, as the environment takes it, or a lower-level option to run to its end."""

    def sample_action(self, state: Any, rng: np.random.Generator) -> Any:
        """Sample from the policy with the caller's generator. The default is the deterministic `policy`."""
        return self.policy(state)

    @abstractmethod
    def termination(self, state: Any) -> float:
        """Return the probability beta(s') of ending at the state that was reached."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}>"


OptionAction: TypeAlias = int | Option
"""Action of an option in a room: a primitive, or a lower-level option to run to its end."""


class ScriptedOption(Option):
    """Option that runs a fixed list of primitives, open loop."""

    def __init__(self, name: str, actions: Sequence[Any]) -> None:
        super().__init__(name)
        if not len(actions):
            raise OptionError(f"option {name!r} has no actions: give it at least one primitive")
        self.actions = tuple(actions)
        self._done = 0

    def start(self, state: Any) -> None:
        """Start with the first primitive."""
        super().start(state)
        self._done = 0

    def policy(self, state: Any) -> Any:
        """Return the next primitive of the list."""
        action = self.actions[self._done]
        self._done += 1
        return action

    def termination(self, state: Any) -> float:
        """Return 1 after the last primitive, else 0."""
        return float(self._done >= len(self.actions))


class FunctionOption(Option):
    """Option made from three functions of the state.

    Args:
        name: stable name.
        policy: state -> primitive or lower-level option; (state, generator) -> the same if it is stochastic.
        termination: state -> probability of ending there.
        initiation: state -> whether the option can start there, or None for everywhere.
        is_stochastic: whether the policy is random. It must draw from the given generator only.
    """

    def __init__(self, name: str, policy: Callable[..., Any], termination: Callable[[Any], float],
                 initiation: Callable[[Any], bool] | None = None, is_stochastic: bool = False) -> None:
        super().__init__(name)
        self.is_stochastic, self.is_markov = is_stochastic, not is_stochastic
        self._policy, self._termination, self._initiation = policy, termination, initiation

    def initiation(self, state: Any) -> bool:
        """Return the result of the given function; true without one."""
        return self._initiation is None or bool(self._initiation(state))

    def policy(self, state: Any) -> Any:
        """Return the result of the given function.

        Raises:
            OptionError: the policy is stochastic; use `sample_action`.
        """
        if self.is_stochastic:
            raise OptionError(f"option {self.name!r} is stochastic: call sample_action(state, generator)")
        return self._policy(state)

    def sample_action(self, state: Any, rng: np.random.Generator) -> Any:
        """Return the result of the given function, called with the generator if it is stochastic."""
        return self._policy(state, rng) if self.is_stochastic else self.policy(state)

    def termination(self, state: Any) -> float:
        """Return the probability from the given function."""
        return float(self._termination(state))

    def describe(self) -> Mapping[str, Any]:
        """Return the functions that identify a run over this option."""
        return {"policy": self._policy, "termination": self._termination, "initiation": self._initiation,
                "is_stochastic": self.is_stochastic}


class TableOption(Option):
    """Option made from tables, for environments with hashable states.

    Args:
        name: stable name.
        policy: state -> primitive, as a mapping or a list by number of the state; or probabilities, (states, actions),
            with rows of 0 for states without the option.
        termination: state -> probability of ending there, in the same form. States that a mapping lacks have
            probability 1.
        initiation: states where the option can start, or None for all states with an entry in the policy and a
            termination below 1.

    Raises:
        OptionError: a probability is outside 0 to 1, or a row of the policy does not sum to 1.
    """

    def __init__(self, name: str, policy: Mapping[Any, Any] | Sequence[Any] | NDArray[Any],
                 termination: Mapping[Any, float] | Sequence[float] | NDArray[Any],
                 initiation: Collection[Any] | None = None) -> None:
        super().__init__(name)
        rows = _make_table(policy)
        is_stochastic = any(np.ndim(row) == 1 for row in rows.values())
        if is_stochastic:
            rows = {state: np.asarray(row, np.float64) for state, row in rows.items() if np.any(row)}
            wrong = [state for state, row in rows.items() if row.min() < 0 or abs(row.sum() - 1) > 1e-9]
            if wrong:
                raise OptionError(f"option {name!r}: the probabilities in state {wrong[0]!r} must be "
                                  f"non-negative and sum to 1, got {rows[wrong[0]].tolist()}")
        self._actions = {state: int(np.argmax(row)) if is_stochastic else row for state, row in rows.items()}
        self._rows = rows if is_stochastic and any(np.count_nonzero(row) > 1 for row in rows.values()) else {}
        self.is_markov = not self._rows
        self._beta = {state: float(beta) for state, beta in _make_table(termination).items()}
        wrong = [state for state, beta in self._beta.items() if not 0.0 <= beta <= 1.0]
        if wrong:
            raise OptionError(f"option {name!r} ends in state {wrong[0]!r} with {self._beta[wrong[0]]}, which must be "
                              "from 0 to 1")
        self._starts = frozenset(
            (state for state in self._actions if self.termination(state) < 1.0) if initiation is None else initiation)

    def initiation(self, state: Any) -> bool:
        """Return whether the state is in the initiation set."""
        return _make_key(state) in self._starts

    def policy(self, state: Any) -> Any:
        """Return the primitive of this state, the most probable one if the policy is stochastic.

        Raises:
            OptionError: the table has no entry.
        """
        try:
            return self._actions[_make_key(state)]
        except KeyError:
            raise OptionError(f"option {self.name!r} has no action for state {state!r}: give it one, or let it end "
                              "there") from None

    def sample_action(self, state: Any, rng: np.random.Generator) -> Any:
        """Sample from the probabilities of this state."""
        action, row = self.policy(state), self._rows.get(_make_key(state))
        return action if row is None else int(rng.choice(len(row), p=row))

    def termination(self, state: Any) -> float:
        """Return the probability of this state; 1 if the table has no entry."""
        return self._beta.get(_make_key(state), 1.0)

    def describe(self) -> Mapping[str, Any]:
        """Return the tables that identify a run over this option."""
        return {"policy": _list_entries(self._rows or self._actions), "termination": _list_entries(self._beta),
                "initiation": sorted(map(repr, self._starts))}


def _make_table(values: Mapping[Any, Any] | Sequence[Any] | NDArray[Any]) -> dict[Any, Any]:
    """Convert a mapping, or values by number of the state, to a dict with hashable keys."""
    entries: Iterable[tuple[Any, Any]] = values.items() if isinstance(values, Mapping) else enumerate(values)
    return {_make_key(state): value for state, value in entries}


def _make_key(state: Any) -> Any:
    if not isinstance(state, np.ndarray):
        return state
    array = cast("NDArray[Any]", state)
    return tuple(array.ravel().tolist()) if array.ndim else array.item()


def _list_entries(table: Mapping[Any, Any]) -> list[Any]:
    return [[repr(state), value] for state, value in sorted(table.items(), key=lambda entry: repr(entry[0]))]
