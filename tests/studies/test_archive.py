"""Archive exploration: primitives counted, and ways that lead where they say."""

from __future__ import annotations

import dataclasses
from typing import Any

import gymnasium
import numpy as np
import pytest

from hrl_escape.env.config import ShapeConfig
from hrl_escape.env.presets import get_preset
from studies.archive import ArchiveSettings, _Archive, explore


class CountedEnv(gymnasium.Wrapper):
    """Counts steps, and passes states on."""

    steps = 0

    def step(self, action: Any) -> Any:
        self.steps += 1
        return self.env.step(action)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.unwrapped, name)


@pytest.fixture(scope="module")
def env() -> CountedEnv:
    plain = get_preset("paper-one-button")
    config = dataclasses.replace(plain, horizon=60, room=ShapeConfig(width=12, depth=12),
                                 robot=dataclasses.replace(plain.robot, turn_step_deg=90.0))
    return CountedEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", config=config, disable_env_checker=True))


@pytest.mark.nightly_for("state")
@pytest.mark.parametrize("returns", ["state", "moves"])
def test_every_primitive_is_counted_and_the_moves_escape(env: CountedEnv, returns: Any):
    env.steps = 0
    found = explore(env, ArchiveSettings(cell=1.0, headings=1, returns=returns), 3, 50_000)
    assert found.first_escape == found.primitives == env.steps < 50_000, "those of returning count too"
    env.reset(seed=0)
    *_, (_, _, terminated, _, info) = map(env.step, found.moves)
    assert terminated and info["is_success"]
    again = explore(env, ArchiveSettings(cell=1.0, headings=1, returns=returns), 3, 50_000)
    assert again == found


def test_exploration_ends_with_its_budget(env: CountedEnv):
    found = explore(env, ArchiveSettings(cell=1.0), 3, 5)
    assert found.first_escape is None and 5 <= found.primitives < 5 + 30 and not found.moves


def test_cells_are_drawn_by_how_often_they_were_chosen():
    """Of two cells, one new and one chosen 99 times, the new one has 1 / (1 + 1 / 10) of the weight."""
    state: Any = None
    draws = []
    for seed in range(4_000):
        archive = _Archive(seed)
        archive.add("new", 3, None, state)
        archive.add("old", 5, None, state)
        archive._chosen[1] = 99
        draws.append(archive.choose()[0] == 3)
    assert np.mean(draws) == pytest.approx(10 / 11, abs=0.015)
    archive.add("old", 4, None, state)
    assert archive._chosen[1] == 0 and archive.ways[1][0] == 4, "a shorter way makes a cell new"
    archive.add("old", 6, None, state)
    assert archive.ways[1][0] == 4, "a longer one is forgotten"
