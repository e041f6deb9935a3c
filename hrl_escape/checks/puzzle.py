"""Check of puzzles: pure updates, bounded observations, and a symbolic model that predicts both."""

from __future__ import annotations

import json
import math
from collections.abc import Hashable
from typing import get_args

import numpy as np

from hrl_escape.checks.claims import Claims
from hrl_escape.env.puzzles.base import Contacts, Puzzle
from hrl_escape.env.puzzles.mixins import Doored, Graphed, Propped, get_mixin
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.planning.goals import GripAction

Poses = tuple[tuple[float, float, float], ...]


def check_puzzle(puzzle: Puzzle, steps: int = 200, seed: int = 0) -> None:
    """Check the rules, observations and symbolic model of a puzzle against each other.

    Args:
        puzzle: a concrete puzzle, such as from `config.make_puzzle(rng)`.
        steps: primitives of random play, about half of them along the model's operators.
        seed: of the random play.

    Raises:
        ContractError: a requirement is violated.
    """
    _PuzzleCheck(puzzle, np.random.default_rng(seed)).run(steps)


class _PuzzleCheck(Claims):
    """Requirements of a puzzle, checked in random play."""

    def __init__(self, puzzle: Puzzle, rng: np.random.Generator) -> None:
        super().__init__(f"puzzle {puzzle.kind!r}")
        self.puzzle, self.rng = puzzle, rng
        self.targets = {name: i for i, name in enumerate(puzzle.target_names)}
        self.props = {prop.name: i for i, prop in enumerate(get_mixin(puzzle, Propped).props)}
        self.model: SymbolicModel = puzzle.symbolic.make_symbolic_model()

    def run(self, steps: int) -> None:
        self.check_names()
        self.check_model()
        self.check_round_trip()
        state, self.starts = self.puzzle.make_state(), self.puzzle.list_starts()
        self.require(state == self.puzzle.make_state(), "make_state gives the same state each time", state)
        self.require(self.starts[:1] == (state,), "list_starts begins with the state of make_state", self.starts[:1])
        self.check_state(state)
        state, poses = self.begin()
        self.check_reach(state)
        for _ in range(steps):
            self.check_operators(state, poses)
            state, poses = self.play(state, poses) if self.rng.random() < 0.95 else self.begin()
            self.check_state(state)
        self.finish(state, poses)

    # --- what does not change --------------------------------------------------------------

    def check_names(self) -> None:
        puzzle = self.puzzle
        names, graph = (*puzzle.target_names, *self.props), get_mixin(puzzle, Graphed)
        self.require(all(isinstance(n, str) and n for n in names), "names of targets and props are text", names)
        self.require(len(set(names)) == len(names), "no two targets or props have one name", names)
        numbers = (*(end for edge in graph.edges for end in edge), *graph.goal_targets)
        self.require(all(0 <= n < len(self.targets) for n in numbers), "edges and goal_targets name targets", numbers)
        chances = (0.0, *puzzle.chances, 1.0)
        self.require(all(low < high for low, high in zip(chances, chances[1:], strict=False)),
                     "chances ascend between 0 and 1", puzzle.chances)
        bounds = puzzle.bounds
        self.require(all(math.isfinite(low) and math.isfinite(high) and low < high for low, high in bounds),
                     "bounds are finite, low < high", bounds)

    def check_model(self) -> None:
        model, known = self.model, frozenset(self.model.propositions)
        self.require(len(known) == len(model.propositions), "no proposition is listed twice", model.propositions)
        self.require(model.goal <= known, "the goal is made of propositions", model.goal - known)
        names = [operator.name for operator in model.operators]
        self.require(len(set(names)) == len(names), "no two operators have one name", names)
        for op in model.operators:
            used = op.reads | op.may_change
            self.require(used <= known, f"operator {op.name!r} is made of propositions", used - known)
            if op.action in ("press", *get_args(GripAction)):
                self.require(op.target in self.targets,
                             f"operator {op.name!r} presses, grips or uses a target, or pushes it", op.target)
            else:
                self.require(op.action == "push" and op.target in self.props and op.destination in self.props,
                             f"operator {op.name!r} presses, grips or releases at a target, or pushes a prop to a prop",
                             (op.action, op.target, op.destination))
        for fact in get_mixin(self.puzzle, Doored).door_facts:
            closes = [op.name for op in model.operators if fact in op.may_change - op.may_add]
            self.require(fact in known and not closes, "facts that open doors are propositions that nothing deletes",
                         (fact, closes))
        again = self.puzzle.symbolic.make_symbolic_model()
        self.require(again == model, "make_symbolic_model gives the same model each time", again)

    def check_round_trip(self) -> None:
        puzzle = self.puzzle
        again = type(puzzle).from_dict(json.loads(json.dumps(puzzle.to_dict())))
        self.require(again == puzzle, "to_dict and from_dict through JSON give an equal puzzle", again)

    # --- what holds in every state ---------------------------------------------------------

    def check_state(self, state: Hashable) -> None:
        puzzle = self.puzzle
        self.require(_is_hashable(state), "states are hashable", state)
        numbers, bounds = puzzle.observe(state), puzzle.bounds
        self.require(len(numbers) == len(bounds), "observe gives one number for each of bounds", numbers)
        inside = all(isinstance(v, float) and low <= v <= high for v, (low, high) in zip(numbers, bounds, strict=True))
        self.require(inside, "observed numbers are floats within their bounds", numbers)
        lit = puzzle.get_lit(state)
        self.require(len(lit) == len(self.targets) and all(isinstance(is_on, bool) for is_on in lit),
                     "get_lit gives a bool for each target", lit)
        facts = puzzle.symbolic.get_facts(state)
        unknown = facts - frozenset(self.model.propositions)
        self.require(not unknown, "facts are propositions of the symbolic model", unknown)
        doors = get_mixin(puzzle, Doored)
        shut = sum(1 << door for door, fact in enumerate(doors.door_facts) if fact not in facts)
        self.require(doors.get_shut(state) == shut, "get_shut gives the doors whose fact does not hold",
                     doors.get_shut(state))
        progress = puzzle.compute_progress(state)
        self.require(isinstance(progress, float) and 0.0 <= progress <= 1.0, "progress is a share", progress)
        solved = puzzle.is_solved(state)
        self.require(isinstance(solved, bool) and solved == (self.model.goal <= facts),
                     "is_solved exactly where the symbolic goal holds", (state, solved, facts))

    def check_operators(self, state: Hashable, poses: Poses) -> None:
        facts = self.puzzle.symbolic.get_facts(state)
        for op in self.model.operators:
            if op.is_applicable(facts):
                after = self.puzzle.symbolic.get_facts(self.perform(op, state, poses)[0])
                expected = op.apply(facts)
                self.require(after == expected, f"operator {op.name!r} predicts what update does",
                             {"state": state, "predicted": sorted(expected), "really": sorted(after)})

    def check_reach(self, state: Hashable) -> None:
        """Check that the goal is reachable under delete relaxation."""
        reached, before = self.puzzle.symbolic.get_facts(state), None
        while reached != before:
            before, reached = reached, reached.union(*(op.relax(reached) for op in self.model.operators))
        missing = sorted(self.model.goal - reached)
        self.require(not missing, "the symbolic goal can be reached by operators", f"no way to {missing}")

    # --- play ------------------------------------------------------------------------------

    def begin(self) -> tuple[Hashable, Poses]:
        """Return state and object poses of a random start state."""
        state, poses = self.starts[int(self.rng.integers(len(self.starts)))], self.draw_poses()
        return (self.update(state, (), poses) if poses else state), poses

    def finish(self, state: Hashable, poses: Poses) -> None:
        """Apply operators that add facts until the goal holds or none is left, to reach solved states."""
        for _ in range(2 * len(self.model.operators)):
            facts = self.puzzle.symbolic.get_facts(state)
            useful = [op for op in self.model.operators if op.is_applicable(facts) and not op.apply(facts) <= facts]
            if not useful or self.model.goal <= facts:
                break
            state, poses = self.perform(useful[0], state, poses)
            self.check_state(state)

    def play(self, state: Hashable, poses: Poses) -> tuple[Hashable, Poses]:
        """Run one primitive: an applicable operator or a random contact."""
        facts = self.puzzle.symbolic.get_facts(state)
        applicable = [op for op in self.model.operators if op.is_applicable(facts)]
        if applicable and self.rng.random() < 0.5:
            return self.perform(applicable[int(self.rng.integers(len(applicable)))], state, poses)
        number = min(int(self.rng.integers(3)), len(self.targets))
        chosen = sorted(self.rng.choice(len(self.targets), number, replace=False).tolist()) if number else []
        poses, chance = self.draw_poses(), float(self.rng.random())
        after = self.update(state, tuple(chosen), poses, chance)
        one_by_one = state
        for target in chosen:
            one_by_one = self.update(one_by_one, (target,), poses, chance)
        if chosen:
            self.require(after == one_by_one, "presses of one primitive count in index order",
                         {"state": state, "pressed": chosen, "together": after, "one by one": one_by_one})
        return after, poses

    def perform(self, op: Operator, state: Hashable, poses: Poses) -> tuple[Hashable, Poses]:
        """Execute an operator as contacts."""
        if op.action != "push":
            return self.follow(state, self.puzzle.symbolic.make_contacts(op)._replace(prop_poses=poses)), poses
        moved = list(poses)
        moved[self.props[op.target]] = poses[self.props[op.destination or ""]]
        return self.update(state, (), tuple(moved)), tuple(moved)

    def update(self, state: Hashable, pressed: tuple[int, ...], poses: Poses, chance: float = 0.0) -> Hashable:
        return self.follow(state, Contacts(pressed, poses, chance, pressed))

    def follow(self, state: Hashable, contacts: Contacts) -> Hashable:
        before = hash(state)
        after = self.puzzle.update(state, contacts)
        again = self.puzzle.update(state, contacts)
        self.require(after == again and hash(state) == before,
                     "update is pure: the same state and contacts give the same state, nothing is changed in place",
                     {"state": state, "contacts": contacts, "first": after, "second": again})
        ends = (0.0, *self.puzzle.chances, 1.0)
        outcome = sum(contacts.uniform >= chance for chance in ends[1:-1])
        chance = ends[outcome] + 0.999 * (ends[outcome + 1] - ends[outcome])
        other = self.puzzle.update(state, contacts._replace(uniform=chance))
        self.require(other == after, "outcomes of contacts.uniform change at the puzzle's chances only",
                     {"state": state, "contacts": contacts, "first": after, "uniform": chance, "second": other})
        reward = self.puzzle.compute_reward(state, after, contacts)
        self.require(isinstance(reward, float) and math.isfinite(reward), "rewards are finite floats", reward)
        failed = self.puzzle.is_failed(after)
        self.require(isinstance(failed, bool) and not (failed and self.puzzle.is_solved(after)),
                     "is_failed says true or false, and never of a solved puzzle", (after, failed))
        return after

    def draw_poses(self) -> Poses:
        """Sample poses on a floor of 20 m; overlaps are possible."""
        return tuple((float(x), float(y), float(yaw)) for x, y, yaw in
                     self.rng.uniform((-10, -10, -math.pi), (10, 10, math.pi), (len(self.props), 3)))


def _is_hashable(value: object) -> bool:
    try:
        hash(value)
    except TypeError:
        return False
    return True
