"""The Agent protocol and the SMDP transition: what learners and environments say to each other.

Agents learn from SMDP transitions (Sutton, Precup and Singh 1999, section 3): one decision
runs k >= 1 primitives. A flat environment is the case k = 1, so each algorithm is written
once. Nothing here learns; nothing here knows rooms or options, only Gymnasium and `info`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.settings import LearningSettings
from hrl_escape.errors import DiscountMismatchError, StepContractError, UnsupportedSpaceError

__all__ = [
    "Agent",
    "SMDPTransition",
    "StateTree",
    "compute_backup",
    "count_actions",
    "count_steps",
    "make_transition",
    "read_action_mask",
]

StateTree = dict[str, Any]
"""A tree of dicts and lists over numbers, strings, None and numpy arrays: what a checkpoint can hold."""


class SMDPTransition(NamedTuple):
    """One decision and what came of it.

    Attributes:
        observation: where the decision was made, as the environment gave it.
        action: index in the action space.
        action_mask: bool (actions,), the actions legal there.
        reward: R = sum over i < k of gamma^i r_i, at the agent's gamma.
        summed_reward: the undiscounted sum of r_i.
        duration: k >= 1, primitives that ran.
        discount: gamma^k.
        next_observation: the state reached, never the first of a new episode.
        next_action_mask: bool (actions,), the actions legal there.
        terminated: the episode ended in the task's sense; nothing is to be gained after.
        truncated: the episode was cut off; the state reached still has a value.
        trace: the primitives inside, where the environment gives them (see `make_transition`), else empty.
    """

    observation: Any
    action: int
    action_mask: NDArray[np.bool_]
    reward: float
    summed_reward: float
    duration: int
    discount: float
    next_observation: Any
    next_action_mask: NDArray[np.bool_]
    terminated: bool
    truncated: bool
    trace: Sequence[Any] = ()


@runtime_checkable
class Agent(Protocol):
    """A learner. Write these members and `train` can run it; no base class is needed.

    For `make_agent` by name, a class also has `Settings` (a frozen dataclass, best an `AgentSettings`),
    may have `recipes` (name -> settings; without it, `corrected` is `Settings()`) and `needs_trace = True` (it learns
    from `SMDPTransition.trace`, so environments of options are made to give one), is constructed as
    `Class(observation_space, action_space, seed, settings)`, and is published under the entry-point group
    `hrl_escape.agents`:

        [project.entry-points."hrl_escape.agents"]
        my-agent = "my_package.my_module:MyAgent"
    """

    Settings: ClassVar[type]
    settings: Any
    """What the agent was made with."""

    @property
    def gamma(self) -> float:
        """Discount per primitive, at which `SMDPTransition.reward` and `.discount` are computed."""
        ...

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Choose an action for learning: explore, from the agent's own generator."""
        ...

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Choose an action for evaluation: nothing in the agent may change.

        A policy that is random by nature draws from `rng`, never from the agent's own generator, so that
        evaluating twice gives the same numbers and evaluating at all does not disturb learning.
        """
        ...

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn from one decision; returns numbers to log, such as the loss, or nothing.

        Transitions come in order, each from the state reached by the one before, until one is terminated or
        truncated.
        """
        ...

    def state_dict(self) -> StateTree:
        """Everything that learning depends on: weights, optimiser, replay, counters, generators.

        Arrays may share memory with the agent: write or copy them before it goes on learning.
        """
        ...

    def load_state_dict(self, state: StateTree) -> None:
        """Go on exactly where `state_dict` was taken, to the last bit."""
        ...


def read_action_mask(info: Mapping[str, Any], actions: int) -> NDArray[np.bool_]:
    """Read `info["action_mask"]`; without one, all actions are legal.

    Args:
        info: from `reset` or `step`; the mask is 0 or 1 per action, int8 as Gymnasium has it.
        actions: number of actions.

    Returns:
        A bool array (actions,) of its own memory, at least one entry true.

    Raises:
        StepContractError: the mask has another length, or no action is legal.
    """
    mask = info.get("action_mask")
    if mask is None:
        return np.ones(actions, dtype=np.bool_)
    legal = np.asarray(mask) != 0
    if legal.shape != (actions,):
        raise StepContractError(f"info['action_mask'] has shape {legal.shape}; the action space needs ({actions},)")
    if not legal.any():
        raise StepContractError("info['action_mask'] is all zero: at least one action must always be legal")
    return legal


def make_transition(
    observation: Any,
    action: int,
    action_mask: NDArray[np.bool_],
    step: tuple[Any, Any, bool, bool, Mapping[str, Any]],
    gamma: float,
) -> SMDPTransition:
    """Read what `env.step` returned as an SMDP transition at this gamma.

    The contract of `info`, all keys optional:

    - `duration`: int k >= 1, primitives that ran; absent means 1.
    - `rewards`: the k primitive rewards in order. From these R = sum gamma^i r_i is computed, at any gamma.
    - `discounted_reward` and `discount`: R and gamma^k already computed, for environments that do not give
      `rewards`; the gamma must then be the agent's. One of the two ways is needed where k > 1.
    - `action_mask`: see `read_action_mask`; at the state reached.
    - `trace`: one item per primitive, each a tuple that begins with (observation, action, reward,
      next_observation) and may have the attributes `next_action_mask` and `consistent`: pairs (action, beta)
      of the actions whose policy, a function of the state alone, does this same primitive here, with
      their termination probability at the next state. A primitive is consistent with itself, beta = 1.

    Args:
        observation: where the decision was made.
        action: the action taken.
        action_mask: bool (actions,), legal there.
        step: what `env.step(action)` returned.
        gamma: discount per primitive.

    Raises:
        StepContractError: the reward is not finite, the duration below 1, or the rewards do not match it.
        DiscountMismatchError: only `discounted_reward` is given and for another gamma.
    """
    next_observation, reward, terminated, truncated, info = step
    if not math.isfinite(reward):
        raise StepContractError(f"the reward of action {action} is {reward}; rewards must be finite numbers")
    duration = int(info.get("duration", 1))
    if duration == 1:
        discounted = summed = float(reward)
    elif duration < 1:
        raise StepContractError(
            f"action {action} took {duration} primitives; every action must cost at least one, or be masked"
        )
    else:
        discounted, summed = _compute_rewards(float(reward), duration, info, gamma)
    return SMDPTransition(
        observation,
        int(action),
        action_mask,
        discounted,
        summed,
        duration,
        gamma**duration,
        next_observation,
        read_action_mask(info, len(action_mask)),
        bool(terminated),
        bool(truncated),
        info.get("trace") or (),
    )


def _compute_rewards(reward: float, duration: int, info: Mapping[str, Any], gamma: float) -> tuple[float, float]:
    """R = sum gamma^i r_i and sum r_i of an action that ran several primitives."""
    rewards = info.get("rewards")
    if rewards is not None:
        if len(rewards) != duration:
            raise StepContractError(f"info['rewards'] has {len(rewards)} entries for a duration of {duration}")
        discounted = 0.0
        for primitive_reward in reversed(rewards):
            discounted = float(primitive_reward) + gamma * discounted
        return discounted, float(sum(rewards))
    if "discounted_reward" not in info or "discount" not in info:
        raise StepContractError(
            f"an action ran {duration} primitives but info has neither 'rewards' nor 'discounted_reward' with "
            "'discount', so its discounted reward is unknown"
        )
    if abs(float(info["discount"]) - gamma**duration) > 1e-9:
        raise DiscountMismatchError(gamma, float(info["discount"]), duration)
    return float(info["discounted_reward"]), reward


def compute_backup(transition: SMDPTransition, settings: LearningSettings) -> tuple[float, float]:
    """R and the factor b in the backup R + b V(s'), which is all that a learner needs of time and endings.

    With `discounting="primitive"`: R = sum gamma^i r_i and b = gamma^k (1 - terminated). Truncation keeps b
    unless `bootstrap_on_truncation` is off. Backups compose: (R1, b1) then (R2, b2) is (R1 + b1 R2, b1 b2).
    """
    if settings.discounting == "primitive":
        reward, factor = transition.reward, transition.discount
    else:
        reward, factor = transition.summed_reward, settings.gamma
    ended = transition.terminated or (transition.truncated and not settings.bootstrap_on_truncation)
    return reward, 0.0 if ended else factor


def count_actions(action_space: gymnasium.Space, agent: str) -> int:
    """Number of actions of a discrete space that starts at 0.

    Raises:
        UnsupportedSpaceError: the space is of another kind.
    """
    if not isinstance(action_space, gymnasium.spaces.Discrete) or action_space.start != 0:
        raise UnsupportedSpaceError(f"{agent} chooses among Discrete(n) actions from 0, not {action_space}")
    return int(action_space.n)


def count_steps(transition: SMDPTransition, settings: LearningSettings) -> int:
    """How far the agent's clock advances: k primitives, or one decision."""
    return transition.duration if settings.clock == "primitive" else 1
