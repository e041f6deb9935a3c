"""Skill chaining: options built backwards from the goal, each leading to the states where the next can begin.

Konidaris and Barto (2009), in tables. The initiation set of an option is learned: it includes states that reached its
target within some decisions, if a way there is known. States whose runs fail are removed again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from hrl_escape.agents.agent import AgentSettings, SMDPTransition
from hrl_escape.agents.discovery import (
    NOTHING,
    DiscoveringAgent,
    Discovery,
    StateGraph,
    TableSkill,
    load_skills,
    make_subgoal_option,
    save_skills,
)
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class SkillChainingSettings(AgentSettings):
    """Settings of `skill-chaining`: length of the chain, and data of its initiation sets."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive, or per decision if `discounting` is `decision`. Higher values look further ahead and
    learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma, as the
    paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination, as in the
    paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy` draws evenly with probability epsilon. `boltzmann` draws by exp(q / temperature)."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return. More explores more."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as in keras-rl 0.4.2; values beyond it are equally likely. 0
    sets none."""
    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.5
    """Step size of the first update of a state and action. 1 suits deterministic environments; smaller values average
    noise."""
    learning_rate_power: Annotated[float, Range(0, 1)] = 0.0
    """Power p in the step size learning_rate / n^p of the n-th update of a state and action. Values above 0.5 converge
    under noise."""
    initial_value: float = 0.0
    """Value of actions that were never tried, in units of return. Higher values explore more."""
    use: Literal["explore", "choose"] = "choose"
    """`explore`: options run in exploration only, and the policy is over primitives. `choose`: the policy chooses among
    primitives and options, valued by intra-option Q-learning."""
    option_share: Annotated[float, Range(0, 1)] = 0.2
    """Share of exploratory choices that begin an option, if one can begin; the others are primitives."""
    skills: Annotated[int, Range(1)] = 8
    """Most options of the chain."""
    gestation: Annotated[int, Range(1)] = 5
    """Arrivals in a target before its option is made. More make better options, later."""
    reach: Annotated[int, Range(1)] = 10
    """Number of decisions before an arrival whose states are candidates for the initiation set. More make it larger."""
    start_rate: Annotated[float, Range(0, 1)] = 0.5
    """Smallest estimated success rate of states in the initiation set, (arrivals + 1) / (runs + 2). More make options
    more reliable and their initiation sets smaller."""


class SkillChain(Discovery):
    """A chain of options, built from its end.

    Attributes:
        targets: state number -> level of the target that it belongs to; level 0 is the end of the task.
    """

    STATE = (
        Kept("targets", pack=lambda targets: [list(item) for item in targets.items()], unpack=dict),
        "_sets",
        Kept("_made", pack=save_skills, unpack=load_skills),
        Kept("_outcomes", pack=lambda counts: [[*key, *count] for key, count in counts.items()],
             unpack=lambda rows: {(level, state): (arrived, runs) for level, state, arrived, runs in rows}),
        "_arrivals",
        Kept("_recent", pack=list),
        "_has_begun",
        "_begins_inside",
    )

    def __init__(self, settings: SkillChainingSettings) -> None:
        self._settings = settings
        self.slots = settings.skills
        self.targets: dict[int, int] = {}
        self._sets: list[list[int]] = [[]]
        """By level, the states that reached its target; the last level has no option yet."""
        self._made: list[TableSkill] = []
        """Option of each level."""
        self._runs: list[list[int]] = []
        """By level, the states of a run of its option, or of other options with the same actions."""
        self._outcomes: dict[tuple[int, int], tuple[int, int]] = {}
        """(level, state) -> arrivals in the level's target, and number of attempts."""
        self._relearned: set[int] = set()
        """Levels whose initiation set may have changed."""
        self._arrivals = 0
        self._recent: deque[int] = deque(maxlen=settings.reach)
        self._has_begun, self._begins_inside = False, False

    def observe(self, transition: SMDPTransition, before: int, after: int) -> None:
        """Follow the episode; at an arrival in the current target, store the states before it."""
        level = len(self._sets) - 1
        self._judge_runs(transition, before, after)
        if not self._has_begun:
            self._has_begun, self._begins_inside = True, before in self.targets
        if before not in self.targets:
            self._recent.append(before)
        if transition.terminated:
            self.targets.setdefault(after, 0)
        if self.targets.get(after) == level and before not in self.targets:
            self._arrivals += 1
            for state in dict.fromkeys(self._recent):
                self._count(level, state, arrived=True)
            self._sets[level] = list(dict.fromkeys([*self._sets[level], *self._recent]))
        if after in self.targets:
            self._recent.clear()
        if transition.terminated or transition.truncated:
            self._recent.clear()
            self._has_begun = False

    def _judge_runs(self, transition: SMDPTransition, before: int, after: int) -> None:
        """Follow runs of options. A run that arrives or ends elsewhere is a sample for all states that it visited."""
        for level, (option, run) in enumerate(zip(self._made, self._runs, strict=True)):
            if transition.cut or before >= len(option.actions) or option.actions[before] != transition.action:
                run.clear()  # another option has acted
                continue
            run.append(before)
            arrived = self.targets.get(after, 0 if transition.terminated else NOTHING) == level
            if arrived or transition.terminated or after >= len(option.actions) or option.actions[after] == NOTHING:
                for state in run:
                    self._count(level, state, arrived)
            if arrived or transition.terminated or transition.truncated:
                run.clear()

    def _count(self, level: int, state: int, arrived: bool) -> None:
        arrivals, runs = self._outcomes.get((level, state), (0, 0))
        self._outcomes[level, state] = arrivals + arrived, runs + 1
        self._relearned.add(level)

    def _learn_starts(self, level: int) -> Mapping[int, TableSkill]:
        """Option of a level with its current initiation set, if that has changed."""
        option = self._made[level]
        counts = np.array([self._outcomes.get((level, state), (0, 0)) for state in range(len(option.actions))])
        rates = (counts[:, 0] + 1) / (counts[:, 1] + 2)
        starts = (option.actions != NOTHING) & (rates >= self._settings.start_rate)
        if (starts == option.starts).all():
            return {}
        self._made[level] = replace(option, starts=starts)
        return {level: self._made[level]}

    def propose(self, graph: StateGraph) -> Mapping[int, TableSkill]:
        """Return options whose initiation set has changed, and the next one.

        The next one is made once its target was reached often enough and episodes still begin outside the chain.
        """
        level = len(self._sets) - 1
        changed = {number: option for each in sorted(self._relearned) if each < len(self._made)
                   for number, option in self._learn_starts(each).items()}
        self._relearned.clear()
        if self._arrivals < self._settings.gestation or level >= self.slots or self._begins_inside:
            return changed
        model = graph.make_model()
        inside, targets = (np.zeros(len(graph), np.bool_) for _ in range(2))
        inside[self._sets[level]] = True
        targets[[state for state, of in self.targets.items() if of == level]] = True
        option = make_subgoal_option(f"skill-{level + 1}", model, inside & ~targets, targets)
        for state in np.flatnonzero(option.starts).tolist():
            self.targets.setdefault(state, level + 1)
        self._sets.append([])
        self._made.append(option)
        self._runs.append([])
        self._arrivals = 0
        return changed | {level: option}

    def after_load(self) -> None:
        """Bound the stored runs; runs that were active at the checkpoint are not counted."""
        self._recent = deque(self._recent, maxlen=self._settings.reach)
        self._runs = [[] for _ in self._made]


class SkillChaining(DiscoveringAgent):
    """Q-learning over primitives and a chain of options to the end of the task.

    The target T_0 is the end of the task. After `gestation` arrivals in T_i, option i leads there from its initiation
    set: the states at most `reach` decisions before an arrival with a known way to T_i inside the set. T_(i+1) is that
    set. Afterwards runs of the option refine it: it can begin where (arrivals + 1) / (runs + 2) is at least
    `start_rate`. The chain is complete when episodes begin inside it.
    """

    settings: SkillChainingSettings
    Discovery = SkillChain
