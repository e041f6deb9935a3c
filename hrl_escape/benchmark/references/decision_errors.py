"""Exploration and exploitation errors of decisions, from the belief of the Bayes planner.

b is the belief over graphs and rules after the presses so far, and Q(b, a) the least expected number of primitives to
the exit after decision a. The error of a decision is Q(b, a) - min Q(b, .). It is an exploitation error if b fixes an
order: every press of it is certain to turn its button on, and together they open the exit. Otherwise it is an
exploration error.

The realised regret of an episode, its primitives minus the expected ones at the start, is a sum of three parts:

    regret = errors + luck + path

*Luck* is the outcome of each press minus its expectation. It averages to zero over graphs drawn from the configuration,
for every player that has only seen this episode. A player that knows the room from before has less luck than zero.
*Path* is what is left: plans are not always the shortest. With up to three buttons every leg is planned from the exact
pose, and *path* is zero unless a player ends where a shorter way is found. With more buttons this holds for the next
leg; later legs have the lengths of a table (`path_lengths.py`), and *path* has the difference too. An episode
that is cut off counts the primitives that are still expected; a failed puzzle counts as much as the exit is worth.

Park et al. (arXiv 2604.13151) estimate both errors from actions alone: see `action_errors.py`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.benchmark.references.bayes import Posterior, get_bits
from hrl_escape.benchmark.references.belief_graph import BeliefGraph, split_mistakes
from hrl_escape.benchmark.references.graph_family import GraphFamily, can_light
from hrl_escape.benchmark.references.path_lengths import PathLengths, walk_path
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.poses import list_touched
from hrl_escape.errors import UnsupportedError
from hrl_escape.options.domain import DomainStep
from hrl_escape.planning.goals import ExitGoal, PressGoal
from hrl_escape.planning.planner import get_planner
from hrl_escape.sets.own_config import find_own_config

MOST_PLANNED = 3
"""Largest number of buttons with every leg planned from the exact pose."""


class DecisionError(NamedTuple):
    """Error of one decision, in primitives.

    Attributes:
        exploration: Q(b, a) - min Q(b, .), at least 0, where the belief fixed no order.
        exploitation: the same where the belief fixed an order that opens the exit. A decision with a press on the way
            can have both.
        luck: outcome of the decision's presses minus its expectation.
        path: part of the regret that is due to the approximation of path lengths.
    """

    exploration: float
    exploitation: float
    luck: float
    path: float


@dataclasses.dataclass(frozen=True)
class EpisodeErrors:
    """Errors of an episode, in primitives.

    Attributes:
        decisions: errors of the decisions, in order.
        regret: primitives of the episode, with those that are still expected at its end, minus the expected ones at
            its start. The sum of `exploration`, `exploitation`, `luck` and `path`.
    """

    decisions: tuple[DecisionError, ...]
    regret: float

    @property
    def exploration(self) -> float:
        """Sum of the exploration errors."""
        return sum(each.exploration for each in self.decisions)

    @property
    def exploitation(self) -> float:
        """Sum of the exploitation errors."""
        return sum(each.exploitation for each in self.decisions)

    @property
    def luck(self) -> float:
        """Sum of the differences between the outcomes of presses and their expectations."""
        return sum(each.luck for each in self.decisions)

    @property
    def path(self) -> float:
        """Part of the regret that is due to the approximation of path lengths."""
        return sum(each.path for each in self.decisions)


class ErrorMeter:
    """Measures the errors of episodes in one room.

        meter = ErrorMeter(make_room("ladder-1/chain-3/test#0"))
        errors = meter.measure(env.state, env.decisions)

    Args:
        room: the room; its graph is not read.
        config: configuration that it was sampled from; by default the preset or rung of its name.

    Raises:
        UnsupportedError: the Bayes planner does not list the room's graphs exactly, the dynamics are random, or there
            are doors within the room.
    """

    def __init__(self, room: RoomInstance, config: RoomConfig | None = None) -> None:
        if room.dynamics.is_random or room.inner_doors:
            raise UnsupportedError("errors of decisions need dynamics without noise, and no doors within the room; "
                                   f"{room.name} has {'noise' if room.dynamics.is_random else 'doors'}")
        posterior = Posterior(room, config or find_own_config(room), None)
        if posterior.graph is None:
            raise UnsupportedError(f"errors of decisions need rooms whose graphs can be listed, with up to five or six "
                                   f"buttons; {room.name} has {len(room.targets)}")
        legs = _Legs(room)
        self._room = room
        self._prior = _Belief(posterior.family, posterior.graph, posterior.ways, posterior.costs, legs)

    def measure(self, start: RoomState, decisions: Sequence[Sequence[DomainStep]]) -> EpisodeErrors:
        """Measure the errors of an episode.

        Args:
            start: first state of the episode.
            decisions: primitives of each decision, in order: `OptionsEnv.last_steps` or `TextEnv.decisions`.
        """
        belief: _Belief | _Over = self._prior
        begun = value = belief.compute_value(start)
        errors, primitives, state = list[DecisionError](), 0, start
        for steps in decisions:
            parts = list[tuple[float, float, float, float]]()
            for k, after, press in _split(steps, self._room.puzzle):
                outcomes = belief.list_outcomes(press)
                here = k + sum(odds * each.compute_value(after) for _, odds, each in outcomes)
                best = min(here, belief.compute_value(state, press and press.target))
                following = next((each for name, _, each in outcomes if press is None or name == press.outcome),
                                 None)
                if following is None:
                    raise UnsupportedError(f"the configuration of {self._room.name} draws no graph that agrees with "
                                           "these presses: pass the configuration that the room is from")
                follows = following.compute_value(after)
                error, exploits = here - best, belief.fixes_order
                parts.append((0.0 if exploits else error, error if exploits else 0.0, k + follows - here,
                              best - value))
                belief, state, value, primitives = following, after, follows, primitives + k
            errors.append(DecisionError(*map(sum, zip(*parts, strict=True))))
        return EpisodeErrors(tuple(errors), primitives + value - begun)


class _Legs:
    """Planned legs from a pose to the press of each button and to the open exit.

    The doors within the room are open and the buttons on, so that lengths depend on the pose alone.
    """

    def __init__(self, room: RoomInstance) -> None:
        self.count = len(room.targets)
        self._planner, self._known = get_planner(room), dict[RoomState, tuple[NDArray[np.float64], list[RoomState]]]()

    def measure(self, state: RoomState) -> tuple[NDArray[np.float64], list[RoomState]]:
        """Return the lengths, float64 (buttons + 1,), with the exit last, and the state after each press."""
        pose = state._replace(puzzle=(1 << self.count) - 1, primitives=0)
        if pose not in self._known:
            walks = [walk_path(self._planner, pose, goal) for goal in (*map(PressGoal, range(self.count)), ExitGoal())]
            self._known[pose] = (np.array([cost for _, cost in walks]), [after or pose for after, _ in walks[:-1]])
        return self._known[pose]


class _Press(NamedTuple):
    """A press of a button that was off."""

    target: int
    outcome: str  # opens, lights, fails, resets, dark, or leaves for the way out


class _Over:
    """End of an episode, at a cost."""

    fixes_order = True

    def __init__(self, cost: float) -> None:
        self._cost = cost

    def compute_value(self, state: RoomState, without: int | None = None) -> float:
        return self._cost

    def list_outcomes(self, press: _Press | None) -> list[tuple[str, float, _Belief | _Over]]:
        raise AssertionError("the episode is over")


class _Belief:
    """Buttons that are on, the graphs that agree with all presses, and the button pressed last."""

    def __init__(self, family: GraphFamily, graph: BeliefGraph, ways: PathLengths, costs: NDArray[np.float32],
                 legs: _Legs, lit: int = 0, kept: NDArray[np.int32] | None = None, last: int | None = None,
                 is_open: bool = False) -> None:
        self._family, self._graph, self._ways, self._costs, self._legs = family, graph, ways, costs, legs
        self._lit, self._last, self._is_open = lit, last, is_open
        self._kept = np.arange(len(family.weights), dtype=np.int32) if kept is None else kept
        self._outcomes: dict[_Press | None, list[tuple[str, float, _Belief | _Over]]] = {}

    @property
    def fixes_order(self) -> bool:
        """True if presses that are certain to turn their buttons on open the exit under every graph."""
        parents, lit = self._family.parents[self._kept], self._lit
        while True:
            sure = [button for button in range(self._legs.count)
                    if not lit >> button & 1 and can_light(parents[:, button], lit).all()]
            if not sure:
                return bool((lit >> self._family.goals[self._kept] & 1).all())
            lit |= sum(1 << button for button in sure)

    def compute_value(self, state: RoomState, without: int | None = None) -> float:
        """Least expected primitives from a pose, by decisions other than a press of the button `without`."""
        legs, arrivals = self._legs.measure(state)
        if self._is_open:
            return float(legs[-1])
        parents = self._family.parents[self._kept]
        useful = [button for button in range(self._legs.count) if button != without and not self._lit >> button & 1
                  and can_light(parents[:, button], self._lit).any()]
        if self._legs.count > MOST_PLANNED:
            after = self._read_table(useful)
        else:
            after = [sum(odds * each.compute_value(arrivals[button])
                         for _, odds, each in self.list_outcomes(_Press(button, ""))) for button in useful]
        return float(min((legs[button] + cost for button, cost in zip(useful, after, strict=True)), default=np.inf))

    def list_outcomes(self, press: _Press | None) -> list[tuple[str, float, _Belief | _Over]]:
        """Outcomes of a decision with their probabilities and the beliefs after them."""
        if press is None:
            return [("", 1.0, self)]
        if press.outcome == "leaves":
            return [("leaves", 1.0, _Over(0.0))]
        press = press._replace(outcome="")
        if press not in self._outcomes:
            self._outcomes[press] = list(self._divide(press.target))
        return self._outcomes[press]

    def _divide(self, target: int) -> Iterator[tuple[str, float, _Belief | _Over]]:
        """Divide the graphs by the outcome of a press."""
        family, kept, lit, on = self._family, self._kept, self._lit, self._lit | 1 << target
        allowed = can_light(family.parents[kept, target], lit)
        opens = allowed & (family.goals[kept] == target)
        fails, resets, dark = split_mistakes(family.rules[kept], ~allowed, lit)
        weights = family.weights[kept] / family.weights[kept].sum()
        for name, part, bits in (("opens", opens, on), ("lights", allowed & ~opens, on), ("fails", fails, lit),
                                 ("resets", resets, 0), ("dark", dark, lit)):
            if part.any():
                yield name, float(weights[part].sum()), _Over(self._ways.failure) if name == "fails" else _Belief(
                    family, self._graph, self._ways, self._costs, self._legs, bits, kept[part], target,
                    name == "opens" or self._is_open and name != "resets")

    def _read_table(self, buttons: Sequence[int]) -> list[float]:
        """Expected primitives after the press of each of these buttons, by the lengths of the table."""
        number = self._graph.find(self._lit, self._kept)
        if number is None:  # after a press that was known to be in vain
            weights = self._family.weights[self._kept]
            self._family = self._family.select(self._kept, weights / weights.sum())
            self._kept = np.arange(len(weights), dtype=np.int32)
            self._graph = BeliefGraph(self._family, self._lit)
            self._costs, number = self._graph.solve(self._ways), self._graph.root
        last = self._legs.count if self._last is None else self._last
        return [float(self._graph.compute_costs_after(self._costs, np.array([number]), button, self._ways)
                      [0, last * self._legs.count + button]) for button in buttons]


def _split(steps: Sequence[DomainStep], puzzle: Any) -> Iterator[tuple[int, RoomState, _Press | None]]:
    """Split a decision after each press of a button that was off, and after the way out.

    Yields the primitives, the state after them, and the press, or None for primitives without one.
    """
    k = 0
    for step in steps:
        k += 1
        before, after = get_bits(step.state), get_bits(step.next_state)
        lit = before
        for target in list_touched(step.events.pressed):
            if before >> target & 1:
                continue
            on = after & 1 << target
            opens = puzzle.is_solved(lit | on) and not puzzle.is_solved(lit)
            outcome = ("opens" if opens else "lights") if on else (
                "fails" if step.events.failed else "resets" if lit & ~after else "dark")
            yield k, step.next_state, _Press(target, outcome)
            k, lit = 0, 0 if outcome == "resets" else lit | on
        if step.info["is_success"]:
            yield k, step.next_state, _Press(-1, "leaves")
            k = 0
    if k:
        yield k, steps[-1].next_state, None
