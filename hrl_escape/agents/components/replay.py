"""Replay of SMDP backups: rings of them in numpy and torch, n-step composition before, and the schedule of updates.

The buffers store the backup (R, b) of each decision, target R + b V(s'), so that duration, discount and termination
cannot be lost or applied twice (see `agent.compute_backup`). One environment has rings in numpy, `ReplayBuffer` and
`NStep`; many have their twins on one device, `StreamReplay` and `StreamNStep`, to which a stream adds what one
environment would. On one CPU core `ReplayBuffer` samples several times faster than TorchRL's ReplayBuffer over
LazyTensorStorage (`python -m benchmarks.agents`).

Agents with the replay of many streams share `ReplayStreamAgent`. Where many updates are due after a step of all of
them, minibatches grow instead, so that every decision is learned from as often as in one environment.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium
import numpy as np
import torch
from numpy.typing import DTypeLike, NDArray
from torch import Tensor

from hrl_escape.agents.agent import LearningSettings, SMDPTransition, compute_backup, count_actions, count_steps
from hrl_escape.agents.components.exploration import EpsilonSettings, compute_epsilon, make_rng
from hrl_escape.agents.components.networks import NetworkSettings, ObservationEncoder
from hrl_escape.agents.state import Kept, Stateful, StateTree, read_value
from hrl_escape.agents.streams import OpenChoices, StreamAgent, StreamTransitions, compute_backups
from hrl_escape.errors import CheckpointError
from hrl_escape.settings import Range


@dataclass(frozen=True)
class ReplaySettings(EpsilonSettings, NetworkSettings, LearningSettings):
    """Settings that `dqn`, `sarsa` and `ddpg` have in common: epsilon, optimiser, and updates from replay."""

    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    loss: Literal["huber", "squared"] = "huber"
    """Loss of action values: Huber with threshold 1 (in scaled rewards), or half the squared error."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates from replay for each step of the clock; an option of 16 primitives is followed by 16 times as many."""
    stream_updates: Annotated[int, Range(1)] = 16
    """Most updates after a step of many streams. Where more are due, minibatches grow, so that every decision is
    learned from as often; much fewer and larger ones learn less, as the target network follows updates."""
    stream_replay: Annotated[int, Range(1)] = 128
    """Decisions of each stream, on average, for which replay has room at least."""


class Experience(NamedTuple):
    """Backups, one (fields without a leading dimension) or a batch of them."""

    observation: Any  # (batch, *observation shape), encoded
    mask: Any  # bool (batch, actions), legal there
    action: Any  # int64 (batch,), or float32 (batch, actions) for relaxed actions
    reward: Any  # float32 (batch,), R
    bootstrap: Any  # float32 (batch,), b: gamma^k, or 0 where nothing follows
    next_observation: Any  # (batch, *observation shape)
    next_mask: Any  # bool (batch, actions), legal at the next observation


def make_experience(transition: SMDPTransition, encoder: ObservationEncoder, settings: Any, bonus: float = 0.0
                    ) -> Experience:
    """The backup of a decision, in scaled rewards; `bonus`, in units of return, is added to its reward."""
    reward, bootstrap = compute_backup(transition, settings)
    return Experience(encoder.encode(transition.observation), transition.action_mask, transition.action,
                      (reward + bonus) * settings.reward_scale, bootstrap, encoder.encode(transition.next_observation),
                      transition.next_action_mask)


class UpdateSchedule(Stateful):
    """Clock of an agent with replay, in `steps`, and the updates due on it: `rate` a step after the warm-up."""

    STATE = ("steps", "_due")

    def __init__(self, warmup: int, rate: float) -> None:
        self.steps, self._due = 0, 0.0
        self._warmup, self._rate = warmup, rate

    @property
    def is_warm(self) -> bool:
        """True once updates may be made."""
        return self.steps > self._warmup

    def advance(self, steps: int, stored: int) -> int:
        """Count steps of the clock; returns how many updates are due, none while nothing is `stored`."""
        self.steps += steps
        if not (self.is_warm and stored):
            return 0
        self._due += steps * self._rate
        whole = int(self._due)
        self._due -= whole
        return whole


class _Ring:
    """The last `capacity` backups, of as many as were `added`; `fields` are arrays or tensors (capacity, ...)."""

    def __init__(self, fields: Experience) -> None:
        self.capacity, self.added, self._fields = len(fields.reward), 0, fields

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def state_dict(self) -> StateTree:
        """The filled rows and the counter."""
        return {"added": self.added} | {name: read_value(field[: len(self)], name)
                                        for name, field in self._fields._asdict().items()}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`; `CheckpointError` if it has another capacity or other spaces."""
        self.added = int(state["added"])
        for name, field in self._fields._asdict().items():
            stored, own = state[name], read_value(field[: len(self)], name)
            if stored.shape != own.shape or stored.dtype != own.dtype:
                raise CheckpointError(
                    f"the checkpoint's replay has {name} of shape {stored.shape} {stored.dtype}; "
                    f"this agent needs ({len(self)}, ...) of {own.shape[1:]} {own.dtype}"
                )
            field[: len(self)] = stored if isinstance(field, np.ndarray) else torch.from_numpy(stored).to(field.device)


class ReplayBuffer(_Ring):
    """The last `capacity` backups, sampled uniformly with replacement.

    An action has the shape () where it is an index, (actions,) where it is relaxed.
    """

    def __init__(self, capacity: int, observation_shape: tuple[int, ...], observation_dtype: DTypeLike, actions: int,
                 action_shape: tuple[int, ...] = ()) -> None:
        super().__init__(Experience(
            observation=np.zeros((capacity, *observation_shape), observation_dtype),
            mask=np.zeros((capacity, actions), np.bool_),
            action=np.zeros((capacity, *action_shape), np.float32 if action_shape else np.int64),
            reward=np.zeros(capacity, np.float32),
            bootstrap=np.zeros(capacity, np.float32),
            next_observation=np.zeros((capacity, *observation_shape), observation_dtype),
            next_mask=np.zeros((capacity, actions), np.bool_),
        ))

    def add(self, experience: Experience) -> None:
        """Store one backup, over the oldest when full."""
        row = self.added % self.capacity
        for field, value in zip(self._fields, experience, strict=True):
            field[row] = value
        self.added += 1

    def sample(self, batch: int, rng: np.random.Generator) -> Experience:
        """Draw a batch; arrays are copies with leading dimension `batch`."""
        return self.take(rng.integers(len(self), size=batch))

    def take(self, rows: NDArray[np.int64]) -> Experience:
        """Copies of the backups in some rows."""
        return Experience(*(field.take(rows, axis=0) for field in self._fields))


class Priorities(Stateful):
    """Rows of a ring drawn in proportion to their latest loss to a power (Schaul et al. 2016, section 3.3).

    New rows have the largest priority so far. The sums are taken anew for every draw: of 50,000 rows that takes 0.1 ms,
    less than a tree of sums in Python.
    """

    STATE = ("_powers", "_largest", "_seen")

    def __init__(self, exponent: float) -> None:
        self._exponent = exponent
        self._powers = np.zeros(0)
        self._largest, self._seen = 1.0, 0

    def draw(self, ring: _Ring, batch: int, importance: float, rng: np.random.Generator
             ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Rows, int64 (batch,), and their weights (N P)^-importance over the largest of them, float32 (batch,)."""
        self._powers = np.pad(self._powers, (0, len(ring) - len(self._powers)))
        self._powers[np.arange(max(self._seen, ring.added - ring.capacity), ring.added) % ring.capacity] = self._largest
        self._seen = ring.added
        sums = self._powers.cumsum()
        rows = np.minimum(sums.searchsorted(rng.random(batch) * sums[-1], side="right"), len(ring) - 1)
        weights = (self._powers[rows] * len(ring) / sums[-1]) ** -importance
        return rows, (weights / weights.max()).astype(np.float32)

    def set(self, rows: NDArray[np.int64], losses: NDArray) -> None:
        """Note the latest losses of some rows, each 0 or more."""
        self._powers[rows] = (losses + 1e-6) ** self._exponent
        self._largest = max(self._largest, float(self._powers[rows].max()))


def _join(first: Experience, then: Experience) -> Experience:
    return first._replace(reward=first.reward + first.bootstrap * then.reward,
                          bootstrap=first.bootstrap * then.bootstrap, next_observation=then.next_observation,
                          next_mask=then.next_mask)


class NStep(Stateful):
    """Joins n consecutive decisions into one backup: (R1, b1) then (R2, b2) is (R1 + b1 R2, b1 b2).

    Thus each decision contributes its own gamma^k (Sutton, Precup and Singh 1999), and a decision after which nothing
    follows, b = 0, ends the return. An episode's end flushes the shorter tails.
    """

    STATE = (Kept("_pending", pack=lambda pending: [each._asdict() for each in pending],
                  unpack=lambda saved: deque(Experience(**fields) for fields in saved)),)

    def __init__(self, n: int) -> None:
        self.n = n
        self._pending: deque[Experience] = deque()

    def push(self, experience: Experience, episode_over: bool) -> list[Experience]:
        """Take in one decision; returns the joined backups that are complete."""
        joined = [_join(earlier, experience) for earlier in self._pending]
        self._pending = deque([*joined, experience])
        if episode_over:
            complete = list(self._pending)
            self._pending.clear()
            return complete
        return [self._pending.popleft()] if len(self._pending) == self.n else []


def _make_fields(shape: tuple[int, ...], observation: Tensor, actions: int) -> Experience:
    """Empty backups (*shape, ...) whose observations are like one that is given, on its device."""
    seen = torch.zeros((*shape, *observation.shape[1:]), dtype=observation.dtype, device=observation.device)
    mask = torch.zeros((*shape, actions), dtype=torch.bool, device=observation.device)
    number = torch.zeros(shape, device=observation.device)
    return Experience(seen, mask, number.long(), number, number.clone(), seen.clone(), mask.clone())


class StreamReplay(_Ring):
    """The last `capacity` backups of all streams, sampled uniformly with replacement.

    Encoded observations are like a batch that is given, in shape, dtype and device.
    """

    def __init__(self, capacity: int, observation: Tensor, actions: int) -> None:
        super().__init__(_make_fields((capacity,), observation, actions))

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
        return self.take(torch.randint(len(self), (batch,), generator=generator, device=generator.device))

    def take(self, rows: Any) -> Experience:
        """Backups in some rows, int64 (batch,)."""
        rows = torch.as_tensor(rows, device=self._fields.reward.device)
        return Experience(*(field.index_select(0, rows) for field in self._fields))


class StreamNStep(Stateful):
    """Joins n consecutive decisions of each stream into one backup; see `NStep`."""

    STATE = ("_is_there", *(Kept(f"_pending.{name}", name) for name in Experience._fields))

    def __init__(self, n: int, streams: int, observation: Tensor, actions: int) -> None:
        self.n = n
        self._pending = _make_fields((n - 1, streams), observation, actions)  # [a - 1]: a decisions joined
        self._is_there = torch.zeros((n - 1, streams), dtype=torch.bool, device=observation.device)

    def push(self, stream: Tensor, experience: Experience, over: Tensor) -> Experience:
        """Take in decisions of some streams, each once, (k, ...); returns the joined backups that are complete."""
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
            joined, is_there = _join(older, experience), was_there
        backups, dones = zip(*complete, strict=True)
        return Experience(*(torch.cat([value[done] for value, done in zip(values, dones, strict=True)])
                            for values in zip(*backups, strict=True)))

    def forget(self) -> None:
        """Drop the decisions not yet complete: every stream begins an episode."""
        self._is_there.zero_()


class ReplayStreams(NamedTuple):
    """Choices in progress, replay and unfinished backups of many streams."""

    open: OpenChoices
    replay: StreamReplay
    n_step: StreamNStep


class ReplayStreamAgent(StreamAgent):
    """Base of agents that learn action values or preferences by updates from replay."""

    settings: Any
    is_markov: bool = True
    STATE = (Kept("_streams", is_left_out=True), Kept("_stream_rng", is_left_out=True), "replay",
             Kept("_schedule.steps", "steps"), Kept("_schedule._due", "updates_due"), "_action_rng", "_replay_rng")
    _streams: ReplayStreams | None = None

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int, settings: Any,
                 relaxed: bool = False) -> None:
        self.settings = settings = settings or self.Settings()
        self._encoder = encoder = ObservationEncoder(observation_space, settings.scale_observations)
        self._actions = actions = count_actions(action_space, self.name)
        self.replay = ReplayBuffer(settings.replay_capacity, encoder.shape, encoder.dtype, actions,
                                   (actions,) if relaxed else ())
        self._schedule = UpdateSchedule(settings.warmup, settings.updates_per_step)
        self._action_rng, self._replay_rng, self._stream_rng = (
            make_rng(seed, purpose) for purpose in ("actions", "replay", "streams"))

    @abstractmethod
    def move(self, device: torch.device) -> None:
        """Move networks and optimisers to a device."""

    @abstractmethod
    def compute_scores(self, encoded: Tensor) -> Tensor:
        """Numbers whose legal maximum is exploited, in units of return, (n, actions) from (n, *shape)."""

    @abstractmethod
    def update(self, batch: Experience) -> dict[str, float]:
        """One gradient step on a batch of arrays or tensors; returns numbers to log."""

    def draw(self, replay: Any, batch: int, rng: Any) -> Experience:
        """A batch of one environment's replay or of that of many streams, uniformly."""
        return replay.sample(batch, rng)

    def make_due_updates(self, transition: SMDPTransition) -> dict[str, float]:
        """Advance the clock by a decision, and make the updates from replay that are due; returns numbers to log."""
        due = self._schedule.advance(count_steps(transition, self.settings), len(self.replay))
        metrics = {"epsilon": compute_epsilon(self.settings, self._schedule.steps)}
        for _ in range(due):
            metrics |= self.update(self.draw(self.replay, self.settings.batch_size, self._replay_rng))
        return metrics

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
            metrics |= self.update(self.draw(replay, settings.batch_size * due // count, choices.generator))
        return metrics


def sample_actions(values: Tensor, mask: Tensor, settings: Any, steps: int,
                   generator: torch.Generator) -> Tensor:
    """Draw an action for each row of values (n, actions), in units of return, as `sample_action` does, int64 (n,)."""
    waits = torch.empty_like(values).exponential_(generator=generator).clamp_(min=1e-30).log()
    if settings.exploration == "boltzmann":
        ratio = values / settings.temperature
        if settings.boltzmann_clip:
            ratio = ratio.clamp(-settings.boltzmann_clip, settings.boltzmann_clip)
        return (ratio - waits).masked_fill(~mask, -torch.inf).argmax(dim=1)
    best, any_legal = (scores.masked_fill(~mask, -torch.inf).argmax(dim=1) for scores in (values, -waits))
    draws = torch.rand(len(values), generator=generator, device=values.device)
    return torch.where(draws < compute_epsilon(settings, steps), any_legal, best)
