"""Tabular Q-learning over decisions of any duration.

SMDP Q-learning of Bradtke and Duff (1994), as in Sutton, Precup and Singh (1999), section 3.2. With durations of 1 it
is Q-learning of Watkins (1989).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import gymnasium

from hrl_escape.agents.agent import AgentSettings, SMDPTransition
from hrl_escape.agents.components.bonuses import CountBonus
from hrl_escape.agents.components.tables import TabularAgent
from hrl_escape.agents.single_env import SwitchingAgent
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class QLearningSettings(AgentSettings):
    """Settings of `q-learning`: the settings of every agent with a table, and a bonus by counts."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive, or per decision if `discounting` is `decision`. Higher values look further ahead and
    learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma, as the
    paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination, as in the
    paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""
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
    bonus_weight: Annotated[float, Range(0)] = 0.0
    """Largest cost of reaching known cells, in units of return: the n-th visit costs bonus_weight (1 - 1 / sqrt(n)).
    More explores more; 0 turns the bonus off."""
    bonus_bins: Annotated[int, Range(2)] = 5
    """Number of evenly spaced points, both bounds included, to round bounded components to for counting: 5 over a 20 m
    room is 5 m. Binary components are unchanged."""


class QLearning(SwitchingAgent, TabularAgent):
    """Q(s, o) <- Q(s, o) + alpha [R + gamma^k (1 - terminated) max over legal o' of Q(s', o') - Q(s, o)]."""

    settings: QLearningSettings
    STATE = ("_bonus",)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: QLearningSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._bonus = CountBonus(observation_space, self.settings.bonus_weight, self.settings.bonus_bins, self.name)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Back up the decision, with the bonus of the next state."""
        error = self.back_up(transition, self._bonus.visit(transition.next_observation))
        return self.finish_decision(transition, error)
