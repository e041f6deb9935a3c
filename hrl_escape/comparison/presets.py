"""The comparisons that come with the package, by name: data only."""

from __future__ import annotations

import dataclasses
from typing import Any

from hrl_escape.comparison.grid import AgentSpec, Grid
from hrl_escape.comparison.places import RoomSpec
from hrl_escape.comparison.references import REFERENCES
from hrl_escape.env.config import DynamicsConfig, RobotConfig, RoomConfig
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig, ViolationRule
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.errors import UnknownNameError
from hrl_escape.synthesis.kinds import LEAVES

__all__ = ["GRIDS", "HIERARCHICAL", "HIERARCHY_LEARNERS", "INTRA_OPTION_LEARNERS", "get_grid"]


def _parse_agents(*texts: str) -> tuple[AgentSpec, ...]:
    return tuple(AgentSpec.parse(text) for text in texts)


def _name_options(*names: str) -> tuple[AgentSpec, ...]:
    """Learners over options alone, with settings for runs of a few hundred decisions."""
    return tuple(dataclasses.replace(AgentSpec.parse(f"smdp-{name}+no-primitives"),
                                     settings=_FEW_DECISIONS.get(name, {})) for name in names)


def _parse_rooms(*texts: str) -> tuple[RoomSpec, ...]:
    return tuple(RoomSpec.parse(text) for text in texts)


def _make_layered_room(buttons: int, rule: ViolationRule, noisy: bool = False) -> RoomSpec:
    """A room of buttons anywhere on the walls, their numbers shuffled, each with at most two parents.

    It is the first instance in which some button needs another. With noise, displacements err by 10 % and a tenth of
    all primitives do nothing.
    """
    graph = GraphConfig(kind="layered", max_parents=2)
    puzzle = ButtonsConfig(count=buttons, graph=graph, on_violation=rule, buttons=Panels(width=1.5))
    dynamics = DynamicsConfig(noise=0.1, slip=0.1) if noisy else DynamicsConfig()
    room = RoomConfig(name=f"layered-{buttons}-{rule}{'-noise' * noisy}", robot=RobotConfig(body_radius=0.5),
                      puzzle=puzzle, dynamics=dynamics)
    return RoomSpec(config=room.to_dict(), seed=1 if buttons == 2 else 0)


_FLAT = _parse_agents("random", "dqn@paper", "sarsa@paper", "ddpg@paper", "dqn", "sarsa", "ddpg")
_OPTIONS = _parse_agents("smdp-random", "smdp-dqn@paper", "smdp-sarsa@paper", "smdp-ddpg@paper", "smdp-dqn",
                         "smdp-sarsa", "smdp-ddpg", *REFERENCES)
HIERARCHICAL = ("maxq-q", "hamq", "h-dqn@table", "feudal-rl")
"""A tabular agent for each kind of hierarchy that is synthesised."""
HIERARCHY_LEARNERS = (
    "q-learning", "option-critic", "eigenoptions", "covering-options", "skill-chaining", "ppo", "dac", "ppoc", "a2oc",
    "diayn", "r-max", "factored-r-max", "met-r-max", "vigorito-barto", "monte-carlo-model", "hrc")
"""Agents that learn options, skills or structure, each kind behind the flat agent that learns in the same way."""
INTRA_OPTION_LEARNERS = ("q-learning", "intra-option-q")
_SHORT = {"rollout": 32, "batch_size": 32}
_FEW_DECISIONS = {"ppo": _SHORT, "dac": _SHORT, "ppoc": _SHORT | {"least_samples": 32}, "diayn": _SHORT,
                  "eigenoptions": {"discover_every": 50}, "covering-options": {"discover_every": 50}}
"""Settings of those that by default learn or search less often than there are decisions in 10,000 primitives."""
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
        Grid(
            name="hierarchies",
            description="Hierarchies synthesised from a room: what does their structure bring alone, and what do "
            "planned leaves?",
            agents=_parse_agents("random", "q-learning", *(f"{name}+{leaves}" for leaves in LEAVES[::-1]
                                                           for name in HIERARCHICAL),
                                 "smdp-random+no-primitives", "smdp-q-learning+no-primitives", *REFERENCES),
            rooms=_parse_rooms("paper-two-button", "four-button-chain", "ten-button", "arm-two-button"),
            runs=10,
            primitives=10_000,
            eval_every=5_000,
            eval_episodes=1,  # as in the paper's rooms: one start, no chance
        ),
        Grid(
            name="learned-hierarchies",
            description="Options, skills and causal structure learned over meta-actions: do they help with two to "
            "eight buttons whose numbers say nothing of their order?",
            agents=(*_name_options("random", *HIERARCHY_LEARNERS), *_parse_agents(*REFERENCES)),
            rooms=tuple(_make_layered_room(buttons, rule) for rule in ("ignore", "reset") for buttons in (2, 4, 8)),
            runs=10,
            primitives=10_000,
            eval_every=5_000,
            eval_episodes=1,  # as above
        ),
        Grid(
            name="intra-option",
            description="What does learning from the primitives inside options bring, with options that follow plans "
            "and with those that are functions of the state?",
            agents=_parse_agents("smdp-random+no-primitives",
                                 *(f"smdp-{name}{kind}+no-primitives" for kind in ("", "+markov")
                                   for name in INTRA_OPTION_LEARNERS), *REFERENCES),
            rooms=(*(_make_layered_room(buttons, "ignore") for buttons in (2, 4, 6)),
                   _make_layered_room(4, "ignore", noisy=True)),
            runs=10,
            primitives=5_000,
            eval_every=2_500,
            eval_episodes=1,
        ),
    )
}
"""Name -> grid."""


def get_grid(name: str) -> Grid:
    """A grid by name.

    Raises:
        UnknownNameError: there is none; the message names the closest.
    """
    if name not in GRIDS:
        raise UnknownNameError("comparison", name, GRIDS)
    return GRIDS[name]
