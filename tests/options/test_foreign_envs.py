"""`OptionsEnv` over other people's environments makes the transitions that a copied makes, primitive by primitive."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from tests.options.oracle import Skill, compare_with_copy

LEFT, RIGHT, FORWARD, TOGGLE = 0, 1, 2, 5
FREE = (1, 8)
"""MiniGrid's numbers of an empty cell and of a goal."""


def is_free(seen) -> bool:
    """Whether MiniGrid's cell ahead can be entered: the view is 7 x 7 with the agent at the bottom middle."""
    return int(seen["image"][3, 5, 0]) in FREE


GRID_SKILLS = [
    Skill("run", lambda seen: FORWARD, lambda seen: not is_free(seen), is_free),
    Skill("turn-to-north", lambda seen: RIGHT, lambda seen: seen["direction"] == 3,
          lambda seen: seen["direction"] != 3),
    Skill("turn-until-free", lambda seen: LEFT, is_free),
]
FEW_PRIMITIVES = [*(1,) * 7, 8, 3, 8]


@pytest.mark.nightly_for("MiniGrid-LavaGapS5-v0")
@pytest.mark.parametrize("name", ["MiniGrid-Empty-5x5-v0", "MiniGrid-LavaGapS5-v0", "BabyAI-GoToObj-v0"])
def test_grids(name):
    pytest.importorskip("minigrid")
    replayed = compare_with_copy(lambda: gymnasium.make(name, max_steps=24), GRID_SKILLS, decisions=200,
                                 weights=FEW_PRIMITIVES)
    assert replayed.longest > 2 and replayed.truncated and replayed.masked
    assert replayed.terminated or name.startswith("BabyAI")  # there a turn or a single step ends the mission, too
    assert replayed.returns > 2, "a success pays less, the later it comes"


def make_lander(**arguments):
    pytest.importorskip("Box2D")
    return gymnasium.make("LunarLander-v3", max_episode_steps=110, **arguments)


def is_falling(seen) -> bool:
    return seen[3] < -0.3


def test_a_lander_of_box2d():
    replayed = compare_with_copy(make_lander, [
        Skill("brake", lambda seen: 2, lambda seen: not is_falling(seen), is_falling),
        Skill("fall", lambda seen: 0, lambda seen: seen[1] < 0.2),
        Skill("right-itself", lambda seen: 3 if seen[4] > 0 else 1, lambda seen: abs(seen[4]) < 0.05),
    ], decisions=100, weights=[1, 1, 1, 1, 6, 1, 3])
    assert replayed.longest > 20 and replayed.terminated and replayed.truncated and replayed.masked
    assert replayed.returns > 90, "every reward is another"


@pytest.mark.nightly
def test_a_lander_of_continuous_actions():
    replayed = compare_with_copy(lambda: make_lander(continuous=True), [
        Skill("brake", lambda seen: [min(1.0, -seen[3]), 0.0], lambda seen: not is_falling(seen)),
        Skill("fall", lambda seen: np.zeros(2), is_falling),
        Skill("lean", lambda seen: [0.0, -2 * seen[4]], lambda seen: abs(seen[4]) < 0.02),
    ], decisions=100, seed=7)
    assert replayed.longest > 20 and replayed.terminated and replayed.truncated
