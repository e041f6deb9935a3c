"""The price of a hierarchy: what the best policy that it allows falls short of the best policy, computed exactly.

Three optima of one environment (Dietterich 2000, section 3; Parr and Russell 1998): flat, over primitives;
hierarchical, over all policies that the hierarchy can express; recursive, where each task is optimal for itself and
none for its caller. Flat >= hierarchical >= recursive.

The hierarchical optimum is value iteration over the SMDP of reachable (state, stack of running calls) pairs. The
recursive one is the same task by task, with the choices of the tasks below held fixed.

The environment is given as data: Gymnasium's toy-text environments carry such a model; of a deterministic environment
whose state can be read and set, one is enumerated.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import gymnasium
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from hrl_escape.agents.agent import count_actions, read_action_mask
from hrl_escape.agents.hierarchy.machine import Choose, Do, Input, Machine, MachineRun
from hrl_escape.agents.hierarchy.task import BaseTask, Frame, Hierarchy, Seen, Step
from hrl_escape.agents.hierarchy.task_graph import flat, freeze
from hrl_escape.errors import StepContractError, UnsupportedError

Outcomes: TypeAlias = Sequence[tuple[float, int, float, bool]]
"""Ways an action can go: (probability, next state, reward, terminated), as in Gymnasium's `P[state][action]`."""


@dataclass(frozen=True, eq=False)
class TabularModel:
    """A finite environment whose rules are known.

    Attributes:
        outcomes: by state and action.
        starts: (states,), probability of each first state.
        observations: what an agent sees in each state.
        masks: bool (states, actions), the legal actions, or None if all are legal everywhere.
    """

    outcomes: Sequence[Sequence[Outcomes]]
    starts: NDArray[np.float64]
    observations: Sequence[Any]
    masks: NDArray[np.bool_] | None = None

    @cached_property
    def legal(self) -> NDArray[np.bool_]:
        """Legal actions, bool (states, actions)."""
        return np.ones((len(self.outcomes), len(self.outcomes[0])), np.bool_) if self.masks is None else self.masks

    def see(self, hierarchy: Hierarchy) -> list[Seen]:
        """The moment of each state."""
        return [hierarchy.see(seen, mask) for seen, mask in zip(self.observations, self.legal, strict=True)]


def read_model(env: gymnasium.Env) -> TabularModel:
    """Read the model that a toy-text environment carries (FrozenLake, Taxi, CliffWalking).

    Raises:
        UnsupportedError: it carries none.
    """
    inner: Any = env.unwrapped
    rules, starts = getattr(inner, "P", None), getattr(inner, "initial_state_distrib", None)
    if rules is None or starts is None:
        raise UnsupportedError(f"{type(inner).__name__} has no attributes P and initial_state_distrib; a deterministic "
                               "environment with get_state and set_state can be enumerated by enumerate_model")
    outcomes = [[rules[state][action] for action in range(len(rules[state]))] for state in range(len(rules))]
    return TabularModel(outcomes, np.asarray(starts, np.float64), range(len(rules)))


def enumerate_model(
    env: gymnasium.Env,
    key: Callable[[Any], Hashable] = lambda state: state,
    seeds: Sequence[int] = (0,),
    most_states: int = 200_000,
) -> TabularModel:
    """Enumerate a deterministic environment by trying every action in every state that can be reached.

    Args:
        env: with Discrete actions, `get_state()` (everything that decides what follows) and `set_state(state)`, which
            continues from it. Truncations are left out.
        key: state -> a unique key, without clocks, which would make every state new.
        seeds: of the first states, which are equally likely.
        most_states: bound on states.

    Raises:
        UnsupportedError: more states than `most_states`, or no `get_state`.
    """
    inner: Any = env.unwrapped
    if not (hasattr(inner, "get_state") and hasattr(inner, "set_state")):
        raise UnsupportedError(f"{type(inner).__name__} has no get_state and set_state, so it cannot be enumerated")
    actions = count_actions(env.action_space, "enumerate_model")
    numbers: dict[Hashable, int] = {}
    states: list[Any] = []
    observations: list[Any] = []
    masks: list[NDArray[np.bool_]] = []

    def number(observation: Any, info: Any) -> int:
        state = inner.get_state()
        name = key(state)
        if name not in numbers:
            if len(states) == most_states:
                raise UnsupportedError(f"more than {most_states:,} states; raise most_states, or give a key that "
                                       "leaves out what changes nothing")
            numbers[name] = len(states)
            states.append(state)
            observations.append(observation)
            masks.append(read_action_mask(info, actions))
            waiting.append(numbers[name])
        return numbers[name]

    waiting: deque[int] = deque()
    first = [number(*env.reset(seed=seed)) for seed in seeds]
    outcomes: list[list[Outcomes]] = []
    while waiting:
        state = waiting.popleft()
        row: list[Outcomes] = []
        for action in range(actions):
            inner.set_state(states[state])
            observation, reward, terminated, _, info = env.step(action)
            row.append([(1.0, number(observation, info), float(reward), bool(terminated))])
        outcomes.append(row)
    starts = np.bincount(first, minlength=len(states)) / len(first)
    return TabularModel(outcomes, starts, observations, np.array(masks))


TIE = 1e-9
"""Choices whose values differ by less are equally good; a task then takes the first."""

MOST_SWEEPS = 200_000


class HierarchyPrice(NamedTuple):
    """Expected discounted returns from the first state.

    Attributes:
        flat: of the best policy.
        hierarchical: of the best policy that the hierarchy allows.
        recursive: of the policy whose tasks are each optimal for themselves, or None for programs, which have no tasks.
        pairs: (state, stack) pairs, or (state, machine state) pairs, that were solved for the hierarchical optimum.
    """

    flat: float
    hierarchical: float
    recursive: float | None
    pairs: int


def compute_price(model: TabularModel, hierarchy: Hierarchy | Machine, gamma: float = 1.0,
                  read: Callable[[Any], Any] | None = None) -> HierarchyPrice:
    """Compute the flat, the hierarchical and the recursive optimum of a finite environment.

    Args:
        model: the environment; its time limit is left out.
        hierarchy: a `Hierarchy`, or a program made with `machine`. Whether a call is over may depend on the moment and
            on its context, not on how long it has run; a program may keep in mind nothing but its arguments.
        gamma: discount per primitive. With 1, an episode must end for certain under every optimal policy.
        read: makes `Seen.state` of an observation for a program; a `Hierarchy` has its own.

    Raises:
        UnsupportedError: an end depends on a call's duration, or values do not converge.
        StepContractError: the root has nothing to choose somewhere.
    """
    primitives = flat(len(model.outcomes[0]))
    best = _Calls(model, primitives, gamma)
    best.solve_root()
    if not isinstance(hierarchy, Hierarchy):
        seen = model.see(Hierarchy(primitives.root, read=read))
        machine = _solve_machine(model, hierarchy, seen, gamma)
        return HierarchyPrice(best.start_value, float(machine[0]), None, machine[1])
    calls = _Calls(model, hierarchy, gamma)
    pairs = calls.solve_root()
    hierarchical = calls.start_value
    calls.solve_tasks()
    return HierarchyPrice(best.start_value, hierarchical, calls.start_value, pairs)


# --- value iteration over any decision points ----------------------------------------------

Follow: TypeAlias = "list[tuple[float, int]]"
"""(discounted probability, decision point that comes next)."""


@dataclass
class _Points:
    """Decision points, numbered by first visit, and all their choices in one list."""

    numbers: dict[Hashable, int] = field(default_factory=dict)
    first: list[int] = field(default_factory=lambda: [0])
    """Start of each point's choices in the list, and the end of the last one's."""
    choices: list[int] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    follow: list[Follow] = field(default_factory=list)

    def number(self, key: Hashable) -> int:
        """Number of a point, a new one at the first meeting."""
        return self.numbers.setdefault(key, len(self.numbers))

    def explore(self, starts: Iterable[Hashable], expand: Callable[[Any], Iterable[tuple[int, float, Any]]]) -> None:
        """Meet all points that can be reached; `expand` gives (choice, reward, [(discounted probability, point)])."""
        waiting = []
        for key in starts:
            if key not in self.numbers:
                self.number(key)
                waiting.append(key)
        for key in waiting:
            for choice, reward, reached in expand(key):
                self.choices.append(choice)
                self.rewards.append(reward)
                for _, after in reached:
                    if after not in self.numbers:
                        waiting.append(after)
                        self.number(after)
                self.follow.append([(weight, self.numbers[after]) for weight, after in reached])
            self.first.append(len(self.choices))

    def solve(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Optimal value of each point, and the first of its best choices."""
        count, rows = len(self.numbers), len(self.rewards)
        entries = [(row, point, weight) for row, each in enumerate(self.follow) for weight, point in each]
        row, point, weight = zip(*entries, strict=True) if entries else ((), (), ())
        matrix = csr_array((np.array(weight, np.float64), (np.array(row, np.int64), np.array(point, np.int64))),
                           shape=(rows, count))
        rewards, first = np.array(self.rewards), np.array(self.first[:-1])
        values = np.zeros(count)
        for _ in range(MOST_SWEEPS):
            of_choices = rewards + matrix @ values
            swept = np.maximum.reduceat(of_choices, first)
            change, values = np.abs(swept - values).max(), swept
            if change < 1e-12 * max(1.0, float(np.abs(values).max())):
                break
        else:
            raise UnsupportedError("values do not converge: episodes can last for ever; set gamma below 1")
        is_best = of_choices >= np.repeat(values, np.diff(self.first)) - TIE
        best = [self.choices[begin + int(is_best[begin:end].argmax())]
                for begin, end in zip(self.first, self.first[1:], strict=False)]
        return values, np.array(best)


# --- tasks ---------------------------------------------------------------------------------

Running: TypeAlias = "tuple[Hashable, ...]"
"""Running calls from the outermost: (task, frozen context) each."""


class _Calls:
    """Optimal choices of a hierarchy's calls.

    Attributes:
        start_value: expected return from the first state, of the policy solved last.
    """

    def __init__(self, model: TabularModel, hierarchy: Hierarchy, gamma: float) -> None:
        self._model, self._hierarchy, self._gamma = model, hierarchy, gamma
        self._seen = model.see(hierarchy)
        self._frames: dict[Hashable, tuple[BaseTask, Frame, Frame]] = {}
        """Call -> its task, and two frames of it that differ in their duration alone."""
        self._is_over: dict[tuple[Hashable, int], float] = {}
        self._legal: dict[tuple[Hashable, int], list[int]] = {}
        self._arrived: dict[tuple[int, Running, bool], list[tuple[float, Running]]] = {}
        self._chosen: dict[tuple[Hashable, int], int] = {}
        """(call, state) -> choice of calls that are solved already."""
        self._solved: set[Hashable] = set()
        self.start_value = 0.0

    # --- what tasks answer, asked once ---

    def _enter(self, task: BaseTask, context: Any) -> Hashable:
        call = task.name, freeze(context)
        if call not in self._frames:
            some = self._seen[0]
            self._frames[call] = task, Frame(task, context, some, 1), Frame(task, context, some, 10**9)
        return call

    def _ends(self, call: Hashable, state: int) -> float:
        key = call, state
        if key not in self._is_over:
            task, young, old = self._frames[call]
            ends = task.ends(young, self._seen[state])
            if ends != task.ends(old, self._seen[state]):
                raise UnsupportedError(f"task {task.name!r} ends after a time, which is not part of a (state, "
                                       "stack) pair; give it no time limit")
            self._is_over[key] = ends
        return self._is_over[key]

    def _list_legal(self, call: Hashable, state: int) -> list[int]:
        key = call, state
        if key not in self._legal:
            task, frame, _ = self._frames[call]
            self._legal[key] = task.legal(self._seen[state], frame.context).nonzero()[0].tolist()
        return self._legal[key]

    # --- decision points: (state, running calls) ---

    def solve_root(self, fixed: bool = False) -> int:
        """Solve the whole hierarchy for the environment's reward; returns the number of (state, stack) pairs."""
        root = self._enter(self._hierarchy.root, None)
        starts = np.flatnonzero(self._model.starts).tolist()
        points = _Points()
        points.explore(((state, (root,)) for state in starts), lambda key: self._expand(key, root, None, fixed))
        values, _ = points.solve()
        self.start_value = float(sum(self._model.starts[state] * values[points.number((state, (root,)))]
                                     for state in starts))
        return len(points.numbers)

    def solve_tasks(self) -> None:
        """Solve every call for itself, the innermost first, then evaluate all of them together."""
        root = self._enter(self._hierarchy.root, None)
        self._solve_call(root, ())
        self.solve_root(fixed=True)

    def _solve_call(self, call: Hashable, callers: Running) -> None:
        """Fix the choices of a call in every state where it is not over, after the choices of its children."""
        if call in self._solved:
            return
        task, frame, _ = self._frames[call]
        if call in callers:
            raise UnsupportedError(f"task {task.name!r} calls itself, so tasks cannot be solved one by one")
        active = [state for state in range(len(self._seen))
                  if self._ends(call, state) < 1.0 and self._list_legal(call, state)]
        for state in active:
            for choice in self._list_legal(call, state):
                called = task.decode(choice, self._seen[state], frame.context)
                if not isinstance(called.child, (int, np.integer)):
                    self._solve_call(self._enter(called.child, called.context), (*callers, call))
        points = _Points()
        points.explore(((state, (call,)) for state in active), lambda key: self._expand(key, call, frame, False))
        _, best = points.solve()
        for (state, running), number in points.numbers.items():  # type: ignore[misc]  # keys are such pairs
            if len(running) == 1:
                self._chosen[call, state] = int(best[number])
        self._solved.add(call)

    def _expand(self, key: tuple[int, Running], bottom: Hashable, own: Frame | None, fixed: bool
                ) -> Iterable[tuple[int, float, Any]]:
        """Choices of the last running call; `own` pays by its own task, and makes its end the end of all."""
        state, running = key
        call = running[-1]
        task, frame, _ = self._frames[call]
        is_fixed = fixed or (own is not None and len(running) > 1)
        choices = [self._chosen[call, state]] if is_fixed else self._list_legal(call, state)
        if not choices:
            raise StepContractError(f"task {task.name!r} runs where it has nothing to choose")
        for choice in choices:
            called = task.decode(choice, self._seen[state], frame.context)
            if isinstance(called.child, (int, np.integer)):
                yield choice, *self._act(state, running, int(called.child), bottom, own)
            else:
                yield choice, 0.0, [(1.0, (state, (*running, self._enter(called.child, called.context))))]

    def _act(self, state: int, running: Running, primitive: int, bottom: Hashable, own: Frame | None
             ) -> tuple[float, list[tuple[float, Hashable]]]:
        """Expected pay of a primitive, and what comes after it with its discounted probability."""
        paid, reached = 0.0, []
        for probability, after, reward, terminated in self._model.outcomes[state][primitive]:
            if own is None:
                paid += probability * reward
            else:
                step = Step(self._seen[state], primitive, reward, reward, 1, self._seen[after], terminated, False)
                paid += probability * own.task.pay(step, own)
                final = own.task.final(own, self._seen[after]) * self._ends(bottom, after)
                paid += probability * self._gamma * final
            if not terminated:
                reached += [(probability * self._gamma * weight, (after, left))
                            for weight, left in self._arrive(after, running, own is None) if left]
        return paid, reached

    def _arrive(self, state: int, running: Running, restarts: bool) -> list[tuple[float, Running]]:
        """Calls that continue at the state reached, with their probability; none where the outermost is over."""
        key = state, running, restarts
        if key not in self._arrived:
            self._arrived[key] = list(self._end_calls(state, running, restarts))
        return self._arrived[key]

    def _end_calls(self, state: int, running: Running, restarts: bool) -> Iterable[tuple[float, Running]]:
        remaining = 1.0
        for keep, call in enumerate(running):
            ends = self._ends(call, state)
            if ends > 0.0:
                yield remaining * ends, self._drop_stuck(state, running[:keep], running, restarts)
            remaining *= 1.0 - ends
            if remaining <= 0.0:
                return
        yield remaining, self._drop_stuck(state, running, running, restarts)

    def _drop_stuck(self, state: int, left: Running, running: Running, restarts: bool) -> Running:
        while left and not self._list_legal(left[-1], state):
            left = left[:-1]
        return left or (running[:1] if restarts else ())


# --- programs ------------------------------------------------------------------------------


def _solve_machine(model: TabularModel, program: Machine, seen: Sequence[Seen], gamma: float) -> tuple[float, int]:
    """Hierarchical optimum of a program, and the number of (state, machine state) pairs."""
    inputs: dict[Hashable, list[Input]] = {}
    """A way to each pair: a generator cannot be copied, so it is run again."""

    def note(state: int, run: MachineRun) -> Hashable:
        # One line may choose and do what was chosen.
        key = state, run.read_state(), run.request.primitive if isinstance(run.request, Do) else None
        inputs.setdefault(key, list(run.inputs))
        return key

    def expand(key: tuple[int, Hashable, int | None]) -> Iterable[tuple[int, float, Any]]:
        state, told = key[0], inputs[key]
        run = MachineRun(program, told)
        if isinstance(run.request, Choose):
            for index in range(len(run.request.things)):
                after = MachineRun(program, told)
                after.tell(index)
                yield index, 0.0, [(1.0, note(state, after))]
            return
        assert isinstance(run.request, Do)
        paid, reached = 0.0, []
        for probability, following, reward, terminated in model.outcomes[state][run.request.primitive]:
            paid += probability * reward
            if not terminated:
                after = MachineRun(program, told)
                after.tell(seen[following])
                reached.append((probability * gamma, note(following, after)))
        yield 0, paid, reached

    points = _Points()
    starts: Mapping[int, Hashable] = {
        state: note(state, MachineRun(program, [seen[state]])) for state in np.flatnonzero(model.starts).tolist()
    }
    points.explore(starts.values(), expand)
    values, _ = points.solve()
    value = sum(model.starts[state] * values[points.number(key)] for state, key in starts.items())
    return float(value), len(points.numbers)
