"""Rewards and `info` keys of a step that may have run several primitives.

`OptionsEnv` writes these keys. Agents, and levels of options above, read them. Other environments may use the same
names for other values. A key is therefore only read together with the keys that belong to it and with a value of its
type.
"""

from __future__ import annotations

import math
import numbers
import operator
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hrl_escape.errors import ActionError, DiscountMismatchError, StepContractError

ENDINGS = ("reached", "timeout", "episode-over", "planning-failed", "interrupted")
"""Values of `info["option"]["ended"]`."""
FLOAT32_ROUNDING = 2.0**-23
"""Relative rounding error of float32, the dtype of rewards in some wrappers and vector environments."""
CHANGED = (
    "the reward {where} is {reward:g}, but its primitives paid {summed:g} in sum: a wrapper above OptionsEnv changed "
    "it, where it does not reach the rewards inside options. Put the wrapper below, as in "
    "OptionsEnv(ClipReward(env), ...)"
)
"""Message for a reward that differs from the rewards of the primitives."""


def read_action(action: Any, count: int) -> int:
    """Return an action as a whole number.

    Raises:
        ActionError: it is not one of 0 to count - 1.
    """
    try:
        index = operator.index(action)
    except TypeError:
        raise ActionError(action, count) from None
    if not 0 <= index < count:
        raise ActionError(action, count)
    return index


class Payment(NamedTuple):
    """Rewards of one step."""

    duration: int  # k >= 1, number of primitives
    summed: float  # undiscounted sum of their rewards
    rewards: tuple[float, ...] | None  # one per primitive, or None if the step does not give them
    discounted: float | None  # sum over i < k of gamma^i r_i, if given
    discount: float | None  # gamma^k, if given

    def compute_discounted(self, gamma: float) -> float:
        """Return the sum over i < k of gamma^i r_i.

        Raises:
            DiscountMismatchError: the step gives it for another gamma, without the rewards of primitives.
        """
        if self.discounted is not None and self.discount is not None and is_discount(self.discount, gamma,
                                                                                     self.duration):
            return self.discounted
        if self.rewards is None:
            assert self.discount is not None
            raise DiscountMismatchError(gamma, self.discount, self.duration)
        total = 0.0
        for reward in reversed(self.rewards):
            total = reward + gamma * total
        return total


def is_discount(discount: float, gamma: float, duration: int) -> bool:
    """Return whether a discount is gamma^k, up to the rounding of float32."""
    return math.isclose(discount, gamma**duration, rel_tol=FLOAT32_ROUNDING * duration, abs_tol=1e-12)


def is_decision(info: Mapping[str, Any]) -> bool:
    """Return whether `info` has a duration with the rewards of that many primitives or their discounted sum."""
    return "duration" in info and (_has_rewards(info) or ("discounted_reward" in info and "discount" in info))


def _has_rewards(info: Mapping[str, Any]) -> bool:
    """Return whether `info["rewards"]` is a list of some kind."""
    rewards = info.get("rewards")
    return hasattr(rewards, "__len__") and not isinstance(rewards, Mapping | str)


def read_duration(info: Mapping[str, Any], where: str = "of a step") -> int:
    """Return the number of primitives of a step; 1 if `info` does not give it.

    Raises:
        StepContractError: it is not a whole number of at least 1, or it is above 1 without the keys for rewards.
    """
    duration: Any = info.get("duration")
    is_whole = isinstance(duration, numbers.Integral) and not isinstance(duration, bool)
    if isinstance(duration, np.ndarray) and duration.ndim == 0 and duration.dtype.kind in "iu":
        duration, is_whole = int(duration), True
    if is_decision(info):
        if not is_whole:
            raise StepContractError(f"info['duration'] {where} is {duration!r}; it must be the whole number of "
                                    "primitives that ran")
        if duration < 1:
            raise StepContractError(f"the step {where} took {duration} primitives; every action must cost at least "
                                    "one, or be masked")
    elif not is_whole:
        return 1
    elif duration != 1:
        raise StepContractError(
            f"info['duration'] {where} is {duration}, but info has neither 'rewards' nor 'discounted_reward' with "
            f"'discount', so the rewards of {duration} primitives are unknown. Add them; if the environment means "
            "something else by 'duration', rename the key in a wrapper")
    return int(duration)


def read_payment(reward: Any, info: Mapping[str, Any], where: str = "of a step") -> Payment:
    """Return the rewards of a step.

    Args:
        reward: reward that `step` returned: the sum of the rewards of its primitives, or their discounted sum.
        info: info of the same step. If it describes a decision, `rewards`, `summed_reward`, `discounted_reward` and
            `discount` are read; see `OptionsEnv`.
        where: the step in messages, such as `of action 3`.

    Raises:
        StepContractError: a reward is not a single finite number, the rewards do not match the duration, or `reward`
            equals neither sum, because a wrapper changed it after summation.
    """
    given = read_number(reward, f"the reward {where}")
    duration = read_duration(info, where) if "duration" in info else 1
    if not is_decision(info):
        return Payment(1, given, (given,), None, None)
    discounted, discount, summed, rewards = None, None, None, info["rewards"] if _has_rewards(info) else None
    if "discounted_reward" in info and "discount" in info:
        discounted, discount = (read_number(info[name], f"the reward {where} is {given:g} and its {name}")
                                for name in ("discounted_reward", "discount"))
    if "summed_reward" in info:
        summed = read_number(info["summed_reward"], f"the reward {where} is {given:g} and its summed_reward")
    if rewards is not None:
        rewards = _read_each(rewards, duration, f"the reward {where} is {given:g} and info['rewards']")
        summed = float(sum(rewards)) if summed is None else summed
    elif summed is None:
        summed = discounted if duration == 1 and discounted is not None else given
    assert summed is not None
    scale = sum(map(abs, rewards or ()))
    if not any(is_same(given, each, duration, scale) for each in (summed, discounted) if each is not None):
        raise StepContractError(CHANGED.format(where=where, reward=given, summed=summed))
    return Payment(duration, summed, (summed,) if rewards is None and duration == 1 else rewards, discounted, discount)


def is_same(reward: float, paid: float, duration: int, scale: float = 0.0) -> bool:
    """Return whether a reward is a sum of a number of rewards, up to the rounding of float32.

    Args:
        reward: the reward.
        paid: the sum.
        duration: number of rewards in the sum.
        scale: sum of their absolute values, if known.
    """
    return abs(reward - paid) <= FLOAT32_ROUNDING * duration * max(scale, abs(paid))


def read_number(value: Any, what: str) -> float:
    """Return a single finite number. Raises `StepContractError`, with `what` in its message, for anything else."""
    if type(value) is not float:
        try:
            array = np.empty(0) if value is None else np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError, RuntimeError):
            array = np.empty(0)
        if array.size != 1:
            raise StepContractError(f"{what} is {value!r}; rewards must be numbers, one per step. If the environment "
                                    "returns several, combine them in a wrapper below, such as TransformReward")
        value = float(array.item())
    if not math.isfinite(value):
        raise StepContractError(f"{what} is {value}; rewards must be finite numbers")
    return value


def _read_each(rewards: Any, duration: int, what: str) -> tuple[float, ...]:
    """Rewards of the primitives. Raises `StepContractError`."""
    if len(rewards) != duration:
        raise StepContractError(f"{what} has {len(rewards)} entries for a duration of {duration}; it must have one per "
                                "primitive")
    return tuple(read_number(each, f"{what} has an entry that") for each in rewards)


def read_option(info: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return `info["option"]` if `OptionsEnv` wrote it, with one of `ENDINGS` as `ended`; otherwise None."""
    option = info.get("option")
    if not isinstance(option, Mapping):
        return None
    name, ended = option.get("name", ""), option.get("ended")
    return option if isinstance(name, str) and isinstance(ended, str) and ended in ENDINGS else None


def read_trace(info: Mapping[str, Any], duration: int) -> Sequence[Any]:
    """Return `info["trace"]` if it has a tuple of at least four fields per primitive; otherwise an empty sequence."""
    trace = info.get("trace")
    if not isinstance(trace, (tuple, list)) or not all(isinstance(step, tuple) and len(step) >= 4 for step in trace):
        return ()
    primitives = sum(len(getattr(step, "rewards", ())) or 1 for step in trace)
    return trace if primitives == duration else ()


def read_share(info: Mapping[str, Any], name: str) -> float | None:
    """Return a number from 0 to 1 in `info`, or None if the key is absent or has a value of another type.

    Raises:
        StepContractError: the number is not from 0 to 1.
    """
    value = info.get(name)
    if not isinstance(value, numbers.Real):
        return None
    share = float(value)
    if not 0.0 <= share <= 1.0:
        raise StepContractError(f"info[{name!r}] is {value}; it must be a number from 0 to 1. If the environment means "
                                "something else by the key, rename it in a wrapper")
    return share
