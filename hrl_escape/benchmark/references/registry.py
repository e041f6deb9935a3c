"""References by name: agents without training, evaluated on the same episodes as learners.

| name | what it does | what it is given |
|---|---|---|
| `sweep` | presses buttons 1, 2, ..., n, leaves, over and over | nothing |
| `sweep-random` | the same in an order drawn for the episode | nothing |
| `search-random` | presses buttons that are off and untried since a light last changed, in random order | lights |
| `search-nearest` | the same, the nearest first | lights, positions |
| `search-backtrack` | the same, and returns by known presses to a state with untried buttons | lights, positions |
| `search-memory` | searches, then repeats and shortens its escape from the room | lights, positions, earlier episodes |
| `count-cues` | tries buttons by the cues of the next button in training rooms | lights, positions, training rooms |
| `bayes` | minimises expected primitives over the possible graphs | lights, positions, room configuration |
| `oracle` | follows the best known plan | everything |

`search-memory` remembers earlier episodes in a room. Compare learners that train in the room where they are tested with
it; it supports button puzzles. `count-cues` learns in training rooms: compare learners that are tested in unseen rooms
with it. The other search baselines forget everything at the end of an episode. The Bayes planner is given how rooms are
drawn.
"""

from __future__ import annotations

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import FixedPolicy
from hrl_escape.agents.spec import (
    BAYES,
    COUNT_CUES,
    ORACLE,
    SEARCH_BACKTRACK,
    SEARCH_MEMORY,
    SEARCH_NEAREST,
    SEARCH_RANDOM,
    SWEEP,
    SWEEP_RANDOM,
)
from hrl_escape.benchmark.episodes import StateRecorder, find_recorder
from hrl_escape.benchmark.references.bayes import BayesPlanner
from hrl_escape.benchmark.references.count_cues import CountCues
from hrl_escape.benchmark.references.search import (
    PlanFollower,
    Reference,
    SearchBacktrack,
    SearchNearest,
    SearchRandom,
    Sweep,
    SweepRandom,
)
from hrl_escape.benchmark.references.search_memory import SearchMemory
from hrl_escape.sets.sequence import SequenceEnv

_RULES: dict[str, type[Reference]] = {
    SWEEP: Sweep, SWEEP_RANDOM: SweepRandom, SEARCH_RANDOM: SearchRandom, SEARCH_NEAREST: SearchNearest,
    SEARCH_BACKTRACK: SearchBacktrack, SEARCH_MEMORY: SearchMemory,
    COUNT_CUES: CountCues, BAYES: BayesPlanner, ORACLE: PlanFollower,
}
SWEEP_BASELINES = (SWEEP, SWEEP_RANDOM)
"""Search baselines that press buttons in the order of their numbers."""
SEARCH_METHODS = (SEARCH_RANDOM, SEARCH_NEAREST, SEARCH_BACKTRACK)
"""Search baselines that read which buttons are on, and forget everything after an episode."""
SEARCH_BASELINES = (*SWEEP_BASELINES, *SEARCH_METHODS, SEARCH_MEMORY)
"""References that are given neither the dependency graph nor how rooms are drawn."""
TRAINED_IN_ROOM, TRAINED_IN_SET = (SEARCH_MEMORY,), (COUNT_CUES,)
"""References that comparisons train: in the room where they are tested, and in training rooms."""


def describe_rule(name: str) -> str:
    """Describe a reference in words that follow its name and "which"."""
    return _RULES[name].RULE


class SequenceReference(FixedPolicy):
    """A reference in a sequence of rooms: one player for each room."""

    def __init__(self, name: str, env: SequenceEnv) -> None:
        self._env = env
        self._players = {id(part.unwrapped): make_reference(name, part, find_recorder(part)) for part in env.parts}
        self._last: FixedPolicy | None = None

    def act(self, observation: object, action_mask: NDArray[np.bool_]) -> int:
        """Return the action of the player of the current room."""
        return self._find_player().act(observation, action_mask)

    def act_greedy(self, observation: object, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the action of the player of the current room."""
        return self._find_player().act_greedy(observation, action_mask, rng)

    def _find_player(self) -> FixedPolicy:
        player, last = self._players[id(self._env.unwrapped)], self._last
        # Rooms of one latent code: the Bayes planner carries its posterior over the code to the next room.
        if self._env.paired and player is not last and isinstance(player, BayesPlanner):
            is_first = self._env.unwrapped is self._env.parts[0].unwrapped
            player.expect(last.infer_code() if isinstance(last, BayesPlanner) and not is_first else None)
        self._last = player
        return player


def make_reference(name: str, env: gymnasium.Env, recorder: StateRecorder) -> FixedPolicy:
    """Make a reference.

    Args:
        name: one of `REFERENCES`.
        env: environment with options, or with primitives for `oracle`.
        recorder: around the flat room; ignored for a sequence of rooms, whose rooms have recorders of their own.
    """
    if isinstance(env, SequenceEnv) and len(env.parts) > 1:
        return SequenceReference(name, env)
    return _RULES[name](env, recorder)
