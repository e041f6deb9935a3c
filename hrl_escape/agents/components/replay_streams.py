"""Learning from the replay of many streams: what `dqn`, `sarsa` and `ddpg` have beyond one environment.

Choices, replay and unfinished backups lie on the device of the streams. Where many updates are due after a step of all
of them, minibatches grow instead, so that every decision is learned from as often as in one environment.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from hrl_escape.agents.components.exploration import compute_epsilon
from hrl_escape.agents.components.networks import ObservationEncoder
from hrl_escape.agents.components.replay import Experience, StreamNStep, StreamReplay, UpdateSchedule
from hrl_escape.agents.state import Kept
from hrl_escape.agents.streams import OpenChoices, StreamAgent, StreamTransitions, compute_backups

__all__ = ["ReplayStreamAgent", "sample_actions"]


class ReplayStreams(NamedTuple):
    """Choices in progress, replay and unfinished backups of many streams."""

    open: OpenChoices
    replay: StreamReplay
    n_step: StreamNStep


class ReplayStreamAgent(StreamAgent):
    """Base of agents that learn action values or preferences by updates from replay."""

    settings: Any
    STATE = (Kept("_streams", is_left_out=True), Kept("_stream_rng", is_left_out=True))
    _actions: int
    _encoder: ObservationEncoder
    _schedule: UpdateSchedule
    _stream_rng: np.random.Generator
    _streams: ReplayStreams | None = None

    @abstractmethod
    def move(self, device: torch.device) -> None:
        """Move networks and optimisers to a device."""

    @abstractmethod
    def compute_scores(self, encoded: Tensor) -> Tensor:
        """Numbers whose legal maximum is exploited, in units of return, (n, actions) from (n, *shape)."""

    @abstractmethod
    def update(self, batch: Experience) -> dict[str, float]:
        """One gradient step on a batch of arrays or tensors; returns numbers to log."""

    def compute_bonus(self, decisions: StreamTransitions) -> Tensor | None:
        """Pay for novelty beside the rewards of decisions, in units of return, (n,); None for none."""
        return None

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Move networks and replay to a device; every stream begins an episode, and what replay holds stays."""
        if self._streams is not None and self._streams.open.has(count, device):
            self._streams.n_step.forget()
            return
        self.move(device)
        settings, actions = self.settings, self._actions
        example = torch.from_numpy(np.zeros((1, *self._encoder.shape), self._encoder.dtype)).to(device)
        self._streams = ReplayStreams(
            OpenChoices(count, actions, device, self._stream_rng),
            StreamReplay(max(settings.replay_capacity, settings.stream_replay * count), example, actions),
            StreamNStep(getattr(settings, "n_step", 1), count, example, actions))

    def act_streams(self, observation: Tensor, mask: Tensor, stream: Tensor) -> Tensor:
        """Explore as the settings say, by the online network, for each row."""
        assert self._streams is not None, "begin_streams comes first"
        with torch.no_grad():
            scores = self.compute_scores(self._encoder.encode_many(observation))
        choices = self._streams.open
        choices.choose(stream, mask, torch.zeros_like(scores[:, 0]), choices.memory[stream])
        return sample_actions(scores, mask, self.settings, self._schedule.steps, choices.generator)

    def observe_streams(self, decisions: StreamTransitions) -> Mapping[str, float]:
        """Store the decisions, then make the updates that are due."""
        assert self._streams is not None, "begin_streams comes first"
        choices, replay, n_step = self._streams
        settings, encoder = self.settings, self._encoder
        reward, bootstrap = compute_backups(decisions, settings)
        bonus = self.compute_bonus(decisions)
        reward = reward if bonus is None else reward + bonus
        over = decisions.terminated | decisions.truncated
        mask, *_ = choices.end(decisions.stream, over)
        experience = Experience(
            encoder.encode_many(decisions.observation), mask, decisions.action, reward * settings.reward_scale,
            bootstrap, encoder.encode_many(decisions.next_observation), decisions.next_action_mask)
        replay.add(n_step.push(decisions.stream, experience, over))
        steps = int(decisions.duration.sum()) if settings.clock == "primitive" else len(over)
        due = self._schedule.advance(steps, len(replay))
        metrics = {"epsilon": compute_epsilon(settings, self._schedule.steps)}
        count = min(due, settings.stream_updates)
        for _ in range(count):
            metrics |= self.update(replay.sample(settings.batch_size * due // count, choices.generator))
        return metrics


def sample_actions(values: Tensor, mask: Tensor, settings: Any, steps: int,
                   generator: torch.Generator) -> Tensor:
    """Draw an action for each row of values (n, actions) as `sample_action` does, int64 (n,).

    Args:
        values: in units of return.
        mask: bool (n, actions), legal.
        settings: of exploration, as `DQNSettings` has them.
        steps: on the clock.
        generator: on the device of the values.
    """
    waits = torch.empty_like(values).exponential_(generator=generator).clamp_(min=1e-30).log()
    if settings.exploration == "boltzmann":
        ratio = values / settings.temperature
        if settings.boltzmann_clip:
            ratio = ratio.clamp(-settings.boltzmann_clip, settings.boltzmann_clip)
        return (ratio - waits).masked_fill(~mask, -torch.inf).argmax(dim=1)
    best, any_legal = (scores.masked_fill(~mask, -torch.inf).argmax(dim=1) for scores in (values, -waits))
    draws = torch.rand(len(values), generator=generator, device=values.device)
    return torch.where(draws < compute_epsilon(settings, steps), any_legal, best)
