"""References by rule: sweeps over all buttons, search baselines, and the oracle.

A sweep presses buttons in the order of their numbers, or in a random order for each episode; the two are equal in
expectation if numbers are independent of the graph. Search baselines read the same information as agents over options:
which targets are on, whether the exit is open, and positions. They forget everything at the end of an episode. The
oracle follows the best known plan, which has an efficiency of 1.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import FixedPolicy
from hrl_escape.benchmark.episodes import StateRecorder
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.poses import list_touched
from hrl_escape.planning.goals import PressGoal


class Reference(FixedPolicy):
    """Base of references, which read the room directly; `RULE` describes one after its name and "which"."""

    RULE: ClassVar[str]

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        self._env: Any = env
        self._recorder = recorder


class Sweep(Reference):
    """Sweep over options in the order of their numbers, the exit last, in a loop."""

    RULE = "presses all buttons in the order of their numbers"

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        names, options = (self._env.get_wrapper_attr(name) for name in ("action_names", "options"))
        self._order: Sequence[int] = range(len(names) - len(options), len(names))
        self._next = 0

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Return the next legal option in order; the first one at the start of an episode."""
        del observation
        if len(self._recorder.states) == 1:
            self._next = 0
        for _ in self._order:
            action = self._order[self._next % len(self._order)]
            self._next += 1
            if action_mask[action]:
                return action
        return int(np.flatnonzero(action_mask)[0])


class SweepRandom(Sweep):
    """Sweep over options in a random order for each episode, the exit last, in a loop."""

    RULE = "presses all buttons in an order drawn for the episode"

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the next legal option in order; an episode begins with a new order."""
        if len(self._recorder.states) == 1:
            *buttons, leave = sorted(self._order)  # the exit has the last number
            self._order = [*rng.permutation(buttons).tolist(), leave]
        return self.act(observation, action_mask)


class PlanFollower(Reference):
    """Oracle: follows the best known plan and replans after noise; stays where it is without a plan."""

    RULE = "follows the best known plan"

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        self._policy: Any = None

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Return the next primitive of the plan."""
        del observation
        from hrl_escape.planning.best_known import Replanner  # loads the planners

        begins = len(self._recorder.states) == 1
        if begins:
            self._policy = Replanner(self._env.unwrapped.instance)
        primitive = self._policy.choose(self._recorder.states[-1], begins)
        return int(np.flatnonzero(action_mask)[-1]) if primitive is None else primitive


class SearchBaseline(Reference):
    """Base of search baselines: takes the exit when it is open, and otherwise an option that the subclass chooses.

    Subclasses receive every press, including unintended ones, and every option without effect.
    """

    def __init__(self, env: gymnasium.Env, recorder: StateRecorder) -> None:
        super().__init__(env, recorder)
        self._leave = len(self._env.get_wrapper_attr("action_names")) - 1  # the exit has the last number
        self._options: dict[int, Any] = {}  # options of the current room
        self._rng = np.random.default_rng(0)
        self._read = 0  # number of states of the episode that were read
        self._chosen: int | None = None

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Act as in an evaluation, with the generator of this reference."""
        return self.act_greedy(observation, action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the exit if it is open, otherwise the choice of the rule."""
        del observation
        states = self._recorder.states
        if len(states) == 1:
            options = self._env.get_wrapper_attr("options")
            self._options = dict(enumerate(options, self._leave + 1 - len(options)))
            self._begin(is_new=len(self._recorder.starts) == 1)
            self._read, self._chosen = 1, None
        self._read_on(states)
        if self._puzzle.is_solved(states[-1].puzzle) and action_mask[self._leave]:
            self._chosen = None
            return self._leave
        legal = [action for action in self._options if action_mask[action] and action != self._leave]
        if not legal:
            self._chosen = None
            return int(np.flatnonzero(action_mask)[0])
        self._chosen = self._choose(legal, states[-1], rng)
        return self._chosen

    def _read_on(self, states: Sequence[RoomState]) -> None:
        """Process the presses since the last decision, and its option if it pressed nothing."""
        noted = set()
        begin, events = self._read - 1, self._recorder.events
        for before, after, happened in zip(states[begin:], states[begin + 1:], events[begin:], strict=False):
            for target in list_touched(happened.pressed):
                press = self._get_press(target)
                if press is not None:
                    self._note(press, before, after)
                    noted.add(press)
        if self._chosen is not None and self._chosen not in noted:
            self._note(self._chosen, states[self._read - 1], states[-1])
        self._read = len(states)

    @property
    def _room(self) -> Any:
        return self._env.unwrapped

    @property
    def _puzzle(self) -> Any:
        return self._room.instance.puzzle

    def _get_press(self, target: int) -> int | None:
        """Return the action that presses only a target, or None."""
        return next((action for action, option in self._options.items()
                     if getattr(option, "goal", None) == PressGoal(target)), None)

    def _is_dark(self, action: int, puzzle_state: Any) -> bool:
        lit = self._puzzle.get_lit(puzzle_state)
        return not any(lit[target] for target in self._options[action].targets)

    def _prefer_dark(self, actions: Sequence[int], state: RoomState) -> list[int]:
        return [action for action in actions if self._is_dark(action, state.puzzle)] or list(actions)

    def _measure(self, action: int, state: RoomState) -> float:
        """Return the straight-line distance from the robot to the target of an action, m."""
        targets = self._room.instance.targets
        return min((math.dist((state.x, state.y), (targets[i].x, targets[i].y))
                    for i in self._options[action].targets), default=math.inf)

    def describe_presses(self) -> dict[int, str]:
        """Describe the knowledge of each press at the latest decision, by the number of its option."""
        state = self._recorder.states[-1]
        known = {action: self._describe(action, state) for action in self._options if action != self._leave}
        return {action: words if self._is_dark(action, state.puzzle) else "lit" for action, words in known.items()}

    @abstractmethod
    def _describe(self, action: int, state: RoomState) -> str:
        """Describe the knowledge of pressing a target that is off."""

    def _tell(self, is_tried: bool, action: int, state: RoomState) -> str:
        return "tried in vain" if is_tried else f"untried, {self._measure(action, state):.1f} m"

    @abstractmethod
    def _begin(self, is_new: bool) -> None:
        """Begin an episode; `is_new` is false for a later trial in the same room."""

    @abstractmethod
    def _note(self, action: int, before: RoomState, after: RoomState) -> None:
        """Process an action and the states before and after it."""

    @abstractmethod
    def _choose(self, legal: Sequence[int], state: RoomState, rng: np.random.Generator) -> int:
        """Choose a legal option other than the exit."""


class SearchRandom(SearchBaseline):
    """Search baseline: presses buttons that are off and untried since a light last changed, in random order.

    If all of these were tried it presses buttons that are on, and after all buttons it starts again.
    """

    RULE = "presses buttons that are off and untried since a light last changed, in random order"

    def _begin(self, is_new: bool) -> None:
        self._tried: set[int] = set()

    def _note(self, action: int, before: RoomState, after: RoomState) -> None:
        if self._puzzle.observe(before.puzzle) != self._puzzle.observe(after.puzzle):
            self._tried.clear()
        else:
            self._tried.add(action)

    def _describe(self, action: int, state: RoomState) -> str:
        return self._tell(action in self._tried, action, state)

    def _choose(self, legal: Sequence[int], state: RoomState, rng: np.random.Generator) -> int:
        fresh = [action for action in legal if action not in self._tried]
        if not fresh:
            self._tried.clear()
        return self._pick(self._prefer_dark(fresh or legal, state), state, rng)

    def _pick(self, actions: Sequence[int], state: RoomState, rng: np.random.Generator) -> int:
        return actions[int(rng.integers(len(actions)))]


class SearchNearest(SearchRandom):
    """Search baseline: as `SearchRandom`, the nearest button first by straight-line distance."""

    RULE = "presses buttons that are off and untried since a light last changed, the nearest first"

    def _pick(self, actions: Sequence[int], state: RoomState, rng: np.random.Generator) -> int:
        return min(actions, key=lambda action: self._measure(action, state))


class SearchBacktrack(SearchBaseline):
    """Search baseline: returns by known presses to the pattern with most lights on that has untried buttons.

    It remembers the result of every action for each pattern of lights, so after a reset it repeats successful presses.
    It presses the nearest untried button. Trials in the same room share its memory.
    """

    RULE = "returns by known presses to a state with untried buttons"

    def _begin(self, is_new: bool) -> None:
        if is_new:
            self._known: dict[tuple[float, ...], dict[int, tuple[float, ...]]] = {}
            self._states: dict[tuple[float, ...], Any] = {}  # a puzzle state that showed each pattern

    def _note(self, action: int, before: RoomState, after: RoomState) -> None:
        was, now = self._puzzle.observe(before.puzzle), self._puzzle.observe(after.puzzle)
        if was != now or action not in self._known.get(was, ()):
            self._known.setdefault(was, {})[action] = now

    def _describe(self, action: int, state: RoomState) -> str:
        return self._tell(action in self._known.get(self._puzzle.observe(state.puzzle), {}), action, state)

    def _choose(self, legal: Sequence[int], state: RoomState, rng: np.random.Generator) -> int:
        here = self._puzzle.observe(state.puzzle)
        self._states[here] = state.puzzle
        ways = self._find_ways(here)
        for only_dark in (True, False):
            open_ = [place for place in ways if self._list_untried(place, legal, only_dark)]
            if open_:
                lit = {place: sum(self._puzzle.get_lit(self._states[place])) for place in open_}
                best = max(open_, key=lambda place: (lit[place], -len(ways[place])))
                if ways[best] and ways[best][0] in legal:
                    return ways[best][0]
                if not ways[best]:
                    return self._pick(self._list_untried(here, legal, only_dark), state)
        return legal[int(rng.integers(len(legal)))]

    def _pick(self, untried: Sequence[int], state: RoomState) -> int:
        """Return the untried action to take: the nearest by straight-line distance."""
        return min(untried, key=lambda action: self._measure(action, state))

    def _find_ways(self, here: tuple[float, ...]) -> dict[tuple[float, ...], tuple[int, ...]]:
        """Return the shortest known action sequences to all reachable patterns."""
        ways: dict[tuple[float, ...], tuple[int, ...]] = {here: ()}
        queue = deque([here])
        while queue:
            place = queue.popleft()
            for action, after in self._known.get(place, {}).items():
                if after not in ways and after in self._states:
                    ways[after] = (*ways[place], action)
                    queue.append(after)
        return ways

    def _list_untried(self, place: tuple[float, ...], legal: Sequence[int], only_dark: bool) -> list[int]:
        known = self._known.get(place, {})
        return [action for action in legal if action not in known
                and (not only_dark or self._is_dark(action, self._states[place]))]
