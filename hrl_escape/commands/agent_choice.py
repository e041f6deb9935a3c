"""Options of `train` and `watch` that choose an agent; not a command."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Literal, TypeAlias

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.commands.room_choice import split_assignment
from hrl_escape.env.observations.base import list_observations
from hrl_escape.errors import ConfigError

if TYPE_CHECKING:
    VectorObservation: TypeAlias = str
else:  # choices that `--help` lists
    VectorObservation = Literal[tuple(observation.name for observation in list_observations() if observation.is_vector)]


@dataclasses.dataclass(frozen=True)
class AgentChoice:
    """Options of an agent's training, inherited by dataclasses of commands."""

    settings: tuple[str, ...] = ()
    """Settings to change, as name=value; `hrl-escape train AGENT --list-settings` shows them."""
    option_set: str | None = None
    """Named option set: press (one button, by default), press-with-ancestors (first those that must be on before it),
    press-reactive (one button by a function of the state, as +reactive does; see `hrl-escape list option-sets`."""
    observation: VectorObservation | None = None
    """Observation of the agent: features by default, or objects for agents that need it; with +planned or +learned it
    is the situation of the tasks."""

    def make_spec(self, agent: str | AgentSpec) -> AgentSpec:
        """Parse the spec of an agent with these options.

        Raises:
            ConfigError: an option contradicts the spec.
        """
        spec = AgentSpec.parse(agent)
        named = spec.options.option_set
        if named != "press" and self.option_set not in (None, named):
            raise ConfigError("option_set", self.option_set, f"{named}, as in {agent}, or left out")
        settings = spec.settings | dict(split_assignment(text, "--settings", "gamma=0.95") for text in self.settings)
        options = dataclasses.replace(spec.options, option_set=self.option_set or named)
        return dataclasses.replace(spec, label="" if options != spec.options else spec.label, settings=settings,
                                   options=options)

    def choose_observation(self, spec: AgentSpec) -> str:
        """Return the given observation, or the one that the agent needs."""
        return self.observation or spec.default_observation
