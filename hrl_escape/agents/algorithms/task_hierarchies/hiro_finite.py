"""HIRO: a manager that sets displacements as goals, and relabels old goals to match what the worker does today.

Nachum, Gu, Lee and Levine (2018), with finitely many displacements and primitives: values are tables, and the worker's
policy is the softmax of its values, which gives logged primitives a likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, count_actions
from hrl_escape.agents.components.exploration import (
    choose_best,
    compute_epsilon,
    compute_softmax,
    make_rng,
    mask_values,
    sample_index,
    sample_legal,
)
from hrl_escape.agents.components.tables import QTable, TabularSettings, make_cell_finder
from hrl_escape.agents.hierarchy.goal_space import GoalSpace, GoalTask, make_goal_space
from hrl_escape.agents.hierarchy.runner import CallRunner
from hrl_escape.agents.hierarchy.task import BaseTask, Decision, Frame, Hierarchy, Return, Seen, Stack, Step
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class HiroFiniteSettings(AgentSettings):
    """Settings of `hiro-finite`; epsilon applies to the manager, and the worker explores by its softmax."""

    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "never"
    """Choose every running call again at each primitive, instead of running it to its end: never, in evaluation
    only (hierarchical greedy execution), or always."""
    window: Annotated[int, Range(1)] = 10
    """c, number of primitives of a goal. Longer windows leave fewer, longer decisions to the manager."""
    worker_gamma: Annotated[float, Range(0, 1)] = 0.95
    """Discount per primitive of the worker, whose reward is minus the remaining distance."""
    temperature: Annotated[float, Range(0, open_low=True)] = 0.2
    """Temperature of the worker's softmax, in units of distance. More explores more."""
    correction: bool = True
    """Relabel old goals with the goal that makes their primitives likeliest today; otherwise goals stay as they
    were."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of the tables. Smaller values average noise."""
    replay_capacity: Annotated[int, Range(1)] = 2_000
    """Decisions of the manager kept for replay."""
    batch_size: Annotated[int, Range(1)] = 8
    """Decisions replayed after each decision of the manager."""


class Window(NamedTuple):
    """A decision of the manager, with its primitives."""

    before: NDArray[np.int32]  # cells of the view at the beginning
    legal: NDArray[np.bool_]  # legal goals at the beginning, (goals,)
    goal: int  # index of the goal
    reward: float  # sum of gamma^i r_i
    bootstrap: float  # gamma^k, 0 if the episode terminated
    after: NDArray[np.int32]  # cells at the end
    next_legal: NDArray[np.bool_]
    cells: NDArray[np.int32]  # (k, ...), cells at each primitive, without the end of the window
    points: NDArray[np.float64]  # (k + 1, dimensions), projections of these and of the end
    masks: NDArray[np.bool_]  # (k, primitives)
    actions: NDArray[np.int64]  # (k,)


def _make_key(cell: NDArray[np.int32], goal: NDArray[np.float64]) -> bytes:
    return cell.tobytes() + (np.round(goal, 6) + 0.0).tobytes()  # -0.0 is 0.0


class Pursuit(GoalTask):
    """Pursues a goal for a number of primitives and sees the remaining part; reward is minus the remaining distance."""

    def __init__(self, space: GoalSpace, primitives: int, window: int) -> None:
        super().__init__("worker", space, primitives)
        self._window = window

    def tell(self, frame: Frame, seen: Seen) -> NDArray[np.float64]:
        """Return the call's goal, advanced to a moment."""
        return self.goal_space.advance(self.goal_space.goals[frame.context], frame.start.observation, seen.observation)

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Return 1 when the window is over."""
        return float(frame.primitives >= self._window)

    def pay(self, step: Step, frame: Frame) -> float:
        """Return minus the remaining distance after the primitive."""
        seen = step.next_seen
        return -step.arrival * float(self.goal_space.measure(self.tell(frame, seen), seen.observation))


class Naming(GoalTask):
    """Sets a goal for every window; its reward is the environment's."""

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Return goals that are not reached in this state, or all if every goal is reached."""
        open_goals = ~self.goal_space.list_reached(seen.observation)
        return open_goals if open_goals.any() else ~open_goals


class HiroFinite(CallRunner):
    """Two levels of Q-learning, with the manager's goals relabelled before each use.

        worker:  Q1(s, a; g) <- -d(s', h(s, g, s')) + gamma_w^k max over a' of Q1(s', a'; h(s, g, s'))
        manager: Q2(s, g~) <- R + gamma^k max over g' of Q2(s', g'),
                 g~ = argmax over goals of sum over i of log pi(a_i | s_i, g_i),  g_(i+1) = h(s_i, g_i, s_(i+1))

    pi is the softmax of Q1 over legal primitives. The sum is over the states where primitives were chosen; the goal
    that was set wins ties. The paper draws ten candidates; here every goal is one.

    Args:
        goal_space: the goals; by default the result of `make_goal_space`, with absolute goals.
    """

    Settings = HiroFiniteSettings
    names_displacements = True
    """In rooms its goals are displacements on the floor, instead of events."""
    STATE = ("tables", Kept("_replay", pack=lambda kept: [each._asdict() for each in kept],
                            unpack=lambda saved: [Window(**fields) for fields in saved]),
             "_added", Kept("_way"), "_steps", "_action_rng")
    EPISODE = (*CallRunner.EPISODE, "_way")
    EPISODE_STATE = (*CallRunner.EPISODE_STATE, "way")
    _way: list[list[Any]]
    """Cells, point, mask and primitive of each primitive in the running window."""

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HiroFiniteSettings | None = None, goal_space: GoalSpace | None = None) -> None:
        settings = settings or HiroFiniteSettings()
        self._actions = count_actions(action_space, "hiro-finite")
        self.space = space = goal_space or make_goal_space(observation_space, "hiro-finite")
        self._worker = Pursuit(space, self._actions, settings.window)
        manager = Naming("manager", space, len(space.goals), self._worker)
        super().__init__(Hierarchy(manager, (self._worker,), source="learned", privileges=space.privileges), seed,
                         settings)
        self._find_cell = make_cell_finder(manager.view_space or observation_space, settings, "hiro-finite")
        table = TabularSettings(learning_rate=settings.learning_rate)
        self.tables = {"manager": QTable(len(space.goals), table), "worker": QTable(self._actions, table)}
        self._replay: list[Window] = []
        self._added, self._steps, self._action_rng = 0, 0, make_rng(seed, "actions")

    def begin_episode(self) -> None:
        """Clear the running window."""
        super().begin_episode()
        self._way = []

    @property
    def latest(self) -> Window:
        """The manager's last finished decision."""
        return self._replay[(self._added - 1) % self.settings.replay_capacity]

    # --- acting --------------------------------------------------------------------------

    def compute_worker_values(self, cell: NDArray[np.int32], goal: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return Q1(s, .; g), g relative to s, (primitives,); for several goals, (goals, primitives)."""
        if goal.ndim > 1:
            return np.array([self.compute_worker_values(cell, each) for each in goal])
        return self.tables["worker"].get_values(_make_key(cell, goal))

    def compute_worker_policy(self, cell: NDArray[np.int32], goal: NDArray[np.float64], mask: NDArray[np.bool_]
                              ) -> NDArray[np.float64]:
        """Return the softmax of Q1 over legal primitives, as in `compute_worker_values`."""
        return compute_softmax(mask_values(self.compute_worker_values(cell, goal) / self.settings.temperature, mask))

    def find_allowed(self, seen: Seen, legal: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the goals that the manager considers among legal ones, (goals,)."""
        return legal

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Choose epsilon-greedily for the manager, by softmax for the worker."""
        cell, frame = self._find_cell(view), stack[-1]
        if frame.task is self._worker:
            policy = self.compute_worker_policy(cell, self._worker.tell(frame, seen), legal)
            return sample_index(policy, self._action_rng)
        allowed = self.find_allowed(seen, legal)
        if self._action_rng.random() < compute_epsilon(self.settings, self._steps):
            return sample_legal(allowed, self._action_rng)
        return choose_best(self.tables["manager"].get_values(cell.tobytes()), allowed, self._action_rng)

    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Return the best goal, or the best primitive towards it."""
        cell, frame = self._find_cell(view), stack[-1]
        if frame.task is self._worker:
            return choose_best(self.compute_worker_values(cell, self._worker.tell(frame, seen)), legal, rng)
        return choose_best(self.tables["manager"].get_values(cell.tobytes()), self.find_allowed(seen, legal), rng)

    # --- learning ------------------------------------------------------------------------

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Learn from the primitive, from the manager's decision after its window, and from replayed decisions."""
        metrics: dict[str, float] = {}
        for returned in returns:
            if returned.frame.task is self._worker:
                metrics["worker_error"] = self._learn_worker(step, returned)
            else:
                self.store(returned)
                rows = self._action_rng.integers(len(self._replay), size=self.settings.batch_size)
                windows = [self._replay[row] for row in rows]
                metrics["manager_error"] = max(map(self._learn_manager, windows))
        self._steps += step.duration
        return metrics

    def _learn_worker(self, step: Step, returned: Return) -> float:
        decision, frame = returned.decision, returned.frame
        cell, after = self._find_cell(decision.view), self._find_cell(self._worker.view(returned.seen, ()))
        goal, left = self._worker.tell(frame, step.seen), self._worker.tell(frame, returned.seen)
        self._way.append([cell, self.space.project(step.seen.observation), decision.legal, decision.choice])
        target, legal = decision.reward, returned.seen.mask
        if not returned.terminated:  # for the worker, the end of the window is not terminal
            target += self.settings.worker_gamma**decision.duration * float(
                self.compute_worker_values(after, left)[legal].max())
        return abs(self.tables["worker"].update(_make_key(cell, goal), decision.choice, target))

    def get_gamma(self, task: BaseTask) -> float:
        """Return the worker's discount, or the manager's."""
        return self.settings.worker_gamma if task is self._worker else self.gamma

    def store(self, returned: Return) -> None:
        """Store the manager's decision, replacing the oldest if replay is full; truncated windows count."""
        decision: Decision = returned.decision
        seen, task = returned.seen, returned.frame.task
        cells, points, masks, actions = zip(*self._way, strict=True)
        legal = task.legal(seen, None)
        window = Window(
            self._find_cell(decision.view), decision.legal, decision.choice, decision.reward,
            0.0 if returned.terminated else decision.discount, self._find_cell(task.view(seen, returned.stack)),
            self.find_allowed(seen, legal), np.array(cells), np.array([*points, self.space.project(seen.observation)]),
            np.array(masks), np.array(actions))
        row = self._added % self.settings.replay_capacity
        self._replay[row : row + 1] = [window]
        self._added, self._way = self._added + 1, []

    def compute_likelihoods(self, window: Window) -> NDArray[np.float64]:
        """Return the sum over the window of log pi(a_i | s_i, g_i) for each goal at its beginning, (goals,)."""
        total = np.zeros(len(self.space.goals))
        chosen_in = zip(window.cells, window.points[:-1], window.masks, window.actions, strict=True)
        for cell, point, mask, action in chosen_in:
            told = self.space.goals + (window.points[0] - point) * self.space.is_relative
            policies = self.compute_worker_policy(cell, told, mask)
            total += np.log(np.maximum(policies[:, action], 1e-300))
        return total

    def relabel(self, window: Window) -> int:
        """Return the goal that a window is learned with today."""
        if not self.settings.correction:
            return window.goal
        likely = np.where(window.legal, self.compute_likelihoods(window), -np.inf)
        return window.goal if likely[window.goal] >= likely.max() - 1e-12 else int(likely.argmax())

    def _learn_manager(self, window: Window) -> float:
        table, target = self.tables["manager"], window.reward
        if window.bootstrap:
            target += window.bootstrap * float(table.get_values(window.after.tobytes())[window.next_legal].max())
        return abs(table.update(window.before.tobytes(), self.relabel(window), target))
