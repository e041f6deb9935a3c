"""The references by name, evaluated on the same episodes as the learners, without training.

| name | what it does | what it is given |
|---|---|---|
| `sweep` | presses buttons 1, 2, ..., n, leaves, over and over | nothing |
| `sweep-random` | the same in an order drawn for the episode | nothing |
| `search-random` | presses what is unlit and untried since the lights last changed, in random order | lights |
| `search-nearest` | the same, the nearest first | lights, places |
| `search-backtrack` | the same, and goes back by known presses to where something is untried | lights, places |
| `bayes` | fewest expected primitives over the graphs that the room configuration can draw | lights, places, room
configuration | | `oracle` | follows the best known plan | everything |

A search baseline is given neither the graph nor how rooms are drawn, and starts every episode anew. The Bayes planner,
`bayes`, is given how rooms are drawn and plans for the fewest expected primitives. A learner that trains in the
room where it is tested can exceed both, because it keeps what it found.
"""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import FixedPolicy
from hrl_escape.agents.spec import (
    BAYES,
    ORACLE,
    SEARCH_BACKTRACK,
    SEARCH_NEAREST,
    SEARCH_RANDOM,
    SWEEP,
    SWEEP_RANDOM,
)
from hrl_escape.benchmark.episodes import StateRecorder, find_recorder
from hrl_escape.benchmark.references.bayes import BayesPlanner
from hrl_escape.benchmark.references.by_lights import (
    PlanFollower,
    Reference,
    SearchBacktrack,
    SearchNearest,
    SearchRandom,
    Sweep,
    SweepRandom,
)
from hrl_escape.sets.sequence import SequenceEnv

_RULES: dict[str, type[Reference]] = {
    SWEEP: Sweep, SWEEP_RANDOM: SweepRandom, SEARCH_RANDOM: SearchRandom, SEARCH_NEAREST: SearchNearest,
    SEARCH_BACKTRACK: SearchBacktrack, BAYES: BayesPlanner, ORACLE: PlanFollower,
}
BY_NUMBER = (SWEEP, SWEEP_RANDOM)
"""References that follow the numbers of one room's options."""
BY_LIGHTS = (SEARCH_RANDOM, SEARCH_NEAREST, SEARCH_BACKTRACK)
"""Search baselines that see what is lit."""
SEARCH_BASELINES = BY_NUMBER + BY_LIGHTS
"""References that know neither the dependency graph nor how rooms are drawn."""


def describe_rule(name: str) -> str:
    """Words on what a reference does, to follow its name and "which"."""
    return _RULES[name].RULE


class Climber(FixedPolicy):
    """A reference on every floor of a tower."""

    def __init__(self, name: str, tower: SequenceEnv) -> None:
        self._tower = tower
        self._players = {id(floor.unwrapped): make_reference(name, floor, find_recorder(floor))
                         for floor in tower.parts}
        self._last: FixedPolicy | None = None

    def act(self, observation: object, action_mask: NDArray[np.bool_]) -> int:
        """Action of the reference on the present floor."""
        return self._find_player().act(observation, action_mask)

    def act_greedy(self, observation: object, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Action of the reference on the present floor."""
        return self._find_player().act_greedy(observation, action_mask, rng)

    def _find_player(self) -> FixedPolicy:
        """The present floor's; where floors have one rule, it is told what the floor below has taught of it."""
        player, last = self._players[id(self._tower.unwrapped)], self._last
        if self._tower.paired and player is not last and isinstance(player, BayesPlanner):
            is_first = self._tower.unwrapped is self._tower.parts[0].unwrapped
            player.expect(last.infer_motif() if isinstance(last, BayesPlanner) and not is_first else None)
        self._last = player
        return player


def make_reference(name: str, env: gymnasium.Env, recorder: StateRecorder) -> FixedPolicy:
    """Make the reference of this name, one of `REFERENCES`.

    Its environment has options for all but `oracle`. The recorder is around the flat room; of a tower those on its
    floors count.
    """
    if isinstance(env, SequenceEnv) and len(env.parts) > 1:
        return Climber(name, env)
    return _RULES[name](env, recorder)
