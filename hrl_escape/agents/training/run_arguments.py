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

    @property
    def identity(self) -> dict[str, Any]:
        """The arguments as JSON values; one thread, which most runs have, goes without saying."""
        values = dataclasses.asdict(self)
        return values if self.threads != 1 else {name: value for name, value in values.items() if name != "threads"}
