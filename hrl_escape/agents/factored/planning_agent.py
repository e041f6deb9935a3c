"""Factored model learned from a history of decisions, and agents that plan in it: to unknown outcomes, then to the end.

Everything else is derived from the history, and the history is therefore the checkpoint. The reward is modelled as a
usual rate per primitive plus a bonus at the end of a decision, and the bonus as an outcome like others. A masked action
is a sample too: it has no effect. Where an option can start is therefore learned like its effects. Agents choose which
hypotheses to believe.

Durations are learned separately from outcomes, from the pose where actions start. An action that always ends at about
the same pose leads to a place of its own. Between places the model uses the mean of the observed durations; elsewhere
it uses a linear function of distance, fitted to the history. Without a pose every action has its mean duration.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import make_rng, sample_legal
from hrl_escape.agents.factored.observation import FactorReader
from hrl_escape.agents.factored.search import (
    MOST_ACTIONS,
    ActionModel,
    ChooseHypotheses,
    ModelPlan,
    Packing,
    compile_action,
    find_plan,
    find_relevant,
    make_tables,
)
from hrl_escape.agents.factored.structure import LEVELS, StructureLearner
from hrl_escape.agents.state import Kept, Stateful, StateTree, pack_columns, unpack_columns
from hrl_escape.errors import UnsupportedSpaceError

NEAR = 0.15
"""A pose belongs to a place within this fraction of the mean distance between poses."""


class DurationHistory(NamedTuple):
    """Decisions in order, without those that truncation cut inside an option."""

    starts: NDArray[np.float64]  # (decisions, pose), pose before each
    actions: NDArray[np.int64]  # (decisions,)
    ends: NDArray[np.float64]  # (decisions, pose), pose after each
    durations: NDArray[np.float64]  # (decisions,), primitives
    previous: NDArray[np.int64]  # (decisions,), previous action in the same episode, or -1


class DurationModel(NamedTuple):
    """Durations between places, as fitted by `fit_durations`."""

    table: NDArray[np.float64]
    """(actions + 1, actions), primitives of each action from each place; the last row applies elsewhere."""
    places: NDArray[np.int64]  # (actions,), row of `table` after each action
    homes: NDArray[np.float64]  # (actions, pose), where each action ends
    weights: NDArray[np.float64]  # (pose,), weight of each number of the pose in a distance
    line: tuple[float, float]  # duration = line[0] + line[1] * distance
    near: float  # see `NEAR`, in units of that distance

    def compute_durations(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return `table` with a last row for this pose."""
        has_home = self.places < len(self.places)
        if not has_home.any():
            return self.table
        away = np.linalg.norm((self.homes - pose) * self.weights, axis=1)
        table = self.table.copy()
        table[-1] = np.where(has_home, _predict(self.line, away), self.table[-1])
        nearest = int(np.where(has_home, away, np.inf).argmin())
        if away[nearest] <= self.near:
            table[-1] = table[nearest]
        return table


def _predict(line: tuple[float, float], distance: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.maximum(line[0] + line[1] * distance, 1.0)


def fit_durations(history: DurationHistory, actions: int) -> DurationModel:
    """Fit durations to a history, which can be empty."""
    starts, chosen, ends, duration, previous = history
    if not len(chosen):
        return DurationModel(np.ones((actions + 1, actions)), np.full(actions, actions), np.zeros((actions, 0)),
                             np.zeros(0), (1, 0), 0)
    counts = np.bincount(chosen, minlength=actions)
    means = np.full(actions, duration.mean())
    means[counts > 0] = (np.bincount(chosen, duration, actions) / np.maximum(counts, 1))[counts > 0]
    table = np.tile(means, (actions + 1, 1))
    homes = np.zeros((actions, ends.shape[1]))
    np.add.at(homes, chosen, ends)
    homes /= np.maximum(counts, 1)[:, None]
    spread, scatter = ends.std(axis=0), np.sqrt(((ends - homes[chosen]) ** 2).mean(axis=0))
    weights = (scatter < 0.5 * spread).astype(np.float64)  # numbers that are similar at the ends, unlike the heading
    if len(chosen) < 3 or not weights.any():
        return DurationModel(table, np.full(actions, actions), homes, weights, (float(duration.mean()), 0.0), 0.0)
    scatters = np.linalg.norm((ends - homes[chosen]) * weights, axis=1)
    width = np.linalg.norm((ends - ends.mean(axis=0)) * weights, axis=1).mean()
    own = np.bincount(chosen, scatters, actions) / np.maximum(counts, 1)
    has_home = (counts > 0) & (own <= NEAR * width)
    places = np.where(has_home, np.arange(actions), actions)
    known = has_home[chosen]
    distance = np.linalg.norm((starts - homes[chosen]) * weights, axis=1)
    line = (float(duration.mean()), 0.0)
    if known.sum() >= 2 and distance[known].std() > 1e-9:
        design = np.column_stack([np.ones(known.sum()), distance[known]])
        offset, slope = np.linalg.lstsq(design, duration[known], rcond=None)[0]
        line = (float(offset), float(slope)) if slope > 0 else line
    between = np.linalg.norm((homes[:, None] - homes[None]) * weights, axis=2)
    pairs = has_home[:, None] & has_home[None]
    table[:-1] = np.where(pairs, _predict(line, between), table[:-1])
    travelled = previous >= 0
    cells = previous[travelled] * actions + chosen[travelled]
    seen = np.bincount(cells, minlength=actions * actions).reshape(actions, actions)
    total = np.bincount(cells, duration[travelled], actions * actions).reshape(actions, actions)
    table[:-1] = np.where(seen > 0, total / np.maximum(seen, 1), table[:-1])
    return DurationModel(table, places, homes, weights, line, NEAR * float(width))


REMEMBERED_DECISIONS = 2_000
"""Number of recent decisions that durations are fitted to."""


class Belief:
    """A compiled model, updated action by action.

    Args:
        choose: returns the hypotheses to believe; called again for an action after each of its samples.
        visits: number of samples that make a context known.

    Attributes:
        models: models of all actions since the last `update`.
    """

    def __init__(self, choose: ChooseHypotheses, visits: int) -> None:
        self.choose, self.visits = choose, visits
        self.models: list[ActionModel] = []
        self._compiled: dict[int, ActionModel] = {}

    def forget(self, action: int | None = None) -> None:
        """Mark an action, or (None) every action, for compilation."""
        for each in list(self._compiled) if action is None else [action]:
            self._compiled.pop(each, None)

    def update(self, model: FactoredModel) -> None:
        """Compile the marked actions."""
        actions, packing = range(model.learner.actions), model.packing
        if len(self._compiled) == len(actions):
            return
        for action in actions:
            if action not in self._compiled:
                self._compiled[action] = model.compile(model.learner, packing, action, self.choose, model.bonuses,
                                                       self.visits)
        self.models = [self._compiled[action] for action in actions]
        self.tables = make_tables(self.models)
        self.bonus = max([rule.bonus for each in self.models for rule in each.rules], default=0.0)
        self.relevant = find_relevant(self.models, packing.wide, with_gaps=False)
        self.relevant_with_gaps = find_relevant(self.models, packing.wide, with_gaps=True)


class PendingPlan(Stateful):
    """Rest of a plan, followed while it leads to the predicted states."""

    STATE = ("_states", "_actions")

    def __init__(self) -> None:
        self._states: list[int] = []
        self._actions: list[int] = []

    def begin(self, plan: ModelPlan) -> None:
        """Replace the plan."""
        self._states, self._actions = list(plan.states), list(plan.actions)

    def drop(self) -> None:
        """Discard the plan."""
        self._states, self._actions = [], []

    def take(self, state: int, legal: NDArray[np.bool_]) -> int | None:
        """Return the next action if the state is the predicted one and the action is legal."""
        if not self._states or self._states[0] != state or not legal[self._actions[0]]:
            return None
        self._states.pop(0)
        return self._actions.pop(0)


class _Recorded(NamedTuple):
    """A decision of the history."""

    before: NDArray[np.float64]  # flattened observation
    after: NDArray[np.float64]
    masks: NDArray[np.bool_]  # legal actions before
    action: int
    duration: int
    reward: float  # sum of the rewards
    over: bool
    previous: int  # previous action in the same episode, or -1
    again: bool  # whether the action was legal right after itself


class FactoredModel:
    """History of an agent, and the model derived from it.

    Args:
        conditions: `all-on` or `any`; see `FactoredRMaxSettings`.
        make_learner: (sizes of the factors, actions, max_parents, all_on) -> the structure learner.
        compile: makes the model of an action, with the arguments of `compile_action`.

    Attributes:
        repeatable: actions that were seen to be legal right after themselves, bool (actions,).
    """

    def __init__(
        self, space: gymnasium.Space, actions: int, gamma: float, max_parents: int, conditions: str, agent: str,
        make_learner: Callable[..., StructureLearner] = StructureLearner,
        compile: Callable[..., ActionModel] = compile_action,
    ) -> None:
        if actions > MOST_ACTIONS:
            raise UnsupportedSpaceError(f"{agent} plans with at most {MOST_ACTIONS} actions, got {actions}")
        self.gamma, self._actions, self._max_parents, self._agent = gamma, actions, max_parents, agent
        self._make_learner, self.compile = make_learner, compile
        self._reader = FactorReader(space, agent)
        self._all_on = conditions == "all-on" and bool((self._reader.sizes == 2).all())
        self._rows: list[_Recorded] = []
        self._previous = -1  # previous action in the same episode
        self._rates: Counter[float] = Counter()
        self._beliefs: list[Belief] = []
        self._rebuild()

    def _rebuild(self, rate: float = 0.0) -> None:
        """Derive the model again after the factors or the usual rate have changed."""
        self._packing: Packing | None = None  # made at first use, when the factors of a Box are known
        self.learner = self._make_learner(self._reader.sizes, self._actions, self._max_parents, self._all_on)
        self.rate = rate
        self._levels: dict[float, int] = {0.0: 0}
        self._durations: DurationModel | None = None
        self.repeatable = np.ones(self._actions, dtype=np.bool_)
        self._tried: set[int] = set()
        self._done: set[int] = set()  # actions that have been masked ever since they ran
        self._masked: set[tuple[bytes, int]] = set()
        for row in self._rows:
            self._learn(row)
        for belief in self._beliefs:
            belief.forget()

    def _learn(self, row: _Recorded) -> None:
        action = row.action
        self.repeatable[action] = row.again or (self.repeatable[action] and action in self._tried)
        self._tried.add(action)
        before, after = self._reader.read(row.before), self._reader.read(row.after)
        self._learn_mask(before, row.masks, row.previous)
        bonus = self._get_level(round(row.reward - self.rate * row.duration, 6))
        self.learner.add(before, action, after, row.over, bonus)

    def _learn_mask(self, state: NDArray[np.int64], mask: NDArray[np.bool_], previous: int) -> None:
        """Record, once per state, that masked actions have no effect, except those masked since they ran."""
        masked = (~mask).nonzero()[0].tolist()
        self._done = {action for action in masked if previous >= 0 and (action == previous or action in self._done)}
        for action in masked:
            key = state.tobytes(), action
            if action not in self._done and key not in self._masked:
                self._masked.add(key)
                self.learner.add(state, action, state, False, 0)
                for belief in self._beliefs:
                    belief.forget(action)

    def _get_level(self, bonus: float) -> int:
        if bonus not in self._levels:
            if len(self._levels) == LEVELS:
                return self._levels[min(self._levels, key=lambda level: abs(level - bonus))]
            self._levels[bonus] = len(self._levels)
        return self._levels[bonus]

    @property
    def components(self) -> NDArray[np.int64]:
        """Index of each factor in the observation."""
        return self._reader.components

    @property
    def bonuses(self) -> list[float]:
        """The bonus of each level."""
        return sorted(self._levels, key=lambda bonus: self._levels[bonus])

    @property
    def packing(self) -> Packing:
        """Bit layout of states."""
        if self._packing is None:
            self._packing = Packing(self.learner, self._agent)
        return self._packing

    @property
    def is_empty(self) -> bool:
        """True before the first record."""
        return not self._rows

    def get_alive(self, action: int, outcome: int) -> NDArray[np.int64]:
        """Return every hypothesis that the history does not contradict, small ones first."""
        return self.learner.get_alive(action, outcome)

    def get_likeliest(self, action: int, outcome: int) -> NDArray[np.int64]:
        """Return the smallest hypothesis that the history does not contradict."""
        return self.learner.get_alive(action, outcome)[:1]

    def make_belief(self, choose: ChooseHypotheses, visits: int) -> Belief:
        """Return a compiled model that everything recorded from now on updates; see `compile_action`."""
        belief = Belief(choose, visits)
        self._beliefs.append(belief)
        return belief

    def record(self, transition: SMDPTransition) -> None:
        """Record a decision. An option that truncation cut inside shows no outcome and is skipped."""
        previous = self._previous
        self._previous = -1 if transition.terminated or transition.truncated else transition.action
        if transition.cut:
            return
        before, after = map(self._reader.flatten, (transition.observation, transition.next_observation))
        row = _Recorded(
            before, after, np.asarray(transition.action_mask, dtype=np.bool_), transition.action, transition.duration,
            transition.summed_reward, transition.terminated, previous,
            bool(transition.next_action_mask[transition.action]))
        self._rows.append(row)
        self._count_rate(row)
        usual, count = self._rates.most_common(1)[0] if self._rates else (self.rate, 0)
        usual = usual if count > self._rates[self.rate] else self.rate
        if self._reader.notice(np.stack([before, after])) or usual != self.rate:
            self._rebuild(usual)
        else:
            self._learn(row)
            self._durations = None
            for belief in self._beliefs:
                belief.forget(transition.action)

    def _count_rate(self, row: _Recorded) -> None:
        if not row.over:
            self._rates[round(row.reward / row.duration, 9)] += 1

    def pack(self, observation: Any) -> int:
        """Return the state as one word."""
        return self.packing.pack(self._reader.read(self._reader.flatten(observation)))

    def search(self, belief: Belief, observation: Any, legal: NDArray[np.bool_], seek_gaps: bool, most_nodes: int
               ) -> ModelPlan:
        """Plan from an observation; see `find_plan`."""
        belief.update(self)
        relevant = belief.relevant_with_gaps if seek_gaps else belief.relevant
        return find_plan(belief.tables, self.pack(observation), legal, self.repeatable, relevant,
                         *self.estimate_durations(observation), self.rate, self.gamma, belief.bonus, seek_gaps,
                         most_nodes)

    def estimate_durations(self, observation: Any) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return primitives of actions after each other, the last row from here, (actions + 1, actions), and rows."""
        if self._durations is None:
            self._durations = fit_durations(self.list_durations(), self._actions)
        pose = self._reader.read_pose(self._reader.flatten(observation))
        return self._durations.compute_durations(pose), self._durations.places

    def list_durations(self) -> DurationHistory:
        """Return the durations of the most recent decisions."""
        told = pack_columns(self._rows[-REMEMBERED_DECISIONS:], ("before", "action", "after", "duration", "previous"))
        starts, ends = (np.ascontiguousarray(self._reader.read_pose(told[name])) for name in ("before", "after"))
        return DurationHistory(starts, told["action"], ends, told["duration"].astype(np.float64), told["previous"])

    def find_graph(self, choose: ChooseHypotheses) -> frozenset[tuple[int, int]]:
        """Return edges (parent, child): some action turns the child on, and the parent is among its conditions.

        Numbers are indices of the observation's components. A child is not its own parent.
        """
        edges: set[tuple[int, int]] = set()
        for action in range(self._actions):
            for outcome in self.learner.list_active(action):
                if outcome >= self.learner.over:
                    continue
                hypothesis = int(choose(action, int(outcome))[0])
                counts = self.learner.get_counts(action, hypothesis, int(outcome))
                if self.learner.sizes[outcome] == 2 and not counts[:, 0, 1].any():
                    continue  # it is only ever turned off here
                child = int(self.components[outcome])
                parents = (int(self.components[p]) for p in self.learner.hypotheses[hypothesis])
                edges |= {(parent, child) for parent in parents if parent != child}
        return frozenset(edges)

    def state_dict(self) -> StateTree:
        """Return decisions in columns, in order. The model follows from them."""
        return {"rate": self.rate, "last": self._previous, **pack_columns(self._rows, _Recorded._fields)}

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`."""
        self._previous = int(state["last"])
        self._rows = list(map(_Recorded._make, unpack_columns(state, _Recorded._fields)))
        if self._rows:
            self._reader.notice(np.concatenate([state["before"], state["after"]]))
        self._rates.clear()
        for row in self._rows:
            self._count_rate(row)
        self._rebuild(float(state["rate"]))


# --- agents -----------------------------------------------------------------------------


class PlanningAgent(Agent):
    """Base class of agents that follow plans in a learned factored model.

    Attributes:
        model: the history, and everything derived from it.
    """

    STATE = ("model", "_pending", Kept("_is_exploring", "exploring"), "_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: Any) -> None:
        self.settings = settings or self.Settings()
        actions = count_actions(action_space, self.name)
        self.model = FactoredModel(observation_space, actions, self.gamma, self.settings.max_parents,
                                   self.settings.conditions, self.name, self.make_learner, self.compile_model)
        self._rng = make_rng(seed, "actions")
        self._pending = PendingPlan()
        self._is_exploring = self._is_planned = False

    def make_learner(self, sizes: NDArray[np.int64], actions: int, max_parents: int, all_on: bool) -> StructureLearner:
        """Make the structure learner."""
        return StructureLearner(sizes, actions, max_parents, all_on)

    def compile_model(self, *arguments: Any) -> ActionModel:
        """Return the model of an action, from the arguments of `compile_action`."""
        return compile_action(*arguments)

    @abstractmethod
    def _find_plan(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """Plan to follow in training: to an open outcome, or to the end of the task."""

    @abstractmethod
    def _find_escape(self, observation: Any, action_mask: NDArray[np.bool_]) -> ModelPlan:
        """Plan to the end of the task from known outcomes."""

    def _search(self, belief: Belief, observation: Any, action_mask: NDArray[np.bool_], seek_gaps: bool) -> ModelPlan:
        return self.model.search(belief, observation, action_mask, seek_gaps, self.settings.most_nodes)

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Return the next step of the plan, or a random legal action without one."""
        self._is_planned = False
        if self.model.is_empty:
            return sample_legal(action_mask, self._rng)
        state = self.model.pack(observation)
        action = self._pending.take(state, action_mask)
        if action is None:
            self._pending.begin(self._find_plan(observation, action_mask))
            action = self._pending.take(state, action_mask)
        self._is_planned = action is not None
        return sample_legal(action_mask, self._rng) if action is None else action

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the first step to the end of the task, or a random legal action if no way is known."""
        plan = None if self.model.is_empty else self._find_escape(observation, action_mask)
        return plan.actions[0] if plan and plan.actions else sample_legal(action_mask, rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Add to the history; the end of an episode discards the plan. `planned` is 0 for a random choice."""
        self.model.record(transition)
        if transition.terminated or transition.truncated:
            self._pending.drop()
        return {"exploring": float(self._is_exploring), "planned": float(self._is_planned)}
