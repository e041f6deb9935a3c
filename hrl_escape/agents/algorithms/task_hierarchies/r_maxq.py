"""R-MAXQ: R-MAX's optimistic model of the primitives, combined upwards into models of whole tasks.

Jong and Stone (2008), Hierarchical model-based reinforcement learning: R-MAX + MAXQ. A task's model contains its reward
and its final states, and its caller plans with it as with a primitive.
"""

from __future__ import annotations

import ast
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, count_actions
from hrl_escape.agents.components.exploration import make_rng, sample_legal
from hrl_escape.agents.components.tables import make_discretiser
from hrl_escape.agents.hierarchy.runner import CallRunner
from hrl_escape.agents.hierarchy.task import Hierarchy, Return, Seen, Stack, Step
from hrl_escape.agents.hierarchy.task_graph import GraphTask, flat, get_graph, get_task
from hrl_escape.agents.state import Kept
from hrl_escape.errors import UnsupportedError
from hrl_escape.settings import Range

SWEEPS_A_TASK = 10_000
"""Largest number of sweeps of value iteration in one task."""
LEAK = 1e-10
"""Probability that a step of a task ends it nowhere, which gives a policy that never ends a finite, low value."""


@dataclass(frozen=True, kw_only=True)
class RMaxqSettings(AgentSettings):
    """Settings of `r-maxq`: samples that make a pair known, and bounds of its models."""

    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "never"
    """Choose every running call again at each primitive, instead of running it to its end: never, in evaluation
    only (hierarchical greedy execution), or always."""
    visits: Annotated[int, Range(1)] = 1
    """m, samples that make a pair of state and primitive known. 1 is enough for deterministic outcomes; more are needed
    under noise."""
    optimistic_value: float = 100.0
    """V_max, value of an unknown pair in units of return. It must bound all true values from above; higher values
    explore more."""
    tolerance: Annotated[float, Range(0, open_low=True)] = 1e-9
    """Tolerance of value iteration, which stops when all changes are smaller. Smaller values are more precise and
    slower."""
    most_states: Annotated[int, Range(1)] = 2_000
    """Most states; a task's model grows with its square."""


class _Model(NamedTuple):
    """A primitive or task as its caller's model: R (states,), P (states, states) with discounts included."""

    rewards: NDArray
    follow: NDArray


class _Plan(NamedTuple):
    """A task's Q(s, .), (states, choices), and its model."""

    values: NDArray
    model: _Model


class RMaxq(CallRunner):
    """Models of tasks from models of their children.

    Primitive a:  R(s), P(s, .) from counts, P including gamma^k; R = V_max, P = 0 if n(s, a) < m
    Task i:       pi(s)   = argmax over legal c of R_c(s) + sum over x of P_c(s, x) V(x)
                  V(x)    = pseudo-reward of x if i is over, otherwise the maximum
                  R_i(s)  = R_pi(s) + sum over x where i continues of P_pi(s, x) R_i(x)
                  P_i(s, x) = P_pi(s, x) [i is over at x] + sum over y where i continues of P_pi(s, y) P_i(y, x)

    An unknown primitive gives every call that leads to it the value V_max; this is the only exploration. Plans are
    computed again when a pair becomes known, over the states met so far.

    Args:
        observation_space: observation space; states are rounded observations.
        hierarchy: result of `maxq(graph, until)`; without one, a single task over all primitives, which is R-MAX.
    """

    Settings: ClassVar[type] = RMaxqSettings
    STATE = (
        Kept("_met", "states"),
        Kept("_counts", pack=lambda counts: np.array(counts, np.int64), unpack=lambda saved: list(np.array(saved))),
        Kept("_rewards", pack=np.array, unpack=lambda saved: list(np.array(saved))),
        Kept("_weights", pack=lambda weights: list(map(repr, weights)),
             unpack=lambda saved: list(map(ast.literal_eval, saved))),
        "_action_rng",
    )  # fmt: skip

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: RMaxqSettings | None = None, hierarchy: Hierarchy | None = None) -> None:
        settings = settings or RMaxqSettings()
        self._actions = count_actions(action_space, "r-maxq")
        super().__init__(hierarchy or flat(self._actions), seed, settings)
        get_graph(self.hierarchy, "r-maxq")
        self._discretise = make_discretiser(observation_space, settings, "r-maxq")
        self._action_rng = make_rng(seed, "actions")
        self._forget()

    def _forget(self) -> None:
        self._numbers: dict[Hashable, int] = {}
        self._moments: list[Seen] = []
        self._counts: list[NDArray[np.int64]] = []
        self._rewards: list[NDArray[np.float64]] = []
        self._weights: list[dict[tuple[int, int], float]] = []
        """By state, (primitive, next state) -> sum of gamma^k over samples that continued."""
        self._plans: dict[str, _Plan] = {}

    # --- the model --------------------------------------------------------------------

    def number(self, seen: Seen) -> int:
        """Return the number of a moment's state, a new one at its first visit."""
        key = self._discretise(seen.observation)
        if key not in self._numbers:
            if len(self._moments) >= self.settings.most_states:
                raise UnsupportedError(f"r-maxq met more than {len(self._moments)} states. Raise `most_states`, or "
                                       "round observations more coarsely")  # fmt: skip
            self._numbers[key] = len(self._moments)
            self._moments.append(seen)
            self._counts.append(np.zeros(self._actions, np.int64))
            self._rewards.append(np.zeros(self._actions))
            self._weights.append({})
            self._plans = {}
        return self._numbers[key]

    def _model_primitive(self, action: int) -> _Model:
        states = len(self._moments)
        rewards, follow = np.full(states, self.settings.optimistic_value), np.zeros((states, states))
        for state in range(states):
            count = int(self._counts[state][action])
            if count >= self.settings.visits:
                rewards[state] = self._rewards[state][action] / count
                for (taken, after), weight in self._weights[state].items():
                    if taken == action:
                        follow[state, after] = weight / count
        return _Model(rewards, follow)

    def plan(self, task: GraphTask) -> _Plan:
        """Return the plan of a task in the current model, with the plans of all tasks below."""
        if task.name not in self._plans:
            models = [self._get_model(child) for child in task.children]
            moments = self._moments
            over = np.array([task.until(seen) for seen in moments], np.bool_)
            legal = np.stack([task.legal(seen, None) for seen in moments]) & ~over.reshape(-1, 1)
            goes_on = np.asarray(legal.any(axis=1))
            values = np.where(over, [task.pseudo(seen) if task.pseudo else 0.0 for seen in moments], 0.0)
            rewards = np.stack([model.rewards for model in models], axis=1)
            choices = rewards
            for _ in range(SWEEPS_A_TASK):
                choices = rewards + np.stack([model.follow @ values for model in models], axis=1)
                choices = np.where(legal, choices, -np.inf)
                swept = np.where(goes_on, choices.max(axis=1), values)
                change, values = np.abs(swept - values).max(), swept
                if change <= self.settings.tolerance:
                    break
            rows, best = np.arange(len(moments)), choices.argmax(axis=1)
            follow = np.stack([model.follow for model in models])[best, rows] * goes_on[:, None]
            system = np.eye(len(moments)) - follow * (goes_on * (1 - LEAK))
            right = np.column_stack([rewards[rows, best] * goes_on, follow * ~goes_on])
            solved = np.linalg.solve(system, right)
            self._plans[task.name] = _Plan(choices, _Model(solved[:, 0], solved[:, 1:]))
        return self._plans[task.name]

    def _get_model(self, child: GraphTask | int) -> _Model:
        if not isinstance(child, int):
            return self.plan(child).model
        name = f"primitive {child}"
        if name not in self._plans:
            self._plans[name] = _Plan(np.zeros((0, 0)), self._model_primitive(child))
        return self._plans[name].model

    # --- the agent --------------------------------------------------------------------

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Return the best choice of the optimistic plan."""
        return self.choose_greedy(stack, view, legal, seen, self._action_rng)

    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Return the best choice of the same plan; a random one in new states, or without known legal choices."""
        state = self._numbers.get(self._discretise(seen.observation))
        if state is None:
            return sample_legal(legal, rng)
        values = np.where(legal, self.plan(get_task(stack)).values[state], -np.inf)
        return int(values.argmax()) if np.isfinite(values).any() else sample_legal(legal, rng)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Count one primitive. An option that was cut inside has no outcome."""
        if step.cut:
            return {"states": len(self._moments)}
        before, after, action = self.number(step.seen), self.number(step.next_seen), step.action
        weights = self._weights[before]
        is_new = False
        if not step.terminated:
            is_new = (action, after) not in weights
            weights[action, after] = weights.get((action, after), 0.0) + self.gamma**step.duration
        self._rewards[before][action] += step.reward
        self._counts[before][action] += 1
        count = int(self._counts[before][action])
        # Further samples change averages little, and planning at every doubling is enough.
        if is_new or count == self.settings.visits or (count > self.settings.visits and count & (count - 1) == 0):
            self._plans = {}
        return {"states": len(self._moments)}

    @property
    def _met(self) -> list[list[Any]]:
        return [[seen.observation, seen.mask] for seen in self._moments]

    @_met.setter
    def _met(self, saved: list[list[Any]]) -> None:
        self._forget()
        for observation, mask in saved:
            self.number(self.hierarchy.see(observation, np.asarray(mask, np.bool_)))
