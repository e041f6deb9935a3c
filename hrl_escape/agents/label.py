"""Labels of agents: one short text names an agent, its recipe, and what it observes and chooses among.

`smdp-ppo+objects+memory+no-primitives` is the agent `smdp-ppo` with the setting `network=objects`, for an environment
with options, without primitives and with a memory of the episode. Every command and every function that takes an
agent's name takes a label; all of them read it here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from typing_extensions import Self

from hrl_escape.errors import AgentSettingsError, UnknownNameError

SMDP_PREFIX = "smdp-"
DEFAULT_RECIPE = "corrected"


@dataclass(frozen=True)
class AgentTrait:
    """Effect of a word behind `+`."""

    about: str  # effect, for help texts
    settings: Mapping[str, Any] = field(default_factory=dict)  # settings of the agent
    options: Mapping[str, Any] = field(default_factory=dict)  # arguments of the options, or `memory`
    leaves: Literal["planned", "learned"] | None = None  # leaves of a hierarchy that is synthesised from the room


TRAITS: dict[str, AgentTrait] = {
    "objects": AgentTrait("a network over rows of objects, with the observation `objects`", {"network": "objects"}),
    "memory": AgentTrait("a memory of the episode in these rows", options={"memory": True}),
    "gru": AgentTrait("a recurrent network", {"memory": "gru"}),
    "no-primitives": AgentTrait("options only, without primitives", options={"include_primitives": False}),
    "markov": AgentTrait("options that are functions of the state", options={"option_set": "press-reactive"}),
    "patient": AgentTrait("longer exploration and a larger replay memory, for dqn",
                     {"learning_rate": 1e-3, "epsilon_end": 0.1, "epsilon_steps": 30_000, "replay_capacity": 100_000}),
    "three-parents": AgentTrait("up to three parents a button, for agents that learn structure", {"max_parents": 3}),
    "planned": AgentTrait("a hierarchy synthesised from the room, with planned walks", leaves="planned"),
    "learned": AgentTrait("the same, with walks that are learned", leaves="learned"),
}
"""Words behind `+` in a label."""


@dataclass(frozen=True)
class AgentLabel:
    """A label in its parts."""

    text: str  # the label
    name: str  # name in the registry, or of a reference
    recipe: str = ""  # recipe behind `@`; empty where the label gives none
    settings: Mapping[str, Any] = field(default_factory=dict)  # settings that differ from the recipe's
    options: Mapping[str, Any] = field(default_factory=dict)  # what the environment's options must be
    leaves: Literal["planned", "learned"] | None = None  # of the hierarchy that the environment must have

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a label such as `dqn`, `smdp-dqn@paper`, `maxq-q+planned` or `smdp-dqn+objects+memory`.

        Args:
            text: a name, then `@` and a recipe, then words of `TRAITS`, each behind `+`.

        Returns:
            The label in its parts. Neither the name nor the recipe is looked up.

        Raises:
            UnknownNameError: no such trait.
            AgentSettingsError: two traits contradict each other, or a trait is about options that the agent does not
                choose among.
        """
        head, *words = text.split("+")
        name, _, recipe = head.partition("@")
        settings: dict[str, Any] = {}
        options: dict[str, Any] = {}
        leaves = None
        for word in words:
            if word not in TRAITS:
                raise UnknownNameError("trait of an agent", word, TRAITS)
            trait = TRAITS[word]
            if leaves is not None and trait.leaves not in (None, leaves):
                raise AgentSettingsError("agent", text, "either +planned or +learned")
            settings |= trait.settings
            options |= trait.options
            leaves = trait.leaves or leaves
            if trait.options and not name.startswith(SMDP_PREFIX):
                raise AgentSettingsError("agent", text, f"{SMDP_PREFIX}{name} with +{word}, which is about options, or "
                                         f"{name} without it")
        return cls(text, name, recipe, settings, options, leaves)

    def resolve_recipe(self, recipe: str) -> str:
        """Recipe of the label, or else the given one.

        Raises:
            AgentSettingsError: the label and the argument name two recipes.
        """
        if self.recipe and recipe not in (DEFAULT_RECIPE, self.recipe):
            raise AgentSettingsError("recipe", recipe, f"{self.recipe}, as in {self.text}, or left out")
        return self.recipe or recipe
