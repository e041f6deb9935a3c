"""HQ-learning: a fixed sequence of reactive agents; each hands over at a subgoal that it learns to choose.

Wiering and Schmidhuber (1997), HQ-learning, Adaptive Behavior 6. One reactive policy is not enough if observations
alias; the index of the active agent is the only memory. The page of this historical algorithm lists what does not
reproduce.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import choose_best, compute_epsilon, make_rng, sample_index
from hrl_escape.agents.components.tables import (
    QTable,
    TabularSettings,
    ValueTable,
    make_discretiser,
)
from hrl_escape.agents.single_env import SwitchingAgent
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class HqLearningSettings(AgentSettings):
    """Settings of `hq-learning`; defaults follow the paper's key-and-door maze."""

    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    epsilon_start: Annotated[float, Range(0, 1)] = 0.6
    """Epsilon at the beginning; p_max in the paper is 1 - epsilon."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.2
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 100_000
    """Number of primitives of the linear decrease of epsilon. More explores for longer."""
    agents: Annotated[int, Range(1)] = 3
    """Number of reactive agents in the sequence."""
    learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.05
    """Step size of values of primitives. Smaller values average noise."""
    subgoal_learning_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Step size of values of subgoals. Smaller values average noise."""
    trace: Annotated[float, Range(0, 1)] = 0.9
    """Lambda of the returns of primitives and subgoals. More carries rewards back faster, with more variance."""
    temperature: Annotated[float, Range(0, open_low=True)] = 0.2
    """Temperature of Boltzmann draws, which replace the best primitive with probability epsilon. More explores more."""


class _Acted(NamedTuple):
    """One decision of the running trial, and the agent's V over legal primitives; tables change at its end only."""

    agent: int
    key: bytes
    action: int
    reward: float
    discount: float
    value: float


class _Turn(NamedTuple):
    """An agent's turn: its index, and its subgoal, or None for the last agent, and before the first observation."""

    agent: int
    subgoal: bytes | None


class HqLearning(SwitchingAgent):
    """Values of primitives by agent and observation, and of subgoals by agent.

    Agent i acts until it observes its subgoal g_i after at least one primitive; then i + 1 takes over, and the last one
    acts to the end. A trial is learned backwards at its end, with V_j of the agent j that acts next:

        T_t = r_t + gamma [(1 - lambda) V_j(o_{t+1}) + lambda T_{t+1}],   Q_i(o_t, a_t) <- Q_i + alpha [T_t - Q_i]

    where V is the largest value of legal primitives. With R_i the return of i in its turn of n_i primitives, W_i the
    largest HQ_i:

        H_i = R_i + gamma^n_i [(1 - lambda) W_{i+1} + lambda H_{i+1}],    HQ_i(g_i) <- HQ_i + beta [H_i - HQ_i]

    If i + 1 is the last agent, H_i = R_i + gamma^n_i R_{i+1}; if i never handed over, H_i = R_i. A truncated trial
    bootstraps Q but not HQ: not handing over in time counts as failure, as in the paper. Subgoals are chosen among the
    observations met so far.
    """

    Settings: ClassVar[type] = HqLearningSettings
    STATE = (
        "tables", "subgoals", Kept("_met", pack=repr, unpack=ast.literal_eval), "_steps", "_rng",
        Kept("_trial", pack=lambda trial: repr([tuple(acted) for acted in trial]),
             unpack=lambda saved: [_Acted(*acted) for acted in ast.literal_eval(saved)]),
        Kept("_turns", pack=lambda turns: repr([(tuple(turn), begun) for turn, begun in turns]),
             unpack=lambda saved: [(_Turn(*turn), begun) for turn, begun in ast.literal_eval(saved)]),
    )
    EPISODE = ("_trial", "_turns")
    EPISODE_STATE = ("trial", "turns")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: HqLearningSettings | None = None) -> None:
        self.settings = settings = settings or HqLearningSettings()
        actions = count_actions(action_space, "hq-learning")
        table = TabularSettings(learning_rate=settings.learning_rate)
        self._discretise = make_discretiser(observation_space, settings, "hq-learning")
        self.tables = [QTable(actions, table) for _ in range(settings.agents)]
        self.subgoals = ValueTable(settings.subgoal_learning_rate)
        """HQ by (agent, observation)."""
        self._met: list[bytes] = []
        self._rng = make_rng(seed, "actions")
        self._steps = 0
        self.begin_episode()

    def begin_episode(self) -> None:
        """Clear the running trial."""
        self._trial: list[_Acted] = []
        self._turns: list[tuple[_Turn, int]] = []
        """Turns of this trial, each with the number of decisions before it."""

    @property
    def _turn(self) -> _Turn | None:
        return self._turns[-1][0] if self._turns else None

    @property
    def last(self) -> int:
        """Index of the last agent, which has no subgoal."""
        return self.settings.agents - 1

    def compute_subgoal_values(self, agent: int) -> NDArray[np.float64]:
        """Return HQ of an agent, (observations met,)."""
        return np.array([self.subgoals.get((agent, key)) for key in self._met])

    def _take_over(self, agent: int, rng: np.random.Generator, explores: bool = True) -> _Turn:
        """Begin an agent's turn, with the best subgoal (ties at random), or a random one in exploration."""
        if agent == self.last or not self._met:
            return _Turn(agent, None)
        if explores and rng.random() < compute_epsilon(self.settings, self._steps):
            return _Turn(agent, self._met[int(rng.integers(len(self._met)))])
        every = np.ones(len(self._met), np.bool_)
        return _Turn(agent, self._met[choose_best(self.compute_subgoal_values(agent), every, rng)])

    # --- the agent --------------------------------------------------------------------

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Return the agent's best primitive, ties at random; with probability epsilon a Boltzmann draw."""
        key = self._discretise(observation)
        if self._turn is None:
            self._meet(key)
            self._turns = [(self._take_over(0, self._rng), 0)]
        values = self.tables[self._turns[-1][0].agent].get_values(key)
        if self._rng.random() >= compute_epsilon(self.settings, self._steps):
            return choose_best(values, action_mask, self._rng)
        scaled = np.where(action_mask, values, -np.inf) / self.settings.temperature
        return sample_index(np.exp(scaled - scaled.max()), self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the best primitive of the active agent in the evaluation that `rng` identifies."""
        key = self._discretise(observation)
        (turn,) = self.recall(rng) or (None,)
        if turn is None or key == turn.subgoal:
            turn = self._take_over(0 if turn is None else turn.agent + 1, rng, explores=False)
        self._evaluation = rng, turn
        return choose_best(self.tables[turn.agent].get_values(key), action_mask, rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Record a decision, hand over at the subgoal, and learn at the end of the trial."""
        turn = self._turn
        assert turn is not None
        key, after = self._discretise(transition.observation), self._discretise(transition.next_observation)
        value = float(self.tables[turn.agent].get_values(key)[transition.action_mask].max())
        self._trial.append(_Acted(turn.agent, key, transition.action, transition.reward, transition.discount, value))
        self._steps += transition.duration
        self._meet(after)
        if transition.terminated or transition.truncated:
            error = self._learn(after, transition)
            self.begin_episode()
            return {"td_error": error, "epsilon": compute_epsilon(self.settings, self._steps)}
        if after == turn.subgoal:
            self._turns.append((self._take_over(turn.agent + 1, self._rng), len(self._trial)))
        return {}

    def _meet(self, key: bytes) -> None:
        if key not in self._met:
            self._met.append(key)

    def _learn(self, after: bytes, transition: SMDPTransition) -> float:
        """Learn from the finished trial; return the largest error of a primitive's value."""
        legal = transition.next_action_mask
        values = self.tables[self._trial[-1].agent].get_values(after)
        followed = value = 0.0 if transition.terminated else float(np.where(legal, values, -np.inf).max())
        targets = []
        for acted in reversed(self._trial):
            mixed = (1 - self.settings.trace) * value + self.settings.trace * followed
            followed = acted.reward + acted.discount * mixed
            targets.append(followed)
            value = acted.value
        self._learn_subgoals()
        return max(
            abs(self.tables[acted.agent].update(acted.key, acted.action, target))
            for acted, target in zip(self._trial, reversed(targets), strict=True)
        )

    def _learn_subgoals(self) -> None:
        """Learn HQ of every turn of the trial, the last one first."""
        followed: float | None = None
        end = len(self._trial)
        targets = []
        for turn, begun in reversed(self._turns):
            earned, discount = 0.0, 1.0
            for acted in self._trial[begun:end]:
                earned += discount * acted.reward
                discount *= acted.discount
            if followed is not None:
                largest = followed if turn.agent + 1 == self.last else self.compute_subgoal_values(turn.agent + 1).max()
                earned += discount * ((1 - self.settings.trace) * largest + self.settings.trace * followed)
            followed, end = earned, begun
            targets.append((turn, earned))
        for turn, target in targets:
            if turn.subgoal is not None:
                self.subgoals.update((turn.agent, turn.subgoal), target)
