"""Options over networks that learn by clipped objectives from one environment or from many streams.

In many, every stream runs an option of its own. What chose is kept with a decision, its option and its action, for a
decision that outlasts its rollout counts in the next one, when the networks have moved on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.networks import make_forward
from hrl_escape.agents.components.options.choices import OptionChoices
from hrl_escape.agents.components.options.clipped import ClippedOptionAgent
from hrl_escape.agents.components.options.open_options import OpenOptions
from hrl_escape.agents.components.policy_gradient import Rollout, collect_decisions, sample_policy, take_column
from hrl_escape.agents.state import StateTree
from hrl_escape.agents.streams import OpenChoices, StreamAgent, StreamTransitions

__all__ = ["StreamOptionAgent"]


class StreamOptionAgent(ClippedOptionAgent, StreamAgent):
    """Base of agents whose settings are `ClippedSettings` with `stream_rollout`."""

    def __init__(
        self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int, settings: Any = None
    ) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._stream_rng, self._stream_option_rng = make_rng(seed, "streams"), make_rng(seed, "streams' options")
        self._open: tuple[OpenChoices, OpenOptions] | None = None  # None while one environment is played

    def _forget(self) -> None:
        super()._forget()
        self._chunks: list[tuple[Rollout, OptionChoices]] = []  # of streams
        self._collected = 0

    def move(self, device: torch.device) -> None:
        """Move networks, optimisers and what waits for updates to a device."""
        self._learner.move(device)
        self._forward = {name: make_forward(network) for name, network in self.networks.items()}

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Keep the decision; update when the rollout is full. Streams are over with it, and what they collected."""
        if self._open is not None:
            self._open = None
            self._forget()
        return super().observe(transition)

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Move to a device; every stream begins an episode, and what was collected ends there.

        Where streams begin anew in the middle of a rollout, its decisions stay, and their episodes count as truncated.
        """
        if self._open is not None and self._open[0].has(count, device):
            if self._collected:
                rollout, choices = self._gather_chunks()
                over = rollout.over | self._open[0].find_last(rollout.stream, rollout.place)
                self._chunks = [(rollout._replace(over=over), choices)]
            for each in self._open:
                each.begin_episodes()
            return
        self.move(device)
        self._open = (OpenChoices(count, self._actions, device, self._stream_rng),
                      OpenOptions(count, device, self._stream_option_rng))
        self._forget()

    def act_streams(self, observation: Tensor, mask: Tensor, stream: Tensor) -> Tensor:
        """Draw each stream's option, then its action from that option's policy."""
        assert self._open is not None, "begin_streams comes first"
        choices, options = self._open
        seen = self._encoder.encode_many(observation)
        with torch.no_grad():
            option = options.draw(stream, self.compute_betas(seen), self.compute_fresh_choice(seen))
            log_policy = self.compute_log_policies(seen, option, mask)
        action = sample_policy(log_policy, choices.generator)
        choices.choose(stream, mask, take_column(log_policy, action), choices.memory[stream])
        return action

    def observe_streams(self, decisions: StreamTransitions) -> Mapping[str, float]:
        """Keep the decisions; update when the rollout is full."""
        assert self._open is not None, "begin_streams comes first"
        choices, options = self._open
        rollout = collect_decisions(choices, decisions, self._encoder, self.settings)
        self._chunks.append((rollout, options.end(decisions.stream, rollout.over)))
        self._collected += len(decisions.stream)
        if self._collected < max(self.settings.rollout, self.settings.stream_rollout * choices.count):
            return {}
        rollout, own = self._gather_chunks()
        self._forget()
        choices.begin_rollout()
        options.report(self.log)
        return dict(self._learn(rollout, own)) | self.log.measure()

    def _gather_chunks(self) -> tuple[Rollout, OptionChoices]:
        """The rollout of the streams so far, as one."""
        rollouts, choices = zip(*self._chunks, strict=True)
        return (Rollout(*map(torch.cat, zip(*rollouts, strict=True))),
                OptionChoices(*map(torch.cat, zip(*choices, strict=True))))

    def state_dict(self) -> StateTree:
        """The rollout of the streams so far, and their choices in progress, beside all else."""
        streams = None
        if self._open is not None:
            self._open[1].report(self.log)
            rollout, own = self._gather_chunks() if self._collected else (None, None)
            streams = {"rollout": None if rollout is None else rollout._asdict(),
                       "own": None if own is None else own._asdict(),
                       "choices": self._open[0].state_dict(), "options": self._open[1].state_dict()}
        return super().state_dict() | {"streams": streams}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`; streams go on if there are as many, on any device."""
        super().load_state_dict(state)
        streams = state["streams"]
        if self._open is None or streams is None:
            return
        for each, name in zip(self._open, ("choices", "options"), strict=True):
            each.load_state_dict(streams[name])
        if streams["rollout"] is not None:
            fields, own = ({name: torch.from_numpy(np.asarray(field)).to(self.policy.weights.device)
                            for name, field in streams[part].items()} for part in ("rollout", "own"))
            self._chunks, self._collected = [(Rollout(**fields), OptionChoices(**own))], len(fields["place"])

    def _list_rngs(self) -> tuple[tuple[str, np.random.Generator], ...]:
        return (*super()._list_rngs(), ("stream", self._stream_rng), ("stream_option", self._stream_option_rng))
