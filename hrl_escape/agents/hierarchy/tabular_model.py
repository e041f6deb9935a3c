"""Finite environments as data: every outcome of every action in every state, for exact values.

Gymnasium's toy-text environments carry such a model; of a deterministic environment whose state can be read and set,
one is enumerated.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeAlias

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import count_actions, read_action_mask
from hrl_escape.agents.hierarchy.task import Hierarchy, Seen
from hrl_escape.errors import UnsupportedError

__all__ = ["StatefulEnv", "TabularModel", "enumerate_model", "read_model"]

Outcomes: TypeAlias = Sequence[tuple[float, int, float, bool]]
"""Ways an action can go: (probability, next state, reward, terminated), as in Gymnasium's `P[state][action]`."""


@dataclass(frozen=True, eq=False)
class TabularModel:
    """A finite environment whose rules are known.

    Attributes:
        outcomes: by state and action.
        starts: (states,), probability of each first state.
        observations: what an agent sees in each state.
        masks: bool (states, actions), the legal actions; None where all are legal everywhere.
    """

    outcomes: Sequence[Sequence[Outcomes]]
    starts: NDArray[np.float64]
    observations: Sequence[Any]
    masks: NDArray[np.bool_] | None = None

    @cached_property
    def legal(self) -> NDArray[np.bool_]:
        """Legal actions, bool (states, actions)."""
        return np.ones((len(self.outcomes), len(self.outcomes[0])), np.bool_) if self.masks is None else self.masks

    def see(self, hierarchy: Hierarchy) -> list[Seen]:
        """The moment of each state."""
        return [hierarchy.see(seen, mask) for seen, mask in zip(self.observations, self.legal, strict=True)]


def read_model(env: gymnasium.Env) -> TabularModel:
    """Read the model that a toy-text environment carries (FrozenLake, Taxi, CliffWalking).

    Raises:
        UnsupportedError: it carries none.
    """
    inner: Any = env.unwrapped
    rules, starts = getattr(inner, "P", None), getattr(inner, "initial_state_distrib", None)
    if rules is None or starts is None:
        raise UnsupportedError(f"{type(inner).__name__} has no attributes P and initial_state_distrib; a deterministic "
                               "environment with get_state and set_state can be enumerated by enumerate_model")
    outcomes = [[rules[state][action] for action in range(len(rules[state]))] for state in range(len(rules))]
    return TabularModel(outcomes, np.asarray(starts, np.float64), range(len(rules)))


class StatefulEnv(Protocol):
    """An environment whose state can be read and set."""

    def get_state(self) -> Any:
        """Everything that decides what follows, as `set_state` takes it."""
        ...

    def set_state(self, state: Any) -> None:
        """Go on from a state."""
        ...


def enumerate_model(
    env: gymnasium.Env,
    key: Callable[[Any], Hashable] = lambda state: state,
    seeds: Sequence[int] = (0,),
    most_states: int = 200_000,
) -> TabularModel:
    """Enumerate a deterministic environment by trying every action in every state that can be reached.

    Args:
        env: with `get_state` and `set_state` (`StatefulEnv`) and Discrete actions. Truncations are left out.
        key: state -> what tells it from others; leave out clocks, or no state is ever met again.
        seeds: of the first states, which are equally likely.
        most_states: bound on states.

    Raises:
        UnsupportedError: more states than `most_states`, or no `get_state`.
    """
    inner: Any = env.unwrapped
    if not (hasattr(inner, "get_state") and hasattr(inner, "set_state")):
        raise UnsupportedError(f"{type(inner).__name__} has no get_state and set_state, so it cannot be enumerated")
    actions = count_actions(env.action_space, "enumerate_model")
    numbers: dict[Hashable, int] = {}
    states: list[Any] = []
    observations: list[Any] = []
    masks: list[NDArray[np.bool_]] = []

    def number(observation: Any, info: Any) -> int:
        state = inner.get_state()
        name = key(state)
        if name not in numbers:
            if len(states) == most_states:
                raise UnsupportedError(f"more than {most_states:,} states; raise most_states, or give a key that "
                                       "leaves out what changes nothing")
            numbers[name] = len(states)
            states.append(state)
            observations.append(observation)
            masks.append(read_action_mask(info, actions))
            waiting.append(numbers[name])
        return numbers[name]

    waiting: deque[int] = deque()
    first = [number(*env.reset(seed=seed)) for seed in seeds]
    outcomes: list[list[Outcomes]] = []
    while waiting:
        state = waiting.popleft()
        row: list[Outcomes] = []
        for action in range(actions):
            inner.set_state(states[state])
            observation, reward, terminated, _, info = env.step(action)
            row.append([(1.0, number(observation, info), float(reward), bool(terminated))])
        outcomes.append(row)
    starts = np.bincount(first, minlength=len(states)) / len(first)
    return TabularModel(outcomes, starts, observations, np.array(masks))
