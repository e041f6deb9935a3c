"""Tabular Q-learning over decisions of any duration.

SMDP Q-learning of Bradtke and Duff (1994), as in Sutton, Precup and Singh (1999), section 3.2;
with durations of 1 it is Q-learning of Watkins (1989).
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
    """Those of every agent with a table, and a bonus by counts, for `q-learning`."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive; per decision if `discounting` is `decision`."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive`: an action of k primitives is worth sum gamma^i r_i and discounts by gamma^k. `decision`: it is
    worth the plain sum and discounts by gamma, as if it were one step, as the paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the state in which an episode was truncated; otherwise truncation counts as termination, as in
    the paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit in which warm-up, update and exploration schedules count. With primitives, flat and option-level agents do
    the same work on the same experience."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Steps of the clock over which epsilon falls linearly."""
    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy`: uniform over legal actions with probability epsilon, else greedy. `boltzmann`: probability
    proportional to exp(q / temperature)."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as keras-rl 0.4.2 has it: values beyond it are equally
    likely. 0 sets no bound."""
    bins: Annotated[int, Range(2)] = 11
    """A component with bounds low, high is rounded to the nearest of this many evenly spaced points, both ends
    included: 11 over a 20 m room is 2 m; a bit stays a bit."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """A component without bounds is rounded to multiples of this, in its own unit."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size alpha at a state and action's first update; 1 suits deterministic environments."""
    learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """The n-th update of a state and action uses learning_rate / n^power; above 0.5 converges under noise."""
    initial_value: float = 0.0
    """Value of actions that were never tried, in units of return."""
    bonus_weight: Annotated[float, Range(0)] = 0.0
    """A decision that leads to a cell for the n-th time costs this (1 - 1 / sqrt(n)), in units of return; 0 counts
    nothing."""
    bonus_bins: Annotated[int, Range(2)] = 5
    """A component of the observation with bounds is rounded to the nearest of this many points for counting, both ends
    included: 5 over a 20 m room is 5 m; a bit stays a bit."""


class QLearning(SwitchingAgent, TabularAgent):
    """Q(s, o) <- Q(s, o) + alpha [R + gamma^k (1 - terminated) max over legal o' of Q(s', o') - Q(s, o)]."""

    settings: QLearningSettings
    STATE = ("_bonus",)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: QLearningSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._bonus = CountBonus(observation_space, self.settings.bonus_weight, self.settings.bonus_bins, self.name)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Back up the decision, with the bonus of the state reached."""
        error = self.back_up(transition, self._bonus.visit(transition.next_observation))
        return self.finish_decision(transition, error)
