"""Probes: measurements of an agent while it trains, which may also end its run before the budget."""

from __future__ import annotations

from typing import Any, Protocol

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.state import StateTree
from hrl_escape.agents.training.results import EpisodeRecord

__all__ = ["Probe"]


class Probe(Protocol):
    """Observer of one training run; it changes nothing in the agent or in the episodes to come.

    Its state is part of the run's checkpoints, so a resumed run measures what an uninterrupted one does.
    """

    @property
    def identity(self) -> dict[str, Any]:
        """The measurement and the stopping rule as a JSON value, part of the run's identity."""
        ...

    @property
    def is_done(self) -> bool:
        """Nothing is left to measure: the run ends after the present episode."""
        ...

    def after_decision(self, agent: Agent, primitives: int) -> None:
        """Measure after a decision, with this many primitives trained for."""
        ...

    def after_episode(self, agent: Agent, episode: EpisodeRecord) -> None:
        """Measure between training episodes; the evaluation environment may be used."""
        ...

    def state_dict(self) -> StateTree:
        """Everything that the coming measurements depend on, and the past ones."""
        ...

    def load_state_dict(self, state: StateTree) -> None:
        """Go on where `state_dict` was taken."""
        ...
