"""An independent model of `OptionsEnv`: a copied environment in which the primitives of every decision run one by one.

Options are given by their three functions, which are deterministic here. The copied runs them by the definition of an
option (Sutton, Precup and Singh 1999, section 2), with nothing of this package.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from hrl_escape.options import FunctionOption, OptionsEnv


class Skill(NamedTuple):
    """An option (I, pi, beta) over observations, without randomness."""

    name: str
    policy: Callable[[Any], Any]
    ends: Callable[[Any], bool]
    starts: Callable[[Any], bool] = lambda observation: True

    def make_option(self) -> FunctionOption:
        """Make the option of the package."""
        return FunctionOption(self.name, self.policy, lambda seen: float(self.ends(seen)), self.starts)


class Replayed(NamedTuple):
    """Decisions that were compared.

    Attributes:
        decisions: how many.
        longest: most primitives of one.
        terminated: those of several primitives in which the episode terminated.
        truncated: those of several primitives in which it was truncated.
        returns: distinct sums of rewards.
        masked: decisions at which an action was masked.
    """

    decisions: int
    longest: int
    terminated: int
    truncated: int
    returns: int
    masked: int


def compare_with_copy(make: Callable[[], gymnasium.Env], skills: Sequence[Skill], *, decisions: int, seed: int = 0,
                      gamma: float = 0.9, weights: Sequence[float] | None = None) -> Replayed:
    """Run random legal decisions in an `OptionsEnv` and make each again in a copied; raises AssertionError.

    Compared are observations, the mask, the primitives, k, the sum of rewards, the discounted sum R, gamma^k, and
    whether the episode terminated or was truncated.

    Args:
        make: makes the environment; the same seed must give it the same episodes.
        skills: the options.
        decisions: how many to compare.
        seed: of the first episode; each episode has the next one.
        gamma: discount per primitive.
        weights: relative frequency of each action, primitives first; all alike by default.
    """
    env = OptionsEnv(make(), [skill.make_option() for skill in skills], discount=gamma, trace=True)
    copied, rng = make(), np.random.default_rng(seed)
    primitives = env.primitive_count
    share = np.ones(primitives + len(skills)) if weights is None else np.asarray(weights, float)
    over, longest, terminations, truncations, masked, returns = True, 0, 0, 0, 0, set()
    observation: Any = None
    mask = np.ones(0)
    for _ in range(decisions):
        if over:
            observation, info = env.reset(seed=seed)
            expected, _ = copied.reset(seed=seed)
            assert_same(observation, expected)
            seed, mask = seed + 1, info["action_mask"]
        legal = np.array([1] * primitives + [skill.starts(observation) for skill in skills])
        assert mask.tolist() == legal.tolist()
        masked += int(not legal.all())
        action = int(rng.choice(len(legal), p=share * legal / (share * legal).sum()))
        seen, reward, terminated, truncated, info = env.step(action)
        ran = run_in_copy(copied, observation, skills[action - primitives] if action >= primitives else action)
        expected, rewards, actions, *ends = ran
        k = len(rewards)
        assert [terminated, truncated] == ends
        assert info["duration"] == k == len(info["trace"])
        assert_same([step.action for step in info["trace"]], actions)
        assert math.isclose(reward, math.fsum(rewards), rel_tol=1e-9, abs_tol=1e-12)
        assert math.isclose(info["discounted_reward"], math.fsum(gamma**i * paid for i, paid in enumerate(rewards)),
                            rel_tol=1e-9, abs_tol=1e-12)
        assert math.isclose(info["discount"], gamma**k, rel_tol=1e-12)
        assert_same(seen, expected)
        assert_same(info["trace"][-1].next_observation, expected)
        longest = max(longest, k)
        terminations += int(terminated and k > 1)
        truncations += int(truncated and k > 1)
        returns.add(round(reward, 6))
        observation, mask, over = seen, info["action_mask"], terminated or truncated
    env.close()
    copied.close()
    return Replayed(decisions, longest, terminations, truncations, len(returns), masked)


def run_in_copy(copied: gymnasium.Env, observation: Any, choice: Skill | int
                ) -> tuple[Any, list[float], list[Any], bool, bool]:
    """Run a primitive, or a skill to its end: last observation, rewards, primitives, terminated, truncated."""
    rewards: list[float] = []
    actions: list[Any] = []
    while True:
        action = choice.policy(observation) if isinstance(choice, Skill) else choice
        if isinstance(copied.action_space, gymnasium.spaces.Box):
            action = np.asarray(action, copied.action_space.dtype)
        observation, reward, terminated, truncated, _ = copied.step(action)
        actions.append(action)
        rewards.append(float(reward))
        if terminated or truncated or not isinstance(choice, Skill) or choice.ends(observation):
            return observation, rewards, actions, bool(terminated), bool(truncated)


def assert_same(found: Any, expected: Any) -> None:
    """Observations or lists of primitives are equal, part by part."""
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for key, part in expected.items():
            assert_same(found[key], part)
    else:
        np.testing.assert_array_equal(found, expected)
