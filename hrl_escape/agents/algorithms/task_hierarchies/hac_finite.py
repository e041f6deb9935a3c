"""HAC, hierarchical actor-critic: every level learns as if the levels below it were already optimal.

Levy, Konidaris, Platt and Saenko (2019), with finitely many goals and Q-learning in tables, as in their grid worlds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, count_actions
from hrl_escape.agents.components.exploration import choose_best, make_rng, sample_legal
from hrl_escape.agents.components.tables import QTable, TabularSettings, make_cell_finder
from hrl_escape.agents.hierarchy.goal_space import GoalSpace, GoalTask, make_goal_space
from hrl_escape.agents.hierarchy.runner import CallRunner
from hrl_escape.agents.hierarchy.task import Frame, Hierarchy, Return, Seen, Stack, Step
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range

END = -1
"""Goal of the root if the episode has none: termination of the episode."""


@dataclass(frozen=True, kw_only=True)
class HacFiniteSettings(AgentSettings):
    """Settings of `hac-finite`; `gamma` discounts once per choice of a level."""

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
    levels: Annotated[int, Range(1, 4)] = 2
    """Number of levels, including the one that chooses primitives; 1 is a flat agent with goals in hindsight."""
    attempts: Annotated[int, Range(1)] = 5
    """H, most choices of a level for one goal. A level i above the primitives stops after H^(i + 1) primitives, the
    highest level never."""
    subgoal_tests: Annotated[float, Range(0, 1)] = 0.3
    """Fraction of subgoals that are tested: the levels below must reach them without exploring; a miss is worth -H."""
    random_share: Annotated[float, Range(0, 1)] = 0.2
    """Probability of a uniform legal choice. More explores more."""
    hindsight_goals: Annotated[int, Range(0)] = 3
    """Number of goals reached later in a level's call that each of its choices is also learned for."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of the tables. Smaller values average noise."""


class _Level(GoalTask):
    """Pursues a goal through goals of the level below, or through primitives."""

    def __init__(self, name: str, space: GoalSpace, choices: int, below: _Level | None, limit: int) -> None:
        super().__init__(name, space, choices, below)
        self._limit = limit

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        return seen.mask if self.child is None else ~self.goal_space.list_reached(seen.observation)

    def list_calls(self) -> Mapping[str, Any]:
        return {f"{self.name} goal {goal}": goal for goal in range(len(self.goal_space.goals))}

    def ends(self, frame: Frame, seen: Seen) -> float:
        if frame.context is None:
            return 0.0
        is_reached = self.goal_space.is_reached(self.goal_space.goals[frame.context], seen.observation)
        return float(is_reached or frame.primitives >= self._limit)


class HacFinite(CallRunner):
    """Q_i(s, a; g) = 0 if a reaches g, else -1 + gamma max over a' of Q_i(s', a'; g), in [-H, 0].

    The actions a of a level above the primitives are goals for the level below, and g is its own goal. An action is
    learned as the goals that its call reached, for any goal that was set (hindsight actions). It is also learned for
    goals that the level reached later (hindsight goals), and as worth -H without continuation if it was tested and
    missed (subgoal tests). The highest level pursues the goal of the episode, by default its end. Rewards of the
    environment are ignored.

    Args:
        goal_space: absolute goals; by default the result of `make_goal_space` for the observation space.
    """

    Settings = HacFiniteSettings
    EPISODE = (*CallRunner.EPISODE, "_calls", "_tested")
    EPISODE_STATE = (*CallRunner.EPISODE_STATE, "calls", "tested")
    STATE = ("tables", Kept("_calls"), Kept("_tested"), "_action_rng")
    _calls: dict[str, list[list[Any]]]
    """Choices of each level's running call: s, actions in hindsight, s', goals reached there, legal choices there, and
    whether the episode terminated."""
    _tested: int
    """Depth of the call whose subgoal is being tested; 0 for none."""

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HacFiniteSettings | None = None, goal_space: GoalSpace | None = None) -> None:
        settings = settings or HacFiniteSettings()
        actions = count_actions(action_space, "hac-finite")
        self.space = space = goal_space or make_goal_space(observation_space, "hac-finite")
        levels: list[_Level] = []
        for index in range(settings.levels):
            levels.append(_Level(f"level {index}", space, len(space.goals) if index else actions,
                                 levels[-1] if index else None, settings.attempts ** (index + 1)))
        super().__init__(Hierarchy(levels[-1], tuple(levels[:-1]), source="learned", privileges=space.privileges), seed,
                         settings)
        table = TabularSettings(learning_rate=settings.learning_rate, initial_value=-float(settings.attempts))
        self.tables = {level.name: QTable(int(level.space.n), table) for level in levels}
        self._find_cell = make_cell_finder(levels[0].view_space or observation_space, settings, "hac-finite")
        self._action_rng = make_rng(seed, "actions")

    def begin_episode(self) -> None:
        """Clear the running calls and tests."""
        super().begin_episode()
        self._calls, self._tested = {name: [] for name in self.hierarchy.tasks}, 0

    # --- acting --------------------------------------------------------------------------

    def compute_choice_values(self, level: str, view: Any, goal: int) -> NDArray[np.float64]:
        """Return Q_i(s, .; g) of a level, (choices,)."""
        return self.tables[level].get_values(self._make_key(self._find_cell(view), goal))

    def _make_key(self, cell: NDArray[np.int32], goal: int) -> bytes:
        return cell.tobytes() + np.int32(goal).tobytes()

    def _find_goal(self, frame: Frame, seen: Seen) -> int:
        if frame.context is not None:
            return int(frame.context)
        return END if self.space.find_desired is None else self.space.find_desired(seen.observation)

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Choose greedily below a test, otherwise sometimes uniformly; levels above the primitives may begin a test."""
        depth = len(stack)
        if depth <= self._tested:
            self._tested = 0
        if not self._tested and depth < self.settings.levels and (
                self._action_rng.random() < self.settings.subgoal_tests):
            self._tested = depth
        elif not self._tested and self._action_rng.random() < self.settings.random_share:
            return sample_legal(legal, self._action_rng)
        return self.choose_greedy(stack, view, legal, seen, self._action_rng)

    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Return the best choice towards the level's goal, ties at random."""
        frame = stack[-1]
        return choose_best(self.compute_choice_values(frame.task.name, view, self._find_goal(frame, seen)), legal, rng)

    # --- learning ------------------------------------------------------------------------

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Record each level's finished choice, and learn from finished calls."""
        error = 0.0
        reached = self.space.list_reached(step.next_seen.observation)
        for returned in returns:
            frame, decision = returned.frame, returned.decision
            name, is_lowest = frame.task.name, len(returned.stack) == self.settings.levels
            before, after = (self._find_cell(view) for view in (
                decision.view, frame.task.view(returned.seen, returned.stack)))
            actions = [decision.choice] if is_lowest else np.flatnonzero(reached & decision.legal).tolist()
            self._calls[name].append([before, actions, after, reached, frame.task.legal(returned.seen, frame.context),
                                      returned.terminated])
            goal = self._find_goal(frame, returned.seen)
            if len(returned.stack) == self._tested and not (reached[decision.choice] or returned.cut):
                self.tables[name].update(self._make_key(before, goal), decision.choice, -self.settings.attempts)
            if returned.is_over:
                error = max(error, self._learn_call(name, goal))
        return {"td_error": error} if returns else {}

    def _learn_call(self, name: str, goal: int) -> float:
        """Learn from a finished call, last choice first, for its goal and others; return the last error."""
        call, error = self._calls[name], 0.0
        for index in range(len(call) - 1, -1, -1):
            error = self._back_up(name, call[index], goal)
            for later in self._action_rng.integers(index, len(call), self.settings.hindsight_goals):
                there = np.flatnonzero(call[later][3])
                if len(there):
                    self._back_up(name, call[index], int(self._action_rng.choice(there)))
        self._calls[name] = []
        return error

    def _back_up(self, name: str, choice: list[Any], goal: int) -> float:
        before, actions, after, reached, legal, terminated = choice
        worst = -float(self.settings.attempts)
        if terminated if goal == END else reached[goal]:
            target = 0.0
        elif terminated or not legal.any():
            target = worst
        else:
            best = self.tables[name].get_values(self._make_key(after, goal))[legal].max()
            target = max(worst, -1.0 + self.settings.gamma * float(best))
        return max((abs(self.tables[name].update(self._make_key(before, goal), action, target))
                    for action in actions), default=0.0)
