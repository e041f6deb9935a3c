"""Deep Q-network over decisions of any duration, in one environment or in many: double, masked, n-step.

Mnih et al. (2015) with double estimation (van Hasselt, Guez and Silver 2016) on SMDP backups of n decisions (Sutton
1988; Hessel et al. 2018). A useless decision costs one reward and one discount, little beside the values' range, so
the greedy policy hangs on small differences: it holds what it found better where the target stands still long enough
to be fitted and n decisions carry values ahead of it (`benchmarks/README.md`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

import gymnasium
import numpy as np
import torch
from torch import Tensor

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.components.action_value_agent import ActionValueAgent, ActionValueSettings
from hrl_escape.agents.components.distillation import DeepBonusSettings, make_bonus
from hrl_escape.agents.components.exploration import compute_epsilon, make_rng
from hrl_escape.agents.components.hindsight import HindsightReplay
from hrl_escape.agents.components.replay import Experience, NStep
from hrl_escape.agents.components.streams.exploration import sample_actions
from hrl_escape.agents.components.streams.open_choices import OpenChoices
from hrl_escape.agents.components.streams.replay import StreamNStep, StreamReplay
from hrl_escape.agents.goal_rule import GoalRule
from hrl_escape.agents.state import StateTree
from hrl_escape.agents.streams import StreamAgent, StreamTransitions, compute_backups
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range

__all__ = ["DQN", "DQNSettings"]


@dataclass(frozen=True)
class DQNSettings(DeepBonusSettings, ActionValueSettings):
    """Settings of `dqn`."""

    double: bool = True
    """The online network chooses the next action, the target network values it."""
    n_step: Annotated[int, Range(1)] = 3
    """Decisions joined into one backup; above 1 it is off-policy by the share of exploration."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 1.0
    """Share of the online network blended into the target network at each of its updates; 1 copies it."""
    target_every: Annotated[int, Range(1)] = 200
    """Updates of the online network to one of the target network."""
    average_rate: Annotated[float, Range(0, 1)] = 0.005
    """Share of the online network blended, at each update, into the averaged network that the greedy policy follows;
    0 keeps none."""
    hindsight_goals: Annotated[int, Range(0)] = 0
    """Goals achieved later in its episode that are drawn for a decision; replay holds it once more under each
    (Andrychowicz et al. 2017, who take 4). 0 for none. For environments with goals, such as `GoalsEnv`."""
    stream_updates: Annotated[int, Range(1)] = 1
    """Most updates after a step of many streams. Where more are due, minibatches grow, so that every decision is
    learned from as often."""
    stream_replay: Annotated[int, Range(1)] = 128
    """Decisions of each stream, on average, for which replay has room at least."""


class DQN(ActionValueAgent, StreamAgent):
    """Minimise over theta the mean of loss(R + b Q_target(s', o*) - Q_theta(s, o)), o* = argmax of Q_theta(s', .).

    R = sum gamma^i r_i, b = gamma^k (1 - terminated), the argmax over actions legal at s'. With `n_step` n, R and b are
    those of n decisions joined. Without `double`, o* is the argmax of Q_target.

    Args:
        observation_space: of the environment.
        action_space: Discrete.
        seed: fixes weights, exploration, batches and goals.
        settings: of the agent.
        goal_rule: reward and termination as functions of goals, for `hindsight_goals`.

    Raises:
        AgentSettingsError: `hindsight_goals` in an environment without goals.
    """

    name: ClassVar[str] = "dqn"
    Settings: ClassVar[type] = DQNSettings
    settings: DQNSettings

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: DQNSettings | None = None,
        goal_rule: GoalRule | None = None,
    ) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._n_step = NStep(self.settings.n_step)
        self._stream_rng = make_rng(seed, "streams")
        self._streams: _DQNStreams | None = None
        self._bonus = make_bonus(observation_space, seed, self.settings, self.settings, self.name)
        self._hindsight = HindsightReplay(
            observation_space, goal_rule, self.settings.hindsight_goals, self.settings.n_step, self._encoder,
            self.settings, make_rng(seed, "goals")) if self.settings.hindsight_goals else None

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Store the decision, then make the updates that are due."""
        bonus = self._bonus.visit(transition.next_observation)
        experience = self.make_experience(transition, bonus)
        for joined in self._n_step.push(experience, transition.terminated or transition.truncated):
            self.replay.add(joined)
        if self._hindsight is not None:
            for relabelled in self._hindsight.push(transition, experience, bonus):
                self.replay.add(relabelled)
        return self.learn_from_replay(transition)

    # --- streams -------------------------------------------------------------------------

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Move networks and replay to a device; every stream begins an episode, and what replay holds stays.

        Raises:
            AgentSettingsError: `hindsight_goals` in many environments.
        """
        if self._hindsight is not None:
            raise AgentSettingsError("hindsight_goals", self.settings.hindsight_goals, "0 in many environments at once")
        if self._streams is not None and self._streams.open.has(count, device):
            self._streams.n_step.forget()
            return
        self._learner.move(device)
        self.make_forwards()
        example = torch.from_numpy(np.zeros((1, *self._encoder.shape), self._encoder.dtype)).to(device)
        capacity = max(self.settings.replay_capacity, self.settings.stream_replay * count)
        self._streams = _DQNStreams(
            OpenChoices(count, self._actions, device, self._stream_rng),
            StreamReplay(capacity, example, self._actions),
            StreamNStep(self.settings.n_step, count, example, self._actions))

    def act_streams(self, observation: Tensor, mask: Tensor, stream: Tensor) -> Tensor:
        """Explore as the settings say, by the online network, for each row."""
        assert self._streams is not None, "begin_streams comes first"
        with torch.no_grad():
            values = self.online(self._encoder.encode_many(observation)) / self.settings.reward_scale
        choices = self._streams.open
        choices.choose(stream, mask, torch.zeros_like(values[:, 0]), choices.memory[stream])
        return sample_actions(values, mask, self.settings, self._steps, choices.generator)

    def observe_streams(self, decisions: StreamTransitions) -> Mapping[str, float]:
        """Store the decisions, then make the updates that are due."""
        assert self._streams is not None, "begin_streams comes first"
        choices, replay, n_step = self._streams
        reward, bootstrap = compute_backups(decisions, self.settings)
        if self.settings.bonus_weight:
            bonus = self._bonus.visit_many(decisions.next_observation.cpu().numpy())
            reward = reward + torch.from_numpy(bonus).to(reward.device)
        over = decisions.terminated | decisions.truncated
        mask, *_ = choices.end(decisions.stream, over)
        experience = Experience(
            self._encoder.encode_many(decisions.observation), mask, decisions.action,
            reward * self.settings.reward_scale, bootstrap, self._encoder.encode_many(decisions.next_observation),
            decisions.next_action_mask)
        replay.add(n_step.push(decisions.stream, experience, over))
        steps = int(decisions.duration.sum()) if self.settings.clock == "primitive" else len(over)
        self._steps += steps
        metrics = {"epsilon": compute_epsilon(self.settings, self._steps)}
        if self._steps > self.warmup and len(replay):
            self._updates_due += steps * self.settings.updates_per_step
            whole = int(self._updates_due)
            self._updates_due -= whole
            count = min(whole, self.settings.stream_updates)
            for _ in range(count):
                metrics |= self.update(replay.sample(self.settings.batch_size * whole // count, choices.generator))
        return metrics

    # --- learning ------------------------------------------------------------------------

    def compute_targets(self, batch: Experience, next_action: int | None) -> torch.Tensor:
        """R + b Q_target(s', o*), o* = argmax over legal o of Q_theta(s', o)."""
        del next_action  # off policy
        next_values = self.target(batch.next_observation)
        next_choice = self.online(batch.next_observation) if self.settings.double else next_values
        best = next_choice.masked_fill(~batch.next_mask, -torch.inf).argmax(dim=1, keepdim=True)
        return batch.reward + batch.bootstrap * next_values.gather(1, best).squeeze(1)

    def state_dict(self) -> StateTree:
        """Unfinished backups, episode and streams, the bonus's memory, networks, replay, counters, generators."""
        streams = self._streams and {name: part.state_dict() for name, part in self._streams._asdict().items()}
        state = super().state_dict() | {"n_step": self._n_step.state_dict(), "bonus": self._bonus.state_dict(),
                                        "streams": streams, "stream_rng": self._stream_rng.bit_generator.state}
        return state if self._hindsight is None else state | {"hindsight": self._hindsight.state_dict()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        super().load_state_dict(state)
        self._n_step.load_state_dict(state["n_step"])
        self._bonus.load_state_dict(state["bonus"])
        self._stream_rng.bit_generator.state = state["stream_rng"]
        if self._hindsight is not None:
            self._hindsight.load_state_dict(state["hindsight"])
        if self._streams is not None and state["streams"] is not None:
            for name, part in self._streams._asdict().items():
                part.load_state_dict(state["streams"][name])


class _DQNStreams(NamedTuple):
    """Choices in progress, replay and unfinished backups of many streams."""

    open: OpenChoices
    replay: StreamReplay
    n_step: StreamNStep
