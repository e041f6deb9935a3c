"""Archive exploration: primitives counted, ways that lead where they say, and the exact optimum of a small room."""

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


def find_fewest(env: Any) -> int:
    """Primitives of the shortest escape, by breadth-first search over exact states."""
    env.reset(seed=0)
    seen, layer, length = set(), [env.get_state()], 0
    while layer:
        length, after = length + 1, []
        for state in layer:
            for action in range(env.action_space.n):
                env.set_state(state)
                _, _, terminated, _, info = env.env.step(action)
                if terminated and info["is_success"]:
                    return length
                reached = env.get_state()
                place = (reached.pose, reached.puzzle, reached.touching)
                if not terminated and place not in seen:
                    seen.add(place)
                    after.append(reached)
        layer = after
    raise AssertionError("no way out")


@pytest.mark.nightly_for("state")
@pytest.mark.parametrize("returns", ["state", "moves"])
def test_every_primitive_is_counted_and_the_moves_escape(env: CountedEnv, returns: Any):
    env.steps = 0
    found = explore(env, ArchiveSettings(cell=1.0, headings=1, returns=returns), 3, 5_000, 1_000)
    assert found.primitives >= 5_000 and found.first_escape is not None
    assert env.steps == found.primitives, "those of returning too"
    env.reset(seed=0)
    *_, (_, _, terminated, _, info) = map(env.step, found.moves)
    assert terminated and info["is_success"] and len(found.moves) == found.lengths[-1][1]
    assert [at for at, _ in found.lengths] == sorted(at for at, _ in found.lengths) and len(found.lengths) == 6
    again = explore(env, ArchiveSettings(cell=1.0, headings=1, returns=returns), 3, 5_000, 1_000)
    assert again == found


@pytest.mark.nightly
def test_cells_of_single_states_lead_to_the_shortest_escape(env: CountedEnv):
    """With a cell for each state, shorter ways replace longer ones until the shortest escape is left."""
    fewest = find_fewest(env)
    found = explore(env, ArchiveSettings(cell=0.5, headings=4, steps=6, repeat=0.5), 0, 200_000, 5_000, enough=fewest)
    assert found.lengths[-1][1] == found.lengths[-2][1] == fewest and found.primitives < 200_000
    assert min(length for _, length in found.lengths if length) >= fewest


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
