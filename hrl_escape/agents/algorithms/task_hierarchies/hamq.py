"""HAMQ: Q-learning at the choice points of a partial program.

Parr and Russell (1998). The program fixes what its author knows, and learning fills in its choices. In an environment
it is an SMDP whose states are pairs of observation and machine state, including the whole stack of running machines.
`internal` looks up choices that no primitive separates, as in Bai and Russell (2017).
"""

from __future__ import annotations

import ast
import functools
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import (
    AgentSettings,
    OptionPolicy,
    RunningCall,
    SMDPTransition,
    count_actions,
)
from hrl_escape.agents.components.exploration import (
    choose_best,
    compute_epsilon,
    make_rng,
    sample_action,
)
from hrl_escape.agents.components.tables import ValueTable, make_discretiser
from hrl_escape.agents.hierarchy.machine import (
    Choose,
    Do,
    Input,
    Machine,
    MachineRun,
    Program,
    choose,
    do,
    find_machines,
    machine,
)
from hrl_escape.agents.hierarchy.task import Seen
from hrl_escape.agents.hierarchy.task_graph import freeze
from hrl_escape.agents.single_env import SwitchingAgent
from hrl_escape.agents.state import Kept
from hrl_escape.errors import StepContractError
from hrl_escape.settings import Range

MOST_INTERNAL = 10_000
"""Bound on choices without a primitive between them; more means a program that never acts."""


@dataclass(frozen=True, kw_only=True)
class HamqSettings(AgentSettings):
    """Settings of `hamq`: step sizes, exploration, discount, and values of choices without a primitive between them."""

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
    internal: bool = False
    """Store which choice point follows a choice without a primitive in between, and use its value instead of a separate
    one (HAMQ-INT)."""


@machine
def flat_machine(seen: Callable[[], Seen]) -> Any:
    """Program that leaves everything open: any legal primitive, forever."""
    while True:
        yield do((yield choose([int(action) for action in seen().mask.nonzero()[0]])))


class _Point(NamedTuple):
    """A choice point that was passed: its key, its number of choices, and the chosen index."""

    key: Hashable
    choices: int
    chosen: int


class Hamq(SwitchingAgent):
    """Values of the choices that a program leaves open.

    If c was chosen at a choice point (s, m), R was earned in k primitives, and (s', m') is the next choice point:

        Q(s, m, c) <- Q(s, m, c) + alpha [R + gamma^k max over c' of Q(s', m', c') - Q(s, m, c)]

    R and k accumulate across calls and returns. k is 0 only between choice points without a primitive in between.
    Choice points with a single choice are skipped. If the episode terminated, or the program has returned, the next
    value is 0. A choice that was cut inside is not learned.

    Args:
        program: a machine without arguments; by default one that leaves every primitive open, which is Q-learning.
        see: part of a moment that choices depend on; by default the whole observation.
        read: computes `Seen.state` from an observation.
        find_place: (machine, its arguments) -> x and y of its goal on the floor, m, for drawings, or None without one.
    """

    Settings: ClassVar[type] = HamqSettings
    STATE = (
        "table",
        Kept("successors", pack=lambda points: [repr((key, tuple(point))) for key, point in points.items()],
             unpack=lambda saved: {key: _Point(*point) for key, point in map(ast.literal_eval, saved)}),
        "_steps", "_rng", Kept("_told_inputs", "inputs"),
        Kept("_open", pack=lambda point: repr(tuple(point)),
             unpack=lambda saved: None if (point := ast.literal_eval(saved)) is None else _Point(*point)),
        Kept("_since", "since"), Kept("_kept_choice", "choice", is_left_out=True),
    )
    EPISODE = ("_run", "_told", "_passed", "_open", "_reward", "_discount", "_duration")
    EPISODE_STATE = ("inputs", "open", "since", "choice")

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: HamqSettings | None = None,
        program: Machine | None = None,
        see: Callable[[Seen], Any] | None = None,
        read: Callable[[Any], Any] | None = None,
        find_place: Callable[[str, tuple[Any, ...]], tuple[float, float] | None] | None = None,
    ) -> None:
        self._find_place = find_place
        self.settings = settings = settings or HamqSettings()
        count_actions(action_space, "hamq")
        self._program, self._see, self._read = program or flat_machine, see, read
        self.privileges = ("program",) * (self._program is not flat_machine) + ("state",) * (read is not None)
        self._discretise = None if see is not None else make_discretiser(observation_space, settings, "hamq")
        self.table = ValueTable(settings.learning_rate, settings.learning_rate_power, settings.initial_value)
        self.successors: dict[Hashable, _Point] = {}
        """(key, index) -> the choice point that follows without a primitive in between."""
        self._rng = make_rng(seed, "actions")
        self._steps = 0
        self._latest: MachineRun | None = None
        """Run that made the latest choice, in learning or evaluation."""
        self.begin_episode()

    def begin_episode(self) -> None:
        """Clear the running program for a new episode."""
        self._run = MachineRun(self._program)
        self._told = 0
        """Inputs of the program up to the last primitive. `act` continues from there, even if it is called
        repeatedly."""
        self._passed: list[_Point] = []
        """Choice points since then."""
        self._open: _Point | None = None
        self._reward, self._discount, self._duration = 0.0, 1.0, 0

    def compute_choice_values(self, key: Hashable, count: int) -> NDArray[np.float64]:
        """Return Q(s, m, .) at a choice point, (count,)."""
        return np.array([self._compute_value(key, index) for index in range(count)])

    def _compute_value(self, key: Hashable, index: int) -> float:
        following = self.successors.get((key, index))
        if following is None:
            return self.table.get((key, index))
        return max(self._compute_value(following.key, other) for other in range(following.choices))

    def _make_key(self, run: MachineRun) -> Hashable:
        view = self._see(run.seen) if self._see is not None else None
        return freeze(view) if self._discretise is None else self._discretise(run.seen.observation), run.read_state()

    def _advance(self, run: MachineRun, seen: Seen, pick: Callable[[NDArray[np.float64]], int]) -> list[_Point]:
        """Continue a run at the current moment to its next primitive; return the choice points passed."""
        run.tell(seen)
        passed: list[_Point] = []
        while isinstance(run.request, Choose):
            count, index = len(run.request.things), 0
            if count > 1:
                key = self._make_key(run)
                index = pick(self.compute_choice_values(key, count))
                passed.append(_Point(key, count, index))
                if len(passed) > MOST_INTERNAL:
                    raise StepContractError(f"{MOST_INTERNAL} choices without a primitive at {run.read_state()}")
            run.tell(index)
        if run.request is not None and not seen.mask[run.request.primitive]:
            raise StepContractError(f"primitive {run.request.primitive} is illegal here: {run.read_state()}")
        return passed

    def advance_greedily(self, run: MachineRun, observation: Any, mask: NDArray[np.bool_],
                         rng: np.random.Generator | None) -> None:
        """Continue a run at the current moment by greedy choices; ties at random, or the first without `rng`."""
        self._advance(run, self._look(observation, mask),
                      lambda values: choose_best(values, np.ones(len(values), np.bool_), rng))

    def _look(self, observation: Any, mask: NDArray[np.bool_]) -> Seen:
        return Seen(observation, mask, None if self._read is None else self._read(observation))

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Run the program to its next primitive, exploring at choice points."""
        if len(self._run.inputs) > self._told:
            self._run = MachineRun(self._program, self._run.inputs[: self._told])

        def pick(values: NDArray[np.float64]) -> int:
            legal = np.ones(len(values), np.bool_)
            return sample_action(values, legal, self.settings, self._steps, self._rng)

        self._latest = self._run
        self._passed = self._advance(self._run, self._look(observation, action_mask), pick)
        assert isinstance(self._run.request, Do)
        return self._run.request.primitive

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Run the program of this evaluation, which `rng` identifies, to its next primitive."""
        (run,) = self.recall(rng) or (MachineRun(self._program),)
        self._evaluation, self._latest = (rng, run), run
        self.advance_greedily(run, observation, action_mask, rng)
        assert isinstance(run.request, Do)
        return run.request.primitive

    def list_calls(self) -> tuple[RunningCall, ...]:
        """Return the running machines behind the latest choice, the root first; their remaining length is unknown."""
        return tuple(
            RunningCall(call.name, ", ".join(map(str, call.arguments)) or None, call.primitives, 0.0,
                        None if self._find_place is None else self._find_place(call.name, call.arguments))
            for call in (() if self._latest is None else self._latest.list_calls())
        )

    def get_options(self) -> tuple[OptionPolicy, ...]:
        """Return every call of a machine with learned choices, run until it returns; or the whole program.

        The policy of a machine depends on its callers. Calls are therefore named with their callers, as in
        `fetch > navigate(2)`.
        """
        machines = find_machines(self._program)
        calls: dict[str, tuple[Callable[[], Program], tuple[Hashable, ...]]] = {}
        for key in self.table:
            *stack, _ = key[0][1]
            for depth in range(1, len(stack)):
                name, _, arguments = stack[depth]
                if name in machines and not any(isinstance(each, bytes) for each in arguments):
                    title = " > ".join(f"{called}({', '.join(map(str, told))})" if told else called
                                       for called, _, told in stack[1 : depth + 1])
                    calls.setdefault(title, (functools.partial(machines[name], *arguments), tuple(stack[:depth])))
        return tuple(self._export(title, *calls[title]) for title in sorted(calls)) or super().get_options()

    def _export(self, title: str, root: Callable[[], Program], callers: tuple[Hashable, ...]) -> OptionPolicy:
        def begin() -> _CallRun:
            return _CallRun(self, MachineRun(root, callers=callers))

        def can_start(observation: Any, action_mask: NDArray[np.bool_]) -> bool:
            return begin().compute_termination(observation, action_mask) < 1.0

        return OptionPolicy(title, self, begin, can_start)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn at the choice points passed, and add the primitive to the open choice."""
        error = 0.0
        for point in self._passed:
            if self._open is not None:
                error = max(error, self._learn(self._open, point))
            self._open, self._reward, self._discount, self._duration = point, 0.0, 1.0, 0
        self._passed, self._told = [], len(self._run.inputs)
        self._reward += self._discount * transition.reward
        self._discount *= transition.discount
        self._duration += transition.duration
        if transition.terminated or transition.truncated:
            error = max(error, self._finish(transition))
            self.begin_episode()
        self._steps += transition.duration
        return {"td_error": error, "epsilon": compute_epsilon(self.settings, self._steps), "values": len(self.table)}

    def _learn(self, point: _Point, following: _Point) -> float:
        if self.settings.internal and self._duration == 0:
            self.successors[point.key, point.chosen] = following
            return 0.0
        after = float(self.compute_choice_values(following.key, following.choices).max())
        return abs(self.table.update((point.key, point.chosen), self._reward + self._discount * after))

    def _finish(self, transition: SMDPTransition) -> float:
        """The backup of the open choice at the end of the episode."""
        if self._open is None:
            return 0.0
        if transition.terminated:
            return abs(self.table.update((self._open.key, self._open.chosen), self._reward))
        self._run.tell(self._look(transition.next_observation, transition.next_action_mask))
        while isinstance(self._run.request, Choose):
            count = len(self._run.request.things)
            if count > 1:
                return self._learn(self._open, _Point(self._make_key(self._run), count, 0))
            self._run.tell(0)
        return 0.0  # cut inside the choice: the continuation is unknown

    @property
    def _told_inputs(self) -> list[Any]:
        """All inputs of the running program up to the last primitive."""
        return self._list_inputs(self._run.inputs[: self._told])

    @_told_inputs.setter
    def _told_inputs(self, saved: list[Any]) -> None:
        self.begin_episode()
        inputs = self._read_inputs(saved)
        self._run, self._told = MachineRun(self._program, inputs), len(inputs)

    @property
    def _kept_choice(self) -> list[Any] | None:
        """With several environments, inputs and choice points of a primitive that has not ended yet."""
        if self._env is None or len(self._run.inputs) == self._told:
            return None
        return [self._list_inputs(self._run.inputs[self._told :]), repr([tuple(point) for point in self._passed])]

    @_kept_choice.setter
    def _kept_choice(self, saved: list[Any]) -> None:
        self._run = MachineRun(self._program, [*self._run.inputs, *self._read_inputs(saved[0])])
        self._passed = [_Point(*point) for point in ast.literal_eval(saved[1])]

    def _list_inputs(self, inputs: Sequence[Input]) -> list[Any]:
        return [each if isinstance(each, int) else [each.observation, each.mask] for each in inputs]

    def _read_inputs(self, saved: list[Any]) -> list[Input]:
        return [each if isinstance(each, int) else self._look(each[0], np.asarray(each[1], np.bool_)) for each in saved]

    @property
    def _since(self) -> list[Any]:
        """R, gamma^k and k since the open choice."""
        return [self._reward, self._discount, self._duration]

    @_since.setter
    def _since(self, saved: list[Any]) -> None:
        self._reward, self._discount, self._duration = saved


class _CallRun:
    """One call of a machine, run greedily until it returns."""

    def __init__(self, agent: Hamq, run: MachineRun) -> None:
        self._agent, self._run = agent, run
        self._is_told = False
        """The run has received the current moment and waits for its primitive."""

    def act(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        self.compute_termination(observation, action_mask)
        self._is_told = False
        request = self._run.request
        assert isinstance(request, Do)
        return request.primitive

    def compute_termination(self, observation: Any, action_mask: NDArray[np.bool_]) -> float:
        if not self._is_told:
            self._agent.advance_greedily(self._run, observation, action_mask, None)
            self._is_told = True
        return float(self._run.request is None)
