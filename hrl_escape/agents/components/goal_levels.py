"""Parts of hierarchies with continuous goals: where goals are in observations, and a replay of named rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.goal_replay import read_goals
from hrl_escape.agents.components.networks import ObservationEncoder, is_goal_space
from hrl_escape.agents.state import Stateful, StateTree
from hrl_escape.errors import AgentSettingsError, CheckpointError, UnsupportedSpaceError


class GoalReader:
    """Goal space of observations: the achieved goal where observations have goals, else some of their components.

    Args:
        space: observation space.
        columns: components of a Box that goals set, such as (0, 1) for x and y; unused where observations have goals.
        goal_range: largest size of each component of a displacement, in its unit; empty for a quarter of the width
            between the bounds of each component.
        scale: map components of observations with finite bounds to [-1, 1] for networks.
        agent: name in messages.

    Attributes:
        encoder: of whole observations.
        own_size: number of encoded components without the desired goal.
        size: number of components of a goal.
        low: lower bounds of points, float32 (size,); infinite if unbounded.
        high: upper bounds of points.
        range: largest displacement, float32 (size,).

    Raises:
        UnsupportedSpaceError: the space is neither a flat Box nor a Dict with goals.
        AgentSettingsError: `columns` or `goal_range` do not fit.
    """

    def __init__(self, space: gymnasium.Space, columns: Sequence[int], goal_range: Sequence[float], scale: bool,
                 agent: str) -> None:
        self.space, self.encoder = space, ObservationEncoder(space, scale)
        self._has_goals = is_goal_space(space)
        if is_goal_space(space):
            found: Any = space["achieved_goal"]
            self.own_size = ObservationEncoder(space["observation"], scale).shape[0]
        elif isinstance(space, spaces.Box) and len(space.shape) == 1:
            found, self.own_size = space, self.encoder.shape[0]
        else:
            raise UnsupportedSpaceError(f"{agent} finds no continuous goals in {space}: it needs a flat Box, or a Dict "
                                        "of observation, achieved_goal and desired_goal")
        self._columns = list(range(found.shape[0]) if self._has_goals else columns)
        if not self._columns or not all(0 <= each < found.shape[0] for each in self._columns):
            raise AgentSettingsError("goal_columns", tuple(columns), f"components from 0 to {found.shape[0] - 1}")
        self.size = len(self._columns)
        low, high = (torch.as_tensor(bound[self._columns], dtype=torch.float32) for bound in (found.low, found.high))
        self.low, self.high = low, high
        width = (high - low) / 4
        if goal_range:
            if len(goal_range) != self.size or min(goal_range) <= 0:
                raise AgentSettingsError("goal_range", tuple(goal_range), f"{self.size} numbers above 0")
            width = torch.tensor(goal_range, dtype=torch.float32)
        if not bool(((width > 0) & (width < 1e6)).all()):
            raise AgentSettingsError("goal_range", tuple(goal_range), f"{self.size} numbers above 0, because the goals "
                                     "have no finite bounds")
        self.range = width

    def move(self, device: torch.device) -> None:
        """Move the constants to a device."""
        self.low, self.high, self.range = (part.to(device) for part in (self.low, self.high, self.range))

    def view(self, observation: Any) -> Tensor:
        """Return encoded observations with desired goals last, float32 (n, ...)."""
        return torch.as_tensor(self.encoder.encode_batch(observation))

    def project(self, observation: Any) -> Tensor:
        """Return the points of n observations in the goal space, float32 (n, size), in their own units."""
        return self._read(observation, "achieved_goal")

    def find_desired(self, observation: Any) -> Tensor:
        """Return the goals that the environment asks for, float32 (n, size)."""
        return self._read(observation, "desired_goal")

    def _read(self, observation: Any, name: str) -> Tensor:
        if self._has_goals:
            return read_goals(self.space, observation, name).float()
        rows = observation if isinstance(observation, Tensor) else torch.from_numpy(np.stack(list(observation)))
        return rows[:, self._columns].float()


class RowReplay(Stateful):
    """The last `capacity` rows of named tensors, drawn evenly with repetition.

    Args:
        capacity: number of rows.
        shapes: name -> shape of a row; all are float32.
        arrays: source of randomness and device.
    """

    def __init__(self, capacity: int, shapes: Mapping[str, tuple[int, ...]], arrays: Arrays) -> None:
        self._arrays, self._capacity, self.added = arrays, capacity, 0
        self.rows = {name: torch.zeros((capacity, *shape), device=arrays.device) for name, shape in shapes.items()}

    def __len__(self) -> int:
        return min(self.added, self._capacity)

    def add(self, **given: Tensor) -> None:
        """Store n rows, (n, ...) each, and drop the oldest when full."""
        count = len(next(iter(given.values())))
        begin = max(count - self._capacity, 0)
        place = (self._arrays.arange(self.added + begin, count - begin)) % self._capacity
        for name, rows in self.rows.items():
            rows[place] = given[name][begin:].to(rows.dtype)
        self.added += count

    def sample(self, batch: int) -> dict[str, Tensor]:
        """Draw rows, (batch, ...) each."""
        drawn = self._arrays.draw_numbers(len(self), batch)
        return {name: rows.index_select(0, drawn) for name, rows in self.rows.items()}

    def state_dict(self) -> StateTree:
        """Return the filled rows and the counter."""
        return {"added": self.added, **{name: rows[: len(self)].cpu().numpy() for name, rows in self.rows.items()}}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`; raises `CheckpointError` for rows of another form."""
        self.added = int(state["added"])
        for name, rows in self.rows.items():
            saved = np.asarray(state[name])
            if saved.shape != (len(self), *rows.shape[1:]):
                raise CheckpointError(f"the checkpoint's replay has {name} of shape {saved.shape}; this agent needs "
                                      f"{(len(self), *rows.shape[1:])}")
            rows[: len(self)] = torch.from_numpy(np.array(saved)).to(rows.device)
