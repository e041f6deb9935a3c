"""PDDL export of any puzzle's symbolic model, and the way to the planners of unified-planning.

The export is plain text in the STRIPS subset with negative preconditions, ground: one action an operator, which every
classical planner reads. Conditional effects and action costs are declared where a model has some. Solving needs the
extra `pddl`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.puzzles.symbolic import Operator, SymbolicModel
from hrl_escape.errors import MissingExtraError, UnknownNameError, UnsupportedError
from hrl_escape.files import write_text

_PREDICATE = re.compile(r"^([^()]+)\(([^()]*)\)$")


def clean_name(word: str) -> str:
    """A PDDL name: letters, digits, - and _, beginning with a letter; PDDL ignores case."""
    name = re.sub(r"[^a-z0-9_-]+", "-", word.strip().lower()).strip("-") or "x"
    return name if name[0].isalpha() else f"x-{name}"


def write_atom(fact: str) -> str:
    """`on(button-1)` becomes `(on button-1)`, anything else a predicate without arguments."""
    match = _PREDICATE.match(fact)
    if match is None:
        return f"({clean_name(fact)})"
    words = [match.group(1), *(word for word in match.group(2).split(",") if word.strip())]
    return f"({' '.join(map(clean_name, words))})"


def write_all(facts: Iterable[str], negated: Iterable[str] = ()) -> str:
    """Write the conjunction of facts that hold and facts that do not: `(and (on button-1) (not (on button-2)))`."""
    atoms = [write_atom(fact) for fact in sorted(facts)]
    atoms += [f"(not {write_atom(fact)})" for fact in sorted(negated)]
    return f"(and {' '.join(atoms)})"


def make_domain(model: SymbolicModel, name: str = "escape-room") -> str:
    """Write the model's propositions and operators as a PDDL domain."""
    atoms = {fact: write_atom(fact)[1:-1].split() for fact in model.propositions}
    if len({tuple(words) for words in atoms.values()}) < len(atoms):
        raise ValueError(f"two of these propositions have the same name in PDDL: {', '.join(atoms)}")
    predicates = sorted({(words[0], len(words) - 1) for words in atoms.values()})
    constants = sorted({word for words in atoms.values() for word in words[1:]})
    extra = " :conditional-effects" if any(op.when for op in model.operators) else ""
    extra += " :action-costs" if _has_costs(model) else ""
    lines = [f"(define (domain {clean_name(name)})", f"  (:requirements :strips :negative-preconditions{extra})"]
    if constants:
        lines.append(f"  (:constants {' '.join(constants)})")
    lines.append("  (:predicates " + " ".join(
        f"({' '.join([head, *(f'?x{i}' for i in range(count))])})" for head, count in predicates) + ")")
    if _has_costs(model):
        lines.append("  (:functions (total-cost) - number)")
    for op in model.operators:
        lines += [f"  (:action {clean_name(op.name)}", "    :parameters ()",
                  f"    :precondition {write_all(op.preconditions, op.forbidden)}",
                  f"    :effect {_write_effects(op, _has_costs(model))})"]
    return "\n".join(lines) + ")\n"


def _has_costs(model: SymbolicModel) -> bool:
    return any(op.cost != 1.0 for op in model.operators)


def _write_effects(op: Operator, has_costs: bool) -> str:
    parts = [write_all(op.add, op.delete - op.add)[len("(and ") : -1]]
    parts += [f"(when {write_all(effect.condition, effect.forbidden)} "
              f"{write_all(effect.add, effect.delete - effect.add)})" for effect in op.when]
    if has_costs:
        parts.append(f"(increase (total-cost) {op.cost:g})")
    return f"(and {' '.join(filter(None, parts))})"


def make_problem(model: SymbolicModel, facts: frozenset[str], name: str = "room", domain: str = "escape-room") -> str:
    """Write the facts that hold now and those that open the exit as a PDDL problem."""
    begin = " ".join(write_atom(fact) for fact in sorted(facts))
    costs = _has_costs(model)
    return (f"(define (problem {clean_name(name)})\n  (:domain {clean_name(domain)})\n"
            f"  (:init {begin}{' (= (total-cost) 0)' if costs else ''})\n  (:goal {write_all(model.goal)})"
            f"{' (:metric minimize (total-cost))' if costs else ''})\n")


def export_pddl(instance: RoomInstance, state: RoomState | None = None) -> tuple[str, str]:
    """Write an instance's puzzle as (domain, problem) texts.

    Args:
        instance: the room.
        state: where the problem begins, or None for the start of an episode.
    """
    puzzle = instance.puzzle
    model = instance.symbolic_model
    facts = puzzle.symbolic.get_facts(puzzle.make_state() if state is None else state.puzzle)
    domain = f"escape-{puzzle.kind}"
    return make_domain(model, domain), make_problem(model, facts, f"room-{instance.id}", domain)


def save_pddl(instance: RoomInstance, folder: str | Path, state: RoomState | None = None) -> tuple[Path, Path]:
    """Write `domain.pddl` and `problem.pddl` into a folder; returns their paths."""
    paths = Path(folder) / "domain.pddl", Path(folder) / "problem.pddl"
    for path, text in zip(paths, export_pddl(instance, state), strict=True):
        write_text(path, text)
    return paths


def read_problem(domain: str, problem: str) -> Any:
    """Read PDDL texts as a `Problem` of unified-planning. Raises `MissingExtraError`."""
    try:
        from unified_planning.io import PDDLReader
        from unified_planning.shortcuts import get_environment
    except ImportError:
        raise MissingExtraError("unified-planning", "pddl", "solving PDDL") from None
    get_environment().credits_stream = None  # otherwise it prints a banner
    return PDDLReader().parse_problem_string(domain, problem)


def run_engine(problem: Any, engine: str, time_limit: float) -> tuple[Any, str]:
    """Solve a problem with a planner of unified-planning; returns its plan, or None, and the name of its status.

    Raises:
        UnknownNameError: no such planner is installed.
        UnsupportedError: it does not take problems of this kind.
    """
    from unified_planning.exceptions import UPUsageError
    from unified_planning.shortcuts import OneshotPlanner, get_environment

    factory = get_environment().factory
    planners = [name for name in factory.engines if factory.engine(name).is_oneshot_planner()]
    if engine not in planners:
        raise UnknownNameError("planner of unified-planning", engine, planners)
    try:
        with OneshotPlanner(name=engine) as planner:
            result = planner.solve(problem, timeout=time_limit)  # type: ignore[attr-defined]  # mixed in
    except UPUsageError as error:
        raise UnsupportedError(f"{engine} does not solve this problem: {error}") from None
    return result.plan, result.status.name
