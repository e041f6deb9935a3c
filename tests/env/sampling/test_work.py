"""Sampling ends after a bounded amount of work, which is counted and so the same on every machine."""

import dataclasses

import numpy as np
import pytest

from benchmarks.generation import draw_config
from hrl_escape.env.config import ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling import generation
from hrl_escape.env.sampling.certificate import OutOfWork, Work, find_unmet, make_floors
from hrl_escape.errors import GenerationError

CROWDED = RoomConfig(room=ShapeConfig(width=8, depth=20), robot=RobotConfig(body_radius=0.3),
                     obstacles=ObstaclesConfig(count=200))
CROWD_OF_STARTS = RoomConfig(start=StartConfig(choices=10_000), obstacles=ObstaclesConfig(count=20))


@pytest.fixture
def spent(monkeypatch, nothing_kept):
    """Budgets of the rooms that the test samples."""
    budgets = []

    class Recorded(Work):
        def __init__(self, limit):
            super().__init__(limit)
            budgets.append(self)

    monkeypatch.setattr(generation, "Work", Recorded)
    return budgets


@pytest.mark.nightly
@pytest.mark.parametrize("config", [pytest.param(CROWDED, marks=pytest.mark.slow), CROWD_OF_STARTS],
                         ids=["obstacles", "starts"])
def test_what_cannot_be_met_is_refused_once_the_budget_is_spent(config, spent):
    with pytest.raises(GenerationError, match="obstacles"):
        generation.generate(config, 0)
    assert spent[0].done < 1.3 * generation.LARGEST_WORK


@pytest.mark.nightly_for("1")
@pytest.mark.parametrize("count", [1, pytest.param(4, marks=pytest.mark.nightly)])
def test_no_room_configuration_costs_much_more_than_the_budget(spent, count):
    rng = np.random.default_rng(5)
    for seed in range(count):
        try:
            generation.generate(draw_config(rng), seed)
        except GenerationError:
            pass
    assert max(work.done for work in spent) < 1.3 * generation.LARGEST_WORK


def test_ten_thousand_starts_are_sampled():
    config = dataclasses.replace(CROWD_OF_STARTS, obstacles=ObstaclesConfig())
    assert len(generation.generate(config, 0).starts) == 10_000


@pytest.mark.nightly_for("clutter", "ten-button")
@pytest.mark.parametrize("name", ["clutter", "ten-button"])
def test_a_certificate_that_grows_with_the_room_is_the_one_made_afresh(name):
    """Obstacle by obstacle, until one spoils the room: places of touching that are remembered change no answer."""
    instance = generation.generate(get_preset(name), 1)
    floors, rng, verdicts = make_floors(instance), np.random.default_rng(0), set()
    assert find_unmet(instance, floors) is None
    for _ in range(60):
        x, y = rng.uniform(-9, 9, 2).tolist()
        more = [Solid("cylinder", x, y, size := float(rng.uniform(0.2, 1.2)), size)]
        wider = dataclasses.replace(instance, solids=(*instance.solids, *more))
        grown = floors.extend(more)
        verdict = find_unmet(wider, grown)
        assert verdict == find_unmet(wider, make_floors(wider))
        verdicts.add(verdict)
        if verdict is None:
            instance, floors = wider, grown
    assert len(verdicts) > 1


def test_a_spent_budget_stops():
    work = Work(10)
    work.spend(10)
    with pytest.raises(OutOfWork):
        work.spend(1)
