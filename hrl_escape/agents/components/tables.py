"""Tables of values, over actions of a discretised observation or under any keys, and agents that act by them.

An observation becomes a key: a Discrete one is the key itself, a Box is rounded component by component. Rows are
created when a state is first met, and memory grows with the number of visited states.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.agents.agent import (
    Agent,
    AgentSettings,
    SMDPTransition,
    compute_backup,
    count_actions,
    count_steps,
)
from hrl_escape.agents.components.exploration import (
    choose_best,
    compute_epsilon,
    make_rng,
    sample_action,
)
from hrl_escape.agents.state import Columns, Stateful
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.settings import Range


@dataclass(frozen=True)
class ResolutionSettings(AgentSettings):
    """Rounding of observations with and without bounds to states."""

    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""


@dataclass(frozen=True, kw_only=True)
class TabularSettings(AgentSettings):
    """Resolution of states, learning rates of the table, and exploration from it."""

    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy` draws evenly with probability epsilon. `boltzmann` draws by exp(q / temperature)."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return. More explores more."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as in keras-rl 0.4.2; values beyond it are equally likely. 0
    sets none."""
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of the first update of a state and action. 1 suits deterministic environments; smaller values average
    noise."""
    learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """Power p in the step size learning_rate / n^p of the n-th update of a state and action. Values above 0.5 converge
    under noise."""
    initial_value: float = 0.0
    """Value of actions that were never tried, in units of return. Higher values explore more."""


def make_discretiser(space: gymnasium.Space, settings: Any, agent: str) -> Callable[[Any], bytes]:
    """Return a function from observations to table keys, the bytes of int32 cells; see `make_cell_finder`."""
    find_cell = make_cell_finder(space, settings, agent)
    return lambda observation: find_cell(observation).tobytes()


def make_cell_finder(space: gymnasium.Space, settings: Any, agent: str
                     ) -> Callable[[Any], NDArray[np.int32]]:
    """Return a function from observations, one or a batch of them, to int32 cells of the same shape.

    Raises:
        UnsupportedSpaceError: observations are not Discrete, MultiBinary, MultiDiscrete or a one-axis Box.
    """
    if isinstance(space, (spaces.Discrete, spaces.MultiBinary, spaces.MultiDiscrete)):
        return lambda observation: np.asarray(observation, dtype=np.int32)
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise UnsupportedSpaceError(
            f"{agent} keeps a table and needs Discrete, MultiBinary, MultiDiscrete or flat Box observations, not "
            f"{space}; for other observations use dqn or ppo"
        )
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    bounded = (low > -1e6) & (high < 1e6) & (high > low)
    origin = np.where(bounded, low, 0.0)
    width = np.where(bounded, (np.where(bounded, high, 1.0) - origin) / (settings.bins - 1), settings.resolution)

    return lambda observation: np.rint((observation - origin) / width).astype(np.int32)


class QTable(Stateful):
    """Action values and update counts of the states met so far."""

    STATE = (Columns({"values": "_values", "counts": "_counts"}),)

    def __init__(self, actions: int, settings: Any) -> None:
        self._actions, self._settings = actions, settings
        self._values: dict[bytes, NDArray[np.float64]] = {}
        self._counts: dict[bytes, NDArray[np.int64]] = {}

    def __len__(self) -> int:
        return len(self._values)

    def get_values(self, key: bytes) -> NDArray[np.float64]:
        """Return the values of a state, (actions,), read-only. A state never met has `initial_value`."""
        values = self._values.get(key)
        return np.full(self._actions, self._settings.initial_value) if values is None else values

    def update(self, key: bytes, action: int, target: float) -> float:
        """Q(s, a) <- Q(s, a) + alpha (target - Q(s, a)); return the error before the update."""
        if key not in self._values:
            self._values[key] = np.full(self._actions, self._settings.initial_value)
            self._counts[key] = np.zeros(self._actions, np.int64)
        values, counts = self._values[key], self._counts[key]
        counts[action] += 1
        alpha = self._settings.learning_rate / float(counts[action]) ** self._settings.learning_rate_power
        error = target - values[action]
        # `values += alpha * error` would not reach the target exactly with alpha = 1.
        values[action] = (1 - alpha) * values[action] + alpha * target
        return float(error)

    def forget(self, action: int) -> None:
        """Reset an action to its initial value in every state, as if it had never been tried."""
        for values, counts in zip(self._values.values(), self._counts.values(), strict=True):
            values[action], counts[action] = self._settings.initial_value, 0


class ValueTable(Stateful):
    """Values and update counts by key, for agents whose states have different forms in different tasks.

    The n-th update of a key has step size learning_rate / n^power. Keys are literals: numbers, text, bytes, None and
    tuples of these.
    """

    STATE = (Columns({"values": "_values", "counts": "_counts"}, are_literal=True),)

    def __init__(self, learning_rate: float, power: float = 0.0, initial: float = 0.0) -> None:
        self._rate, self._power, self.initial = learning_rate, power, initial
        self._values: dict[Hashable, float] = {}
        self._counts: dict[Hashable, int] = {}

    def __len__(self) -> int:
        return len(self._values)

    def __iter__(self) -> Iterator[Any]:
        return iter(self._values)

    def get(self, key: Hashable) -> float:
        """Return the value of a key."""
        return self._values.get(key, self.initial)

    def update(self, key: Hashable, target: float) -> float:
        """Update a value, x <- x + alpha (target - x); return the error before the update."""
        value = self._values.get(key, self.initial)
        count = self._counts.get(key, 0) + 1
        alpha = self._rate / count**self._power if self._power else self._rate
        # This form reaches the target exactly with alpha = 1.
        self._values[key] = (1 - alpha) * value + alpha * target
        self._counts[key] = count
        return target - value


class TabularAgent(Agent):
    """Base class of agents that learn Q(s, o) in a table, by the SMDP backup of one decision.

    Ties are broken at random: in learning by the agent's generator, in evaluation by the episode's, which makes
    evaluations of frozen tables reproducible.
    """

    STATE = ("table", "_steps", "_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: Any = None) -> None:
        self.settings = settings or self.Settings()
        self.table = QTable(count_actions(action_space, self.name), self.settings)
        self._discretise = make_discretiser(observation_space, self.settings, self.name)
        self._rng = make_rng(seed, "actions")
        self._steps = 0

    def compute_values(self, observation: Any) -> NDArray[np.float64]:
        """Return Q(s, .) at an observation, float64 (actions,)."""
        return self.table.get_values(self._discretise(observation))

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say."""
        values = self.compute_values(observation)
        return sample_action(values, action_mask, self.settings, self._steps, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the legal action of highest value, drawn among equal values."""
        return choose_best(self.compute_values(observation), action_mask, rng)

    def back_up(self, transition: SMDPTransition, bonus: float = 0.0) -> float:
        """Q(s, o) <- Q(s, o) + alpha [R + bonus + b max over legal o' of Q(s', o') - Q(s, o)]; return the error."""
        reward, bootstrap = compute_backup(transition, self.settings)
        target = reward + bonus
        if bootstrap:
            next_values = self.compute_values(transition.next_observation)
            target += bootstrap * float(next_values[transition.next_action_mask].max())
        return self.table.update(self._discretise(transition.observation), transition.action, target)

    def finish_decision(self, transition: SMDPTransition, error: float) -> dict[str, float]:
        """Advance the clock; return numbers to log."""
        self._steps += count_steps(transition, self.settings)
        epsilon = compute_epsilon(self.settings, self._steps)
        return {"td_error": abs(error), "epsilon": epsilon, "states": len(self.table)}
