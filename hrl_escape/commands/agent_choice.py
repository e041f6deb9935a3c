"""The choice of an agent to train: the options that `train` and `watch` share. Not a command."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Literal, TypeAlias

from hrl_escape.agents.label import DEFAULT_RECIPE
from hrl_escape.commands.room_choice import split_assignment
from hrl_escape.comparison.grid import AgentSpec
from hrl_escape.env.observations.base import list_observations
from hrl_escape.errors import ConfigError

if TYPE_CHECKING:
    VectorObservation: TypeAlias = str
else:  # choices that `--help` lists
    VectorObservation = Literal[tuple(observation.name for observation in list_observations() if observation.is_vector)]


@dataclasses.dataclass(frozen=True)
class AgentChoice:
    """Options that say how an agent is trained; dataclasses of commands inherit them."""

    recipe: str = DEFAULT_RECIPE
    """Recipe of the agent's settings; `hrl-escape list recipes` names those of each agent."""
    settings: tuple[str, ...] = ()
    """Settings to change, as name=value; `hrl-escape train AGENT --list-settings` shows them."""
    options_only: bool = False
    """Let an smdp- agent choose among options only, as +no-primitives does."""
    option_set: str | None = None
    """Named option set: press (one button, by default), press-with-ancestors (first those that must be on before it),
    press-reactive (one button by a function of the state, as +markov does); see `hrl-escape list option-sets`."""
    memory: bool = False
    """Show an smdp- agent what it has tried in this episode, beside each object, as +memory does."""
    leaves: Literal["planned", "learned"] | None = None
    """Run a hierarchy synthesised from the room, for agents such as maxq-q or hamq, as +planned and +learned do: the
    planner walks to each target, or walking is learned over primitives."""
    observation: VectorObservation | None = None
    """Observation of the agent: features by default, or objects for agents that need it; with --leaves it is what the
    tasks ask for."""

    def make_spec(self, agent: str) -> AgentSpec:
        """The agent of a name or label, trained as the options say.

        Raises:
            ConfigError: an option contradicts the label.
        """
        spec = AgentSpec.parse(agent)
        for name, given, in_label, default in (
            ("recipe", self.recipe, spec.recipe, DEFAULT_RECIPE),
            ("option_set", self.option_set, spec.options.option_set, "press"),
            ("leaves", self.leaves, spec.leaves, None),
        ):
            if in_label != default and given not in (None, DEFAULT_RECIPE, in_label):
                raise ConfigError(name, given, f"{in_label}, as in {agent}, or left out")
        options = dataclasses.replace(
            spec.options, include_primitives=spec.options.include_primitives and not self.options_only,
            option_set=self.option_set or spec.options.option_set, memory=spec.options.memory or self.memory)
        settings = spec.settings | dict(split_assignment(text, "--settings", "gamma=0.95") for text in self.settings)
        recipe = self.recipe if spec.recipe == DEFAULT_RECIPE else spec.recipe
        return AgentSpec(spec.name, spec.label if "+" in agent else "", recipe, settings, options,
                         self.leaves or spec.leaves)

    def choose_observation(self, spec: AgentSpec) -> str:
        """Observation that is asked for, or else the one that the agent needs."""
        return self.observation or spec.default_observation
