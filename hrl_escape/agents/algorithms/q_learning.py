"""Tabular Q-learning over decisions of any duration.

SMDP Q-learning of Bradtke and Duff (1994), as in Sutton, Precup and Singh (1999), section 3.2;
with durations of 1 it is Q-learning of Watkins (1989).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import gymnasium

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.components.bonuses import BonusSettings, CountBonus
from hrl_escape.agents.components.tables import TabularAgent, TabularAgentSettings
from hrl_escape.agents.streams import RowStreamAgent


@dataclass(frozen=True)
class QLearningSettings(BonusSettings, TabularAgentSettings):
    """Those of every agent with a table, and a bonus by counts, for `q-learning`."""


class QLearning(RowStreamAgent, TabularAgent):
    """Q(s, o) <- Q(s, o) + alpha [R + gamma^k (1 - terminated) max over legal o' of Q(s', o') - Q(s, o)]."""

    settings: QLearningSettings
    STATE = ("_bonus",)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: QLearningSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._bonus = CountBonus(observation_space, self.settings, self.name)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Back up the decision, with the bonus of the state reached."""
        error = self.back_up(transition, self._bonus.visit(transition.next_observation))
        return self.finish_decision(transition, error)
