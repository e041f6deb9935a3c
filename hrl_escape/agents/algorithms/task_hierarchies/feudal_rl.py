"""Feudal learning: managers over nested cells, each rewarded for following its own manager's orders.

Dayan and Hinton (1993), Feudal reinforcement learning. A manager observes the agent's cell at its level. It orders its
sub-manager to leave that cell in a direction, or to search inside (information hiding). Sub-managers are rewarded for
following the order, even if the order was bad (reward hiding).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, count_actions
from hrl_escape.agents.components.tables import QTable, make_discretiser
from hrl_escape.agents.hierarchy.runner import TabularRunner
from hrl_escape.agents.hierarchy.task import BaseTask, Frame, Hierarchy, Return, Seen, Stack, Step, allow_only
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range

DIRECTIONS = ((-1, 0), (1, 0), (0, -1), (0, 1))
"""North, south, west, east: changes of row and column."""
SEARCH = len(DIRECTIONS)
"""The command to search inside the cell; smaller commands are directions."""
ORDER_NAMES = ("north", "south", "west", "east", "search")
"""Names of the commands."""


@dataclass(frozen=True)
class Quadtree:
    """A square divided into four at every level: level n has 2^n x 2^n cells."""

    depth: int  # finest level; level 0 is the whole square
    place: Callable[[Any], tuple[float, float]]
    """Function from an observation to (row, column) in the square, each in [0, 1)."""
    phase: Callable[[Any], tuple[int, ...]] | None = None
    """Function from an observation to numbers that every manager sees in addition to its cell; none by default."""
    has_found: Callable[[Any, Any], bool] | None = None
    """Function (observation at the order, observation) -> whether a search has succeeded; by default only the end of
    the episode is a success."""
    policy: Callable[[Any, tuple[int, int], int], int | None] | None = None
    """Function (observation, cell, order) -> the primitive of the last level for an order about a cell of the finest
    level, or None if there is none. By default this policy is learned."""

    def __post_init__(self) -> None:
        if self.depth < 0:
            raise AgentSettingsError("Quadtree.depth", self.depth, "0 or more")

    def find_cell(self, observation: Any, level: int) -> tuple[int, int]:
        """Return row and column of an observation's cell at a level.

        Raises:
            AgentSettingsError: `place` is outside the square.
        """
        place = self.place(observation)
        if not all(0 <= coordinate < 1 for coordinate in place):
            raise AgentSettingsError("Quadtree.place", place, "a row and a column from 0 up to but not including 1")
        row, column = (int(coordinate * 2**level) for coordinate in place)
        return row, column

    def has_neighbour(self, cell: tuple[int, int], level: int, direction: int) -> bool:
        """Return whether the neighbour of a cell in a direction is in the square."""
        return all(0 <= here + step < 2**level for here, step in zip(cell, DIRECTIONS[direction], strict=True))


class FeudalTask(BaseTask):
    """The manager of one level; the last one chooses primitives.

    A call is an order from the level above, about the current cell of that level: to leave it, or to search it. The
    root has no order, and its reward is the environment's.

    Args:
        level: level of the cells that it observes and gives orders about. Below the tree's depth it observes the
            observation and chooses primitives.
        penalty: cost of leaving the cell against the order.
        patience: most primitives of an order to the last level, doubled for each level above; 0 sets no limit.
    """

    def __init__(self, tree: Quadtree, level: int, primitives: int, penalty: float, patience: int) -> None:
        self.tree, self.level = tree, level
        self.is_last = level > tree.depth
        super().__init__(f"level {level}", primitives if self.is_last else SEARCH + 1)
        # A policy that follows orders does so eventually; orders of levels in between can still fail.
        self.is_obedient = self.is_last and tree.policy is not None
        self._patience = 0 if self.is_obedient else patience * 2 ** (tree.depth + 1 - level)
        self._penalty = penalty

    def view(self, seen: Seen, stack: Stack) -> Any:
        """Return row and column of its cell, and the phase; the last level sees the observation."""
        if self.is_last:
            return seen.observation
        phase = self.tree.phase
        cell = self.tree.find_cell(seen.observation, self.level)
        return np.array(cell if phase is None else (*cell, *phase(seen.observation)))

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Return legal commands: directions inside the square, and the search; primitives on the last level.

        With a given policy these are its primitive, and the orders that it can follow.
        """
        if self.is_last:
            return self._obey(seen, context) if self.is_obedient else seen.mask
        cell = self.tree.find_cell(seen.observation, self.level)
        inside = [self.tree.has_neighbour(cell, self.level, direction) for direction in range(SEARCH)]
        legal = np.array([*inside, True], np.bool_)
        if self.tree.policy is not None and isinstance(self.child, FeudalTask):
            if not self.child.is_last:  # its choices are independent of its order
                return legal & self.child.legal(seen, None).any()
            for order in legal.nonzero()[0].tolist():
                legal[order] = self.child.legal(seen, order).any()
        return legal

    def _obey(self, seen: Seen, order: int | None) -> NDArray[np.bool_]:
        policy, cell = self.tree.policy, self.tree.find_cell(seen.observation, self.tree.depth)
        chosen = None if policy is None or order is None else policy(seen.observation, cell, order)
        return allow_only(chosen, seen.mask)

    def list_calls(self) -> Mapping[str, Any]:
        """Return one call per direction, and one to search."""
        return {f"{self.name} {order}": number for number, order in enumerate(ORDER_NAMES)}

    def find_exit(self, frame: Frame, seen: Seen) -> tuple[int, int] | None:
        """Return the change of row and column from the call's cell, or None inside it."""
        if frame.context is None:
            return None
        (top, left), (row, column) = (self.tree.find_cell(each.observation, self.level - 1)
                                      for each in (frame.start, seen))  # fmt: skip
        return None if (top, left) == (row, column) else (row - top, column - left)

    def is_settled(self, frame: Frame, seen: Seen) -> bool:
        """Return whether the cell was left, or the search has succeeded."""
        return self.find_exit(frame, seen) is not None or self._has_found(frame, seen)

    def _has_found(self, frame: Frame, seen: Seen) -> bool:
        found = self.tree.has_found
        is_search = frame.context is not None and frame.context == SEARCH
        return is_search and found is not None and found(frame.start.observation, seen.observation)

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Return 1 if the cell was left in any direction, a search has succeeded, or patience has run out."""
        given_up = frame.context is not None and 0 < self._patience <= frame.primitives
        return float(given_up or self.is_settled(frame, seen))

    def pay(self, step: Step, frame: Frame) -> float:
        """Return 1 for leaving as ordered, success, or the episode's end in a search; minus the penalty for leaving."""
        if frame.context is None:
            return step.reward
        if self._has_found(frame, step.next_seen):
            return step.arrival
        way = self.find_exit(frame, step.next_seen)
        if way is not None:
            was_ordered = frame.context < SEARCH and way == DIRECTIONS[frame.context]
            return step.arrival * (1.0 if was_ordered else -self._penalty)
        return step.arrival * (frame.context == SEARCH and step.terminated)


def make_feudal_hierarchy(tree: Quadtree, primitives: int, penalty: float, patience: int) -> Hierarchy:
    """Make managers of the levels 1 to the tree's depth, and one of primitives below."""
    levels = [FeudalTask(tree, level, primitives, penalty, patience) for level in range(1, tree.depth + 2)]
    for above, below in zip(levels, levels[1:], strict=False):
        above.child = below
    root, *others = levels
    source = "given" if tree.phase is None else "synthesised"
    told = ("cells",) if tree.depth else ()
    return Hierarchy(root, tuple(others), source=source, privileges=told)


@dataclass(frozen=True, kw_only=True)
class FeudalRlSettings(AgentSettings):
    """Settings of `feudal-rl`: rewards and patience of orders, step sizes, exploration and discount."""

    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy` draws evenly with probability epsilon. `boltzmann` draws by exp(q / temperature)."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return. More explores more."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as in keras-rl 0.4.2; values beyond it are equally likely. 0
    sets none."""
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of the first update of a state and action. 1 suits deterministic environments; smaller values average
    noise."""
    learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """Power p in the step size learning_rate / n^p of the n-th update of a state and action. Values above 0.5 converge
    under noise."""
    initial_value: float = 0.0
    """Value of actions that were never tried, in units of return. Higher values explore more."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "never"
    """Choose every running call again at each primitive, instead of running it to its end: never, in evaluation
    only (hierarchical greedy execution), or always."""
    penalty: Annotated[float, Range(0)] = 0.2
    """Cost to a manager of leaving its cell against the order. More makes managers follow orders more strictly."""
    patience: Annotated[int, Range(0)] = 10
    """Most primitives of an order to the last level, doubled for each level above; 0 sets no limit. Walls can block an
    ordered way."""


class FeudalRl(TabularRunner):
    """Q-learning at every level of a quadtree, given the order from above.

    Level n in cell c with order m chose a; that ended after k primitives in cell c', with reward rho on the way:

        Q_n(c, m, a) <- Q_n + alpha [rho + gamma^k (1 - over) max over legal a' of Q_n(c', m, a') - Q_n(c, m, a)]

    rho is gamma^(k-1) times 1 if m was followed: the cell above c was left in the ordered direction, or the episode
    terminated during a search; minus a penalty if it was left in another direction; otherwise 0. "Over" is either, or
    the end of the episode; an order that was abandoned or cut bootstraps. Only the top level has the environment's
    reward, R = sum of gamma^i r_i. Below the tree the last level observes the observation and chooses primitives.

    A cell is not a state: the outcome depends on where in the cell the agent is. Values of managers need not converge.

    Args:
        tree: the cells; by default none, which is Q-learning.
    """

    Settings: ClassVar[type] = FeudalRlSettings
    STATE = ("tables",)

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: FeudalRlSettings | None = None, tree: Quadtree | None = None) -> None:
        settings = settings or FeudalRlSettings()
        actions = count_actions(action_space, "feudal-rl")
        tree = tree or Quadtree(0, lambda observation: (0.0, 0.0))
        hierarchy = make_feudal_hierarchy(tree, actions, settings.penalty, settings.patience)
        super().__init__(hierarchy, seed, settings)
        self.tables = {name: QTable(int(task.space.n), settings) for name, task in hierarchy.tasks.items()}
        self._discretise = make_discretiser(observation_space, settings, "feudal-rl")

    def make_key(self, task: FeudalTask, view: Any, order: int | None) -> bytes:
        """Return the key of a level's view and order."""
        seen = self._discretise(view) if task.is_last else np.asarray(view, np.int32).tobytes()
        return seen + np.int32(-1 if order is None else order).tobytes()

    def compute_choice_values(self, task: FeudalTask, view: Any, order: int | None) -> NDArray[np.float64]:
        """Return Q_n(c, m, .), (choices,)."""
        return self.tables[task.name].get_values(self.make_key(task, view, order))

    def weigh(self, stack: Stack, view: Any, seen: Seen) -> NDArray[np.float64] | None:
        """Return the level's values, or None on the last level with a given policy."""
        task = _get_task(stack)
        return None if task.is_obedient else self.compute_choice_values(task, view, stack[-1].context)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Learn at every level whose choice ended."""
        error = 0.0
        for returned in returns:
            task, frame, decision = _get_task(returned.stack), returned.frame, returned.decision
            if task.is_obedient:
                continue
            order, target = frame.context, decision.reward
            if not (returned.terminated or task.is_settled(frame, returned.seen)):
                view = task.view(returned.seen, returned.stack)
                legal = task.legal(returned.seen, order)
                if not legal.any():
                    continue  # the order was abandoned without leaving the place
                values = self.compute_choice_values(task, view, order)
                target += decision.discount * float(np.where(legal, values, -np.inf).max())
            key = self.make_key(task, decision.view, order)
            error = max(error, abs(self.tables[task.name].update(key, decision.choice, target)))
        return self.finish_step(step, error)


def _get_task(stack: Stack) -> FeudalTask:
    task = stack[-1].task
    assert isinstance(task, FeudalTask)
    return task
