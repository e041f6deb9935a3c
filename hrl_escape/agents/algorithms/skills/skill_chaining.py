"""Skill chaining: options found backwards from the goal, each leading to where the next may begin.

Konidaris and Barto (2009), in tables: the initiation set of an option holds the states from which its target was
reached within some decisions, as far as a way there is known that stays within the set.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.discovery.discovering_agent import DiscoveringAgent, DiscoverySettings
from hrl_escape.agents.discovery.found_option import TableSkill, make_subgoal_option
from hrl_escape.agents.discovery.state_graph import StateGraph
from hrl_escape.agents.state import StateTree
from hrl_escape.settings import Range

__all__ = ["SkillChain", "SkillChaining", "SkillChainingSettings"]


@dataclass(frozen=True)
class SkillChainingSettings(DiscoverySettings):
    """Settings of `skill-chaining`."""

    use: Literal["explore", "choose"] = "choose"
    """`explore`: options are run in exploration alone, and the policy is over primitives. `choose`: they are choices
    beside the primitives, valued by intra-option Q-learning."""
    skills: Annotated[int, Range(1)] = 8
    """Most options of the chain."""
    gestation: Annotated[int, Range(1)] = 5
    """Arrivals in a target before an option to it is made."""
    reach: Annotated[int, Range(1)] = 10
    """Decisions before an arrival whose states belong to the initiation set."""


class SkillChain:
    """A chain of options, made from its end.

    Args:
        settings: of `skill-chaining`.

    Attributes:
        targets: state by number -> the level whose target it belongs to; level 0 is the end of the task.
    """

    def __init__(self, settings: SkillChainingSettings) -> None:
        self._settings = settings
        self.slots = settings.skills
        self.targets: dict[int, int] = {}
        self._sets: list[list[int]] = [[]]
        """By level, the states from which its target was reached; the last level has no option yet."""
        self._arrivals = 0
        self._recent: deque[int] = deque(maxlen=settings.reach)
        self._has_begun, self._begins_inside = False, False

    def observe(self, transition: SMDPTransition, before: int, after: int) -> None:
        """Follow the episode; at an arrival in the present target, keep the states before it."""
        level = len(self._sets) - 1
        if not self._has_begun:
            self._has_begun, self._begins_inside = True, before in self.targets
        if before not in self.targets:
            self._recent.append(before)
        if transition.terminated:
            self.targets.setdefault(after, 0)
        if self.targets.get(after) == level and before not in self.targets:
            self._arrivals += 1
            self._sets[level] = list(dict.fromkeys([*self._sets[level], *self._recent]))
        if after in self.targets:
            self._recent.clear()
        if transition.terminated or transition.truncated:
            self._recent.clear()
            self._has_begun = False

    def propose(self, graph: StateGraph) -> Mapping[int, TableSkill]:
        """The next option, once its target was reached often enough and episodes still begin outside the chain."""
        level = len(self._sets) - 1
        if self._arrivals < self._settings.gestation or level >= self.slots or self._begins_inside:
            return {}
        model = graph.make_model()
        inside, targets = (np.zeros(len(graph), np.bool_) for _ in range(2))
        inside[self._sets[level]] = True
        targets[[state for state, of in self.targets.items() if of == level]] = True
        option = make_subgoal_option(f"skill-{level + 1}", model, inside & ~targets, targets)
        for state in np.flatnonzero(option.starts).tolist():
            self.targets.setdefault(state, level + 1)
        self._sets.append([])
        self._arrivals = 0
        return {level: option}

    def state_dict(self) -> StateTree:
        """Targets, sets, arrivals and the states of the episode."""
        return {
            "targets": [list(item) for item in self.targets.items()],
            "sets": [list(states) for states in self._sets],
            "arrivals": self._arrivals,
            "recent": list(self._recent),
            "has_begun": self._has_begun,
            "begins_inside": self._begins_inside,
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        self.targets = {int(number): int(level) for number, level in state["targets"]}
        self._sets = [[int(number) for number in states] for states in state["sets"]]
        self._arrivals = int(state["arrivals"])
        self._recent = deque((int(number) for number in state["recent"]), maxlen=self._settings.reach)
        self._has_begun, self._begins_inside = bool(state["has_begun"]), bool(state["begins_inside"])


class SkillChaining(DiscoveringAgent):
    """Q-learning over primitives and a chain of options to the end of the task.

    The target T_0 is the end of the task. After `gestation` arrivals in T_i, option i leads there from its initiation
    set: of the states at most `reach` decisions before an arrival, those with a known way to T_i that stays among them.
    T_(i+1) is that set. The chain is complete when episodes begin inside it.
    """

    name: ClassVar[str] = "skill-chaining"
    Settings: ClassVar[type] = SkillChainingSettings
    settings: SkillChainingSettings

    def make_discovery(self) -> SkillChain:
        """The chain."""
        return SkillChain(self.settings)
