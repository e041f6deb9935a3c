"""Comparisons that come with the package, by name."""

from __future__ import annotations

from typing import Any

from hrl_escape.agents.spec import COUNT_CUES, REFERENCES, SEARCH_MEMORY, AgentSpec
from hrl_escape.benchmark.grid import Grid
from hrl_escape.errors import UnknownNameError
from hrl_escape.sets.room_spec import RoomSpec


def _make(name: str, description: str, agents: str, rooms: str, **numbers: Any) -> Grid:
    """Make a grid from the texts of agents and rooms."""
    return Grid(name, description, tuple(map(AgentSpec.parse, agents.split())),
                tuple(map(RoomSpec.parse, rooms.split())), **numbers)


_REFERENCES = " ".join(name for name in REFERENCES if name != COUNT_CUES)
"""References for learners that train in the room where they are tested."""
_FORGETFUL = " ".join(name for name in REFERENCES if name not in (SEARCH_MEMORY, COUNT_CUES))
"""References of the paper's figures, whose runs are published."""
_FLAT = "random dqn@keras-rl-2019 sarsa@keras-rl-2019 ddpg@keras-rl-2019 dqn sarsa ddpg"
# Menashe and Stone chose among meta-actions and primitives.
_PUBLISHED = " ".join(f"{name}+primitives" for name in (
    "random-options", "smdp-dqn@keras-rl-2019", "smdp-sarsa@keras-rl-2019", "smdp-ddpg@keras-rl-2019"))
_OPTIONS = f"{_PUBLISHED} smdp-dqn+primitives smdp-sarsa+primitives smdp-ddpg+primitives {_FORGETFUL}"
# The paper's rooms are deterministic with one start, so one episode per evaluation is enough.
_PAPER: dict[str, Any] = {"runs": 10, "primitives": 20_000, "eval_every": 500, "eval_episodes": 1}

GRIDS: dict[str, Grid] = {grid.name: grid for grid in (
    _make("demo", "Four buttons in a hidden order; a wrong press turns all of them off. Who learns the order?",
          "random-options smdp-q-learning dqn smdp-dqn search-memory oracle",
          "ladder-2/violations-2/train#0", runs=10, primitives=7_000, eval_every=1_000, eval_episodes=1),
    _make("quickstart", "Do options help in a room with two buttons, and does learning improve on them?",
          f"random dqn random-options+primitives smdp-q-learning+primitives smdp-dqn+primitives {_REFERENCES}",
          "paper-two-button", runs=10, primitives=15_000, eval_episodes=3),
    _make("patience", "Does an agent without options escape from the room of quickstart with a larger budget?",
          f"dqn@patient {_REFERENCES}", "paper-two-button",
          runs=10, primitives=100_000, eval_every=2_500, eval_episodes=1),
    _make("paper", "The three algorithms of Menashe and Stone (2019) as they were, with and without meta-actions, in "
          "the paper's two rooms.",
          f"random dqn@keras-rl-2019 sarsa@keras-rl-2019 ddpg@keras-rl-2019 {_PUBLISHED} {_REFERENCES}",
          "paper-one-button paper-two-button", runs=10, primitives=20_000),
    _make("paper-figure-1", "Figure 1 of Menashe and Stone (2019): one button, primitives only.",
          _FLAT, "paper-one-button", **_PAPER),
    _make("paper-figure-2", "Figure 2 of Menashe and Stone (2019): two buttons, primitives only.",
          _FLAT, "paper-two-button", **_PAPER),
    _make("paper-figure-3", "Figure 3 of Menashe and Stone (2019): two buttons with meta-actions.",
          _OPTIONS, "paper-two-button", **_PAPER),
    _make("paper-figure-3-decisions",
          "Figure 3 with 20,000 decisions a run, as the published program counted its steps.",
          _OPTIONS, "paper-two-button", **{**_PAPER, "primitives": 400_000, "decisions": 20_000, "eval_every": 1_000}),
    _make("ladder", "From one button to ten: which agents escape from harder rooms?",
          "random dqn ppo random-options+primitives smdp-q-learning+primitives smdp-dqn+primitives smdp-ppo+primitives "
          f"{_REFERENCES}",
          "paper-one-button paper-two-button four-button-chain clutter ten-button", runs=10, primitives=50_000),
)}
"""Grids of `hrl-escape compare`, by name."""


def get_grid(name: str) -> Grid:
    """Return a grid by name.

    Raises:
        UnknownNameError: no such grid.
    """
    if name not in GRIDS:
        raise UnknownNameError("comparison", name, GRIDS)
    return GRIDS[name]
