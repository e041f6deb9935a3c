"""The choice of an agent to train: the options that `train` and `watch` share. Not a command."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Literal, TypeAlias

from hrl_escape.commands.room_choice import split_assignment
from hrl_escape.comparison.grid import AgentSpec, OptionsView
from hrl_escape.env.observations.base import list_observations

if TYPE_CHECKING:
    VectorObservation: TypeAlias = str
else:  # choices that `--help` lists
    VectorObservation = Literal[tuple(observation.name for observation in list_observations() if observation.is_vector)]


@dataclasses.dataclass(frozen=True)
class AgentChoice:
    """Options that say how an agent is trained; dataclasses of commands inherit them."""

    recipe: str = "corrected"
    """Recipe of the agent's settings: corrected or paper."""
    settings: tuple[str, ...] = ()
    """Settings to change, as name=value; `hrl-escape train AGENT --list-settings` shows them."""
    options_only: bool = False
    """Let an smdp- agent choose among options only."""
    flavour: Literal["press", "press-with-ancestors", "press-markov"] = "press"
    """Meta-actions: press one button, or press first those that must be on before it."""
    memory: bool = False
    """Show an smdp- agent what it has tried in this episode, beside each object: with --observation objects."""
    leaves: Literal["planned", "learned"] | None = None
    """Run a hierarchy synthesised from the room, for agents such as maxq-q or hamq: the planner walks to each target,
    or walking is learned over primitives."""
    observation: VectorObservation = "features"
    """Observation of the agent; with --leaves it is what the tasks ask for."""

    def make_spec(self, agent: str) -> AgentSpec:
        """The agent of a name, trained as the options say."""
        options = OptionsView(include_primitives=not self.options_only, flavour=self.flavour, memory=self.memory)
        settings = dict(split_assignment(text, "--settings", "gamma=0.95") for text in self.settings)
        return AgentSpec(name=agent, recipe=self.recipe, settings=settings, options=options, leaves=self.leaves)
