"""Replay of many streams as tensors on one device: a ring of backups, and n-step composition stream by stream.

The twins of `components/replay.py` with a leading dimension: a stream adds what one environment would, whenever the
decisions of the others end.
"""

from __future__ import annotations

import torch
from torch import Tensor

from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.state import StateTree
from hrl_escape.errors import CheckpointError

__all__ = ["StreamNStep", "StreamReplay"]


def _make_fields(shape: tuple[int, ...], observation: Tensor, actions: int) -> Experience:
    """Empty backups (*shape, ...) whose observations are like one that is given, on its device."""
    seen = torch.zeros((*shape, *observation.shape[1:]), dtype=observation.dtype, device=observation.device)
    mask = torch.zeros((*shape, actions), dtype=torch.bool, device=observation.device)
    number = torch.zeros(shape, device=observation.device)
    return Experience(seen, mask, number.long(), number, number.clone(), seen.clone(), mask.clone())


class StreamReplay:
    """The last `capacity` backups of all streams, sampled uniformly with replacement.

    Args:
        capacity: how many are kept.
        observation: a batch of encoded observations, for shape, dtype and device.
        actions: number of actions.
    """

    def __init__(self, capacity: int, observation: Tensor, actions: int) -> None:
        self.capacity, self.added = capacity, 0
        self._fields = _make_fields((capacity,), observation, actions)

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def add(self, experience: Experience) -> None:
        """Store backups (n, ...), over the oldest when full; of more than fit, the last."""
        count = len(experience.action)
        begin = max(count - self.capacity, 0)
        rows = (torch.arange(begin, count, device=experience.action.device) + self.added) % self.capacity
        for field, value in zip(self._fields, experience, strict=True):
            field[rows] = value[begin:]
        self.added += count

    def sample(self, batch: int, generator: torch.Generator) -> Experience:
        """Draw a batch of backups, (batch, ...)."""
        rows = torch.randint(len(self), (batch,), generator=generator, device=generator.device)
        return Experience(*(field[rows] for field in self._fields))

    def state_dict(self) -> StateTree:
        """The filled rows and the counter."""
        return {"added": self.added} | {name: field[: len(self)].cpu().numpy()
                                        for name, field in self._fields._asdict().items()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`.

        Raises:
            CheckpointError: it comes from another capacity or other spaces.
        """
        self.added = int(state["added"])
        _restore(self._fields, state, len(self))


class StreamNStep:
    """Joins n consecutive decisions of each stream into one backup; see `NStep`.

    Args:
        n: decisions to join.
        streams: number of streams.
        observation: as for `StreamReplay`.
        actions: number of actions.
    """

    def __init__(self, n: int, streams: int, observation: Tensor, actions: int) -> None:
        self.n = n
        self._pending = _make_fields((n - 1, streams), observation, actions)  # [a - 1]: a decisions joined
        self._is_there = torch.zeros((n - 1, streams), dtype=torch.bool, device=observation.device)

    def push(self, stream: Tensor, experience: Experience, over: Tensor) -> Experience:
        """Take in a decision of some streams, int64 (k,); returns the joined backups that are complete.

        Args:
            stream: streams, each once.
            experience: their backups, (k, ...).
            over: bool (k,), the episode ended.
        """
        complete: list[tuple[Experience, Tensor]] = []
        joined, is_there = experience, torch.ones_like(over)
        for place in range(self.n):  # the newest first; each takes the place of the next older
            is_done = is_there & (over if place < self.n - 1 else True)
            complete.append((joined, is_done))
            if place == self.n - 1:
                break
            older = Experience(*(field[place, stream] for field in self._pending))
            was_there = self._is_there[place, stream]
            for field, value in zip(self._pending, joined, strict=True):
                field[place, stream] = value
            self._is_there[place, stream] = is_there & ~over
            joined = older._replace(
                reward=older.reward + older.bootstrap * experience.reward,
                bootstrap=older.bootstrap * experience.bootstrap,
                next_observation=experience.next_observation, next_mask=experience.next_mask)
            is_there = was_there
        backups, dones = zip(*complete, strict=True)
        return Experience(*(torch.cat([value[done] for value, done in zip(values, dones, strict=True)])
                            for values in zip(*backups, strict=True)))

    def forget(self) -> None:
        """Drop the decisions not yet complete: every stream begins an episode."""
        self._is_there.zero_()

    def state_dict(self) -> StateTree:
        """The decisions not yet complete."""
        return {"is_there": self._is_there.cpu().numpy()} | {
            name: field.cpu().numpy() for name, field in self._pending._asdict().items()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`.

        Raises:
            CheckpointError: it is of other streams, or joins others.
        """
        _restore(self._pending, state, len(self._is_there))
        self._is_there.copy_(torch.from_numpy(state["is_there"]))


def _restore(fields: Experience, state: StateTree, rows: int) -> None:
    for name, field in fields._asdict().items():
        if state[name].shape != (rows, *field.shape[1:]):
            raise CheckpointError(f"the checkpoint's replay has {name} of shape {state[name].shape}; this agent needs "
                                  f"{(rows, *field.shape[1:])}")
        field[:rows] = torch.from_numpy(state[name]).to(field.device)
