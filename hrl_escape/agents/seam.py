"""Adapters between the two interfaces of agents: `BatchAgent`, by batches of decisions, and `Agent`, one at a time.

Loops over one environment speak the interface of `Agent`, loops over many that of `BatchAgent`. Agents that have the
other one are adapted here. The module goes once every agent is a `BatchAgent`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition
from hrl_escape.agents.batch_agent import BatchAgent, Decisions, Moments, Policy, make_decision, make_moment
from hrl_escape.agents.streams import StreamAgent, StreamTransitions

if TYPE_CHECKING:
    import torch


class OneByOne(Protocol):
    """An agent in one environment."""

    def act(self, observation: Any, action_mask: NDArray[np.bool_], /) -> int:
        """Choose an action for learning."""
        ...

    def observe(self, transition: SMDPTransition, /) -> Mapping[str, float]:
        """Learn from one decision."""
        ...


class _OneOfBatch:
    """A learner in one environment."""

    def __init__(self, learner: BatchAgent) -> None:
        self._learner = learner

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        return int(self._learner.act(make_moment(observation, action_mask))[0])

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        return self._learner.observe(make_decision(transition))


def serve_one(agent: Agent) -> OneByOne:
    """Return the choices and updates of an agent in one environment."""
    return _OneOfBatch(agent) if isinstance(agent, BatchAgent) else agent


class ByBatch(Protocol):
    """An agent in many environments; see `BatchAgent`."""

    def begin_episodes(self, num_envs: int, device: torch.device, /) -> None:
        """Begin an episode in every environment."""
        ...

    def act(self, batch: Moments, /) -> Any:
        """Choose actions for learning."""
        ...

    def observe(self, batch: Decisions, /) -> Mapping[str, float]:
        """Learn from decisions."""
        ...


class _StreamsByBatch:
    """A `StreamAgent` behind the interface of `BatchAgent`."""

    def __init__(self, agent: StreamAgent) -> None:
        self._agent = agent
        self.begin_episodes = agent.begin_streams

    def act(self, batch: Moments) -> Any:
        return self._agent.act_streams(batch.observation, batch.action_mask, batch.env)

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        return self._agent.observe_streams(StreamTransitions(
            batch.env, batch.observation, batch.action, batch.reward, batch.summed_reward, batch.duration,
            batch.next_observation, batch.next_action_mask, batch.terminated, batch.truncated))


def serve_many(agent: Agent) -> ByBatch:
    """Return the choices and updates of an agent in many environments; it is one of `MANY`."""
    if isinstance(agent, StreamAgent):
        return _StreamsByBatch(agent)
    assert isinstance(agent, BatchAgent)
    return agent


MANY = (BatchAgent, StreamAgent)
"""Classes of agents that learn from many environments at once."""


class AgentPolicy(Policy):
    """Policy of an agent that has `act_greedy`."""

    def __init__(self, agent: Agent) -> None:
        self._agent, self.is_markov = agent, agent.is_markov
        self._memory: tuple[Any, ...] | None = None
        self._rng = np.random.default_rng(0)

    def begin_episode(self, rng: np.random.Generator, num_envs: int = 1) -> None:
        """Forget the episode."""
        assert num_envs == 1, "one environment"
        self._rng, self._memory = rng, None

    def act(self, batch: Moments) -> Any:
        """Choose in one environment."""
        return np.array((self.choose(batch.observation[0], batch.action_mask[0]),))

    def choose(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Choose in one environment."""
        with _Episode(self):
            return self._agent.act_greedy(observation, action_mask, self._rng)

    def note_outcome(self, transition: SMDPTransition) -> None:
        """Pass the outcome on."""
        with _Episode(self):
            self._agent.note_outcome(transition, self._rng)


class _Episode:
    """Puts the memory of a policy's episode in place while its agent is asked: an agent remembers one episode."""

    def __init__(self, policy: AgentPolicy) -> None:
        self._policy = policy

    def __enter__(self) -> None:
        agent, policy = self._policy._agent, self._policy
        self._before, agent._evaluation = agent._evaluation, policy._memory

    def __exit__(self, *_: object) -> None:
        agent, policy = self._policy._agent, self._policy
        policy._memory, agent._evaluation = agent._evaluation, self._before
