"""Rewards: how much a room pays for a primitive, as a function of the states before and after it and of its events.

`RewardConfig` is the paper's sparse reward. A subclass adds to it in `compute_extra`, with one text for a single room
(numbers) and for a batch (tensors). It is named in the room configuration, `reward.kind = "potential"`, and works in
every engine, with velocities, under options and on the command line.

A reward of your own is registered by `rewards.register(MyReward.kind, MyReward)`, or by an entry point in the group
`hrl_escape.rewards`.
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

    Targets and doors are bits of one word: bit i is set for target i of `RoomInstance.targets`, or inner door i.
    """

    pressed: Any  # targets newly touched, int or int64
    turned_on: Any  # targets that came on, int or int64
    turned_off: Any  # targets that went off, int or int64
    opened: Any  # inner doors that opened, int or int64
    closed: Any  # inner doors that closed, int or int64
    escaped: Any  # the episode ended in the open exit, bool
    failed: Any  # the episode ended because the puzzle was failed, bool


class RewardState(NamedTuple):
    """State of a room as rewards see it: numbers for one room, tensors (rooms,) for a batch."""

    x: Any  # position of the base's axis, m
    y: Any  # likewise
    heading_steps: Any  # heading in turn steps from +x, counter-clockwise
    lit: Any  # share of the targets that are on, 0 to 1; 0 where there is none
    solved: Any  # the exit is open, bool


@dataclasses.dataclass(frozen=True)
class RewardConfig(HashedSettings):
    """Sparse reward of the paper: -1 a primitive, +100 at the exit."""

    kind: ClassVar[str] = "sparse"
    _section = "reward"
    step: Annotated[float, Range(-1e6, 1e6)] = -1.0
    """Reward of every primitive."""
    exit: Annotated[float, Range(-1e6, 1e6)] = 100.0
    """Reward of the primitive that exits, on top of its step."""
    exit_replaces_step: bool = False
    """The exiting primitive earns `exit` alone (the published 2019 code)."""

    @property
    def on_exit(self) -> float:
        """Reward of the primitive that exits, without `compute_extra`."""
        return self.exit if self.exit_replaces_step else self.step + self.exit

    def compute_extra(self, before: RewardState, after: RewardState, events: Events) -> Any:
        """Compute what a primitive earns in addition to `step` and `exit`; 0 by default.

        Use arithmetic and comparisons alone, so that the same text serves numbers and tensors.

        Args:
            before: state before the primitive.
            after: state after it.
            events: what happened in between.

        Returns:
            A number, or a float tensor (rooms,) for a batch.
        """
        return 0.0

    @property
    def is_sparse(self) -> bool:
        """True if a primitive earns `step` and `exit` alone, so that a return follows from the number of primitives."""
        return type(self).compute_extra is RewardConfig.compute_extra

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain values, and the kind unless it is the sparse one."""
        fields = super().to_dict()
        return fields if type(self) is RewardConfig else {"kind": self.kind} | fields

    @classmethod
    def from_dict(cls, data: Any) -> Self:
        """Build the reward of the kind that `data` names; see `Settings.from_dict`.

        Raises:
            UnknownNameError: no such kind of reward, or no such field.
            ConfigError: a value is not possible.
        """
        if not isinstance(data, Mapping):
            raise ConfigError(cls._section, data, "a table of fields")
        member = rewards.get(data.get("kind", cls.kind))
        if not issubclass(member, cls):
            raise ConfigError("reward.kind", member.kind, repr(cls.kind))
        return super(RewardConfig, member).from_dict({name: data[name] for name in data if name != "kind"})


@dataclasses.dataclass(frozen=True)
class PotentialReward(RewardConfig):
    """Sparse reward with potential-based shaping (Ng, Harada and Russell 1999): gamma Phi(s') - Phi(s) is added.

    Phi(s) is `weight` times the share of the targets that are on, and 0 at an episode's end. Shaping leaves the optimal
    policies of an agent with the same discount unchanged.
    """

    kind = "potential"
    weight: Annotated[float, Range(0, 1e6)] = 10.0
    """Potential of a room with all targets on, in units of reward."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount of the shaping per primitive; give it the agent's gamma."""

    def compute_extra(self, before: RewardState, after: RewardState, events: Events) -> Any:
        """Compute gamma Phi(s') - Phi(s), with Phi(s') = 0 where the episode terminates."""
        goes_on = (1 - events.escaped * 1) * (1 - events.failed * 1)
        return self.weight * (self.gamma * after.lit * goes_on - before.lit)


@dataclasses.dataclass(frozen=True)
class TimePenaltyReward(RewardConfig):
    """A penalty for every primitive and nothing for the exit: the return is minus the length of the episode."""

    kind = "time-penalty"
    exit: Annotated[float, Range(-1e6, 1e6)] = 0.0
    """Reward of the primitive that exits, on top of its step."""


def _is_reward(part: Any) -> bool:
    return isinstance(part, type) and issubclass(part, RewardConfig)


rewards: Registry[type[RewardConfig]] = Registry("reward", "a subclass of RewardConfig", _is_reward)
"""Classes of rewards by kind."""
for _reward in (RewardConfig, PotentialReward, TimePenaltyReward):
    rewards.register(_reward.kind, _reward)
