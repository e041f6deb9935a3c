"""The comparisons that come with the package, by name: data only."""

from __future__ import annotations

from typing import Any

from hrl_escape.comparison.grid import AgentSpec, Grid
from hrl_escape.comparison.places import RoomSpec
from hrl_escape.comparison.references.registry import REFERENCES
from hrl_escape.errors import UnknownNameError


def _parse_agents(*texts: str) -> tuple[AgentSpec, ...]:
    return tuple(AgentSpec.parse(text) for text in texts)


def _parse_rooms(*texts: str) -> tuple[RoomSpec, ...]:
    return tuple(RoomSpec.parse(text) for text in texts)


_FLAT = _parse_agents("random", "dqn@paper", "sarsa@paper", "ddpg@paper", "dqn", "sarsa", "ddpg")
_OPTIONS = _parse_agents("smdp-random", "smdp-dqn@paper", "smdp-sarsa@paper", "smdp-ddpg@paper", "smdp-dqn",
                         "smdp-sarsa", "smdp-ddpg", *REFERENCES)
# The paper's rooms have one start and no chance: every episode of one evaluation is the same, so one is enough.
_PAPER: dict[str, Any] = {"runs": 10, "primitives": 20_000, "eval_every": 500, "eval_episodes": 1}

GRIDS: dict[str, Grid] = {
    grid.name: grid
    for grid in (
        Grid(
            name="quickstart",
            description="Do options help in a room with two buttons, and does learning add to what they know?",
            agents=_parse_agents("random", "dqn", "smdp-random", "smdp-q-learning", "smdp-dqn", *REFERENCES),
            rooms=_parse_rooms("paper-two-button"),
            runs=8,
            primitives=15_000,
            eval_episodes=3,
        ),
        Grid(
            name="patience",
            description="Does a flat learner escape from the room of quickstart, given time?",
            agents=_parse_agents("dqn+patient", *REFERENCES),
            rooms=_parse_rooms("paper-two-button"),
            runs=10,
            primitives=100_000,
            eval_every=2_500,
            eval_episodes=1,
        ),
        Grid(
            name="paper",
            description="The three algorithms of Menashe and Stone (2019) as they were, with and without "
            "meta-actions, in the paper's two rooms.",
            agents=_parse_agents(
                "random", "dqn@paper", "sarsa@paper", "ddpg@paper",
                "smdp-random", "smdp-dqn@paper", "smdp-sarsa@paper", "smdp-ddpg@paper", *REFERENCES,
            ),
            rooms=_parse_rooms("paper-one-button", "paper-two-button"),
            runs=10,
            primitives=20_000,
        ),
        Grid(
            name="paper-figure-1",
            description="Figure 1 of Menashe and Stone (2019): one button, primitives only.",
            agents=_FLAT,
            rooms=_parse_rooms("paper-one-button"),
            **_PAPER,
        ),
        Grid(
            name="paper-figure-2",
            description="Figure 2 of Menashe and Stone (2019): two buttons, primitives only.",
            agents=_FLAT,
            rooms=_parse_rooms("paper-two-button"),
            **_PAPER,
        ),
        Grid(
            name="paper-figure-3",
            description="Figure 3 of Menashe and Stone (2019): two buttons with meta-actions.",
            agents=_OPTIONS,
            rooms=_parse_rooms("paper-two-button"),
            **_PAPER,
        ),
        Grid(
            name="paper-figure-3-decisions",
            description="Figure 3 with 20,000 decisions a run, as the published program counted its steps.",
            agents=_OPTIONS,
            rooms=_parse_rooms("paper-two-button"),
            **{**_PAPER, "primitives": 400_000, "decisions": 20_000, "eval_every": 1_000},
        ),
        Grid(
            name="ladder",
            description="From one button to ten: who still escapes as rooms grow harder?",
            agents=_parse_agents("random", "dqn", "ppo", "smdp-random", "smdp-q-learning", "smdp-dqn", "smdp-ppo",
                                 *REFERENCES),
            rooms=_parse_rooms("paper-one-button", "paper-two-button", "four-button-chain", "clutter", "ten-button"),
            runs=10,
            primitives=50_000,
        ),
    )
}
"""Grids that `hrl-escape compare` knows by name."""


def get_grid(name: str) -> Grid:
    """A grid by name; `UnknownNameError` where there is none."""
    if name not in GRIDS:
        raise UnknownNameError("comparison", name, GRIDS)
    return GRIDS[name]
