"""Replay of SMDP backups: a ring of decisions, drawn as backups of n decisions, and the schedule of updates.

The ring stores the backup (R, b) of each decision, with the target R + b V(s'), which contains duration, discount and
termination once (see `agent.compute_backup`). Consecutive decisions of one environment are linked, and joined when they
are drawn. The ring holds NumPy arrays of one environment, or tensors of many on their device. With NumPy it samples
several times faster than TorchRL's ReplayBuffer over LazyTensorStorage (`python -m benchmarks.agents`).

`ReplayAgent` is the base of agents that learn by updates from replay. Where many updates are due after a step of
many environments, minibatches grow instead, so that every decision is learned from as often as in one environment, up
to `max_batch_size`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import torch
from numpy.typing import DTypeLike, NDArray

from hrl_escape.agents.agent import compute_backup, count_actions
from hrl_escape.agents.batch_agent import BatchAgent
from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.box_actions import BoxActions
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.networks import ObservationEncoder
from hrl_escape.agents.decisions import Decisions
from hrl_escape.agents.state import Kept, Stateful, StateTree, read_value
from hrl_escape.errors import CheckpointError


class Experience(NamedTuple):
    """Backups, one (fields without a leading dimension) or a batch of them."""

    observation: Any  # (batch, *observation shape), encoded
    mask: Any  # bool (batch, actions), legal there
    action: Any  # int64 (batch,), or float32 (batch, numbers) for relaxed actions and points of a Box
    reward: Any  # float32 (batch,), R
    bootstrap: Any  # float32 (batch,), b: gamma^k, or 0 after a termination
    next_observation: Any  # (batch, *observation shape)
    next_mask: Any  # bool (batch, actions), legal at the next observation


class UpdateSchedule(Stateful):
    """Clock of an agent with replay, in `steps`, and its updates: `rate` per step after the warm-up."""

    STATE = ("steps", "_due")

    def __init__(self, warmup: int, rate: float) -> None:
        self.steps, self._due = 0, 0.0
        self._warmup, self._rate = warmup, rate

    @property
    def is_warm(self) -> bool:
        """True after the warm-up."""
        return self.steps > self._warmup

    def advance(self, steps: int, stored: int) -> int:
        """Count steps of the clock and return the number of due updates, 0 without `stored` decisions."""
        self.steps += steps
        if not (self.is_warm and stored):
            return 0
        self._due += steps * self._rate
        whole = int(self._due)
        self._due -= whole
        return whole


def list_batch_sizes(settings: Any, due: int, is_many: bool) -> list[int]:
    """Return the size of each minibatch for some due updates; with many environments fewer, larger ones.

    Sizes are at most `max_batch_size`, in settings that have it.
    """
    count = min(due, settings.max_updates) if is_many else due
    size = settings.batch_size * due // max(count, 1)
    return [min(size, max(settings.batch_size, getattr(settings, "max_batch_size", size)))] * count


class Replay(Stateful):
    """The last `capacity` decisions, drawn uniformly with replacement as backups of n decisions.

    A drawn decision is joined with the next decisions of its environment, up to `n_step` in total, to the episode's
    end or to the newest: (R1, b1) then (R2, b2) is (R1 + b1 R2, b1 b2). Thus each contributes its own gamma^k (Sutton,
    Precup and Singh 1999).

    Args:
        arrays: library of the ring, and generator of the draws.
        capacity: maximum number of decisions.
        observation_shape: of an encoded observation.
        observation_dtype: of an encoded observation.
        actions: number of actions, 0 for a Box.
        action_shape: () where an action is an index, (numbers,) where it is relaxed or a point of a Box.
        n_step: decisions joined into one backup.
        num_envs: number of environments.

    Attributes:
        added: number of decisions added so far.
    """

    def __init__(self, arrays: Arrays, capacity: int, observation_shape: tuple[int, ...],
                 observation_dtype: DTypeLike, actions: int, action_shape: tuple[int, ...] = (), n_step: int = 1,
                 num_envs: int = 1) -> None:
        self._arrays, self.capacity, self.n_step, self.added = arrays, capacity, n_step, 0
        shape, dtype = (capacity, *observation_shape), np.dtype(observation_dtype).name
        self._fields = Experience(
            arrays.zeros(shape, dtype), arrays.zeros((capacity, actions), "bool"),
            arrays.zeros((capacity, *action_shape), "float32" if action_shape else "int64"), arrays.zeros((capacity,)),
            arrays.zeros((capacity,)), arrays.zeros(shape, dtype), arrays.zeros((capacity, actions), "bool"))
        self._next = arrays.zeros((capacity,), "int64") - 1  # number of the decision that followed; -1 for none
        self._latest = arrays.zeros((num_envs,), "int64") - 1  # of each environment; -1 where an episode begins

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def add(self, experience: Experience, env: Any = None, over: Any = None) -> None:
        """Store backups of one decision, (n, ...), and drop the oldest when full.

        Args:
            experience: the backups.
            env: environment of each, int64 (n,), or None for backups that are never joined.
            over: bool (n,), where the episode ended.
        """
        count, capacity = len(experience.reward), self.capacity
        begin = max(count - capacity, 0)
        first = (self.added + begin) % capacity
        rows = slice(first, first + count - begin)
        if rows.stop > capacity:
            rows = self._arrays.arange(first, count - begin) % capacity
        for field, value in zip(self._fields, experience, strict=True):
            field[rows] = value[begin:] if begin else value
        self._next[rows] = -1
        if env is not None:
            self._link(env, over, count)
        self.added += count

    def _link(self, env: Any, over: Any, count: int) -> None:
        """Link the decisions that `add` stores with the preceding ones in their environments."""
        oldest = max(self.added + count - self.capacity, 0)
        if count == 1:  # a fifth of the time of the form for many rows
            before = int(self._latest[env[0]])
            if before >= oldest:
                self._next[before % self.capacity] = self.added
            self._latest[env[0]] = -1 if over[0] else self.added
            return
        number = self._arrays.arange(self.added, count)
        before = self._latest[env]
        there = before >= oldest
        self._next[before[there] % self.capacity] = number[there]
        self._latest[env] = self._arrays.library.where(over, -1, number)

    def begin_episodes(self) -> None:
        """Begin an episode in every environment: later decisions are not joined to earlier ones."""
        self._latest[:] = -1

    def sample(self, batch: int) -> Experience:
        """Draw backups of n decisions, (batch, ...)."""
        return self.take(self._arrays.draw_numbers(len(self), batch))

    def take(self, rows: Any) -> Experience:
        """Return backups of n decisions that begin in some rows, int64 (batch,)."""
        fields, take, where = self._fields, self._arrays.take, self._arrays.library.where
        reward, bootstrap, last = take(fields.reward, rows), take(fields.bootstrap, rows), rows
        for _ in range(self.n_step - 1):
            after = take(self._next, last)
            follows = after >= 0
            last = where(follows, after % self.capacity, last)
            reward = reward + bootstrap * take(fields.reward, last) * follows
            bootstrap = where(follows, bootstrap * take(fields.bootstrap, last), bootstrap)
        return Experience(take(fields.observation, rows), take(fields.mask, rows), take(fields.action, rows), reward,
                          bootstrap, take(fields.next_observation, last), take(fields.next_mask, last))

    def state_dict(self) -> StateTree:
        """Return the filled rows, their links and the counter."""
        rows = {name: read_value(field[: len(self)], name) for name, field in self._fields._asdict().items()}
        return {"added": self.added, "next": read_value(self._next[: len(self)], "next"),
                "latest": read_value(self._latest, "latest"), **rows}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`; raises `CheckpointError` for another capacity or other spaces."""
        self.added = int(state["added"])
        own = {**self._fields._asdict(), "next": self._next}
        for name, field in own.items():
            stored, here = np.asarray(state[name]), read_value(field[: len(self)], name)
            if stored.shape != here.shape or stored.dtype != here.dtype:
                raise CheckpointError(
                    f"the checkpoint's replay has {name} of shape {stored.shape} {stored.dtype}; "
                    f"this agent needs ({len(self)}, ...) of {here.shape[1:]} {here.dtype}"
                )
            field[: len(self)] = self._arrays.restore(stored)
        self._latest = self._arrays.restore(state["latest"])


class Priorities(Stateful):
    """Priorities of rows: draws are proportional to a power of the latest loss (Schaul et al. 2016, section 3.3).

    New rows have the largest priority so far. The sums are computed again for every draw: for 50,000 rows that takes
    0.1 ms, less than a tree of sums in Python.
    """

    STATE = ("_powers", "_largest", "_seen")

    def __init__(self, exponent: float) -> None:
        self._exponent = exponent
        self._powers = np.zeros(0)
        self._largest, self._seen = 1.0, 0

    def draw(self, ring: Replay, batch: int, importance: float, rng: np.random.Generator
             ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Draw rows, int64 (batch,), with weights (N P)^-importance over their maximum, float32 (batch,)."""
        self._powers = np.pad(self._powers, (0, len(ring) - len(self._powers)))
        self._powers[np.arange(max(self._seen, ring.added - ring.capacity), ring.added) % ring.capacity] = self._largest
        self._seen = ring.added
        sums = self._powers.cumsum()
        rows = np.minimum(sums.searchsorted(rng.random(batch) * sums[-1], side="right"), len(ring) - 1)
        weights = (self._powers[rows] * len(ring) / sums[-1]) ** -importance
        return rows, (weights / weights.max()).astype(np.float32)

    def set(self, rows: NDArray[np.int64], losses: NDArray) -> None:
        """Set the latest losses of some rows, each 0 or more."""
        self._powers[rows] = (losses + 1e-6) ** self._exponent
        self._largest = max(self._largest, float(self._powers[rows].max()))


def make_batch(one: Experience) -> Experience:
    """Return a batch of one backup."""
    numbers = {name: np.float32(getattr(one, name)) for name in ("reward", "bootstrap")}
    return Experience(*(np.asarray(field)[None] for field in one._replace(**numbers)))


class ReplayAgent(BatchAgent):
    """Base of agents that learn action values or preferences by updates from replay.

    Args:
        n_step: decisions joined into one backup.
        relaxed: replay holds a vector in place of the action's index; it always does for a Box.

    Attributes:
        replay: decisions of the agent's environments.
    """

    settings: Any
    is_markov: bool = True
    STATE = (Kept("_schedule.steps", "steps"), Kept("_schedule._due", "updates_due"))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int, settings: Any,
                 n_step: int = 1, relaxed: bool = False) -> None:
        self.settings = settings = settings or self.Settings()
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        is_box = "box" in self.acts_in
        self._actions = 0 if is_box else count_actions(action_space, self.name)
        self._box = BoxActions(action_space, self.name) if is_box else None
        self._schedule = UpdateSchedule(settings.warmup, settings.updates_per_step)
        self._seed, self._n_step, self._is_relaxed = seed, n_step, relaxed
        self.make_replay(1, None)

    def make_replay(self, num_envs: int, device: torch.device | None) -> None:
        """Make an empty replay for some environments."""
        settings, encoder, is_many = self.settings, self._encoder, device is not None
        self.place = num_envs, device
        self._arrays = Arrays(make_rng(self._seed, "draws"), device)
        capacity = max(settings.replay_capacity, settings.replay_per_env * num_envs if is_many else 1)
        action_shape = (self._box.size,) if self._box else (self._actions,) if self._is_relaxed else ()
        self.replay = Replay(self._arrays, capacity, encoder.shape, encoder.dtype, self._actions, action_shape,
                             self._n_step, num_envs)

    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin an episode in every environment; replay is kept if their number is unchanged."""
        if self.place == (num_envs, device):
            self.replay.begin_episodes()
            return
        self.move(device or torch.device("cpu"))
        self.make_replay(num_envs, device)

    @abstractmethod
    def move(self, device: torch.device) -> None:
        """Move networks and optimisers to a device."""

    @abstractmethod
    def update(self, batch: Experience) -> Mapping[str, float]:
        """Make one gradient step on a batch of arrays or tensors; return numbers to log."""

    def make_experience(self, batch: Decisions, bonus: Any = 0.0) -> Experience:
        """Compute backups of decisions, in scaled rewards, with a `bonus`, (n,), in units of return."""
        reward, bootstrap = compute_backup(batch, self.settings)
        return Experience(
            self._encoder.encode_batch(batch.observation), batch.action_mask, batch.action,
            (reward + bonus) * self.settings.reward_scale, bootstrap,
            self._encoder.encode_batch(batch.next_observation), batch.next_action_mask)

    def make_due_updates(self, duration: Any) -> dict[str, float]:
        """Advance the clock by decisions of some primitives, int64 (n,), and make the due updates.

        Returns numbers to log.
        """
        settings = self.settings
        steps = int(duration.sum()) if settings.clock == "primitive" else len(duration)
        due = self._schedule.advance(steps, len(self.replay))
        metrics: dict[str, float] = {}
        for size in list_batch_sizes(settings, due, self.place[1] is not None):
            metrics |= self.update(self.draw(size))
        return metrics

    def draw(self, size: int) -> Experience:
        """Draw a batch of backups from replay."""
        return self.replay.sample(size)

    def list_running(self) -> dict[str, Stateful]:
        """Return parts of the state for the present environments, by their names in a checkpoint."""
        return {"replay": self.replay, "draws": self._arrays}
