"""Task planning: the order of a puzzle's operators with the fewest primitives.

A best-first search over (facts that hold, last operator) with the planner's cost of each leg. For a puzzle that is a
set of targets it is Held and Karp's dynamic programme, pruned by the symbolic model. It knows operators and costs, no
geometry.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeAlias

from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.search import OpenNodes

START, EXIT = -1, -2
LARGEST_SEARCH = 200_000
"""Most legs of an exact search: 12 targets in any order have 135,000."""


class TaskNode(NamedTuple):
    """Node of a search over orders."""

    facts: int  # code of the facts that hold
    last: int  # number of the operator done last, `START` or `EXIT`


class Leg(NamedTuple):
    """Leg of a task: one operator, carried out from some place."""

    cost: float  # primitives
    place: Any  # its end, as the planner of legs needs it to plan the next leg
    facts: frozenset[str] | None = None
    """Facts that hold at its end, or None for the facts that the operator's effects imply."""


ExtendLeg: TypeAlias = Callable[[Any, Operator | None], Leg | None]
"""(place, operator) -> the leg, or None if it is impossible; operator None is the last leg, to the exit."""


@dataclasses.dataclass(frozen=True)
class TaskPlan:
    """An order of operators."""

    operators: tuple[Operator, ...]  # in order; the last leg (to the exit) follows
    cost: float  # primitives of all legs together
    lower_bound: float  # no order costs less, by these legs


def find_relevant_operators(model: SymbolicModel, goal: Iterable[str] | None = None) -> tuple[Operator, ...]:
    """Operators relevant to a goal: leaving out the others changes neither its reachability nor the shortest plan.

    The wanted facts are the goal's and those a relevant operator needs: facts that must hold, facts that must not. An
    operator is relevant if it makes a wanted fact true. No fact is wanted for its own opposite: an operator that
    lights a lamp asks that it be dark, but a lit lamp need not be put out for that.
    """
    wanted = {(fact, True) for fact in (model.goal if goal is None else goal)}
    found: set[str] = set()
    while True:
        useful = [(op, made) for op in model.operators if (made := _list_effects(op) & wanted)]
        grown = wanted.union(*(_list_needs(op) - {(fact, not holds)} for op, made in useful for fact, holds in made))
        found |= {op.name for op, _ in useful}
        if grown == wanted:
            return tuple(op for op in model.operators if op.name in found)
        wanted = grown


def _list_effects(op: Operator) -> set[tuple[str, bool]]:
    gone = op.may_change - op.add
    return {(fact, True) for fact in op.may_add} | {(fact, False) for fact in gone}


def _list_needs(op: Operator) -> set[tuple[str, bool]]:
    needs = {(fact, True) for fact in op.preconditions} | {(fact, False) for fact in op.forbidden}
    for effect in op.when:
        needs |= {(fact, True) for fact in effect.condition} | {(fact, False) for fact in effect.forbidden}
    return needs


class _Coded(NamedTuple):
    """Operator, or a conditional effect of one, as bits of facts."""

    needs: int
    forbids: int
    adds: int
    deletes: int


class _Effects(NamedTuple):
    """Conditional effects by one bit of their condition, 0 for those without, and all of those bits."""

    by_bit: dict[int, list[_Coded]]
    bits: int


class TaskSearch:
    """Search over the orders of a symbolic model's operators.

    Args:
        model: propositions and operators.
        goal: facts to make true, or None for the model's own goal.
        lower_bound: (operator done last or None, operator to do or None for the last leg) -> primitives
            that this leg costs at least, from any place. A tighter bound is faster.
        relevant_only: leave out operators that the goal does not need. Legs planned one by one may end better after
            one of these.
    """

    def __init__(self, model: SymbolicModel, goal: frozenset[str] | None = None,
                 lower_bound: Callable[[Operator | None, Operator | None], float] = lambda last, then: 0.0,
                 relevant_only: bool = True) -> None:
        goal = model.goal if goal is None else goal
        self.operators = find_relevant_operators(model, goal) if relevant_only else tuple(model.operators)
        self._bits = {fact: 1 << i for i, fact in enumerate(model.propositions)}
        self._goal = self._encode(goal)
        self._coded = [
            _Coded(*map(self._encode, (op.preconditions, op.forbidden, op.add, op.delete))) for op in self.operators
        ]
        self._when = [self._encode_effects(op) for op in self.operators]
        numbers = range(len(self.operators))
        froms: list[Operator | None] = [*self.operators, None]
        self._least_to = [min((lower_bound(last, op) for last in froms if last is not op), default=0.0)
                          for op in self.operators]
        self._least_exit = min((lower_bound(last, None) for last in froms), default=0.0)
        adds = [self._encode(op.may_add) for op in self.operators]
        makers = {bit: [n for n in numbers if adds[n] & bit] for bit in self._bits.values()}
        self._sole_maker = {bit: made_by[0] for bit, made_by in makers.items() if len(made_by) == 1}
        self._estimates: dict[int, float] = {}

    def _encode(self, facts: Iterable[str]) -> int:
        code = 0
        for fact in facts:
            code |= self._bits[fact]
        return code

    def _encode_effects(self, op: Operator) -> _Effects:
        table: dict[int, list[_Coded]] = {}
        for effect in op.when:
            coded = _Coded(*map(self._encode, (effect.condition, effect.forbidden, effect.add, effect.delete)))
            table.setdefault(coded.needs & -coded.needs, []).append(coded)
        return _Effects(table, sum(table))

    def _apply(self, n: int, facts: int) -> int:
        op, when = self._coded[n], self._when[n]
        adds, deletes = op.adds, op.deletes
        left = facts & when.bits
        bits = [0] if when.by_bit else []
        while left:
            bits.append(left & -left)
            left &= left - 1
        for bit in bits:
            for effect in when.by_bit.get(bit, ()):
                if effect.needs & ~facts == 0 and not effect.forbids & facts:
                    adds, deletes = adds | effect.adds, deletes | effect.deletes
        return facts & ~deletes | adds

    def _list_next(self, facts: int) -> list[int]:
        return [n for n, op in enumerate(self._coded) if op.needs & ~facts == 0 and not op.forbids & facts]

    def _estimate(self, facts: int) -> float:
        """Lower bound of the remaining primitives, from operators that no other can replace."""
        known = self._estimates.get(facts)
        if known is None:
            pending: set[int] = set()
            wanted = self._goal & ~facts
            while wanted:
                bit = wanted & -wanted
                wanted &= ~bit
                maker = self._sole_maker.get(bit)
                if maker is not None and maker not in pending:
                    pending.add(maker)
                    wanted |= self._coded[maker].needs & ~facts
            known = self._estimates[facts] = sum(self._least_to[n] for n in pending) + self._least_exit
        return known

    def list_legs(self, facts: frozenset[str], most: int) -> list[tuple[TaskNode, TaskNode]]:
        """Legs of an exhaustive search, up to `most`, as the nodes that they join; the first begins where it begins."""
        queue: list[TaskNode] = [TaskNode(self._encode(facts), START)]
        seen = set(queue)
        legs: list[tuple[TaskNode, TaskNode]] = []
        while queue and len(legs) < most:
            node = queue.pop()
            if node.facts & self._goal == self._goal:
                legs.append((node, TaskNode(node.facts, EXIT)))
                continue
            for n in self._list_next(node.facts):
                then = TaskNode(self._apply(n, node.facts), n)
                legs.append((node, then))
                if then not in seen:
                    seen.add(then)
                    queue.append(then)
        return legs[:most]

    def find_order(self, facts: frozenset[str], place: Any, extend: ExtendLeg, largest: int = LARGEST_SEARCH
                   ) -> TaskPlan | None:
        """Find the order of fewest primitives from here, or None if there is none.

        Exact over orders unless more than `largest` legs would have to be examined; then the best of a
        beam search (over at most as many again), with the bound that the exact search had reached. Each
        (facts, last operator) keeps its cheapest place.
        """
        begin, searched = self._encode(facts), 0
        frontier: OpenNodes[tuple[int, int], tuple[Any, Any]] = OpenNodes()
        frontier.push((begin, START), 0.0, self._estimate(begin), (place, None))
        while (entry := frontier.pop()) is not None:
            bound, _, cost, (at, last), (here, trail) = entry
            if last == EXIT:
                return self._report(trail, cost, cost)
            if searched >= largest:
                width = max(4, largest // (4 * len(self.operators) ** 2))
                finished = self._search_beam(begin, place, extend, width, 1, 4 * len(self.operators) + 1)
                if not finished:
                    return None
                cost, trail = min(finished, key=lambda order: order[0])
                return self._report(trail, cost, min(bound, cost))
            for n, leg, then in self._expand(at, here, extend):
                searched += 1
                total = cost + leg.cost
                least = total if n == EXIT else max(bound, total + self._estimate(then))  # at least its parent's bound
                frontier.push((then, n), total, least, (leg.place, (trail, n)))
        return None

    def find_orders(self, facts: frozenset[str], place: Any, extend: ExtendLeg, count: int, most: int
                    ) -> list[TaskPlan]:
        """Find several cheap orders, cheapest first, by a beam search.

        Unlike `find_order`, each (facts, last operator) keeps its `count` cheapest places, because the next leg can be
        shorter from a place that took longer to reach. About `most` legs are examined: the beam is as wide as that
        allows. Facts, place and `extend` are as in `find_order`.
        """
        width = max(1, 2 * most // max(len(self.operators), 1) ** 2)
        finished = self._search_beam(self._encode(facts), place, extend, width, count, 2 * len(self.operators) + 1)
        plans = [self._report(trail, cost, 0.0) for cost, trail in finished]
        return sorted(plans, key=lambda plan: plan.cost)[:count]

    def _expand(self, at: int, here: Any, extend: ExtendLeg) -> Iterable[tuple[int, Leg, int]]:
        """Legs that can follow, as (operator, leg, facts after it); only the exit once the goal holds."""
        if at & self._goal == self._goal:
            leg = extend(here, None)
            if leg is not None:
                yield EXIT, leg, at
            return
        for n in self._list_next(at):
            leg = extend(here, self.operators[n])
            if leg is not None:
                yield n, leg, self._apply(n, at) if leg.facts is None else self._encode(leg.facts)

    def _search_beam(self, begin: int, place: Any, extend: ExtendLeg, width: int, kept: int, most: int
                     ) -> list[tuple[float, Any]]:
        """Beam search: after every operator keep the most promising orders.

        It keeps `width` orders of at most `most` legs, and of those with the same facts and last operator the `kept`
        cheapest.

        Returns:
            Complete orders as (cost, trail), and the number of legs examined.
        """
        layer: list[tuple[float, float, int, int, Any, Any]] = [(0.0, 0.0, begin, START, place, None)]
        finished: list[tuple[float, Any]] = []
        for _ in range(most):
            found: dict[tuple[int, int], list[tuple[float, float, int, int, Any, Any]]] = {}
            for _, cost, at, _, here, trail in layer:
                for n, leg, then in self._expand(at, here, extend):
                    total = cost + leg.cost
                    if n == EXIT:
                        finished.append((total, (trail, n)))
                    else:
                        found.setdefault((then, n), []).append(
                            (total + self._estimate(then), total, then, n, leg.place, (trail, n)))
            cheapest = (sorted(entries, key=lambda entry: entry[:2])[:kept] for entries in found.values())
            layer = sorted(itertools.chain(*cheapest), key=lambda entry: entry[:4])[:width]
        return finished

    def _report(self, trail: Any, cost: float, bound: float) -> TaskPlan:
        operators = []
        while trail is not None:
            trail, n = trail
            if n != EXIT:
                operators.append(self.operators[n])
        return TaskPlan(tuple(reversed(operators)), cost, bound)
