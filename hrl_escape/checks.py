"""The contracts as runnable checks, for this project's own implementations and for strangers'.

Each `check_*` exercises one implementation by random play and raises `ContractError` at the
first claim that does not hold. A check reads the public interface only; it proves nothing, but
what it misses has to hide well.
"""

from __future__ import annotations

import json
import math
from collections.abc import Hashable, Sequence
from typing import Any

import gymnasium
import numpy as np

from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.base import Contacts, Operator, Puzzle, SymbolicModel
from hrl_escape.errors import ContractError, PlanningFailed
from hrl_escape.options.option import Option
from hrl_escape.options.path_check import check_planner

__all__ = ["check_option", "check_planner", "check_puzzle"]

Poses = tuple[tuple[float, float, float], ...]


def check_puzzle(puzzle: Puzzle, steps: int = 200, seed: int = 0) -> None:
    """Check a puzzle: its rules, its numbers, its symbolic model, and that they agree.

    Args:
        puzzle: a concrete puzzle, such as `config.make_puzzle(rng)` gives.
        steps: primitives of random play, about half of them along the model's operators.
        seed: of the random play.

    Raises:
        ContractError: the first claim that does not hold.
    """
    _PuzzleCheck(puzzle, np.random.default_rng(seed)).run(steps)


class _PuzzleCheck:
    """The claims about one puzzle, and the random play they are tried in."""

    def __init__(self, puzzle: Puzzle, rng: np.random.Generator) -> None:
        self.puzzle, self.rng = puzzle, rng
        self.name = f"puzzle {puzzle.kind!r}"
        self.targets = {name: i for i, name in enumerate(puzzle.target_names)}
        self.props = {prop.name: i for i, prop in enumerate(puzzle.props)}
        self.model: SymbolicModel = puzzle.make_symbolic_model()

    def require(self, holds: bool, claim: str, seen: object) -> None:
        if not holds:
            raise ContractError(self.name, claim, repr(seen))

    def run(self, steps: int) -> None:
        self.check_names()
        self.check_model()
        self.check_round_trip()
        state = self.puzzle.make_state()
        self.require(state == self.puzzle.make_state(), "make_state gives the same state each time", state)
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
        names = (*puzzle.target_names, *(prop.name for prop in puzzle.props))
        self.require(all(isinstance(n, str) and n for n in names), "names of targets and props are text", names)
        self.require(len(set(names)) == len(names), "no two targets or props have one name", names)
        numbers = (*(end for edge in puzzle.edges for end in edge), *puzzle.goal_targets)
        self.require(all(0 <= n < len(self.targets) for n in numbers), "edges and goal_targets name targets", numbers)
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
            used = op.preconditions | op.forbidden | op.add | op.delete
            self.require(used <= known, f"operator {op.name!r} is made of propositions", used - known)
            if op.action == "press":
                self.require(op.target in self.targets, f"operator {op.name!r} presses a target", op.target)
            else:
                self.require(op.action == "push" and op.target in self.props and op.destination in self.props,
                             f"operator {op.name!r} presses a target, or pushes a prop to a prop",
                             (op.action, op.target, op.destination))
        again = self.puzzle.make_symbolic_model()
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
        facts = puzzle.get_facts(state)
        unknown = facts - frozenset(self.model.propositions)
        self.require(not unknown, "facts are propositions of the symbolic model", unknown)
        solved = puzzle.is_solved(state)
        self.require(isinstance(solved, bool) and solved == (self.model.goal <= facts),
                     "is_solved exactly where the symbolic goal holds", (state, solved, facts))

    def check_operators(self, state: Hashable, poses: Poses) -> None:
        facts = self.puzzle.get_facts(state)
        for op in self.model.operators:
            if op.is_applicable(facts):
                after = self.puzzle.get_facts(self.perform(op, state, poses)[0])
                expected = op.apply(facts)
                self.require(after == expected, f"operator {op.name!r} predicts what update does",
                             {"state": state, "predicted": sorted(expected), "really": sorted(after)})

    def check_reach(self, state: Hashable) -> None:
        """Where deletions and what is forbidden are forgotten, operators must lead to the goal."""
        reached, grown = self.puzzle.get_facts(state), True
        while grown:
            useful = [op for op in self.model.operators if op.preconditions <= reached and not op.add <= reached]
            reached, grown = reached.union(*(op.add for op in useful)), bool(useful)
        missing = sorted(self.model.goal - reached)
        self.require(not missing, "the symbolic goal can be reached by operators", f"no way to {missing}")

    # --- play ------------------------------------------------------------------------------

    def begin(self) -> tuple[Hashable, Poses]:
        """A new episode."""
        state, poses = self.puzzle.make_state(), self.draw_poses()
        return (self.update(state, (), poses) if poses else state), poses

    def finish(self, state: Hashable, poses: Poses) -> None:
        """Follow operators that add something, as far as that leads, so that solved states are seen."""
        for _ in range(2 * len(self.model.operators)):
            facts = self.puzzle.get_facts(state)
            useful = [op for op in self.model.operators if op.is_applicable(facts) and not op.add <= facts]
            if not useful or self.model.goal <= facts:
                break
            state, poses = self.perform(useful[0], state, poses)
            self.check_state(state)

    def play(self, state: Hashable, poses: Poses) -> tuple[Hashable, Poses]:
        """One primitive: an applicable operator, or anything."""
        facts = self.puzzle.get_facts(state)
        applicable = [op for op in self.model.operators if op.is_applicable(facts)]
        if applicable and self.rng.random() < 0.5:
            return self.perform(applicable[int(self.rng.integers(len(applicable)))], state, poses)
        number = min(int(self.rng.integers(3)), len(self.targets))
        chosen = sorted(self.rng.choice(len(self.targets), number, replace=False).tolist()) if number else []
        poses = self.draw_poses()
        after = self.update(state, tuple(chosen), poses)
        one_by_one = state
        for target in chosen:
            one_by_one = self.update(one_by_one, (target,), poses)
        if chosen:
            self.require(after == one_by_one, "presses of one primitive count in index order",
                         {"state": state, "pressed": chosen, "together": after, "one by one": one_by_one})
        return after, poses

    def perform(self, op: Operator, state: Hashable, poses: Poses) -> tuple[Hashable, Poses]:
        """Do physically what an operator means."""
        if op.action == "press":
            return self.update(state, (self.targets[op.target],), poses), poses
        moved = list(poses)
        moved[self.props[op.target]] = poses[self.props[op.destination or ""]]
        return self.update(state, (), tuple(moved)), tuple(moved)

    def update(self, state: Hashable, pressed: tuple[int, ...], poses: Poses) -> Hashable:
        before = hash(state)
        contacts = Contacts(pressed, poses)
        after = self.puzzle.update(state, contacts)
        again = self.puzzle.update(state, contacts)
        self.require(after == again and hash(state) == before,
                     "update is pure: the same state and contacts give the same state, nothing is changed in place",
                     {"state": state, "pressed": pressed, "first": after, "second": again})
        return after

    def draw_poses(self) -> Poses:
        """Somewhere on a floor of 20 m, with nothing on top of anything on purpose."""
        return tuple((float(x), float(y), float(yaw)) for x, y, yaw in
                     self.rng.uniform((-10, -10, -math.pi), (10, 10, math.pi), (len(self.props), 3)))


def _is_hashable(value: object) -> bool:
    try:
        hash(value)
    except TypeError:
        return False
    return True


# --- options ---------------------------------------------------------------------------------


def check_option(option: Option, env: gymnasium.Env, runs: int = 10, seed: int = 0,
                 states: Sequence[RoomState] = ()) -> None:
    """Check an option by running it in a room from where random play has led.

    Args:
        option: any option.
        env: a flat environment of a room that it suits.
        runs: how many places random play leads to.
        seed: of the random play.
        states: more places to start from, for an option that starts where random play hardly leads.

    Raises:
        ContractError: the first claim that does not hold.
    """
    _OptionCheck(option, env, np.random.default_rng(seed)).run(runs, seed, states)


class _OptionCheck:
    """The claims about one option, and the runs they are tried in."""

    DEEPEST = 8

    def __init__(self, option: Option, env: gymnasium.Env, rng: np.random.Generator) -> None:
        self.option, self.env, self.rng = option, env, rng
        self.name = f"option {option.name!r}"
        self.room: Any = env.unwrapped
        self.primitives = len(self.room.rules.primitives)

    def require(self, holds: bool, claim: str, seen: object) -> None:
        if not holds:
            raise ContractError(self.name, claim, repr(seen))

    def run(self, runs: int, seed: int, states: Sequence[RoomState]) -> None:
        option = self.option
        self.require(isinstance(option.name, str) and bool(option.name), "the name is text", option.name)
        self.require(option.instance is None or option.instance.id == self.room.instance.id,
                     "it was made for this room, or for any", option.instance and option.instance.id)
        started = sum(self.try_from(state) for state in states)
        for number in range(runs):
            self.env.reset(seed=seed + number)
            if self.wander(10 * number):
                started += self.try_from(self.room.get_state())
        self.require(started > 0, f"it starts somewhere in {runs} places that random play led to, or in given states",
                     started)

    def wander(self, steps: int) -> bool:
        """Play at random; false if the episode ended."""
        for _ in range(steps):
            *_, terminated, truncated, _ = self.env.step(int(self.rng.integers(self.primitives)))
            if terminated or truncated:
                return False
        return True

    def try_from(self, state: RoomState) -> bool:
        """Run it twice from one state; false if it may not start there, or could not be planned."""
        allowed = self.option.initiation(state)
        self.require(isinstance(allowed, bool), "initiation gives a bool", allowed)
        self.require(self.option.initiation(state) == allowed, "initiation gives the same answer each time", state)
        if not allowed:
            return False
        try:
            first, again = self.roll_out(state), self.roll_out(state)
        except PlanningFailed as failure:
            self.require(bool(str(failure)), "a failed plan says why", failure)
            return False
        self.require(first == again, "the same state and the same draws give the same run", (first, again))
        if self.option.is_markov:
            for at, primitive in first:
                self.require(self.option.policy(at) == primitive, "is_markov: the policy is a function of the state",
                             at)
        return True

    def roll_out(self, state: RoomState) -> list[tuple[RoomState, int]]:
        """One run to its end: (state, primitive) of each step."""
        option, rng = self.option, np.random.default_rng(0)
        self.env.reset(seed=0)
        self.room.set_state(state)
        option.start(state)
        stack, steps = [option], []
        touched, ended = 0, False
        while not ended:
            self.require(len(steps) <= self.room.instance.horizon, "it ends with the episode at the latest", len(steps))
            primitive = self.ask(stack, state)
            *_, terminated, truncated, _ = self.env.step(primitive)
            steps.append((state, primitive))
            before, state = state, self.room.get_state()
            touched |= state.touching & ~before.touching
            ended = self.ends(stack, state, rng) or terminated or truncated
        report = option.report
        self.require(0 <= report.cache_hits <= report.planner_calls and report.planner_seconds >= 0.0,
                     "the report's counts make sense", report)
        dynamics = self.room.instance.dynamics
        if option.targets is not None and dynamics.kind == "kinematic" and not dynamics.noise:
            told = {*report.unavoidable, *(self.room.instance.targets[i].name for i in option.targets)}
            names = [target.name for i, target in enumerate(self.room.instance.targets) if touched >> i & 1]
            others = [name for name in names if name not in told]
            self.require(not others, "it presses no target but its own and those it reports as unavoidable", others)
        return steps

    def ask(self, stack: list[Option], state: RoomState) -> int:
        """The next primitive, through nested options."""
        while True:
            decision = stack[-1].policy(state)
            if not isinstance(decision, Option):
                self.require(not isinstance(decision, bool) and decision in range(self.primitives),
                             f"the policy gives a primitive from 0 to {self.primitives - 1}, or an option", decision)
                return int(decision)
            self.require(len(stack) < self.DEEPEST, f"options nest at most {self.DEEPEST} deep", stack)
            self.require(bool(decision.initiation(state)), "a nested option is entered where it may start", decision)
            decision.start(state)
            stack.append(decision)

    def ends(self, stack: list[Option], state: RoomState, rng: np.random.Generator) -> bool:
        """Ask terminations at the state reached, from the innermost out."""
        while stack:
            beta = stack[-1].termination(state)
            self.require(isinstance(beta, float) and 0.0 <= beta <= 1.0, "termination gives a probability", beta)
            self.require(stack[-1].termination(state) == beta, "termination gives the same answer each time", state)
            if rng.random() >= beta:
                return False
            stack.pop()
        return True
