"""Arguments of a training run that are part of its identity."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

__all__ = ["RunArguments"]


@dataclass(frozen=True)
class RunArguments:
    """Arguments of a run; see `train`.

    Attributes:
        agent_state: hash of the state of an agent that was given as an object; None for one made by name.
        threads: of torch.
        until_return: mean return of two evaluations in a row that ends the run; None where the budget alone does.
        eval_trials: parts of an evaluation episode that count as episodes of their own.
    """

    name: str
    seed: int
    primitives: int
    decisions: int | None
    eval_every: int
    eval_episodes: int
    eval_seed: int
    agent_state: str | None = None
    threads: int = 1
    until_return: float | None = None
    eval_trials: int = 1

    @property
    def identity(self) -> dict[str, Any]:
        """The arguments as JSON values; one thread, no end but the budget's and whole episodes go unsaid."""
        unsaid = {"threads": 1, "until_return": None, "eval_trials": 1}
        return {name: value for name, value in dataclasses.asdict(self).items()
                if name not in unsaid or value != unsaid[name]}
