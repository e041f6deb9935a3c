"""Deep abstract Q-networks: R-MAX over visited abstract states, and an agent for each step between two of them.

Roderick, Grimm and Tellex (2018). The abstraction is given; the set of abstract states and their neighbours are
learned.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, AgentSettings, count_actions
from hrl_escape.agents.algorithms.dqn import DQN
from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.components.exploration import choose_best, make_rng, sample_legal
from hrl_escape.agents.components.tables import ResolutionSettings, make_cell_finder
from hrl_escape.agents.hierarchy.runner import CallRunner, make_task_transition
from hrl_escape.agents.hierarchy.task import BaseTask, Call, Frame, Hierarchy, Return, Seen, Stack, Step
from hrl_escape.agents.single_env import serve_one
from hrl_escape.agents.state import Kept, StateTree
from hrl_escape.settings import Range

Abstraction = Callable[[Any], Any]
"""Function from an observation to its abstract state: numbers, an array or a tuple of them."""


@dataclass(frozen=True, kw_only=True)
class DeepAbstractQSettings(AgentSettings):
    """Settings of `deep-abstract-q`; workers are `dqn` or `q-learning` with other settings at their defaults."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "never"
    """Choose every running call again at each primitive, instead of running it to its end: never, in evaluation
    only (hierarchical greedy execution), or always."""
    worker: Literal["network", "table"] = "network"
    """Algorithm of the workers: `dqn`, or `q-learning`."""
    most_states: Annotated[int, Range(2)] = 64
    """Most abstract states; states met later count as the last."""
    visits: Annotated[int, Range(1)] = 30
    """Tries of a step before its model is used; until then it is worth `optimistic_value`."""
    optimistic_value: float = 100.0
    """Value of an unknown step, in units of return. It must bound all true values from above; higher values explore
    more."""
    recency: Annotated[float, Range(0, 1)] = 0.05
    """Smallest weight of a step's latest outcome in its model, because workers improve; 0 weighs all equally."""
    worker_epsilon: Annotated[float, Range(0, 1)] = 0.1
    """Probability of a random primitive on the way to a target. More explores more."""
    patience: Annotated[int, Range(1)] = 50
    """Most primitives of a step."""


class _Step(BaseTask):
    """Goes from its initial abstract state to a neighbouring one; without a target, to any, at random.

    Its view includes the numbers of both as an array; -1 means no target.
    """

    def __init__(self, primitives: int, find: Callable[[Any], int], patience: int) -> None:
        super().__init__("step", primitives)
        self._find, self._patience = find, patience

    def has_left(self, frame: Frame, seen: Seen) -> bool:
        return self._find(seen.observation) != frame.context[0]

    def list_calls(self) -> Mapping[str, Any]:
        return {}

    def ends(self, frame: Frame, seen: Seen) -> float:
        return float(frame.primitives >= self._patience or self.has_left(frame, seen))

    def pay(self, step: Step, frame: Frame) -> float:
        """Return 1 for the target, -1 for any other abstract state."""
        there = self._find(step.next_seen.observation)
        return 0.0 if there == frame.context[0] else step.arrival * (1.0 if there == frame.context[1] else -1.0)


class _Manager(BaseTask):
    """Chooses an abstract state that was seen to follow the current one, or none (the last choice)."""

    def __init__(self, states: int, find: Callable[[Any], int], is_next: NDArray[np.bool_], step: _Step) -> None:
        super().__init__("manager", states + 1)
        self._find, self._is_next, self._step = find, is_next, step

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        return np.append(self._is_next[self._find(seen.observation)], True)

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        target = -1 if choice == len(self._is_next) else int(choice)
        return Call(self._step, np.array([self._find(seen.observation), target]))


class DeepAbstractQ(CallRunner):
    """Plan over abstract states u with V(u) = max over v of R(u, v) + sum over w of F(u, v, w) V(w).

    v is an abstract state that was seen next to u, or none: primitives are then random. R and F are running means of
    the reward of a step from u towards v, and of gamma^k for the state w where it ended, 0 if the episode terminated. A
    step with fewer than `visits` tries is worth `optimistic_value`. The worker of (u, v) has reward 1 for reaching v
    and -1 for reaching another state; both end its episode. An abandoned step bootstraps.

    Args:
        abstraction: the abstraction. By default the bounded components of an observation, each rounded to the nearer
            bound, or a Discrete observation itself.

    Attributes:
        workers: (u, v) -> the agent of that step.
        is_next: whether v was seen right after u, bool (states, states).
    """

    Settings = DeepAbstractQSettings
    STATE = (Kept("_keys", "keys"), "is_next", "_counts", "_rewards", "_follow", Kept("_saved_workers", "workers"),
             "_action_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: DeepAbstractQSettings | None = None, abstraction: Abstraction | None = None) -> None:
        settings = settings or DeepAbstractQSettings()
        self._spaces, self._seed, states = (observation_space, action_space), seed, settings.most_states
        coarse = ResolutionSettings(bins=2)
        self._abstract = abstraction or make_cell_finder(observation_space, coarse, "deep-abstract-q")
        self._keys: list[str] = []
        """Abstract states as text, in the order of their first visit."""
        self.is_next = np.zeros((states, states), np.bool_)
        step = _Step(count_actions(action_space, "deep-abstract-q"), self.find, settings.patience)
        manager = _Manager(states, self.find, self.is_next, step)
        privileges = () if abstraction is None else ("abstraction",)
        super().__init__(Hierarchy(manager, (step,), source="learned", privileges=privileges), seed, settings)
        self._counts = np.zeros((states, states + 1), np.int64)
        self._rewards = np.zeros((states, states + 1))
        self._follow = np.zeros((states, states + 1, states))
        self.workers: dict[tuple[int, int], Agent] = {}
        self._action_rng = make_rng(seed, "actions")

    def find(self, observation: Any) -> int:
        """Return the number of an observation's abstract state; a new one has the next free number."""
        key = str(np.asarray(self._abstract(observation)).tolist())
        number = self._keys.index(key) if key in self._keys else len(self._keys)
        return min(number, self.settings.most_states - 1)

    def _meet(self, observation: Any) -> None:
        key = str(np.asarray(self._abstract(observation)).tolist())
        if key not in self._keys and len(self._keys) < self.settings.most_states:
            self._keys.append(key)

    # --- acting --------------------------------------------------------------------------

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Register the observation's abstract state, and act in it."""
        self._meet(observation)
        return super().act(observation, action_mask)

    def compute_step_values(self, state: int, unknown: float) -> NDArray[np.float64]:
        """Return Q(u, .) of steps from an abstract state, the last without a target, (states + 1,); else `unknown`."""
        legal = np.column_stack([self.is_next, np.ones(len(self.is_next), np.bool_)])
        known, q = self._counts >= self.settings.visits, np.zeros(self._counts.shape)
        values = np.full(len(legal), min(unknown, self.settings.optimistic_value))
        for _ in range(1_000):
            q = np.where(known, self._rewards + self._follow @ values, unknown)
            after = np.where(legal, q, -np.inf).max(axis=1)
            moved = np.abs(after - values).max()
            values = after
            if moved < 1e-4:
                break
        return q[state]

    def _get_worker(self, pair: tuple[int, int]) -> Agent:
        if pair not in self.workers:
            made = DQN if self.settings.worker == "network" else QLearning
            seed = int(np.random.SeedSequence([self._seed, *pair]).generate_state(1)[0])
            epsilon = self.settings.worker_epsilon
            alone = {"n_step": 1} if made is DQN else {}  # consecutive decisions are of several environments
            self.workers[pair] = made(*self._spaces, seed, made.Settings(
                gamma=self.settings.gamma, epsilon_start=epsilon, epsilon_end=epsilon, **alone))
        return self.workers[pair]

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Return the best step by the optimistic model, or the worker's exploring choice (random without a target)."""
        frame = stack[-1]
        if frame.context is None:
            values = self.compute_step_values(self.find(seen.observation), self.settings.optimistic_value)
            return choose_best(values, legal, self._action_rng)
        before, target = map(int, frame.context)
        if target < 0:
            return sample_legal(legal, self._action_rng)
        return serve_one(self._get_worker((before, target))).act(view, legal)

    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Return the best known step, or the worker's best choice; a random one without any."""
        frame = stack[-1]
        if frame.context is None:
            worst = min(float(self._rewards.min()), 0.0) / max(1 - self.gamma, 1e-3) - 1
            return choose_best(self.compute_step_values(self.find(seen.observation), worst), legal, rng)
        pair = int(frame.context[0]), int(frame.context[1])
        return self.workers[pair].act_greedy(view, legal, rng) if pair in self.workers else sample_legal(legal, rng)

    # --- learning ------------------------------------------------------------------------

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Train the worker with its choice, and update the manager's model with finished steps."""
        metrics: dict[str, float] = {}
        before = self.find(step.seen.observation)
        self._meet(step.next_seen.observation)
        after = self.find(step.next_seen.observation)
        self.is_next[before, after] |= before != after
        for returned in returns:
            frame, transition = returned.frame, make_task_transition(returned)
            if frame.context is None:
                start, choice = self.find(transition.observation), transition.action
                if not transition.truncated:
                    self._model(start, choice, transition.reward, 0.0 if transition.terminated else transition.discount,
                                after)
            elif frame.context[1] >= 0:
                if returned.ended and not returned.terminated and before == after:  # abandoned
                    transition = transition._replace(terminated=False, truncated=True)
                worker = self._get_worker((int(frame.context[0]), int(frame.context[1])))
                metrics |= serve_one(worker).observe(transition)
        return metrics | {"abstract_states": float(len(self._keys))}

    def _model(self, start: int, choice: int, reward: float, discount: float, after: int) -> None:
        self._counts[start, choice] += 1
        share = max(1 / self._counts[start, choice], self.settings.recency)
        self._rewards[start, choice] += share * (reward - self._rewards[start, choice])
        self._follow[start, choice] *= 1 - share
        self._follow[start, choice, after] += share * discount

    @property
    def _saved_workers(self) -> list[StateTree]:
        """Pairs of abstract states and their workers' states."""
        return [{"pair": list(pair), "state": worker.state_dict()} for pair, worker in self.workers.items()]

    @_saved_workers.setter
    def _saved_workers(self, saved: list[StateTree]) -> None:
        self.workers = {}
        for each in saved:
            self._get_worker((int(each["pair"][0]), int(each["pair"][1]))).load_state_dict(each["state"])

    def after_load(self) -> None:
        """Share the known steps with the manager."""
        self.hierarchy.root._is_next = self.is_next  # type: ignore[attr-defined]
