"""Environment for an agent with a task hierarchy: a flat room whose observation is the situation that tasks read.

Primitives, rewards and episodes are the same as in the flat room, and so are budgets and statistics. The situation
holds facts of the room that other agents do not observe. `structure` holds the agent's hierarchy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy_kinds import HierarchyKind
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import RoomState
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.hierarchies.situation import Situations
from hrl_escape.hierarchies.synthesise import make_structure

if TYPE_CHECKING:
    from hrl_escape.env.vector_env import EscapeRoomVectorEnv


class HierarchyEnv(gymnasium.Wrapper, RecordConstructorArgs):
    """Wrapper of a flat room for agents with a task hierarchy; `train` passes its `structure` to the agent.

    Args:
        env: a flat room, always the same instance.
        kind: kind of hierarchy that the agent takes, as in `synthesise`.
        low_level: `planned` or `learned`.
        abstract: each task observes only the relevant part of the situation.
        cell: size of the squares that discretise poses in a learned low level, m; the length of a move by default.

    Attributes:
        structure: arguments of the agent besides spaces and settings.

    Raises:
        UnknownNameError: no such kind or low level.
        UnsupportedError: the puzzle requires more than presses, the environment changes its room, or the low level of
            this kind cannot be planned.
    """

    def __init__(self, env: gymnasium.Env, kind: HierarchyKind = "maxq", low_level: str = "planned",
                 abstract: bool = True, cell: float | None = None) -> None:
        RecordConstructorArgs.__init__(self, kind=kind, low_level=low_level, abstract=abstract, cell=cell)
        gymnasium.Wrapper.__init__(self, env)
        self._room: Any = env.unwrapped
        instance: RoomInstance = self._room.instance
        self._id = instance.id
        self._situations = Situations(instance, cell)
        self.observation_space = self._situations.space
        self.structure = make_structure(self._situations, kind, low_level, abstract)

    def observe(self, state: RoomState) -> NDArray[np.float64]:
        """Return the observation of a state of the room, for `make_learned_options`."""
        return self._situations.pack(state)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[NDArray[Any], dict[str, Any]]:
        """Begin an episode.

        Raises:
            UnsupportedError: the environment has changed its room.
        """
        _, info = self.env.reset(seed=seed, options=options)
        if self._room.instance.id != self._id:
            raise UnsupportedError(f"a hierarchy was synthesised for room {self._id}, and this is "
                                   f"{self._room.instance.id}: train on one instance")
        return self._situations.pack(self._room.get_state()), info

    def step(self, action: Any) -> tuple[NDArray[Any], Any, bool, bool, dict[str, Any]]:
        """Run one primitive; returns the situation of the new state as observation."""
        _, reward, terminated, truncated, info = self.env.step(action)
        return self._situations.pack(self._room.get_state()), reward, terminated, truncated, info


class HierarchyVectorEnv(VectorWrapper):
    """`HierarchyEnv` for many copies of a room that step together.

    Args:
        env: copies of one instance, with automatic reset in the step after the end of an episode.

    Raises:
        UnknownNameError: no such kind or low level.
        UnsupportedError: the puzzle requires more than presses, there are several instances, or the low level of this
            kind cannot be planned.
        ConfigError: another kind of automatic reset.
    """

    def __init__(self, env: EscapeRoomVectorEnv, kind: HierarchyKind = "maxq", low_level: str = "planned") -> None:
        super().__init__(env)
        instance, *others = env.instances
        if others:
            raise UnsupportedError(f"a hierarchy is synthesised for one room, and these are {len(env.instances)}")
        if env.autoreset_mode == AutoresetMode.SAME_STEP:
            raise ConfigError("autoreset_mode", env.autoreset_mode.value, "'NextStep' or 'Disabled'")
        self._rooms = env
        self._single: tuple[HierarchyKind, str] = kind, low_level
        self._situations = Situations(instance)
        make_structure(self._situations, kind, low_level)  # raises for unsupported rooms
        self.single_observation_space = self._situations.space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def make_single_env(self) -> HierarchyEnv:
        """Make an ordinary environment of the same room and hierarchy."""
        return HierarchyEnv(self._rooms.make_single_env(), *self._single)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin new episodes; see `EscapeRoomVectorEnv.reset`."""
        _, infos = super().reset(seed=seed, options=options)
        return self._pack(), infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Run one primitive in every room; returns the situations of the new states as observations."""
        _, reward, terminated, truncated, infos = super().step(actions)
        return self._pack(), reward, terminated, truncated, infos

    def _pack(self) -> NDArray[np.float64]:
        """Situations of all rooms, (rooms, numbers)."""
        states = self._rooms.room.get_room_states(range(self.num_envs))
        return np.stack([self._situations.pack(state) for state in states])
