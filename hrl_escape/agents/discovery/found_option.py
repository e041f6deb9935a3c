"""Options found in a learned model of states: tables from states to primitives, with an end where there is no entry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

NOTHING = -1
"""In place of a primitive: the option ends, or cannot be."""
SWEEPS = 10_000
"""Bound on sweeps of value iteration."""
_TIE = 1e-9


class StateModel(NamedTuple):
    """Learned model of a finite walk."""

    follow: sparse.csr_matrix
    """(states * actions, states), probability of each next state; rows of 0 where nothing is known."""
    known: NDArray[np.bool_]  # bool (states, actions), pairs that were tried


@dataclass(frozen=True, eq=False)
class TableSkill:
    """A deterministic Markov option over numbered states."""

    name: str  # tells it from others
    actions: NDArray[np.int64]  # int64 (states,), the primitive in each state, `NOTHING` where it ends
    starts: NDArray[np.bool_]  # bool (states,), where it may begin


def _iterate(model: StateModel, values: NDArray[np.float64], gamma: float, gain: NDArray[np.float64] | float,
             settle: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[np.float64]:
    """Gain + gamma P V, (states, actions), at the fixed point of V = settle(its maximum over actions)."""
    for _ in range(SWEEPS):
        choices = gain + gamma * (model.follow @ values).reshape(model.known.shape)
        swept = settle(choices.max(axis=1))
        change, values = np.abs(swept - values).max(initial=0.0), swept
        if change < 1e-12:
            break
    return gain + gamma * (model.follow @ values).reshape(model.known.shape)


def make_eigenoption(name: str, model: StateModel, purpose: NDArray[np.float64], gamma: float) -> TableSkill:
    """Option that climbs a function of the state: paid e(s') - e(s), over where no more can be earned.

    The purpose e is (states,); its negative is another option. Gamma, below 1, discounts the option's own reward.

    Machado et al. (2017): the policy is optimal with one further action, to end, that earns nothing.
    """
    gain = np.where(model.known, (model.follow @ purpose).reshape(model.known.shape) - purpose[:, None], -np.inf)
    choices = _iterate(model, np.zeros(len(gain)), gamma, gain, lambda best: np.maximum(best, 0.0))
    best = choices.max(axis=1, keepdims=True)
    chosen = np.where(best[:, 0] > _TIE, (choices >= best - _TIE).argmax(axis=1), NOTHING)
    return TableSkill(name, chosen, chosen != NOTHING)


def make_point_option(name: str, model: StateModel, start: int, goal: int, gamma: float = 0.99) -> TableSkill:
    """Option from one state to another, to be there soon (Jinnai et al. 2019).

    It may begin in `start` alone, and ends in `goal`, and where no way there is known.
    """
    states = np.arange(len(model.known))
    option = make_subgoal_option(name, model, states == states, states == goal, gamma)
    return TableSkill(name, option.actions, option.starts & (states == start))


def make_subgoal_option(name: str, model: StateModel, inside: NDArray[np.bool_], targets: NDArray[np.bool_],
                        gamma: float = 0.99) -> TableSkill:
    """Option that stays `inside`, bool (states,), until it is in one of its targets, bool (states,), to be there soon.

    It maximises the expected gamma^k of arriving. It may begin wherever a way to a target is known that stays inside,
    so that it is never begun where it cannot arrive; it ends in targets, and everywhere else.
    """
    choices = _iterate(model, targets.astype(np.float64), gamma, 0.0,
                       lambda best: np.where(targets, 1.0, np.where(inside, best, 0.0)))
    best = choices.max(axis=1, keepdims=True)
    on_the_way = (best[:, 0] > 0) & inside & ~targets
    chosen = np.where(on_the_way, (choices >= best * (1 - _TIE)).argmax(axis=1), NOTHING)
    return TableSkill(name, chosen, on_the_way)
