"""Small SMDPs with exact solutions, as Gymnasium environments that keep the contract of `make_transition`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.planning.route import PlanningSummary


@dataclass(frozen=True)
class Outcome:
    """One way an action can go: where it leads, with what primitive rewards, and whether that ends the task."""

    probability: float
    next_state: int
    rewards: tuple[float, ...]
    terminated: bool = False


Smdp = Sequence[Sequence[Sequence[Outcome]]]
"""State -> action -> outcomes; an action without outcomes is illegal there."""


class Step(NamedTuple):
    """One primitive inside a decision, as an environment's trace gives it."""

    observation: Any
    action: int
    reward: float
    next_observation: Any
    next_action_mask: Any = None
    consistent: tuple[tuple[int, float], ...] = ()


def compute_shares(outcomes: Sequence[Outcome]) -> NDArray[np.float64]:
    """Cumulative probabilities, by which one number draws an outcome as `Generator.choice` would, much faster."""
    shares = np.array([outcome.probability for outcome in outcomes])
    assert not outcomes or (shares >= 0).all() and abs(shares.sum() - 1) < 1e-8, f"no probabilities: {shares}"
    cumulative = np.cumsum(shares)
    return cumulative / cumulative[-1:]


class SmdpEnv(gymnasium.Env):
    """Runs an `Smdp`; the observation is the state's number, or a one-hot vector. Every termination is a success.

    Args:
        smdp: the tables.
        start: the first state; None starts anywhere.
        horizon: primitives until truncation; an action is cut inside.
        one_hot: observe a float32 vector instead of the number.
        infos: `rewards` gives the primitive rewards, `discounted` only R and gamma^k, `none` neither.
        gamma: for `discounted`.
    """

    def __init__(
        self,
        smdp: Smdp,
        start: int | None = 0,
        horizon: int = 1_000,
        one_hot: bool = False,
        infos: str = "rewards",
        gamma: float = 0.9,
    ) -> None:
        self.smdp, self.start, self.horizon, self.one_hot = smdp, start, horizon, one_hot
        self.infos, self.gamma = infos, gamma
        states = len(smdp)
        self.observation_space = spaces.Box(0, 1, (states,), np.float32) if one_hot else spaces.Discrete(states)
        self.action_space = spaces.Discrete(len(smdp[0]))
        self._masks = [np.array([len(outcomes) > 0 for outcomes in row], np.int8) for row in smdp]
        self._shares = [[compute_shares(outcomes) for outcomes in row] for row in smdp]

    def observe(self, state: int) -> Any:
        return np.eye(len(self.smdp), dtype=np.float32)[state] if self.one_hot else state

    def compute_mask(self, state: int) -> NDArray[np.int8]:
        return self._masks[state].copy()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.state = int(self.np_random.integers(len(self.smdp))) if self.start is None else self.start
        self.elapsed = 0
        return self.observe(self.state), {"action_mask": self.compute_mask(self.state)}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        outcomes = self.smdp[self.state][action]
        assert outcomes, f"illegal action {action} in state {self.state}"
        chosen = outcomes[self._shares[self.state][action].searchsorted(self.np_random.random(), side="right")]
        duration = min(len(chosen.rewards), self.horizon - self.elapsed)
        rewards = chosen.rewards[:duration]
        self.elapsed += duration
        whole = duration == len(chosen.rewards)
        self.state = chosen.next_state if whole else self.state
        terminated = chosen.terminated and whole
        truncated = self.elapsed >= self.horizon and not terminated
        info: dict[str, Any] = {"duration": duration, "action_mask": self.compute_mask(self.state),
                                "is_success": terminated}
        if self.infos == "rewards":
            info["rewards"] = rewards
        elif self.infos == "discounted":
            info["discounted_reward"] = sum(self.gamma**i * r for i, r in enumerate(rewards))
            info["discount"] = self.gamma**duration
        return self.observe(self.state), float(sum(rewards)), terminated, truncated, info


def solve(smdp: Smdp, gamma: float) -> NDArray[np.float64]:
    """Optimal Q by policy iteration, each policy evaluated exactly by solving its linear system.

    Returns:
        (states, actions); -inf where an action is illegal.
    """
    states, actions = len(smdp), len(smdp[0])
    reward = np.full((states, actions), -np.inf)
    follow = np.zeros((states, actions, states))
    for s, row in enumerate(smdp):
        for a, outcomes in enumerate(row):
            if outcomes:
                reward[s, a] = 0
            for outcome in outcomes:
                discounted = sum(gamma**i * r for i, r in enumerate(outcome.rewards))
                reward[s, a] += outcome.probability * discounted
                if not outcome.terminated:
                    follow[s, a, outcome.next_state] += outcome.probability * gamma ** len(outcome.rewards)
    policy = np.array([[bool(o) for o in row].index(True) for row in smdp])
    rows = np.arange(states)
    while True:
        values = np.linalg.solve(np.eye(states) - follow[rows, policy], reward[rows, policy])
        q = reward + follow @ values
        better = q.argmax(axis=1)
        if (q[rows, better] <= q[rows, policy] + 1e-12).all():
            return q
        policy = better


def make_random_smdp(seed: int, states: int = 6, actions: int = 4, branches: int = 2, longest: int = 7) -> Smdp:
    """A random SMDP: durations 1 to `longest`, some actions illegal, some ends."""
    rng = np.random.default_rng(seed)
    smdp = []
    for _ in range(states):
        row: list[tuple[Outcome, ...]] = []
        for action in range(actions):
            if action and rng.random() < 0.25:
                row.append(())
                continue
            shares = rng.dirichlet(np.ones(branches))
            row.append(
                tuple(
                    Outcome(
                        float(share),
                        int(rng.integers(states)),
                        tuple(float(r) for r in rng.integers(-3, 4, rng.integers(1, longest + 1))),
                        bool(rng.random() < 0.15),
                    )
                    for share in shares
                )
            )
        smdp.append(tuple(row))
    return tuple(smdp)


class ButtonGrid(gymnasium.Env):
    """A 13 x 13 grid: press two buttons in order, then leave; four moves and an option to each place.

    Reward -1 a primitive and 100 more at the exit; truncated at 200 primitives. Options walk straight to their place
    and are functions of the state; with `trace` they say so primitive by primitive.
    """

    PLACES = ((12, 6), (6, 12), (0, 0))  # button 1, button 2, exit
    MOVES = ((1, 0), (-1, 0), (0, 1), (0, -1))

    def __init__(self, with_options: bool = True, trace: bool = False, horizon: int = 200) -> None:
        self.with_options, self.trace, self.horizon = with_options, trace, horizon
        self.planning_total = PlanningSummary()
        self.observation_space = spaces.Box(np.array([0, 0, 0, 0]), np.array([12, 12, 1, 1]), dtype=np.float64)
        self.action_space = spaces.Discrete(7 if with_options else 4)

    def observe(self, state: tuple[int, int, int, int]) -> NDArray[np.float64]:
        return np.array(state, np.float64)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        x, y = self.np_random.integers(4, 9, size=2)
        self.state = (int(x), int(y), 0, 0)
        self.elapsed = 0
        return self.observe(self.state), {"action_mask": self.compute_mask(self.state)}

    def compute_mask(self, state: tuple[int, int, int, int]) -> NDArray[np.int8]:
        """An option is legal unless the robot is at its place."""
        here = [int(state[:2] != place) for place in self.PLACES] if self.with_options else []
        return np.array([1, 1, 1, 1, *here], np.int8)

    def choose(self, option: int, state: tuple[int, int, int, int]) -> int:
        """The option's policy: along x, then along y."""
        (x, y), (goal_x, goal_y) = state[:2], self.PLACES[option]
        if x != goal_x:
            return 0 if goal_x > x else 1
        return 2 if goal_y > y else 3

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        rewards: list[float] = []
        trace: list[Step] = []
        terminated = truncated = over = False
        while not over:
            primitive = action if action < 4 else self.choose(action - 4, self.state)
            before = self.state
            terminated = self._move(primitive)
            rewards.append(99.0 if terminated else -1.0)
            self.elapsed += 1
            truncated = self.elapsed >= self.horizon and not terminated
            over = action < 4 or terminated or truncated or self.state[:2] == self.PLACES[action - 4]
            consistent = [(primitive, 1.0)]
            if self.with_options and self.trace:
                for option, place in enumerate(self.PLACES):
                    if before[:2] != place and self.choose(option, before) == primitive:
                        consistent.append((4 + option, float(self.state[:2] == place)))
            trace.append(
                Step(
                    self.observe(before),
                    primitive,
                    rewards[-1],
                    self.observe(self.state),
                    self.compute_mask(self.state),
                    tuple(consistent),
                )
            )
        self.planning_total += PlanningSummary(planner_calls=int(action >= 4))
        info: dict[str, Any] = {
            "duration": len(rewards),
            "is_success": terminated,
            "rewards": rewards,
            "action_mask": self.compute_mask(self.state),
            "option": {"name": f"action-{action}", "ended": "reached"},
        }
        if self.trace:
            info["trace"] = trace
        return self.observe(self.state), sum(rewards), terminated, truncated, info

    def _move(self, primitive: int) -> bool:
        """Moves, presses; says whether the exit was passed."""
        x = min(max(self.state[0] + self.MOVES[primitive][0], 0), 12)
        y = min(max(self.state[1] + self.MOVES[primitive][1], 0), 12)
        first = int(self.state[2] or (x, y) == self.PLACES[0])
        second = int(self.state[3] or (first and (x, y) == self.PLACES[1]))
        self.state = (x, y, first, second)
        return bool(second) and (x, y) == self.PLACES[2]


def spread_options(smdp: Smdp, seed: int) -> Smdp:
    """The same deterministic SMDP with a state after each primitive inside an option, whose one action is the rest.

    So a cut inside an option has an exact value: `CutEnv` stops there. States keep their numbers, new ones follow. The
    action is any but the first.
    """
    rng = np.random.default_rng(seed)
    actions = len(smdp[0])
    rows = [list(row) for row in smdp]
    for state, action in [(s, a) for s in range(len(smdp)) for a in range(actions) if smdp[s][a]]:
        (outcome,) = rows[state][action]
        for done in range(1, len(outcome.rewards)):
            row: list[tuple[Outcome, ...]] = [()] * actions
            row[int(rng.integers(1, actions))] = (Outcome(1.0, outcome.next_state, outcome.rewards[done:],
                                                       outcome.terminated),)
            rows.append(row)
    return tuple(map(tuple, rows))


class CutEnv(SmdpEnv):
    """Runs the result of `spread_options` from anywhere, each episode with a time limit of its own, often inside one.

    Args:
        smdp: before it is spread.
        seed: of the actions by which options go on.
        longest: largest time limit, primitives.
    """

    def __init__(self, smdp: Smdp, seed: int, longest: int = 12) -> None:
        super().__init__(spread_options(smdp, seed), start=None)
        self.longest = longest
        self._inside: dict[tuple[int, int], int] = {}
        """(state, action) -> the state after its first primitive; those after it are numbered on."""
        for state, row in enumerate(smdp):
            for action, outcomes in enumerate(row):
                if outcomes:
                    self._inside[state, action] = len(smdp) + sum(self._count(key, smdp) for key in self._inside)

    @staticmethod
    def _count(key: tuple[int, int], smdp: Smdp) -> int:
        return len(smdp[key[0]][key[1]][0].rewards) - 1

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        found = super().reset(seed=seed, options=options)
        self.horizon = int(self.np_random.integers(1, self.longest + 1))
        return found

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        state, before = self.state, self.elapsed
        observation, reward, terminated, truncated, info = super().step(action)
        is_cut = info["duration"] < len(self.smdp[state][action][0].rewards)
        info["option"] = {"ended": "episode-over" if is_cut else "reached"}
        if is_cut:
            done = self.elapsed - before
            self.state = self._inside[state, action] + done - 1 if (state, action) in self._inside else state + done
            observation, info["action_mask"] = self.observe(self.state), self.compute_mask(self.state)
        return observation, reward, terminated, truncated, info
