"""Interface of agents that act on, and learn from, a batch of n decisions.

In one environment n is 1, and batches are NumPy arrays. In many environments batches are tensors on their device. Each
row of a batch names its environment, because decisions end at different times. A `Policy` chooses and remembers the
episode. A `BatchAgent` improves its policy.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition

if TYPE_CHECKING:
    import torch


class Moments(NamedTuple):
    """n moments at which an action is chosen."""

    env: Any  # int64 (n,), environment of each row; no environment has two rows
    observation: Any  # tensor (n, ...), or a sequence of n observations of any space
    action_mask: Any  # bool (n, actions), the legal actions


class Decisions(NamedTuple):
    """n decisions and their outcomes; see `SMDPTransition` for the fields."""

    env: Any  # int64 (n,), environment of each row; no environment has two rows
    observation: Any  # tensor (n, ...), or a sequence of n observations of any space
    action_mask: Any  # bool (n, actions)
    action: Any  # int64 (n,)
    reward: Any  # float32 (n,), R = sum over i < k of gamma^i r_i at the agent's gamma
    summed_reward: Any  # float32 (n,)
    duration: Any  # int64 (n,), k
    discount: Any  # float32 (n,), gamma^k
    next_observation: Any  # as `observation`; the state reached, never the first of a new episode
    next_action_mask: Any  # bool (n, actions)
    terminated: Any  # bool (n,)
    truncated: Any  # bool (n,)
    trace: Sequence[Any] = ()  # of one environment, the primitives inside each decision, where it gives them


_ONLY = np.zeros(1, np.int64)


def make_moment(observation: Any, action_mask: NDArray[np.bool_]) -> Moments:
    """Return the batch of one moment of one environment; the mask is (actions,)."""
    return Moments(_ONLY, (observation,), action_mask[None])


def make_decision(one: SMDPTransition) -> Decisions:
    """Return the batch of one decision of one environment."""
    numbers = np.array((one.reward, one.summed_reward, one.discount), np.float32)
    return Decisions(_ONLY, (one.observation,), one.action_mask[None], np.array((one.action,)), numbers[:1],
                     numbers[1:2], np.array((one.duration,)), numbers[2:], (one.next_observation,),
                     one.next_action_mask[None], np.array((one.terminated,)), np.array((one.truncated,)),
                     (one.trace,))


class Policy(ABC):
    """Choice of actions without learning, with the memory of the episodes that run.

    It shares its parameters with the agent that made it. Several policies of one agent run episodes side by side.
    """

    is_markov: bool = True
    """The choice is a function of the observation and the legal actions: nothing is drawn or remembered."""

    @abstractmethod
    def begin_episode(self, rng: np.random.Generator, num_envs: int = 1) -> None:
        """Begin an episode in every environment; a random policy draws from `rng`."""

    @abstractmethod
    def act(self, batch: Moments) -> Any:
        """Choose actions, int64 (n,)."""

    def note_outcome(self, transition: SMDPTransition) -> None:  # noqa: B027
        """Take in the outcome of the latest choice in one environment; by default it is ignored.

        Hierarchical policies count the primitives of a call.
        """

    def choose(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Choose in one environment; the mask is bool (actions,)."""
        return int(self.act(make_moment(observation, action_mask))[0])


class BatchAgent(Agent):
    """An agent that acts on, and learns from, a batch of n decisions.

    A new agent acts in one environment. `begin_episodes` prepares it for many.
    """

    @abstractmethod
    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin an episode in every environment; decisions that have not ended are dropped.

        Args:
            num_envs: number of environments.
            device: device of batches and networks; None for NumPy arrays of one environment.
        """

    @abstractmethod
    def act(self, batch: Moments) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Choose actions for learning, int64 (n,)."""

    @abstractmethod
    def observe(self, batch: Decisions) -> Mapping[str, float]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Learn from decisions; returns numbers to log, or nothing.

        Decisions of one environment come in order, each from the state reached by the one before, until one is
        terminated or truncated.
        """

    @abstractmethod
    def make_policy(self) -> Policy:
        """Make a policy that chooses as evaluation does."""

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Choose as `make_policy` does, in the episode of `rng`."""
        if (known := self.recall(rng)) is None:
            policy = self.make_policy()
            policy.begin_episode(rng)
            self._evaluation, known = (rng, policy), (policy,)
        return known[0].choose(observation, action_mask)
