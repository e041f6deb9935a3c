"""Choices in progress of many streams, whose decisions end each at its own time."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from hrl_escape.agents.components.networks import ObservationEncoder
from hrl_escape.agents.components.policy_gradient import ClippedSettings, Rollout
from hrl_escape.agents.state import StateTree
from hrl_escape.agents.streams import StreamTransitions, compute_backups
from hrl_escape.errors import CheckpointError

__all__ = ["OpenChoices"]


class OpenChoices:
    """The masks and probabilities that streams' present decisions were chosen with, and their generator.

    Args:
        count: number of streams.
        actions: number of actions.
        device: device of all tensors.
        rng: seeds the generator.
        memory: numbers in a stream's recurrent memory.

    Attributes:
        generator: on the device, for the draws of all streams.
        memory: (count, numbers), what each stream remembers now; 0 before an episode's first decision.
    """

    def __init__(self, count: int, actions: int, device: torch.device, rng: np.random.Generator,
                 memory: int = 0) -> None:
        self.count = count
        self.generator = torch.Generator(device).manual_seed(int(rng.integers(2**63)))
        self._mask = torch.ones((count, actions), dtype=torch.bool, device=device)
        self._log_probability = torch.zeros(count, device=device)
        self._place = torch.zeros(count, dtype=torch.int64, device=device)
        self.memory, self._before = (torch.zeros((count, memory), device=device) for _ in range(2))

    def choose(self, stream: Tensor, mask: Tensor, log_probability: Tensor, memory: Tensor) -> None:
        """Keep with what some streams, int64 (n,), have just chosen, and what they remember since."""
        self._mask[stream], self._log_probability[stream] = mask, log_probability
        self._before[stream] = self.memory[stream]
        self.memory[stream] = memory

    def end(self, stream: Tensor, over: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Choices of decisions that ended; where the episode is `over` too, bool (n,), the stream forgets.

        Returns:
            Mask (n, actions), log probability (n,), place in the rollout (n,), and memory before the choice.
        """
        place = self._place[stream]
        self._place[stream] += 1
        self.memory[stream] = torch.where(over[:, None], 0.0, self.memory[stream])
        return self._mask[stream], self._log_probability[stream], place, self._before[stream]

    def collect(self, decisions: StreamTransitions, encoder: ObservationEncoder, settings: ClippedSettings,
                bonus: Tensor | None = None) -> Rollout:
        """Decisions that ended, as a part of a rollout, with what they were chosen with.

        Args:
            decisions: of some streams.
            encoder: of observations.
            settings: of the agent.
            bonus: to be added to rewards, in units of return, (n,); None for none.
        """
        reward, bootstrap = compute_backups(decisions, settings)
        reward = reward if bonus is None else reward + bonus
        over = decisions.terminated | decisions.truncated
        mask, log_probability, place, memory = self.end(decisions.stream, over)
        return Rollout(
            encoder.encode_many(decisions.observation), mask, decisions.action, log_probability,
            reward * settings.reward_scale, bootstrap, decisions.duration, over,
            encoder.encode_many(decisions.next_observation), memory, decisions.stream, place,
        )

    def has(self, count: int, device: torch.device) -> bool:
        """True if these are the choices of so many streams on that device."""
        return (self.count, self._place.device) == (count, device)

    def find_last(self, rollout: Rollout) -> Tensor:
        """True at each stream's last decision in a rollout, bool (n,)."""
        return rollout.place == self._place[rollout.stream] - 1

    def begin_episodes(self) -> None:
        """Let every stream forget what it remembers; its present decision is dropped."""
        self.memory.zero_()

    def begin_rollout(self) -> None:
        """Count places from 0 again."""
        self._place.zero_()

    def state_dict(self) -> StateTree:
        """Choices, places, the generator's state."""
        return {"mask": self._mask.cpu().numpy(), "log_probability": self._log_probability.cpu().numpy(),
                "place": self._place.cpu().numpy(), "memory": self.memory.cpu().numpy(),
                "before": self._before.cpu().numpy(), "generator": self.generator.get_state().numpy()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`.

        Raises:
            CheckpointError: it is of other streams.
        """
        for field, name in ((self._mask, "mask"), (self._log_probability, "log_probability"), (self._place, "place"),
                            (self.memory, "memory"), (self._before, "before")):
            if state[name].shape != tuple(field.shape):
                raise CheckpointError(f"the checkpoint's streams have {name} of shape {state[name].shape}; here are "
                                      f"{tuple(field.shape)}")
            field.copy_(torch.from_numpy(state[name]))
        self.generator.set_state(torch.from_numpy(state["generator"]))
