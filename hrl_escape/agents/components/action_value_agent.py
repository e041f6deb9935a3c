"""Deep agents with a network of action values: acting on Q, and the gradient step towards given targets.

A subclass says what the targets are; see `dqn` and `sarsa`.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.components.exploration import (
    ExplorationSettings,
    choose_best,
    compute_exploration_entropy,
    make_rng,
    sample_action,
)
from hrl_escape.agents.components.learner import Learner
from hrl_escape.agents.components.networks import (
    compute_td_loss,
    make_forward,
    make_generator,
)
from hrl_escape.agents.components.object_network import ObjectNetworkSettings, make_action_network
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.components.replay_agent import ReplayAgent, ReplaySettings
from hrl_escape.agents.state import StateTree
from hrl_escape.settings import Range

__all__ = ["ActionValueAgent", "ActionValueSettings"]


@dataclass(frozen=True)
class ActionValueSettings(ObjectNetworkSettings, ReplaySettings, ExplorationSettings):
    """Settings of deep agents with action values."""

    target_every: Annotated[int, Range(1)] = 1
    """Updates of the online network to one of the target network. With a `target_rate` of 1 the target network is a
    copy that stands still in between."""
    average_rate: Annotated[float, Range(0, 1)] = 0.0
    """Share of the online network blended, at each update, into an averaged network that the greedy policy follows
    (Polyak and Juditsky 1992). The average begins as a plain mean, so that it forgets the first weights. 0 keeps none:
    the greedy policy follows the online network."""


class ActionValueAgent(ReplayAgent):
    """Base of agents that learn Q_theta with a target network Q_target.

    Attributes:
        online: Q_theta, from encoded observations to scaled values of all actions.
        target: Q_target, the same.
        average: of the online network's weights, with `average_rate`; the greedy policy follows it.
    """

    is_markov: bool = True

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: ActionValueSettings | None,
    ) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        generator = make_generator(make_rng(seed, "weights"))
        self.online, self.target = (make_action_network(self._encoder, action_space, self.settings, generator)
                                    for _ in range(2))
        self.target.requires_grad_(False)
        self.target.blend(self.online, 1.0)
        networks = {"online": self.online, "target": self.target}
        if self.settings.average_rate:
            self.average = make_action_network(self._encoder, action_space, self.settings, generator)
            self.average.requires_grad_(False)
            self.average.blend(self.online, 1.0)
            networks["average"] = self.average
        self._learner = Learner(self.name, networks, ["online"], self.settings)
        self._conduct: dict[str, float] = {}
        self.make_forwards()

    def make_forwards(self) -> None:
        """Make the functions that act; again after networks moved to another device."""
        self._forward = make_forward(self.online)
        self._exploit = make_forward(self.average) if self.settings.average_rate else self._forward

    def compute_values(self, observation: Any) -> NDArray:
        """Q(s, .) behind the greedy policy at an observation, in units of return, float32 (actions,)."""
        return self._exploit(self._encoder.encode(observation)) / self.settings.reward_scale

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say, by the online network."""
        return self.explore(self._encoder.encode(observation), action_mask)

    def explore(self, encoded: NDArray, action_mask: NDArray[np.bool_]) -> int:
        """Draw an action from the exploring policy at an encoded observation; notes how it was chosen, for the log."""
        values = self._forward(encoded) / self.settings.reward_scale
        action = sample_action(values, action_mask, self.settings, self._steps, self._action_rng)
        self._conduct = {
            "entropy": compute_exploration_entropy(values, action_mask, self.settings, self._steps),
            "greedy": float(values[action] >= values[action_mask].max()),
        }
        return action

    def learn_from_replay(self, transition: SMDPTransition) -> dict[str, float]:
        """As every agent with replay; the numbers to log include how the action was chosen."""
        return super().learn_from_replay(transition) | self._conduct

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The legal action of highest value."""
        return choose_best(self.compute_values(observation), action_mask)

    @abstractmethod
    def compute_targets(self, batch: Experience, next_action: int | None) -> torch.Tensor:
        """Targets of Q_theta(s, o), (batch,); called without gradient.

        Args:
            batch: of tensors.
            next_action: the action taken at s', in a batch of one decision; None if it is not known.
        """

    def compute_loss(self, batch: Experience, next_action: int | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        """The mean loss over a batch, and Q_theta(s, o), (batch,), without gradient.

        Args:
            batch: of numpy arrays or tensors.
            next_action: see `compute_targets`.
        """
        tensors = Experience(*map(torch.as_tensor, batch))
        with torch.no_grad():
            targets = self.compute_targets(tensors, next_action)
        values = self.online(tensors.observation).gather(1, tensors.action.unsqueeze(1)).squeeze(1)
        return compute_td_loss(values, targets, self.settings.loss), values.detach()

    def update(self, batch: Experience, next_action: int | None = None) -> dict[str, float]:
        """One gradient step, then, if it is due, one of the target network; arguments as for `compute_loss`."""
        loss, values = self.compute_loss(batch, next_action)
        value = self._learner.minimise(loss)
        if self._learner.updates % self.settings.target_every == 0:
            self.target.blend(self.online, self.settings.target_rate)
        if self.settings.average_rate:
            self.average.blend(self.online, max(self.settings.average_rate, 1 / self._learner.updates))
        return {"loss": value, "gradient_norm": self._learner.gradient_norm,
                "value": values.mean().item() / self.settings.reward_scale}

    def state_dict(self) -> StateTree:
        """Networks and optimiser beside the replay agent's state."""
        return super().state_dict() | {"learner": self._learner.state_dict()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        super().load_state_dict(state)
        self._learner.load_state_dict(state["learner"])
