"""Agents that act in one environment at a time, and adapters between them and batches.

An `Agent` other than a `BatchAgent` has `act(observation, mask)` and `observe(transition)`. `serve_one` gives this
interface to every agent. `serve_many` gives the interface of `BatchAgent` to a `SwitchingAgent`, which takes its
environments in turn.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition
from hrl_escape.agents.batch_agent import BatchAgent
from hrl_escape.agents.decisions import Decisions, Moments, make_decision, make_moment, to_plain_action
from hrl_escape.agents.state import Kept, StateTree, list_kept

if TYPE_CHECKING:
    import torch


class OneByOne(Protocol):
    """An agent in one environment."""

    def act(self, observation: Any, action_mask: NDArray[np.bool_], /) -> Any:
        """Choose an action for learning."""
        ...

    def observe(self, transition: SMDPTransition, /) -> Mapping[str, float]:
        """Learn from one decision."""
        ...


class _OneOfBatch:
    """A `BatchAgent` in one environment."""

    def __init__(self, learner: BatchAgent) -> None:
        self._learner = learner

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> Any:
        return to_plain_action(self._learner.act(make_moment(observation, action_mask))[0])

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        return self._learner.observe(make_decision(transition))


def serve_one(agent: Agent) -> OneByOne:
    """Return the interface to an agent in one environment; an agent that acted in many begins an episode."""
    if not isinstance(agent, BatchAgent):
        return agent
    if agent.place != (1, None):
        agent.begin_episodes()
    return _OneOfBatch(agent)


class SwitchingAgent(Agent):
    """An agent that acts in one environment at a time and can switch between many.

    All environments share its tables, models and replay. `EPISODE` names the attributes of a running episode. Each
    environment has its own values of them, which are in place while the agent serves it.
    """

    EPISODE: ClassVar[tuple[str, ...]] = ()
    """Attributes of a running episode."""
    EPISODE_STATE: ClassVar[tuple[str, ...]] = ()
    """Keys that hold them in a state."""
    STATE = (Kept("_kept_episodes", "episodes", is_left_out=True),)
    _episodes: list[tuple[Any, ...]] | None = None  # of each environment, and last of a single one
    _env: int | None = None  # number of the environment that is served now, of many

    def begin_episode(self) -> None:  # noqa: B027 - optional: many agents remember nothing of an episode
        """Clear the memory of the running episode."""

    def begin_episodes(self, num_envs: int, device: torch.device) -> None:
        """Begin an episode in every environment; decisions that have not ended are dropped."""
        self._episodes = [()] * (num_envs + 1)
        for env in range(num_envs + 1):
            self.begin_episode()
            self._leave(env)

    def observe_each(self, decisions: Iterable[tuple[int, SMDPTransition]]) -> Mapping[str, float]:
        """Learn from decisions that ended together, each with the number of its environment.

        Returns the means of what they log.
        """
        logged: dict[str, list[float]] = {}
        for env, transition in decisions:
            with self.serve(env):
                metrics = self.observe(transition)
            for name, value in metrics.items():
                logged.setdefault(name, []).append(value)
        return {name: sum(values) / len(values) for name, values in logged.items()}

    @contextmanager
    def serve(self, env: int) -> Iterator[None]:
        """Restore an environment's episode, and afterwards the episode of a single environment."""
        self._env = env
        self._place(env)
        yield
        self._leave(env)

    def _leave(self, env: int) -> None:
        """Store an environment's episode, and restore the episode of a single environment."""
        assert self._episodes is not None, "begin_episodes comes first"
        self._episodes[env] = tuple(getattr(self, name) for name in self.EPISODE)
        self._env = None
        self._place(-1)

    def _place(self, index: int) -> None:
        assert self._episodes is not None, "begin_episodes comes first"
        for name, value in zip(self.EPISODE, self._episodes[index], strict=False):
            setattr(self, name, value)

    @property
    def _kept_episodes(self) -> list[StateTree] | None:
        """Running episodes of all environments, or None without any."""
        if not self.EPISODE or not self._episodes:
            return None
        trees: list[StateTree] = [{} for _ in self._episodes[1:]]
        for env, tree in enumerate(trees):
            with self.serve(env):
                for kept in self._list_episode():
                    kept.write(self, tree)
        return trees

    @_kept_episodes.setter
    def _kept_episodes(self, saved: list[StateTree] | None) -> None:
        """Episodes continue if there are as many environments."""
        for env, tree in enumerate(saved if saved and len(saved) + 1 == len(self._episodes or ()) else ()):
            with self.serve(env):
                for kept in self._list_episode():
                    kept.read(self, tree)

    def _list_episode(self) -> list[Kept]:
        return [kept for kept in list_kept(type(self)) if isinstance(kept, Kept) and kept.key in self.EPISODE_STATE]


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


class _InTurn:
    """A `SwitchingAgent` behind the interface of `BatchAgent`; batches are tensors."""

    def __init__(self, agent: SwitchingAgent) -> None:
        self._agent = agent
        self.begin_episodes = agent.begin_episodes

    def act(self, batch: Moments) -> Any:
        chosen = []
        for env, seen, legal in zip(batch.env.tolist(), batch.observation.cpu().numpy(),
                                    batch.action_mask.cpu().numpy(), strict=True):
            with self._agent.serve(env):
                chosen.append(self._agent.act(seen, legal))
        return batch.env.new_tensor(chosen)

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        rows = zip(*(field.cpu().numpy() for field in batch[:-1]), strict=True)
        return self._agent.observe_each(
            (env, SMDPTransition(seen, int(action), mask, float(reward), float(summed), int(k),
                                 self._agent.gamma ** int(k), reached, next_mask, bool(terminated), bool(truncated),
                                 cut=bool(truncated and not terminated and k > 1)))
            for env, seen, mask, action, reward, summed, k, _, reached, next_mask, terminated, truncated in rows)


def serve_many(agent: Agent) -> ByBatch:
    """Return the interface to an agent in many environments; its class is one of `MANY`."""
    if isinstance(agent, SwitchingAgent):
        return _InTurn(agent)
    assert isinstance(agent, BatchAgent)
    return agent


MANY = (BatchAgent, SwitchingAgent)
"""Classes of agents that learn from many environments at once."""
