"""`dqn` over the primitives of an `OptionsEnv` with traces, whose options serve it for something else than choice."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.algorithms.dqn import DQN, DQNSettings
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.decisions import Moments, Policy
from hrl_escape.agents.registry import get_recipe
from hrl_escape.settings import replace_settings

__all__ = ["PrimitivesDQN", "PrimitivesSettings", "count_primitives", "measure_lengths", "read_room"]

TRIED = 40
"""Options that are run before training, to know how long they last."""


@dataclass(frozen=True, kw_only=True)
class PrimitivesSettings(DQNSettings):
    """Settings of `PrimitivesDQN`, which `read_room` fills in, in addition to the settings of `dqn`."""

    lengths: tuple[int, ...] = (1,)
    """Primitives of options in this room, of which the length of a random way is drawn."""
    primitives: int = 1
    """Actions that are primitives: the first of all."""


_SettingsType = TypeVar("_SettingsType", bound=PrimitivesSettings)


class PrimitivesDQN(DQN):
    """`dqn` that values, and greedily chooses among, the first actions of an environment with options."""

    needs_trace: ClassVar[bool] = True
    settings: Any

    def __init__(self, observation_space: gymnasium.Space, seed: int, settings: PrimitivesSettings) -> None:
        super().__init__(observation_space, gymnasium.spaces.Discrete(settings.primitives), seed, settings)

    def cut(self, action_mask: NDArray[Any]) -> NDArray[Any]:
        """Mask of the primitives."""
        return action_mask[..., : self.settings.primitives]

    def list_options(self, action_mask: NDArray[Any]) -> NDArray[np.int64]:
        """Legal options."""
        return np.flatnonzero(action_mask[self.settings.primitives:]) + self.settings.primitives

    def make_policy(self) -> Policy:
        """Make the policy that takes the legal primitive of highest value."""
        return _PrimitivesPolicy(self, super().make_policy())


class _PrimitivesPolicy(Policy):
    """A policy that is shown the mask of the primitives."""

    def __init__(self, agent: PrimitivesDQN, policy: Policy) -> None:
        self._agent, self._policy = agent, policy

    def begin_episode(self, rng: np.random.Generator, num_envs: int = 1) -> None:
        self._policy.begin_episode(rng, num_envs)

    def act(self, batch: Moments) -> Any:
        return self._policy.act(batch._replace(action_mask=self._agent.cut(batch.action_mask)))


def read_room(kind: type[_SettingsType], env: Any, changes: Mapping[str, Any]) -> _SettingsType:
    """Settings as `dqn` has them, with changes, for the room of an `OptionsEnv` with primitives and traces.

    The lengths of options are measured in it, so that its next episode is begun anew.
    """
    room = {"lengths": measure_lengths(env), "primitives": count_primitives(env)}
    return replace_settings(kind(), {**dataclasses.asdict(get_recipe("dqn")), **changes, **room})


def count_primitives(env: Any) -> int:
    """Number of actions that are primitives."""
    space: Any = env.unwrapped.action_space
    return int(space.n)


def measure_lengths(env: Any) -> tuple[int, ...]:
    """Primitives of random legal options, one after the other."""
    first, rng, lengths = count_primitives(env), make_rng(0, "lengths"), []
    _, info = env.reset(seed=0)
    while len(lengths) < TRIED:
        options = np.flatnonzero(info["action_mask"][first:]) + first
        *_, terminated, truncated, info = env.step(int(rng.choice(options)))
        lengths.append(int(info["duration"]))
        if terminated or truncated:
            _, info = env.reset()
    return tuple(lengths)
