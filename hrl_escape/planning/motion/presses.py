"""Comparison of the presses of a continuous motion with those of its plan."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hrl_escape.env.kinematics import Rules
from hrl_escape.env.poses import list_touched
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.traits import Pushing
from hrl_escape.errors import UnsupportedError
from hrl_escape.planning.plan import Plan

__all__ = ["check_same_presses"]


def check_same_presses(plan: Plan, places: NDArray[np.float64]) -> None:
    """Check that a motion leaves the puzzle in the same state as its plan.

    A press is the first moment of touching a target. A motion may press more than its plan where the puzzle does not
    mind, such as a button that is lit already. Where the puzzle's state follows from more than presses (things carried
    or pushed, chance), the presses must be the plan's, one by one.

    Args:
        plan: the plan.
        places: x, y (m), heading and joint angles (rad) along the motion, shape (n, 3 + joints).

    Raises:
        UnsupportedError: the states differ.
    """
    rules, puzzle, first = Rules(plan.instance), plan.instance.puzzle, plan.states[0]
    home = np.array(rules.robot.home)
    still = (0,) * len(home)
    wanted = _list_begun(state.touching for state in plan.states)
    found = _list_begun((first.touching, *(
        rules.compute_touching(x, y, 0, heading, still, tuple(angles - home))
        for (x, y, heading), angles in zip(places[:, :3].tolist(), places[:, 3:], strict=True))))
    if [target for together in wanted for target in together] == [target for one in found for target in one]:
        return
    grips = any(plan.instance.robot.actions.primitives[action].grip for action in plan.primitives)
    if not (grips or puzzle.is_watching or puzzle.is_random or isinstance(puzzle, Pushing)):
        state = first.puzzle
        for together in found:
            state = puzzle.update(state, Contacts(together))
        if state == plan.states[-1].puzzle:
            return

    def write(begun: list[tuple[int, ...]]) -> str:
        """Names of the targets pressed, in order."""
        return ", ".join(plan.instance.targets[target].name for one in begun for target in one) or "nothing"

    raise UnsupportedError(f"the trajectory of {plan.name!r} would press {write(found)}, where the plan presses "
                           f"{write(wanted)}: follow its primitives instead")


def _list_begun(touching: Iterable[int]) -> list[tuple[int, ...]]:
    """List the bits of the targets whose touch begins, from the bits touched at consecutive places."""
    begun, before = [], -1
    for now in touching:
        new = now & ~before
        if new:
            begun.append(list_touched(new))
        before = now
    return begun
