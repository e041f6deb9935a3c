"""Sequences of rooms as one episode: several trials in the same room, or the floors of a tower.

Trials are the formulation of Duan et al. (2016), "RL^2": an agent whose weights do not change can get better within the
episode by its memory alone. A tower is that of Juliani et al. (2019), "Obstacle Tower": whoever escapes from a floor
climbs to the next one, within one horizon.
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


def compute_floor_seed(seed: int, floor: int) -> int:
    """Seed of a floor, from 0, in the episode of a seed; the first floor has the episode's own."""
    return int(np.random.SeedSequence([seed, floor]).generate_state(1)[0]) if floor else seed


class SequenceEnv(gymnasium.Wrapper, RecordConstructorArgs):
    """Makes an episode of several trials, each from a start of a room.

    With `trials`, all are in the same room, and each has the room's horizon to itself. With `then`, each is on a floor
    of its own: an escape leads to the next floor, whose room and start follow from the episode's seed, and the
    primitives of the floors below count, so that all share one horizon. An episode ends with its last trial, or on a
    floor from which the robot does not escape.

    The step that ends a trial shows the start of the next one, and neither terminates nor truncates unless it was the
    last. Wrappers and recurrent agents outside see one episode. `info["trial"]` is the number of a step's trial, from
    0; where it ends the trial `info["trial_ended"]` is true and `info["is_success"]` says whether the robot escaped.

    Args:
        env: a room or a set of rooms, or an `OptionsEnv` over one.
        trials: number of trials in its room.
        then: environments of the floors above, with the same spaces, or their descriptions.
        paired: every floor has the room of the number, in its set, that the lowest floor's has; otherwise each draws.

    Attributes:
        floors: environments of all floors, the first one that of `env`.

    Raises:
        ConfigError: no trial, or several with floors above.
        UnsupportedError: a floor has other spaces than the first.
    """

    def __init__(self, env: gymnasium.Env, trials: int = 1, then: Sequence[gymnasium.Env | Mapping[str, Any]] = (),
                 paired: bool = False) -> None:
        if trials < 1 or (then and trials > 1):
            raise ConfigError("trials", trials, "1 or more, and 1 where there are floors above")
        above = [make_described_env(floor) if isinstance(floor, Mapping) else floor for floor in then]
        RecordConstructorArgs.__init__(self, trials=trials, then=[describe_env(floor) for floor in above],
                                       **({"paired": True} if paired else {}))
        super().__init__(env)
        self.floors, self.paired = (env, *above), paired
        for number, floor in enumerate(above, 1):
            if (floor.observation_space, floor.action_space) != (env.observation_space, env.action_space):
                raise UnsupportedError(f"floor {number} has other spaces than the one at the bottom; see join_spaces")
        self._count, self._trial, self._seed = max(trials, len(self.floors)), 0, 0
        self._present = env

    @property
    def unwrapped(self) -> Any:
        """The room that the robot is in."""
        return self._present.unwrapped

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin the first trial."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._trial, self._present = 0, self.env
        if len(self.floors) > 1:
            self._seed = int(self.env.unwrapped.np_random.integers(2**63)) if seed is None else seed
        return observation, {**info, "trial": 0}

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Act; at the end of a trial the next one begins."""
        observation, reward, terminated, truncated, info = self._present.step(action)
        info = {**info, "trial": self._trial, "trial_ended": terminated or truncated}
        if terminated or truncated:
            if self._trial + 1 < self._count and (info["is_success"] or len(self.floors) == 1):
                self._trial += 1
                observation, begun = self._try_again() if len(self.floors) == 1 else self._climb()
                info |= {name: begun[name] for name in ("action_mask",) if name in begun}
                terminated = truncated = False
        return observation, reward, terminated, truncated, info

    def set_option_discount(self, gamma: float) -> None:
        """Set the discount of the options on all floors; see `OptionsEnv`."""
        for floor in self.floors:
            set_option_discount(floor, gamma)

    def close(self) -> None:
        """Close the environments of all floors that were built."""
        for floor in self.floors:
            floor.close()

    def _try_again(self) -> tuple[Any, dict[str, Any]]:
        """Begin in the same room again."""
        index = self.unwrapped.instance_index
        return self.env.reset(options=None if index is None else {"instance_index": index})

    def _climb(self) -> tuple[Any, dict[str, Any]]:
        """Begin on the next floor, with the primitives of those below spent."""
        spent, seed = self.unwrapped.get_state().primitives, compute_floor_seed(self._seed, self._trial)
        self._present = self.floors[self._trial]
        lowest: Any = self.floors[0].unwrapped
        room = {"instance_index": lowest.instance_index} if self.paired else {}
        self._present.reset(seed=seed, options=room or None)
        state = self.unwrapped.get_state()._replace(primitives=spent)
        return self._present.reset(seed=seed, options={"state": state, **room})
