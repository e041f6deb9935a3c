"""Recorded decisions in any environment with options, as data for agents and for export."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from hrl_escape.agents.agent import set_option_discount
from hrl_escape.agents.components.offline import Primitives, RecordedDecisions
from hrl_escape.data.materialise import DataLevel, discount_rewards
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.options.domain import find_layer
from hrl_escape.options.options_env import OptionsEnv


@dataclass(frozen=True, eq=False, repr=False)
class PlayedData:
    """Decisions in an environment with options, for `train(data=...)` and `to_minari`.

    Attributes:
        name: name of the data.
        env: the environment, for tests; agents over primitives are tested in the environment below its options.
        gamma: discount of the rewards in `decisions`.
        decisions: the decisions, or None in a set of primitives.
        primitives: the primitives inside, or None where they were not recorded.
        level: what `read` and `blocks` return by default.
    """

    name: str
    env: gymnasium.Env
    gamma: float
    decisions: RecordedDecisions | None
    primitives: Primitives | None
    level: DataLevel = "decisions"

    def __repr__(self) -> str:
        count = "" if self.decisions is None else f", {len(self.decisions.action):,} decisions"
        rows = self.decisions or self.primitives
        episodes = 0 if rows is None else int(rows.last.sum())
        inside = "" if self.primitives is None else f", {len(self.primitives.action):,} primitives"
        return f"<PlayedData {self.name}: {episodes:,} episodes{count}{inside}>"

    @property
    def identity(self) -> Mapping[str, Any]:
        """Name and content hash."""
        content = hashlib.sha256()
        for rows in (self.decisions, self.primitives):
            for field in rows or ():
                array = np.ascontiguousarray(field)
                content.update(f"{array.dtype.str} {array.shape}".encode())
                content.update(array.tobytes())
        return {"name": self.name, "digest": content.hexdigest(), "observation": str(self.env.observation_space)}

    def read(self) -> RecordedDecisions | Primitives:
        """Read all data of the default level."""
        return self.read_decisions(self.gamma) if self.level == "decisions" else self.read_primitives()

    def read_decisions(self, gamma: float) -> RecordedDecisions:
        """Read all decisions, with rewards discounted by gamma.

        Raises:
            UnsupportedError: this is a set of primitives.
            ConfigError: primitives were not recorded, and the discount of the decisions is another.
        """
        if self.decisions is None:
            raise UnsupportedError(f"{self.name} holds primitives without the decisions around them: take an agent "
                                   "without the prefix smdp-, or the set of decisions")
        if gamma == self.gamma:
            return self.decisions
        if self.primitives is None:
            raise ConfigError("gamma", gamma, f"{self.gamma:g}, the discount of the decisions in {self.name}; give "
                              f"the agent settings={{'gamma': {self.gamma:g}}}")
        rewards, _ = discount_rewards(self.primitives.reward, self.decisions.duration, gamma)
        return self.decisions._replace(reward=rewards, discount=gamma**self.decisions.duration.astype(np.float64))

    def read_primitives(self) -> Primitives:
        """Read all primitives.

        Raises:
            UnsupportedError: they were not recorded.
        """
        if self.primitives is None:
            raise UnsupportedError(f"{self.name} holds no primitives: take an agent over options, such as "
                                   "smdp-fitted-q, or record with OptionsEnv as the outermost wrapper")
        return self.primitives

    def blocks(self, level: DataLevel | None = None) -> Iterator[Any]:
        """Yield all data of a level in one block."""
        yield self.read_primitives() if (level or self.level) == "primitives" else self.read_decisions(self.gamma)

    def make_env(self, options: bool, gamma: float) -> gymnasium.Env:
        """Return the environment for tests, with the actions of the decisions or of the primitives."""
        if not options and self.env.has_wrapper_attr("set_option_discount"):
            level = find_layer(self.env, OptionsEnv)
            if level is None:
                raise UnsupportedError(f"{self.env} has no options: wrap it in OptionsEnv(env, options)")
            return level.env
        set_option_discount(self.env, gamma)
        return self.env
