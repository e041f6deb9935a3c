"""h-DQN: a manager that learns to choose goals, over a worker that learns to reach every goal.

Kulkarni, Narasimhan, Saeedi and Tenenbaum (2016). Both are Q-learners, by tables or by networks.
Unlike in the paper, the manager discounts by gamma^k, with the duration k of a goal.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, SMDPTransition, count_actions
from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.exploration import (
    choose_best,
    compute_epsilon,
    make_rng,
    sample_legal,
)
from hrl_escape.agents.components.networks import (
    Learner,
    ObservationEncoder,
    compute_td_loss,
    make_generator,
    make_network,
)
from hrl_escape.agents.components.replay import Experience, Replay, make_batch
from hrl_escape.agents.components.tables import QTable, TabularSettings, make_discretiser
from hrl_escape.agents.hierarchy.goal_space import GoalSet, Worker, make_goal_hierarchy, make_goals
from hrl_escape.agents.hierarchy.runner import CallRunner
from hrl_escape.agents.hierarchy.task import Return, Seen, Stack, Step
from hrl_escape.agents.state import Stateful
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class HDqnSettings(AgentSettings):
    """Settings of `h-dqn`; epsilon is the manager's."""

    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform with zero bias, as in Keras; or orthogonal with zero bias,
    usual for PPO."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam. Too large a step diverges."""
    max_grad_norm: Annotated[float, Range(0)] = 10.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns. Temperatures and logged values
    keep units of return."""
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "never"
    """Choose every running call again at each primitive, instead of running it to its end: never, in evaluation
    only (hierarchical greedy execution), or always."""
    values: Literal["network", "table"] = "network"
    """Networks over the observation and a one-hot goal, or tables over rounded observations."""
    patience: Annotated[int, Range(0)] = 100
    """Most primitives for a goal; 0 sets no limit."""
    worker_epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon of the worker for a goal that it always reaches; it is 1 for a goal that it never reaches."""
    success_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.05
    """Weight of the latest call in the running success rate of a goal."""
    worker_warmup: Annotated[int, Range(0)] = 1_000
    """Primitives at the start with random goals and without learning of the manager."""
    replay_capacity: Annotated[int, Range(1)] = 50_000
    """Decisions kept for replay, at each level."""
    batch_size: Annotated[int, Range(1)] = 32
    """Decisions in an update of a network."""
    updates_per_decision: Annotated[float, Range(0)] = 0.5
    """Updates of a level's network for each decision of that level."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Share of the online network blended into the target network at each update."""
    table_learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """With tables, alpha at a state and action's first update."""
    table_learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """With tables, the n-th update uses alpha / n^power."""


class HDqn(CallRunner):
    """Q-learning at two levels of time.

    The worker with goal g receives f = gamma^(k-1) on reaching g by an action of k primitives, which ends its call:

        Q1(s, a; g) <- f + gamma^k (1 - reached or terminated) max over a' of Q1(s', a'; g)

    The manager chose g at s, the call ended at s' after k primitives, and F = sum of gamma^i r_i during the call:

        Q2(s, g) <- F + gamma^k (1 - terminated) max over g' of Q2(s', g')

    s is the state at the choice of g. A call that is given up, or cut, bootstraps at both levels.

    Args:
        goals: goals, by default from `make_goals` for the observation space. If they have a policy, the
            worker follows it and does not learn.
    """

    Settings: ClassVar[type] = HDqnSettings
    STATE = ("manager", "worker", "successes", "_steps", "_action_rng")
    recipes: ClassVar[Mapping[str, Any]] = MappingProxyType({"table": HDqnSettings(values="table")})

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HDqnSettings | None = None, goals: GoalSet | None = None) -> None:
        settings = settings or HDqnSettings()
        actions = count_actions(action_space, "h-dqn")
        goals = goals or make_goals(observation_space, "h-dqn")
        super().__init__(make_goal_hierarchy(goals, actions, settings.patience), seed, settings)
        self._is_planned = goals.policy is not None
        manager_space, worker_space = (observation_space if view is None else view.space
                                       for view in (goals.manager_view, goals.worker_view))  # fmt: skip
        self._action_rng = make_rng(seed, "actions")
        make = _NetworkValues if settings.values == "network" else _TableValues
        self.manager = make(manager_space, 0, goals.count, settings, make_rng(seed, "manager"))
        self.worker = make(worker_space, goals.count, actions, settings, make_rng(seed, "worker"))
        self.successes = np.zeros(goals.count)
        """Running success rate of each goal."""
        self._steps = 0

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Epsilon-greedy: the worker by the goal's success rate, the manager by the schedule."""
        goal = stack[-1].context
        if goal is not None and self._is_planned:
            return int(legal.argmax())
        if goal is not None:
            end = self.settings.worker_epsilon_end
            epsilon = end + (1 - end) * (1 - float(self.successes[goal]))
        else:
            learning = self._steps - (0 if self._is_planned else self.settings.worker_warmup)
            epsilon = 1.0 if learning < 0 else compute_epsilon(self.settings, learning)
        if self._action_rng.random() < epsilon:
            return sample_legal(legal, self._action_rng)
        return choose_best(self._compute(view, goal), legal, self._action_rng)

    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Choose the best goal, and the best primitive towards it."""
        if stack[-1].context is not None and self._is_planned:
            return int(legal.argmax())
        return choose_best(self._compute(view, stack[-1].context), legal, rng)

    def _compute(self, observation: Any, goal: int | None) -> NDArray:
        return (self.manager if goal is None else self.worker).compute(observation, goal)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Learn at each level with a completed decision."""
        metrics: dict[str, float] = {}
        for returned in returns:
            frame, decision = returned.frame, returned.decision
            goal = frame.context
            is_worker = isinstance(frame.task, Worker)
            reached = isinstance(frame.task, Worker) and frame.task.is_reached(frame, returned.seen)
            if is_worker and (returned.ended or returned.terminated):
                rate = self.settings.success_rate
                self.successes[goal] += rate * (reached - self.successes[goal])
            if self._is_planned and is_worker:
                continue
            if not (is_worker or self._is_planned) and self._steps < self.settings.worker_warmup:
                continue
            legal = frame.task.legal(returned.seen, goal)
            backup = Experience(decision.view, decision.legal, decision.choice, decision.reward,
                                0.0 if reached or returned.terminated or not legal.any() else decision.discount,
                                frame.task.view(returned.seen, returned.stack), legal)
            level = self.worker if is_worker else self.manager
            metrics["worker_error" if is_worker else "manager_error"] = level.learn(backup, goal)
        self._steps += step.duration
        return metrics

    def observe_each(self, decisions: Iterable[tuple[int, SMDPTransition]]) -> Mapping[str, float]:
        """Learn from each decision; a network makes one update from as many backups as in one environment."""
        levels = {name: level for name, level in (("manager_error", self.manager), ("worker_error", self.worker))
                  if isinstance(level, _NetworkValues)}
        for level in levels.values():
            level.waits = True
        metrics = super().observe_each(decisions)
        for level in levels.values():
            level.waits = False
        return {**metrics, **{name: level.update(most=1) for name, level in levels.items()}}


class _TableValues(QTable):
    """Q(s, .; g) in a table."""

    def __init__(self, space: gymnasium.Space, goals: int, actions: int, settings: HDqnSettings,
                 rng: np.random.Generator) -> None:
        table = TabularSettings(bins=settings.bins, resolution=settings.resolution,
                                learning_rate=settings.table_learning_rate,
                                learning_rate_power=settings.table_learning_rate_power)
        super().__init__(actions, table)
        self._discretise = make_discretiser(space, table, "h-dqn")

    def _make_key(self, observation: Any, goal: int | None) -> bytes:
        return self._discretise(observation) + np.int32(-1 if goal is None else goal).tobytes()

    def compute(self, observation: Any, goal: int | None) -> NDArray:
        return self.get_values(self._make_key(observation, goal))

    def learn(self, backup: Experience, goal: int | None) -> float:
        target = backup.reward
        if backup.bootstrap:
            values = self.compute(backup.next_observation, goal)
            target += backup.bootstrap * float(values[backup.next_mask].max())
        return abs(self.update(self._make_key(backup.observation, goal), backup.action, target))


class _NetworkValues(Stateful):
    """Q(s, .; g) by a network with replay and a target network, double estimation."""

    STATE = ("_learner", "_replay", "_due", "_rng")

    def __init__(self, space: gymnasium.Space, goals: int, actions: int, settings: HDqnSettings,
                 rng: np.random.Generator) -> None:
        self._settings, self._goals = settings, goals
        self._encoder = ObservationEncoder(space, settings.scale_observations)
        generator = make_generator(rng)
        self.online = make_network(self._encoder, actions, settings, generator, extra_inputs=goals)
        self._target = make_network(self._encoder, actions, settings, generator, extra_inputs=goals)
        self._target.requires_grad_(False).blend(self.online, 1.0)
        self._learner = Learner("h-dqn", {"online": self.online, "target": self._target}, ["online"], settings)
        shape = (self._encoder.shape[0] + goals,) if goals else self._encoder.shape
        self._replay = Replay(Arrays(rng), settings.replay_capacity, shape, self._encoder.dtype, actions)
        self._rng, self._due = rng, 0.0
        self.waits = False
        """Store backups, without updates."""

    def _encode(self, observation: Any, goal: int | None) -> NDArray:
        encoded = self._encoder.encode(observation)
        if goal is None:
            return encoded
        told = np.zeros(self._goals, np.float32)
        told[goal] = 1.0
        return np.concatenate([encoded, told])

    def compute(self, observation: Any, goal: int | None) -> NDArray:
        return self.online.compute(self._encode(observation, goal)) / self._settings.reward_scale

    def learn(self, backup: Experience, goal: int | None) -> float:
        self._replay.add(make_batch(backup._replace(
            observation=self._encode(backup.observation, goal), mask=True,
            reward=backup.reward * self._settings.reward_scale,
            next_observation=self._encode(backup.next_observation, goal))))
        self._due += self._settings.updates_per_decision
        return 0.0 if self.waits else self.update()

    def update(self, most: int | None = None) -> float:
        """Make the due updates; beyond `most`, minibatches grow instead."""
        loss, due, size = 0.0, int(self._due), self._settings.batch_size
        if due and len(self._replay) >= size:
            self._due -= due
            count = min(due, most or due)
            for _ in range(count):
                batch = self._replay.sample(size * due // count)
                loss = self._learner.minimise(self._compute_loss(batch))
                self._target.blend(self.online, self._settings.target_rate)
        return loss

    def _compute_loss(self, batch: Experience) -> torch.Tensor:
        observation, _, action, reward, bootstrap, next_observation, next_mask = map(torch.from_numpy, batch)
        with torch.no_grad():
            # Where nothing is legal, nothing is bootstrapped.
            best = self.online(next_observation).masked_fill(~next_mask, -1e9).argmax(dim=1, keepdim=True)
            targets = reward + bootstrap * self._target(next_observation).gather(1, best).squeeze(1)
        values = self.online(observation).gather(1, action.unsqueeze(1)).squeeze(1)
        return compute_td_loss(values, targets, "huber")
