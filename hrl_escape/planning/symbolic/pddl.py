"""PDDL export of any puzzle's symbolic model, and solving it with unified-planning.

The export is plain text in the STRIPS subset with negative preconditions, ground: one action
an operator, which every classical planner reads. Solving needs the extra `pddl`; our own
search, which knows what each leg costs, is `operator_order.py`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.base import Operator, SymbolicModel
from hrl_escape.errors import MissingExtraError, PlanningFailed, PlanningReason
from hrl_escape.files import write_text

__all__ = ["export_pddl", "make_domain", "make_problem", "save_pddl", "solve_pddl"]

_PREDICATE = re.compile(r"^([^()]+)\(([^()]*)\)$")


def _clean(word: str) -> str:
    """A PDDL name: letters, digits, - and _, beginning with a letter; PDDL ignores case."""
    name = re.sub(r"[^a-z0-9_-]+", "-", word.strip().lower()).strip("-") or "x"
    return name if name[0].isalpha() else f"x-{name}"


def _write_atom(fact: str) -> str:
    """`on(button-1)` becomes `(on button-1)`, anything else a predicate without arguments."""
    match = _PREDICATE.match(fact)
    if match is None:
        return f"({_clean(fact)})"
    words = [match.group(1), *(word for word in match.group(2).split(",") if word.strip())]
    return f"({' '.join(map(_clean, words))})"


def _write_all(facts: Iterable[str], negated: Iterable[str] = ()) -> str:
    atoms = [_write_atom(fact) for fact in sorted(facts)]
    atoms += [f"(not {_write_atom(fact)})" for fact in sorted(negated)]
    return f"(and {' '.join(atoms)})"


def make_domain(model: SymbolicModel, name: str = "escape-room") -> str:
    """Write the model's propositions and operators as a PDDL domain."""
    atoms = {fact: _write_atom(fact)[1:-1].split() for fact in model.propositions}
    if len({tuple(words) for words in atoms.values()}) < len(atoms):
        raise ValueError(f"two of these propositions have the same name in PDDL: {', '.join(atoms)}")
    predicates = sorted({(words[0], len(words) - 1) for words in atoms.values()})
    constants = sorted({word for words in atoms.values() for word in words[1:]})
    lines = [f"(define (domain {_clean(name)})", "  (:requirements :strips :negative-preconditions)"]
    if constants:
        lines.append(f"  (:constants {' '.join(constants)})")
    lines.append("  (:predicates " + " ".join(
        f"({' '.join([head, *(f'?x{i}' for i in range(count))])})" for head, count in predicates) + ")")
    for op in model.operators:
        lines += [
            f"  (:action {_clean(op.name)}",
            "    :parameters ()",
            f"    :precondition {_write_all(op.preconditions, op.forbidden)}",
            f"    :effect {_write_all(op.add, op.delete - op.add)})",
        ]
    return "\n".join(lines) + ")\n"


def make_problem(model: SymbolicModel, facts: frozenset[str], name: str = "room", domain: str = "escape-room") -> str:
    """Write the facts that hold now and those that open the exit as a PDDL problem."""
    begin = " ".join(_write_atom(fact) for fact in sorted(facts))
    return (f"(define (problem {_clean(name)})\n  (:domain {_clean(domain)})\n"
            f"  (:init {begin})\n  (:goal {_write_all(model.goal)}))\n")


def export_pddl(instance: RoomInstance, state: RoomState | None = None) -> tuple[str, str]:
    """Write an instance's puzzle as (domain, problem) texts.

    Args:
        instance: the room.
        state: where the problem begins; None for the start of an episode.
    """
    puzzle = instance.puzzle
    model = puzzle.make_symbolic_model()
    facts = puzzle.get_facts(puzzle.make_state() if state is None else state.puzzle)
    domain = f"escape-{puzzle.kind}"
    return make_domain(model, domain), make_problem(model, facts, f"room-{instance.id}", domain)


def save_pddl(instance: RoomInstance, folder: str | Path, state: RoomState | None = None) -> tuple[Path, Path]:
    """Write `domain.pddl` and `problem.pddl` into a folder; returns their paths."""
    paths = Path(folder) / "domain.pddl", Path(folder) / "problem.pddl"
    for path, text in zip(paths, export_pddl(instance, state), strict=True):
        write_text(path, text)
    return paths


def solve_pddl(instance: RoomInstance, state: RoomState | None = None, engine: str = "fast-downward",
               time_limit: float = 30.0) -> tuple[Operator, ...]:
    """Solve the exported problem with a planner of unified-planning.

    Args:
        instance: the room.
        state: where the problem begins; None for the start of an episode.
        engine: name of a planner known to unified-planning; `fast-downward-opt` finds the fewest operators.
        time_limit: s.

    Returns:
        The operators that open the exit, in order.

    Raises:
        MissingExtraError: unified-planning is not installed.
        PlanningFailed: the planner found none.
    """
    try:
        from unified_planning.engines import PlanGenerationResultStatus
        from unified_planning.io import PDDLReader
        from unified_planning.shortcuts import OneshotPlanner, get_environment
    except ImportError:
        raise MissingExtraError("unified-planning", "pddl", "solving PDDL") from None
    get_environment().credits_stream = None  # else it prints a banner
    model = instance.puzzle.make_symbolic_model()
    if state is not None and model.goal <= instance.puzzle.get_facts(state.puzzle):
        return ()
    problem = PDDLReader().parse_problem_string(*export_pddl(instance, state))
    with OneshotPlanner(name=engine) as planner:
        result = planner.solve(problem, timeout=time_limit)  # type: ignore[attr-defined]  # mixed in
    if result.plan is None:
        timed_out = result.status == PlanGenerationResultStatus.TIMEOUT
        start = instance.starts[0]
        pose = (start.x, start.y, 0.0) if state is None else (state.x, state.y, 0.0)
        raise PlanningFailed(
            PlanningReason.TIMEOUT if timed_out else PlanningReason.PRECONDITION_UNMET,
            "the puzzle's solution", pose, planners=(engine,), nearest=f"status {result.status.name}",
        )
    operators = {_clean(op.name): op for op in model.operators}
    return tuple(operators[action.action.name] for action in result.plan.actions)
