"""Rewards: the payment for a primitive, as a function of the states before and after it and of its events.

`RewardConfig` is the sparse reward of the paper. A subclass adds to it in `compute_extra`, with the same code for a
single room (numbers) and a batch (tensors). The room configuration names it, `reward.kind = "potential"`, and it works
in every engine, with velocities, under options and on the command line.

`rewards.register(MyReward.kind, MyReward)`, or an entry point in the group `hrl_escape.rewards`, adds a reward of your
own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, NamedTuple

from typing_extensions import Self

from hrl_escape.env.schema import HashedSettings
from hrl_escape.errors import ConfigError
from hrl_escape.registry import Registry
from hrl_escape.settings import Range

__all__ = ["Events", "PotentialReward", "RewardConfig", "RewardState", "TimePenaltyReward", "rewards"]


class Events(NamedTuple):
    """Events of one primitive: numbers for one room, tensors (rooms,) for a batch.

    Targets and doors are bits of one word: bit i is target i of `RoomInstance.targets`, or inner door i.
    """

    pressed: Any  # newly touched targets, int or int64
    turned_on: Any  # targets that turned on, int or int64
    turned_off: Any  # targets that turned off, int or int64
    opened: Any  # inner doors that opened, int or int64
    closed: Any  # inner doors that closed, int or int64
    escaped: Any  # the episode ended in the open exit, bool
    failed: Any  # the episode ended because the puzzle failed, bool


class RewardState(NamedTuple):
    """State of a room as input of rewards: numbers for one room, tensors (rooms,) for a batch."""

    x: Any  # x of the base's axis, m
    y: Any  # y of the base's axis, m
    heading_steps: Any  # heading in turn steps from +x, counter-clockwise
    lit: Any  # fraction of the targets that are on, 0 to 1; 0 without targets
    solved: Any  # the exit is open, bool


@dataclasses.dataclass(frozen=True)
class RewardConfig(HashedSettings):
    """Sparse reward of the paper: -1 per primitive, +100 at the exit."""

    kind: ClassVar[str] = "sparse"
    _section = "reward"
    step: Annotated[float, Range(-1e6, 1e6)] = -1.0
    """Reward of every primitive."""
    exit: Annotated[float, Range(-1e6, 1e6)] = 100.0
    """Reward of the primitive that reaches the exit, in addition to its step."""
    exit_replaces_step: bool = False
    """If true, the primitive that reaches the exit earns `exit` alone (the published 2019 code)."""

    @property
    def on_exit(self) -> float:
        """Reward of the primitive that reaches the exit, without `compute_extra`."""
        return self.exit if self.exit_replaces_step else self.step + self.exit

    def compute_extra(self, before: RewardState, after: RewardState, events: Events) -> Any:
        """Compute the reward of a primitive in addition to `step` and `exit`; 0 by default.

        Use only arithmetic and comparisons, which work for both numbers and tensors.

        Args:
            before: state before the primitive.
            after: state after it.
            events: events of the primitive.

        Returns:
            A number, or a float tensor (rooms,) for a batch.
        """
        return 0.0

    @property
    def is_sparse(self) -> bool:
        """True if rewards are `step` and `exit` alone. The return then follows from the number of primitives."""
        return type(self).compute_extra is RewardConfig.compute_extra

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values, with the kind unless it is the sparse one."""
        fields = super().to_dict()
        return fields if type(self) is RewardConfig else {"kind": self.kind} | fields

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build the reward of the kind that `data` names; see `Settings.from_dict`.

        Raises:
            UnknownNameError: no such kind of reward, or no such field.
            ConfigError: a value is not valid.
        """
        if not isinstance(data, Mapping):
            raise ConfigError(cls._section, data, "a table of fields")
        member = rewards.get(data.get("kind", cls.kind))
        if not issubclass(member, cls):
            raise ConfigError("reward.kind", member.kind, repr(cls.kind))
        return super(RewardConfig, member).from_dict({name: data[name] for name in data if name != "kind"})


@dataclasses.dataclass(frozen=True)
class PotentialReward(RewardConfig):
    """Sparse reward with potential-based shaping (Ng, Harada and Russell 1999): adds gamma Phi(s') - Phi(s).

    Phi(s) is `weight` times the fraction of targets that are on, and 0 at the end of an episode. Shaping preserves the
    optimal policies of an agent with the same discount.
    """

    kind = "potential"
    weight: Annotated[float, Range(0, 1e6)] = 10.0
    """Potential of a room with all targets on, in units of reward. Larger values emphasise shaping."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount of the shaping per primitive. Set it to the agent's gamma."""

    def compute_extra(self, before: RewardState, after: RewardState, events: Events) -> Any:
        """Return gamma Phi(s') - Phi(s), with Phi(s') = 0 if the episode terminates."""
        goes_on = (1 - events.escaped * 1) * (1 - events.failed * 1)
        return self.weight * (self.gamma * after.lit * goes_on - before.lit)


@dataclasses.dataclass(frozen=True)
class TimePenaltyReward(RewardConfig):
    """Penalty for every primitive and no reward at the exit: the return is minus the length of the episode."""

    kind = "time-penalty"
    exit: Annotated[float, Range(-1e6, 1e6)] = 0.0
    """Reward of the primitive that reaches the exit, in addition to its step."""


def _is_reward(part: Any) -> bool:
    return isinstance(part, type) and issubclass(part, RewardConfig)


rewards: Registry[type[RewardConfig]] = Registry("reward", "a subclass of RewardConfig", _is_reward)
"""Classes of rewards by kind."""
for _reward in (RewardConfig, PotentialReward, TimePenaltyReward):
    rewards.register(_reward.kind, _reward)
