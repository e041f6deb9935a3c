"""Experiments of the largest expected information gain, and options built from learned dependencies.

Vigorito and Barto (2010), Intrinsically motivated hierarchical skill learning in structured environments. A decision
tree per action and variable is split leaf by leaf (`trees.py`), and the expected information of a sample is the
intrinsic reward. A leaf where an action turns a bit on is an option: other options first turn on the bits that the
leaf needs. The next experiment is the most rewarding one that options can reach, one after another. What has been
learned therefore makes the rest reachable.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, MarkovRun, OptionPolicy, SMDPTransition
from hrl_escape.agents.algorithms.factored_r_max import FactoredRMax
from hrl_escape.agents.factored.search import ActionModel, ModelPlan, SearchTables, compile_action
from hrl_escape.agents.factored.structure import GrowingSets, StructureLearner
from hrl_escape.agents.factored.trees import TreeLearner, compile_trees
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class VigoritoBartoSettings(AgentSettings):
    """Settings of `vigorito-barto`: trees, experiments, options and search."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    max_parents: Annotated[int, Range(0, 8)] = 2
    """Most factors that decide an outcome, apart from a bit's own value. The number of hypotheses is the number of
    factors to this power."""
    conditions: Literal["all-on", "any"] = "all-on"
    """Contexts that a set of parents distinguishes. `all-on`: whether all of them are on, as in a graph of
    prerequisites (requires binary factors). `any`: each combination of their values."""
    most_nodes: Annotated[int, Range(1)] = 20_000
    """Most states that a search expands. Goals not found by then count as unreachable."""
    visits: Annotated[int, Range(1)] = 3
    """Samples of a context before a variable gets its option; with `sets`, the context then counts as known."""
    models: Literal["trees", "sets"] = "trees"
    """Models of an action's outcomes. `trees`: decision trees, and the experiment of the largest information gain.
    `sets`: sets of at most `max_parents` parents, distinguished by `conditions`, and the nearest experiment that can
    separate two of them; always used if some factor is not binary."""
    evidence: Annotated[float, Range(0)] = 3.0
    """Smallest increase of the criterion for a split, in nats, with `trees`. More makes smaller trees."""
    least_gain: Annotated[float, Range(0)] = 0.3
    """Smallest discounted information, in nats summed over outcomes, that is worth an experiment, with `trees`. Below
    it the agent pursues the task. More explores less."""


class Skill(NamedTuple):
    """A way to turn a bit on."""

    action: int  # the action that turns it on
    needs: tuple[tuple[int, int], ...]  # conditions on a packed state: pairs of a factor's bits and its value


class VigoritoBarto(FactoredRMax):
    """Make the experiment with the most information, by way of options; without one, go to the end of the task.

        gain(s, a)  = sum over outcomes i of max over factors f of I(leaf of tree (a, i) that s falls into, f, s_f)
        experiment  = argmax over actions a and states s that options lead to of gamma^(k_s + k_a) gain(s, a)

    I is the expected information of one more sample about the distribution of the outcome in the leaf, among its
    samples with that value of f. The trees predict s, k_s primitives from here. Options are not continued from a state
    that is worth less than the best experiment found so far.
    """

    settings: VigoritoBartoSettings

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: VigoritoBartoSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._skills: dict[int, Skill] = {}
        self._skills_of: SearchTables | None = None
        """The compiled model behind the skills."""

    def make_learner(self, sizes: NDArray[np.int64], actions: int, max_parents: int, all_on: bool) -> StructureLearner:
        """Make empty trees, or empty sets of parents."""
        if self.settings.models == "trees" and (sizes == 2).all():
            return TreeLearner(sizes, actions, self.settings.evidence)
        return GrowingSets(sizes, actions, max_parents, all_on)

    def compile_model(self, *arguments: Any) -> ActionModel:
        """Return rules from the leaves of trees, or from sets of parents."""
        return (compile_trees if isinstance(arguments[0], TreeLearner) else compile_action)(*arguments)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Add to the history; the end of an episode discards the plan."""
        return {**super().observe(transition), "skills": len(self.find_skills())}

    # --- the graph ------------------------------------------------------------------------

    def get_graph(self) -> frozenset[tuple[int, int]]:
        """Return edges (parent, child): some action turns the child on, and needs a value of the parent."""
        learner = self.model.learner
        if not isinstance(learner, TreeLearner):
            return super().get_graph()
        names = self.model.components.tolist()
        turned_on = {(action, int(leaves.outcomes[leaf])) for action in range(learner.actions)
                     for leaves in (learner.get_leaves(action),) for leaf in learner.list_changes(action)
                     if leaves.totals[leaf].argmax() == 1}
        return frozenset((names[parent], names[child]) for action, child in turned_on
                         for parent in learner.find_parents(action, child, own=0))

    # --- options of bits --------------------------------------------------------------------

    def find_skills(self) -> dict[int, Skill]:
        """Return skills by bit of a packed state: the one with the fewest conditions; ties by the first action."""
        self._careful.update(self.model)
        if self._skills_of is not self._careful.tables:
            self._skills_of, self._skills = self._careful.tables, {}
            is_tree = isinstance(self.model.learner, TreeLearner)
            for bit, skill in self._list_in_rules() if is_tree else self._list_in_sets():
                if bit not in self._skills or len(skill.needs) < len(self._skills[bit].needs):
                    self._skills[bit] = skill
        return self._skills

    def _list_in_rules(self) -> Iterator[tuple[int, Skill]]:
        masks = self.model.packing.masks
        for action, model in enumerate(self._careful.models):
            for rule in model.rules:
                if rule.put:
                    yield rule.put, Skill(action, tuple((mask, rule.value & mask) for mask in masks
                                                        if rule.care & mask and mask != rule.put))

    def _list_in_sets(self) -> Iterator[tuple[int, Skill]]:
        """Bits that actions turn on while all parents are on, each once."""
        learner, packing, taken = self.model.learner, self.model.packing, set()
        for action in range(learner.actions):
            for outcome in learner.list_active(action).tolist():
                if outcome >= learner.over or learner.sizes[outcome] != 2 or outcome in taken:
                    continue
                believed = int(learner.get_alive(action, outcome)[0])
                context = 0 if learner.all_on else int(learner.context_counts[believed]) - 1
                on = learner.get_counts(action, believed, outcome)[context, 0]
                if on.sum() >= self.settings.visits and on.argmax() == 1:
                    taken.add(outcome)
                    yield packing.masks[outcome], Skill(action, tuple(
                        (packing.masks[p], 1 << int(packing.shifts[p])) for p in learner.hypotheses[believed]))

    def choose_towards(self, bit: int, state: int) -> int | None:
        """Return the next action towards turning a bit on in a packed state, or None if it is on or no way is known."""
        skills = self.find_skills()
        if state & bit:
            return None
        for _ in range(len(skills)):
            if bit not in skills:
                return None
            missing = [(mask, value) for mask, value in skills[bit].needs if state & mask != value]
            if not missing:
                return skills[bit].action
            bit, value = missing[0]
            if not value:
                return None  # it would have to be turned off
        return None  # the bits need each other

    def get_options(self) -> tuple[OptionPolicy, ...]:
        """Return an option for each bit that can be turned on, from states where it is off; or the whole policy."""
        return tuple(map(self._export, sorted(self.find_skills()))) or super().get_options()

    def _export(self, bit: int) -> OptionPolicy:
        component = self.model.components[self.model.packing.masks.index(bit)]

        def act(observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
            action = self.choose_towards(bit, self.model.pack(observation))
            assert action is not None, "the option may not start here"
            return action

        def can_start(observation: Any, action_mask: NDArray[np.bool_]) -> bool:
            action = self.choose_towards(bit, self.model.pack(observation))
            return action is not None and bool(action_mask[action])

        # It ends once the bit is on, or if the next action is illegal.
        run = MarkovRun(act, lambda observation, mask: not can_start(observation, mask))
        return OptionPolicy(f"bit-{component}", self, lambda: run, can_start, is_markov=True)

    # --- experiments ------------------------------------------------------------------------

    def _find_plan(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """Way to the next experiment, by trees or by sets of parents, or to the end of the task if none is left."""
        if not isinstance(self.model.learner, TreeLearner):
            return super()._find_plan(observation, action_mask)
        plan = self.find_experiment(observation, action_mask)
        self._is_exploring = bool(plan.actions)
        return plan if plan.actions else self._find_escape(observation, action_mask)

    def find_experiment(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """Return the way by options to the experiment of the largest discounted information gain, its last action.

        Options follow each other while a better experiment is possible at the end. The plan's value is that gain, in
        nats. The plan is empty if no experiment is worth `least_gain`.
        """
        learner, shifts = self.model.learner, self.model.packing.shifts
        assert isinstance(learner, TreeLearner)
        skills, (durations, places) = self.find_skills(), self.model.estimate_durations(observation)
        start = _Way(self.model.pack(observation), (), (), 0.0, -1)
        best, plan, ways, seen = 0.0, ModelPlan((), (), -np.inf), [start], {start.state}
        while ways:
            states = np.array([way.state for way in ways])[:, None] >> shifts & 1
            gains = learner.compute_gains(states.astype(np.bool_))
            for row, way in enumerate(ways):
                gains[row] *= self._find_legal(way, action_mask) * self.gamma ** (way.elapsed + durations[way.place])
            row, action = divmod(int(gains.argmax()), learner.actions)
            if gains[row, action] <= best:
                break
            best, way = float(gains[row, action]), ways[row]
            plan = ModelPlan((*way.actions, action), (*way.states, way.state), best)
            ends = [self._follow(bit, way, action_mask, durations, places) for bit in skills]
            ways = list({end.state: end for end in ends if end is not None and end.state not in seen}.values())
            seen.update(way.state for way in ways)
        return plan if best >= self.settings.least_gain else ModelPlan((), (), -np.inf)

    def _follow(self, bit: int, way: _Way, action_mask: NDArray[np.bool_], durations: NDArray[np.float64],
                places: NDArray[np.int64]) -> _Way | None:
        """A way extended by an option until its bit is on, or None if the outcome is not predictable."""
        for _ in range(len(self.model.components)):
            action = self.choose_towards(bit, way.state)
            if action is None or not self._find_legal(way, action_mask)[action]:
                break
            way = _Way(self.predict(way.state, action), (*way.actions, action), (*way.states, way.state),
                       way.elapsed + durations[way.place, action], int(places[action]))
        return way if way.actions and way.state & bit else None

    def _find_legal(self, way: _Way, action_mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Actions that can follow: legal ones here; later all except a last one that never follows itself."""
        if not way.actions:
            return action_mask
        legal = np.ones(len(action_mask), np.bool_)
        legal[way.actions[-1]] = self.model.repeatable[way.actions[-1]]
        return legal

    def predict(self, state: int, action: int) -> int:
        """Return the likeliest state after an action; unchanged if the task ends."""
        matching = [rule for rule in self._careful.models[action].rules if state & rule.care == rule.value]
        if any(rule.over for rule in matching):
            return state
        for rule in matching:
            state = state & ~rule.clear | rule.put
        return state


class _Way(NamedTuple):
    """A sequence of options: the final state, the actions, and the state before each action.

    `elapsed` is in primitives, `place` the row of the table of durations at the end.
    """

    state: int
    actions: tuple[int, ...]
    states: tuple[int, ...]
    elapsed: float
    place: int
