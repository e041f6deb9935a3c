"""A learned factored model compiled into bit rules, and forward search in it: the best plan to an end or to a gap.

A state is one 64-bit word with a bit field per factor. An action is a list of rules (if `state & care == value`: clear,
set and flip bits, end the task, earn a bonus) and of gaps (if it matches, the outcome is open). The caller chooses the
hypotheses; this module does not learn.

The search is A* over (state, place), where the place is given by the previous action: outcomes depend on the state
only, durations on the place. It maximises the discounted semi-Markov return with an upper bound as heuristic (Nilsson
1980; SMDP backup of Sutton, Precup and Singh 1999). States that no plan needs are therefore never enumerated.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import float64, uint64
from numba.typed import Dict
from numpy.typing import NDArray

from hrl_escape.agents.factored.structure import StructureLearner
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.kernels import kernel

MOST_BITS = 56
"""Bits of a state; a search keeps its place in the other eight."""

ChooseHypotheses = Callable[[int, int], NDArray[np.int64]]
"""(action, outcome) -> hypotheses to believe. The first one predicts; a context new to any of them is a gap."""


class Packing:
    """Bit layout of states: the position of each factor, and the pattern of each context of each hypothesis.

    Attributes:
        shifts: lowest bit of each factor, (factors,).
        masks: all bits of each factor.
        wide: bits of the factors with more than two values.
        patterns: disjoint pairs (care, value) of each context of each hypothesis.

    Raises:
        UnsupportedSpaceError: the factors do not fit into a word.
    """

    def __init__(self, learner: StructureLearner, agent: str) -> None:
        widths = [max(1, int(size - 1).bit_length()) for size in learner.sizes]
        if sum(widths) > MOST_BITS:
            raise UnsupportedSpaceError(
                f"{agent} plans over states of at most {MOST_BITS} bits; these factors have {sum(widths)}"
            )
        self.shifts = np.cumsum([0, *widths])[:-1].astype(np.int64)
        self.masks = [((1 << width) - 1) << int(shift) for width, shift in zip(widths, self.shifts, strict=True)]
        self.wide = sum(mask for mask, size in zip(self.masks, learner.sizes, strict=True) if size > 2)
        self.patterns = [
            [tuple(self._list_patterns(learner, parents, context)) for context in range(contexts)]
            for parents, contexts in zip(learner.hypotheses, learner.context_counts.tolist(), strict=True)
        ]

    def _list_patterns(self, learner: StructureLearner, parents: tuple[int, ...], context: int
                       ) -> Iterator[tuple[int, int]]:
        if not learner.all_on:
            care = value = 0
            for parent in parents:
                context, setting = divmod(context, int(learner.sizes[parent]))
                care |= self.masks[parent]
                value |= setting << int(self.shifts[parent])
            yield care, value
        elif context == 0:
            every = sum(self.masks[parent] for parent in parents)
            yield every, every
        else:  # patterns where one parent is the first that is off
            on = 0
            for parent in parents:
                yield on | self.masks[parent], on
                on |= self.masks[parent]

    def pack(self, values: NDArray[np.int64]) -> int:
        """Return one word for the values of the factors, (factors,)."""
        return int((values << self.shifts).sum())


class Rule(NamedTuple):
    """Effect of an action in states that match."""

    care: int
    value: int
    clear: int
    put: int
    flip: int
    over: bool
    bonus: float


@dataclass(frozen=True)
class ActionModel:
    """Believed effects of one action."""

    rules: tuple[Rule, ...]  # all that match apply
    gaps: NDArray[np.uint64]  # uint64 (gaps, 2), pairs (care, value) with an open outcome


def compile_action(learner: StructureLearner, packing: Packing, action: int, choose: ChooseHypotheses,
                   bonuses: Sequence[float], visits: int) -> ActionModel:
    """Compile chosen hypotheses into rules and gaps.

    An action that has never changed anything has no rules; all hypotheses of `choose(action, over)` then define where
    it was tried.
    """
    active = learner.list_active(action)
    found: dict[tuple[int, int], list] = {}
    gaps: set[tuple[int, int]] = set()
    asked: set[bytes] = set()
    for outcome in active.tolist() if len(active) else [learner.over]:
        chosen = choose(action, outcome)
        if chosen.tobytes() not in asked:
            asked.add(chosen.tobytes())
            for hypothesis, context in learner.find_unseen(action, chosen, visits):
                gaps.update(packing.patterns[hypothesis][context])
        if len(active):
            gaps.update(_find_disputes(learner, packing, action, chosen, outcome))
            _add_rules(found, learner, packing, action, int(chosen[0]), outcome, bonuses)
    rules = tuple(Rule(care, value, *effect) for (care, value), effect in found.items() if any(effect))
    return ActionModel(rules, np.array(sorted(gaps), dtype=np.uint64).reshape(-1, 2))


def _find_disputes(learner: StructureLearner, packing: Packing, action: int, chosen: NDArray[np.int64], outcome: int
                   ) -> Iterator[tuple[int, int]]:
    """Patterns of states where the first hypothesis and another one predict different outcomes."""
    samples = learner.get_samples(action, chosen, outcome)  # (hypotheses, contexts, own, values)
    says, speaks = np.asarray(samples.argmax(axis=-1)), np.asarray(samples.any(axis=-1))
    differ = (says[1:, None] != says[0][:, None]) & speaks[1:, None] & speaks[0][:, None]
    is_bit = outcome < learner.over and learner.sizes[outcome] == 2
    for other, first_context, context, own in np.argwhere(differ).tolist():
        own_care = packing.masks[outcome] if is_bit else 0
        own_value = own_care if own else 0
        for care, value in packing.patterns[int(chosen[0])][first_context]:
            for other_care, other_value in packing.patterns[int(chosen[1 + other])][context]:
                pairs = ((care, value), (other_care, other_value), (own_care, own_value))
                if all(not (a[0] & b[0] & (a[1] ^ b[1])) for a, b in itertools.combinations(pairs, 2)):
                    yield care | other_care | own_care, value | other_value | own_value


def _add_rules(found: dict[tuple[int, int], list], learner: StructureLearner, packing: Packing, action: int,
               hypothesis: int, outcome: int, bonuses: Sequence[float]) -> None:
    """Add one outcome's effects in every context to `found`: (care, value) -> clear, put, flip, over, bonus."""
    counts = learner.get_counts(action, hypothesis, outcome)
    for context in counts.any(axis=(1, 2)).nonzero()[0]:
        cell = counts[context]
        for pattern in packing.patterns[hypothesis][context]:
            effect = found.setdefault(pattern, [0, 0, 0, False, 0.0])
            if outcome == learner.over:
                effect[3] = bool(cell[0].argmax())
            elif outcome == learner.bonus:
                effect[4] = bonuses[int(cell[0].argmax())]
            elif learner.sizes[outcome] == 2:
                after = [int(row.argmax()) if row.any() else own for own, row in enumerate(cell)]  # untried: no change
                if after != [0, 1]:
                    effect[[[0, 0], [1, 1], [1, 0]].index(after)] |= packing.masks[outcome]
            else:
                effect[0] |= packing.masks[outcome]
                effect[1] |= int(cell[0].argmax()) << int(packing.shifts[outcome])


def find_relevant(models: Sequence[ActionModel], wide: int, with_gaps: bool) -> NDArray[np.bool_]:
    """Return the actions that can contribute to ending the task or earning a bonus, bool (actions,).

    This is a backward closure. With gaps, actions that help to fill a relevant action's gaps are relevant too. All
    actions are relevant while no rule ends the task or earns a bonus.
    """
    relevant = np.zeros(len(models), dtype=np.bool_)
    rules = [(action, rule) for action, model in enumerate(models) for rule in model.rules]
    if not any(rule.over or rule.bonus > 0 for _, rule in rules):
        return ~relevant
    wanted_on = wanted_off = 0
    has_grown = True
    while has_grown:
        before = wanted_on, wanted_off, relevant.sum()
        for action, rule in rules:
            both = wanted_on | wanted_off
            reaches = rule.put & wanted_on or rule.clear & wanted_off or rule.flip & both
            if rule.over or rule.bonus > 0 or reaches or (rule.put | rule.clear) & wide & both:
                relevant[action] = True
                wanted_on |= rule.value | rule.care & wide
                wanted_off |= rule.care & ~rule.value | rule.care & wide
        for model in (models[a] for a in relevant.nonzero()[0].tolist()) if with_gaps else ():
            care = int(np.bitwise_or.reduce(model.gaps[:, 0]))
            wanted_on |= int(np.bitwise_or.reduce(model.gaps[:, 1])) | care & wide
            wanted_off |= int(np.bitwise_or.reduce(model.gaps[:, 0] & ~model.gaps[:, 1])) | care & wide
        has_grown = before != (wanted_on, wanted_off, relevant.sum())
    return relevant


# --- search -----------------------------------------------------------------------------

MOST_ACTIONS = 250


class SearchTables(NamedTuple):
    """Models of all actions as arrays: rules and gaps sorted by action, the first of each action, bonuses of rules."""

    rules: NDArray[np.uint64]
    ends: NDArray[np.bool_]
    bonuses: NDArray[np.float64]
    rule_starts: NDArray[np.int64]
    gaps: NDArray[np.uint64]
    gap_starts: NDArray[np.int64]


class ModelPlan(NamedTuple):
    """Result of a search."""

    actions: tuple[int, ...]  # actions in order; empty if the search found nothing
    states: tuple[int, ...]  # packed state before each action
    value: float  # expected discounted return; -inf if the search found nothing


def make_tables(models: Sequence[ActionModel]) -> SearchTables:
    """Return the models of all actions as arrays."""
    rules = [rule for model in models for rule in model.rules]
    return SearchTables(
        np.array([rule[:5] for rule in rules], dtype=np.uint64).reshape(-1, 5),
        np.array([rule.over for rule in rules], dtype=np.bool_),
        np.array([rule.bonus for rule in rules], dtype=np.float64),
        np.cumsum([0, *(len(model.rules) for model in models)]),
        np.concatenate([model.gaps for model in models]),
        np.cumsum([0, *(len(model.gaps) for model in models)]),
    )


def find_plan(
    tables: SearchTables,
    state: int,
    legal: NDArray[np.bool_],
    repeatable: NDArray[np.bool_],
    relevant: NDArray[np.bool_],
    durations: NDArray[np.float64],
    places: NDArray[np.int64],
    rate: float,
    gamma: float,
    bonus: float,
    seek_gaps: bool,
    most_nodes: int,
) -> ModelPlan:
    """Search from a state.

    Args:
        tables: the model.
        state: packed initial state.
        legal: possible first actions, bool (actions,).
        repeatable: actions that may follow themselves, bool (actions,).
        relevant: actions that plans may contain, bool (actions,).
        durations: primitives from each action's place, and in the last row from here, (actions + 1, actions).
        places: row of `durations` after each action, (actions,).
        rate: usual reward of a primitive.
        gamma: discount per primitive.
        bonus: upper bound of a single bonus, at least 0.
        seek_gaps: whether to seek the soonest action with an open outcome, instead of the best known end.
        most_nodes: largest number of expanded states.
    """
    found, actions, states, value = _search(*tables, np.uint64(state), legal, repeatable, relevant, durations, places,
                                            -1.0 if seek_gaps else rate, gamma, 0.0 if seek_gaps else bonus, seek_gaps,
                                            most_nodes)
    return ModelPlan(tuple(actions.tolist()), tuple(states.tolist()), float(value) if found else -np.inf)


@kernel
def _matches_any(patterns, start, stop, state):
    for i in range(start, stop):
        if state & patterns[i, 0] == patterns[i, 1]:
            return True
    return False


@kernel
def _search(rules, ends, bonuses, rule_starts, gaps, gap_starts, root, legal, repeatable, relevant, durations, places,
            rate, gamma, bonus, seek_gaps, most_nodes):  # fmt: skip
    actions = len(legal)
    worst = min(rate, 0.0) / (1.0 - gamma) if gamma < 1.0 else -1e12
    lows = Dict.empty(uint64, float64)  # value of each expanded state and place if only waiting follows
    goal = -1
    state_of, place_of, gain_of, discount_of, parent_of, action_of = [root], [actions], [0.0], [1.0], [-1], [-1]
    heap = [(-bonus, 0)]
    while len(heap) > 0:
        _, node = heapq.heappop(heap)
        state, place, gain, discount = state_of[node], place_of[node], gain_of[node], discount_of[node]
        if place < 0:  # an end, popped with its exact value, which no open node exceeds
            goal = node
            break
        key = state << np.uint64(8) | np.uint64(place)
        low = gain + discount * worst
        if key in lows and low <= lows[key] + 1e-9:
            continue
        if len(lows) >= most_nodes:
            break
        lows[key] = low
        for action in range(actions):
            if not relevant[action] or (node == 0 and not legal[action]):
                continue
            if action == action_of[node] and not repeatable[action]:
                continue
            is_open = _matches_any(gaps, gap_starts[action], gap_starts[action + 1], state)
            if is_open and not seek_gaps:
                continue
            after, over, earned = state, False, 0.0
            if not is_open:
                for i in range(rule_starts[action], rule_starts[action + 1]):
                    if state & rules[i, 0] == rules[i, 1]:
                        after = (after & ~rules[i, 2] | rules[i, 3]) ^ rules[i, 4]
                        over = over or ends[i]
                        earned += bonuses[i]
                if over and seek_gaps or (after == state and not over):
                    continue
            k = durations[place, action]
            factor = gamma**k
            paid = rate * ((1.0 - factor) / (1.0 - gamma) if gamma < 1.0 else k)
            if not seek_gaps and not is_open:
                paid += factor / gamma * earned if gamma > 0.0 else (earned if k <= 1.0 else 0.0)
            value, is_end = gain + discount * paid, over or is_open
            state_of.append(after)
            gain_of.append(value)
            discount_of.append(discount * factor)
            parent_of.append(node)
            action_of.append(action)
            place_of.append(-1 if is_end else places[action])
            if not is_end:
                value += discount * factor * bonus
            heapq.heappush(heap, (-value, len(state_of) - 1))
    length, node = 0, goal
    while node > 0:
        length, node = length + 1, parent_of[node]
    plan, states = np.empty(length, np.int64), np.empty(length, np.uint64)
    node = goal
    while node > 0:
        length -= 1
        plan[length], states[length] = action_of[node], state_of[parent_of[node]]
        node = parent_of[node]
    return goal >= 0, plan, states, gain_of[goal] if goal >= 0 else 0.0
