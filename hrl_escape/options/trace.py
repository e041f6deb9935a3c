"""Trace of a decision: its steps as an agent at this level would have seen them, for intra-option learning."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["TraceStep"]


class TraceStep(NamedTuple):
    """One step of the wrapped environment inside a decision: a primitive, or a decision of the level below.

    Attributes:
        observation: observation of the wrapped environment before it.
        action: the primitive, as the wrapped environment took it.
        reward: its reward; the sum, if the level below ran several primitives.
        next_observation: observation after it.
        state: what options saw before; the full state of a room.
        next_state: the same after.
        next_action_mask: int8 (actions,), the actions legal after it.
        consistent: (action, beta) of the primitive itself and of every option that would have chosen it
            here, with beta the option's probability of ending after it. Only options whose policy is a
            function of the state are among them (see `Option.is_markov`).
        name: of the primitive; empty where primitives have no numbers.
        rewards: one a primitive of the lowest level.
        trace: trace of the level below, if there is one and it traces.
    """

    observation: Any
    action: Any
    reward: float
    next_observation: Any
    state: Any
    next_state: Any
    next_action_mask: NDArray[np.int8]
    consistent: tuple[tuple[int, float], ...]
    name: str = ""
    rewards: tuple[float, ...] = ()
    trace: tuple[Any, ...] = ()

