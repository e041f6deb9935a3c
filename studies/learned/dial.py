"""Learned options compared with planned ones that fail with known probability, in the study of learned hierarchies.

Each option is called at the start of an episode to light the goal's button, with all that it needs. The planned one
knows the graph; the learned ones are the options of agents that learned over planned presses, after several budgets.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.inference import LEVEL
from hrl_escape.benchmark.statistics import LEAST_RUNS
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.observations.base import make_observer
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.errors import ComparisonError
from hrl_escape.options.degraded import OptionDegradation
from hrl_escape.options.learned import make_learned_options
from hrl_escape.options.options_env import OptionsEnv
from studies.learned.option_dial import DialPlace, measure_option, place_on_dial
from studies.store import Store
from studies.tables import make_table

__all__ = ["DialLine", "DialSettings", "PlacedOption", "find_best_option", "measure_dial", "place_lines",
           "tabulate_dial"]

PLANNED = "planned"
OPTION_SET = "press-with-ancestors"


@dataclasses.dataclass(frozen=True)
class DialSettings:
    """The options that are placed, as data.

    Attributes:
        room: name of the room in the grid.
        algorithms: agents whose options are placed; of those that learn none it is their whole policy.
        shares: of the training budget, after which options are placed.
        failures: points of the curve.
        draws: seeds of the planned option's failures.
        calls: of each option and seed. Of the options of an agent the best in as many calls before these counts.
        longest: primitives after which a call is cut.
    """

    room: str
    algorithms: tuple[str, ...]
    shares: tuple[float, ...]
    failures: tuple[float, ...]
    draws: int
    calls: int
    longest: int


@dataclasses.dataclass(frozen=True)
class DialLine:
    """Mean worth of calls of one option.

    Attributes:
        room: name.
        option: `planned`, or the agent's label.
        primitives: that the agent was trained for; 0 of the planned one.
        failure: probability that the planned option fails; None of a learned one.
        seed: of training, or of the planned option's failures.
        worth: mean of gamma^k where the goal holds after the call, else 0.
    """

    room: str
    option: str
    primitives: int
    failure: float | None
    seed: int
    worth: float

    @property
    def place(self) -> tuple[str, str, int, float, int]:
        """Subject of the line."""
        return self.room, self.option, self.primitives, -1.0 if self.failure is None else self.failure, self.seed


# --- runs ----------------------------------------------------------------------------------


def measure_dial(settings: DialSettings, grid: Grid, store: Store, seeds: Sequence[int], budget: int) -> None:
    """Measure what is missing in a store, and keep each line there at once.

    Args:
        settings: the options that are placed.
        grid: comparison that has the room and the agents, with their settings.
        store: where lines are kept.
        seeds: of training.
        budget: primitives, of which `settings.shares` are spent.

    Raises:
        FileReadError: the file is damaged.
        FileWriteError: it cannot be written.
        EscapeError: see `train`.
    """
    agents = _list_agents(settings, grid)
    (room,) = (room for room in grid.rooms if room.label == settings.room)
    there, instance = {line.place for line in store.load()}, room.make_instance()
    for line in _list_wanted(settings, agents, seeds, budget):
        if line.place not in there:
            worth = (_measure_planned(settings, instance, line) if line.failure is not None else
                     _measure_learned(settings, agents[line.option], instance, line))
            store.add([dataclasses.replace(line, worth=round(float(worth.mean()), 4))])


def _list_wanted(settings: DialSettings, agents: Iterable[str], seeds: Sequence[int], budget: int
                 ) -> Iterator[DialLine]:
    """Lines without their numbers, all agents of a seed before the next seed."""
    for failure in settings.failures:
        for draw in range(settings.draws):
            yield DialLine(settings.room, PLANNED, 0, failure, draw, 0.0)
    for seed, share, agent in itertools.product(seeds, settings.shares, agents):
        yield DialLine(settings.room, agent, round(share * budget), None, seed, 0.0)


def _list_agents(settings: DialSettings, grid: Grid) -> dict[str, AgentSpec]:
    """Learners whose options are placed, by label."""
    every = {agent.algorithm: agent for agent in grid.agents if agent.learns}
    return {every[name].label: every[name] for name in settings.algorithms}


def _get_goal(instance: RoomInstance) -> int:
    """Number of the button that opens the exit."""
    assert isinstance(instance.puzzle, ButtonsPuzzle), "rooms of the study have buttons"
    return instance.puzzle.goal


def _is_lit(instance: RoomInstance) -> Callable[[Any, Mapping[str, Any]], bool]:
    """Function of observation and info: the goal's button is on."""
    goal = _get_goal(instance)
    return lambda observation, info: bool(info["buttons_on"][goal])


def _measure_planned(settings: DialSettings, instance: RoomInstance, line: DialLine) -> NDArray[np.float64]:
    assert line.failure is not None
    degradation = OptionDegradation(failure=line.failure, seed=line.seed, option_set=OPTION_SET)
    env = OptionsEnv(EscapeRoomEnv(instance=instance), degradation, include_primitives=False,
                     max_duration=settings.longest)
    return measure_option(env, env.action_names[_get_goal(instance)], _is_lit(instance), settings.calls, line.seed)


def _measure_learned(settings: DialSettings, spec: AgentSpec, instance: RoomInstance, line: DialLine
                     ) -> NDArray[np.float64]:
    """Calls of the agent's best option, chosen by calls of other episodes."""
    room = EscapeRoomEnv(instance=instance, observation="features")
    presses = OptionsEnv(room, include_primitives=False, trace=spec.needs_trace)
    agent = train(spec.name, presses, primitives=line.primitives, seed=line.seed, settings=spec.settings,
                  eval_episodes=0, progress=False).agent
    assert agent is not None, "it was trained here, not read from a file"
    observer, goal = make_observer("features", room.rules), _get_goal(instance)
    learned = make_learned_options(
        agent, lambda state: np.array([option.initiation(state) for option in presses.options]),
        observe=observer.observe, until=lambda state: float(instance.puzzle.get_lit(state.puzzle)[goal]))
    env = OptionsEnv(presses, learned, include_primitives=False, max_duration=settings.longest)
    tried = {name: measure_option(env, name, _is_lit(instance), settings.calls, seed=1).mean()
             for name in env.action_names}
    return measure_option(env, max(tried, key=tried.__getitem__), _is_lit(instance), settings.calls, seed=2)


# --- findings ------------------------------------------------------------------------------


class PlacedOption(NamedTuple):
    """An agent's option after some training.

    Attributes:
        option: label of the agent.
        primitives: of training.
        runs: number of them.
        place: on the dial.
    """

    option: str
    primitives: int
    runs: int
    place: DialPlace


def place_lines(lines: Sequence[DialLine], level: float = LEVEL) -> list[PlacedOption]:
    """Place every learned option of the lines, in their order, with intervals of this confidence.

    Raises:
        ComparisonError: the lines have no curve.
    """
    curve, learned = _group(lines)
    return [PlacedOption(*key, len(worth), place_on_dial(curve, worth, level=level)) for key, worth in learned.items()]


def _group(lines: Sequence[DialLine]) -> tuple[dict[float, list[float]], dict[tuple[str, int], list[float]]]:
    """Worth of planned options by their rate of failure, and of learned ones by name and primitives of training."""
    curve: dict[float, list[float]] = defaultdict(list)
    learned: dict[tuple[str, int], list[float]] = defaultdict(list)
    for line in lines:
        if line.failure is None:
            learned[line.option, line.primitives].append(line.worth)
        else:
            curve[line.failure].append(line.worth)
    return curve, learned


def find_best_option(lines: Sequence[DialLine]) -> tuple[PlacedOption | None, list[str]]:
    """Best option after all training, and the agents whose options are worth less than one that fails every other time.

    Intervals hold together for the options of all agents, so also for the best of them (Bonferroni). None without an
    agent that has `LEAST_RUNS` runs.

    Raises:
        ComparisonError: the lines have no curve, or no learned option.
    """
    _, learned = _group(lines)
    if not learned:
        raise ComparisonError("no learned option was measured")
    last = max(primitives for _, primitives in learned)
    chosen = {key for key, worth in learned.items() if len(worth) >= LEAST_RUNS and key[1] == last}
    if not chosen:
        return None, []
    placed = [option for option in place_lines(lines, 1 - (1 - LEVEL) / len(chosen)) if option[:2] in chosen]
    return (min(placed, key=lambda option: option.place),
            [option.option for option in placed if option.place.low >= 0.5])


def tabulate_dial(lines: Sequence[DialLine]) -> str:
    """Table of all places, by agent and primitives of training."""
    placed = place_lines(sorted(lines, key=lambda line: line.place))
    budgets = sorted({option.primitives for option in placed})
    cells = {option[:2]: f"{place.failure:.0%} ({place.low:.0%} to {place.high:.0%})"
             for option in placed for place in [option.place]}
    return make_table(["option of", *(f"{budget:,} primitives" for budget in budgets)], [
        [AgentSpec.parse(name).title, *(cells.get((name, budget), "-") for budget in budgets)]
        for name in dict.fromkeys(option.option for option in placed)])
