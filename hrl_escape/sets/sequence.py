"""Episodes of several parts: trials in the same room, or one room after another.

Trials follow Duan et al. (2016), "RL^2": an agent with frozen weights can improve within the episode by its memory.
Sequences of rooms follow Juliani et al. (2019), "Obstacle Tower": an escape leads to the next room, within one horizon.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from hrl_escape.agents.agent import set_option_discount
from hrl_escape.agents.training.env_description import describe_env, make_described_env
from hrl_escape.errors import ConfigError, UnsupportedError


def compute_room_seed(seed: int, position: int) -> int:
    """Compute the seed of a room in an episode by its position; the first room has the episode's seed."""
    return int(np.random.SeedSequence([seed, position]).generate_state(1)[0]) if position else seed


class SequenceEnv(gymnasium.Wrapper, RecordConstructorArgs):
    """Wrapper for episodes of several trials, each from a start of a room.

    With `trials`, all trials are in the same room and each has the room's full horizon. With `then`, each trial is in a
    different room: an escape leads to the next room, whose instance and start follow from the episode's seed. All rooms
    share one horizon. The episode ends with the last trial, or in a room from which the robot does not escape.

    The step that ends a trial returns the first observation of the next trial, and neither terminates nor truncates
    unless it was the last. Wrappers and recurrent agents outside see one episode. `info["trial"]` is the number of the
    trial, from 0. At the end of a trial `info["trial_ended"]` is true and `info["is_success"]` holds its success.

    Args:
        env: a room or a set of rooms, or an `OptionsEnv` over one.
        trials: number of trials in its room.
        then: environments of the following rooms, with the same spaces, or their descriptions.
        paired: all rooms have the number of the first one in their sets; otherwise each is drawn.

    Attributes:
        parts: environments of all rooms in order, the first one `env`.

    Raises:
        ConfigError: `trials` is below 1, or above 1 with `then`.
        UnsupportedError: a room has different spaces from the first.
    """

    def __init__(self, env: gymnasium.Env, trials: int = 1, then: Sequence[gymnasium.Env | Mapping[str, Any]] = (),
                 paired: bool = False) -> None:
        if trials < 1 or (then and trials > 1):
            raise ConfigError("trials", trials, "1 or more, and 1 where rooms follow")
        others = [make_described_env(each) if isinstance(each, Mapping) else each for each in then]
        RecordConstructorArgs.__init__(self, trials=trials, then=[describe_env(each) for each in others],
                                       **({"paired": True} if paired else {}))
        super().__init__(env)
        self.parts, self.paired = (env, *others), paired
        for number, each in enumerate(others, 1):
            if (each.observation_space, each.action_space) != (env.observation_space, env.action_space):
                raise UnsupportedError(f"room {number} of the sequence has other spaces than the first; see "
                                       "join_spaces")
        self._count, self._trial, self._seed = max(trials, len(self.parts)), 0, 0
        self._present = env

    @property
    def unwrapped(self) -> Any:
        """The current room's environment."""
        return self._present.unwrapped

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the first trial."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._trial, self._present = 0, self.env
        if len(self.parts) > 1:
            self._seed = int(self.env.unwrapped.np_random.integers(2**63)) if seed is None else seed
        return observation, {**info, "trial": 0}

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Take an action; at the end of a trial the next one begins."""
        observation, reward, terminated, truncated, info = self._present.step(action)
        info = {**info, "trial": self._trial, "trial_ended": terminated or truncated}
        if terminated or truncated:
            if self._trial + 1 < self._count and (info["is_success"] or len(self.parts) == 1):
                self._trial += 1
                observation, begun = self._try_again() if len(self.parts) == 1 else self._go_on()
                info |= {name: begun[name] for name in ("action_mask",) if name in begun}
                terminated = truncated = False
        return observation, reward, terminated, truncated, info

    def set_option_discount(self, gamma: float) -> None:
        """Set the discount of the options in all rooms; see `OptionsEnv`."""
        for each in self.parts:
            set_option_discount(each, gamma)

    def close(self) -> None:
        """Close the environments of all rooms."""
        for each in self.parts:
            each.close()

    def _try_again(self) -> tuple[Any, dict[str, Any]]:
        """Begin in the same room again."""
        index = self.unwrapped.instance_index
        return self.env.reset(options=None if index is None else {"instance_index": index})

    def _go_on(self) -> tuple[Any, dict[str, Any]]:
        """Begin in the next room with the remaining horizon."""
        spent, seed = self.unwrapped.get_state().primitives, compute_room_seed(self._seed, self._trial)
        self._present = self.parts[self._trial]
        first: Any = self.parts[0].unwrapped
        room = {"instance_index": first.instance_index} if self.paired else {}
        self._present.reset(seed=seed, options=room or None)
        state = self.unwrapped.get_state()._replace(primitives=spent)
        return self._present.reset(seed=seed, options={"state": state, **room})
