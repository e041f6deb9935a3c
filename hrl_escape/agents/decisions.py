"""Decisions in batches of n, and policies, which make them without learning.

In one environment n is 1, and batches are NumPy arrays. In many environments batches are tensors on their device. Each
row of a batch names its environment, because decisions end at different times.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.errors import UnsupportedSpaceError


def name_action(names: Sequence[str], action: Any) -> str:
    """Return the name of an action, `velocities` with their values for one of a Box."""
    if isinstance(action, np.ndarray):
        return f"velocities {', '.join(f'{rate:.2f}' for rate in action.reshape(-1))}"
    return names[int(action)]


class SMDPTransition(NamedTuple):
    """One decision and its outcome.

    Attributes:
        observation: at the decision, as the environment gave it.
        action: index in a Discrete action space, or float32 array of a Box.
        action_mask: bool (actions,), the actions legal there; (0,) for a Box.
        reward: R = sum over i < k of gamma^i r_i, at the agent's gamma.
        summed_reward: the undiscounted sum of r_i.
        duration: k >= 1, the number of primitives that ran.
        discount: gamma^k.
        next_observation: the state reached, never the first of a new episode.
        next_action_mask: bool (actions,), the actions legal there.
        terminated: the task ended; later rewards are zero.
        truncated: the episode was cut off; the state reached still has a value.
        trace: the primitives inside, where the environment gives them (see `make_transition`), else empty.
        cut: truncated inside an option, so that the state reached is not where the option leads.
    """

    observation: Any
    action: Any
    action_mask: NDArray[np.bool_]
    reward: float
    summed_reward: float
    duration: int
    discount: float
    next_observation: Any
    next_action_mask: NDArray[np.bool_]
    terminated: bool
    truncated: bool
    trace: Sequence[Any] = ()
    cut: bool = False


class Moments(NamedTuple):
    """n moments of choice."""

    env: Any  # int64 (n,), environment of each row; no environment has two rows
    observation: Any  # tensor (n, ...), or a sequence of n observations of any space
    action_mask: Any  # bool (n, actions), the legal actions; (n, 0) for a Box


class Decisions(NamedTuple):
    """n decisions and their outcomes; see `SMDPTransition` for the fields."""

    env: Any  # int64 (n,), environment of each row; no environment has two rows
    observation: Any  # tensor (n, ...), or a sequence of n observations of any space
    action_mask: Any  # bool (n, actions)
    action: Any  # int64 (n,), or float32 (n, ...) of a Box
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


def to_plain_action(action: Any) -> Any:
    """Return an action as an int, or as a float32 array if it has components."""
    return np.asarray(action, np.float32) if np.ndim(action) else int(action)


def convert_action(action: Any, space: gymnasium.Space | None) -> Any:
    """Return an action of another library as an int, or as float32 in the shape of a Box; a batch of one is accepted.

    Without a space, floats with components are an action in a Box.

    Raises:
        UnsupportedSpaceError: the action has another number of components.
    """
    values = np.asarray(action)
    shape: tuple[int, ...] = () if space is not None or values.dtype.kind != "f" else values.shape
    if isinstance(space, gymnasium.spaces.Box):
        shape = space.shape
    if values.size != math.prod(shape):
        raise UnsupportedSpaceError(f"the policy returned {action!r}, and actions of {space or 'Discrete spaces'} have "
                                    f"the shape {shape}")
    return to_plain_action(values.reshape(shape).copy())


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


def read_decision(batch: Decisions) -> SMDPTransition:
    """Return the decision of a batch of one environment, with Python numbers; rewards are rounded to float32."""
    return SMDPTransition(
        batch.observation[0], to_plain_action(batch.action[0]), batch.action_mask[0], float(batch.reward[0]),
        float(batch.summed_reward[0]), int(batch.duration[0]), float(batch.discount[0]), batch.next_observation[0],
        batch.next_action_mask[0], bool(batch.terminated[0]), bool(batch.truncated[0]), *batch.trace)


class Policy(ABC):
    """Choice of actions without learning, with memory of the running episodes.

    It shares its parameters with the agent that made it. Several policies of one agent run episodes side by side.
    """

    is_markov: bool = True
    """True if the choice is a function of the observation and the legal actions, without randomness and memory."""

    @abstractmethod
    def begin_episode(self, rng: np.random.Generator, num_envs: int = 1) -> None:
        """Begin an episode in every environment; a random policy draws from `rng`."""

    @abstractmethod
    def act(self, batch: Moments) -> Any:
        """Choose actions, int64 (n,), or float32 (n, ...) of a Box."""

    def note_outcome(self, transition: SMDPTransition) -> None:  # noqa: B027 - optional: most agents keep nothing of it
        """Receive the outcome of the latest choice in one environment; ignored by default.

        Hierarchical policies count the primitives of a call.
        """

    def choose(self, observation: Any, action_mask: NDArray[np.bool_]) -> Any:
        """Choose in one environment; the mask is bool (actions,)."""
        return to_plain_action(self.act(make_moment(observation, action_mask))[0])


class AgentPolicy(Policy):
    """Policy of an agent that has `act_greedy`."""

    def __init__(self, agent: Any) -> None:
        self._agent, self.is_markov = agent, agent.is_markov
        self._memory: tuple[Any, ...] | None = None
        self._rng = np.random.default_rng(0)

    def begin_episode(self, rng: np.random.Generator, num_envs: int = 1) -> None:
        """Clear the memory of the episode."""
        assert num_envs == 1, "one environment"
        self._rng, self._memory = rng, None

    def act(self, batch: Moments) -> Any:
        """Choose in one environment."""
        return np.array((self.choose(batch.observation[0], batch.action_mask[0]),))

    def choose(self, observation: Any, action_mask: NDArray[np.bool_]) -> Any:
        """Choose in one environment."""
        with _Episode(self):
            return self._agent.act_greedy(observation, action_mask, self._rng)

    def note_outcome(self, transition: SMDPTransition) -> None:
        """Forward the outcome to the agent."""
        with _Episode(self):
            self._agent.note_outcome(transition, self._rng)


class _Episode:
    """Context that swaps a policy's episode memory into its agent, which holds one episode at a time."""

    def __init__(self, policy: AgentPolicy) -> None:
        self._policy = policy

    def __enter__(self) -> None:
        agent, policy = self._policy._agent, self._policy
        self._before, agent._evaluation = agent._evaluation, policy._memory

    def __exit__(self, *_: object) -> None:
        agent, policy = self._policy._agent, self._policy
        policy._memory, agent._evaluation = agent._evaluation, self._before
