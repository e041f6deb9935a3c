"""The arguments that all classes of many rooms share, as one value: instances, observation and device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import Any, TypeAlias, TypedDict

import numpy as np
import torch

from hrl_escape.env.instance import InstanceForm, RoomInstance, read_instance
from hrl_escape.env.presets import ConfigForm, read_config
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError

InstanceSource: TypeAlias = InstanceForm | Sequence[InstanceForm]


class RoomArguments(TypedDict, total=False):
    """Arguments of `Rooms` that constructors pass on."""

    instance: InstanceSource | None
    instance_seed: int
    num_instances: int
    resample_instance: bool
    device: str | torch.device
    compile: bool


@dataclass(frozen=True)
class Rooms:
    """Many rooms that step together; room i has instance i modulo the number of instances.

    Attributes:
        num_envs: number of rooms.
        config: preset name, `RoomConfig`, or the dict form of one.
        instance: a `RoomInstance`, the path of a saved one, or several of them, instead of `config`.
        instance_seed: seed of the first instance.
        num_instances: number of instances, with consecutive seeds from `instance_seed`.
        observation: name of a vector observation.
        resample_instance: whether every episode draws one of the instances.
        device: device of the rooms.
        compile: whether to fuse a step into compiled kernels, which takes 5 to 30 s once per shape of batch.

    Raises:
        ConfigError: invalid number of rooms or instances, seed or device.
    """

    num_envs: int = 1
    config: ConfigForm = "paper-two-button"
    _: KW_ONLY
    instance: InstanceSource | None = None
    instance_seed: int = 0
    num_instances: int = 1
    observation: str = "state"
    resample_instance: bool = False
    device: str | torch.device = "cpu"
    compile: bool = False

    def __post_init__(self) -> None:
        for name, least in (("num_envs", 1), ("num_instances", 1), ("instance_seed", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
                raise ConfigError(name, value, f"a whole number of at least {least}")
        object.__setattr__(self, "device", find_device(self.device))

    @cached_property
    def instances(self) -> tuple[RoomInstance, ...]:
        """The instances, read or generated at first use."""
        if self.instance is None:
            config = read_config(self.config)
            return tuple(generate(config, self.instance_seed + i) for i in range(self.num_instances))
        if isinstance(self.instance, Sequence) and not isinstance(self.instance, str):
            if not self.instance:
                raise ConfigError("instance", self.instance, "at least one RoomInstance")
            return tuple(read_instance(one) for one in self.instance)
        return (read_instance(self.instance),)

    def list_single_arguments(self) -> dict[str, Any]:
        """Return arguments of an `EscapeRoomEnv` with the same rooms and observation."""
        rooms = self.instances
        given: dict[str, Any] = {"instance": rooms[0]} if len(rooms) == 1 else {"instances": rooms}
        return {**given, "observation": self.observation}

    def describe(self) -> dict[str, Any]:
        """Return what determines the dynamics and observations, as JSON values; instances are given by their ids."""
        return {"num_envs": self.num_envs, "instances": [str(room.id) for room in self.instances],
                "observation": self.observation, "resample_instance": self.resample_instance,
                "device": str(self.device), "compile": self.compile}


def find_device(device: str | torch.device) -> torch.device:
    """Return the torch device of a name, after a test of double precision.

    Raises:
        ConfigError: this torch has no such device, or the device lacks double precision.
    """
    try:
        found = torch.empty(0, dtype=torch.float64, device=device).device
        if found.type == "meta":
            raise TypeError("its tensors hold no numbers")
        return found
    except (RuntimeError, AssertionError, TypeError) as error:  # devices raise different errors if they are missing
        allowed = f"a device of this torch with double precision ({str(error).splitlines()[0]})"
        raise ConfigError("device", str(device), allowed) from None
