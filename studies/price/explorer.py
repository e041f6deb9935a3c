"""A flat learner whose random choices last: planned options, or one primitive repeated as long as these last.

It values, learns from and greedily chooses primitives alone, so that options serve exploration and nothing else. A
random choice is begun so seldom that the share of primitives that are random is epsilon, as without.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.algorithms.dqn import DQN, DQNSettings
from hrl_escape.agents.components.exploration import choose_best, compute_epsilon, make_rng, sample_legal
from hrl_escape.agents.registry import get_recipe
from hrl_escape.settings import replace_settings

__all__ = ["ExploringDQN", "ExploringSettings", "make_explorer", "measure_lengths"]

TRIED = 40
"""Options that are run before training, to know how long they last."""


@dataclass(frozen=True)
class ExploringSettings(DQNSettings):
    """Settings of `ExploringDQN`, beside those of `dqn`."""

    explores_by: Literal["options", "repeats"] = "options"
    """Kind of a random choice."""
    lengths: tuple[int, ...] = (1,)
    """Primitives of options in this room, of which a repeat's length is drawn."""
    primitives: int = 1
    """Actions that are primitives: the first of all."""


class ExploringDQN(DQN):
    """`dqn` over the primitives of an `OptionsEnv` with traces."""

    Settings: ClassVar[type] = ExploringSettings
    settings: ExploringSettings  # pyright: ignore[reportIncompatibleVariableOverride]
    needs_trace: ClassVar[bool] = True
    STATE = ("_repeated",)

    def __init__(self, observation_space: gymnasium.Space, seed: int, settings: ExploringSettings) -> None:
        super().__init__(observation_space, gymnasium.spaces.Discrete(settings.primitives), seed, settings)
        self._repeated = (0, 0)  # a primitive, and for how many decisions more

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Begin a random choice, go on with it, or take the best primitive of the online network."""
        settings, (choice, left) = self.settings, self._repeated
        legal = action_mask[: settings.primitives]
        if left and legal[choice]:
            self._repeated = choice, left - 1
            return choice
        epsilon, length = compute_epsilon(settings, self._schedule.steps), float(np.mean(settings.lengths))
        if self._action_rng.random() >= epsilon / (epsilon + length * (1 - epsilon)):
            return choose_best(self.values.online.compute(self._encoder.encode(observation)), legal)
        options = np.flatnonzero(action_mask[settings.primitives:]) + settings.primitives
        if settings.explores_by == "options" and len(options):
            return int(self._action_rng.choice(options))
        choice = sample_legal(legal, self._action_rng)
        self._repeated = choice, int(self._action_rng.choice(settings.lengths)) - 1
        return choice

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The legal primitive of highest value."""
        return super().act_greedy(observation, action_mask[: self.settings.primitives], rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn from each primitive of the decision as if it had been chosen."""
        if transition.terminated or transition.truncated:
            self._repeated = (0, 0)
        told: Mapping[str, float] = {}
        mask = transition.action_mask
        for number, step in enumerate(transition.trace, 1):
            is_last = number == len(transition.trace)
            after = transition.next_action_mask if is_last else step.next_action_mask.astype(np.bool_)
            reward = float(step.reward)
            told = super().observe(transition._replace(
                observation=step.observation, action=int(step.action), action_mask=mask[: self.settings.primitives],
                reward=reward, summed_reward=reward, duration=1, discount=self.gamma,
                next_observation=step.next_observation, next_action_mask=after[: self.settings.primitives],
                terminated=is_last and transition.terminated, truncated=is_last and transition.truncated, trace=()))
            mask = after
        return told


def make_explorer(explores_by: Literal["options", "repeats"], env: Any, seed: int, settings: Mapping[str, Any]
                  ) -> ExploringDQN:
    """Make the learner for an `OptionsEnv` with primitives and traces; the lengths of options are measured first."""
    lengths = measure_lengths(env)
    own = {"explores_by": explores_by, "lengths": lengths, "primitives": count_primitives(env)}
    changed = {**dataclasses.asdict(get_recipe("dqn")), **settings, **own}
    return ExploringDQN(env.observation_space, seed, replace_settings(ExploringSettings(), changed))


def count_primitives(env: Any) -> int:
    """Number of actions that are primitives."""
    space: Any = env.unwrapped.action_space
    return int(space.n)


def measure_lengths(env: Any) -> tuple[int, ...]:
    """Primitives of random legal options, one after the other."""
    first, rng, lengths = count_primitives(env), make_rng(0, "lengths"), []
    _, info = env.reset(seed=0)
    while len(lengths) < TRIED:
        options = np.flatnonzero(info["action_mask"][first:]) + first
        *_, terminated, truncated, info = env.step(int(rng.choice(options)))
        lengths.append(int(info["duration"]))
        if terminated or truncated:
            _, info = env.reset()
    return tuple(lengths)
