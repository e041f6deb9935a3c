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
from hrl_escape.agents.batch_agent import BatchAgent
from hrl_escape.agents.decisions import Decisions, Moments, make_decision, make_moment
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
    """Return the choices and updates of an agent in one environment; one that acted in many begins an episode."""
    if not isinstance(agent, BatchAgent):
        return agent
    if agent.place != (1, None):
        agent.begin_episodes()
    return _OneOfBatch(agent)


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
