"""Sections: which button hangs where follows the ranking, and nothing but that changes."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig, PositionalCuesConfig
from hrl_escape.env.puzzles.cues import compute_depths
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError


def make_with(sections, kind="chain", count=4, **changes):
    return RoomConfig(
        room=ShapeConfig(width=8, depth=8), robot=RobotConfig(body_radius=0.3),
        puzzle=ButtonsConfig(count=count, graph=GraphConfig(kind=kind, max_parents=2), buttons=Panels(width=0.8),
                             positional_cues=sections, **changes),
    )


def test_buttons_come_in_the_order_of_their_sections_in_every_room():
    rules = PositionalCuesConfig(sections=6, code=3)
    assert sorted(rules.ranks) == list(range(6)) and (rules.ranks != PositionalCuesConfig(sections=6).ranks).any()
    met = set()
    for seed in range(40):
        room = generate(make_with(rules), seed)
        depths = compute_depths(4, room.puzzle.edge_list)
        turns = [math.atan2(target.y, target.x) / math.tau % 1 * 6 for target in room.targets]
        keys = [(rules.ranks[int(turn)], turn) for turn in turns]
        assert sorted(range(4), key=keys.__getitem__) == sorted(range(4), key=depths.__getitem__)
        met |= {int(turn) for turn in turns}
    assert met == set(range(6))


def test_nothing_but_who_hangs_where_changes():
    for seed in range(10):
        plain, told = (generate(make_with(PositionalCuesConfig(sections=count)), seed) for count in (0, 8))
        assert told.puzzle == plain.puzzle and told.id != plain.id
        assert [target.name for target in told.targets] == list(told.puzzle.target_names)
        assert sorted((t.x, t.y, t.yaw) for t in told.targets) == sorted((t.x, t.y, t.yaw) for t in plain.targets)
    config = make_with(PositionalCuesConfig(sections=8))
    assert RoomConfig.from_dict(config.to_dict()) == config
    assert "sections" not in make_with(PositionalCuesConfig()).to_dict()["puzzle"]  # so ids are what they were


def test_likelihoods_are_those_of_the_draws():
    """Two parents and their child: either parent may come first, and the child is last."""
    rules, places = PositionalCuesConfig(sections=4, code=1), np.array([[1.0, 0.1], [-1.0, 0.3], [-0.1, -1.0]])
    rng, depths = np.random.default_rng(0), np.array([0, 1, 0])
    dealt = [tuple(rules.deal(places, depths.tolist(), rng).tolist()) for _ in range(2_000)]
    orders = list(itertools.permutations(range(3)))
    shares = np.array([dealt.count(order) for order in orders]) / len(dealt)
    expected = [rules.compute_likelihood(places[list(order)], depths[None])[0] for order in orders]
    assert sorted(expected) == [0, 0, 0, 0, 0.5, 0.5]
    assert np.abs(shares - expected).max() < 0.05
    assert (PositionalCuesConfig().compute_likelihood(places, depths[None]) == 1).all()


@pytest.mark.parametrize("changes", [{"doors": 1}, {"buttons": Panels(places="paper")}])
def test_sections_are_refused_where_something_else_decides_on_places(changes):
    with pytest.raises(ConfigError, match="0 if doors or fixed places"):
        config = make_with(PositionalCuesConfig(sections=4))
        dataclasses.replace(config.puzzle, **changes)
