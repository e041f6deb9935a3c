"""Difficulty of a room: the random walk is exact, baselines are those of comparisons, and short horizons are found."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from hrl_escape import make_room
from hrl_escape.benchmark.difficulty import measure_difficulty, solve_random_walk
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import PRESETS
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from tests.command_line import call

CARDS = Path(__file__).parents[2] / "docs" / "environments" / "difficulty.json"


def iterate_expectation(room) -> float:
    """Expected primitives of a random escape, by value iteration over states that are found as they are met."""
    rules, numbers, following = Kinematics(room), {}, []
    waiting = [rules.make_state(start)._replace(puzzle=puzzle) for start in room.starts
               for puzzle in room.puzzle.list_starts()]
    starts = {state: numbers.setdefault(state, len(numbers)) for state in waiting}
    while waiting:
        state = waiting.pop(0)
        row = []
        for action in range(len(room.robot.actions.names)):
            step = rules.step(state, action)
            reached = step.state._replace(primitives=0)
            if not step.terminated and reached not in numbers:
                numbers[reached] = len(numbers)
                waiting.append(reached)
            row.append(-1 if step.terminated else numbers[reached])
        following.append(row)
    values, table = np.zeros(len(numbers) + 1), np.array(following)  # the last value is that of an escape, 0
    for _ in range(30_000):
        values[:-1] = 1 + values[table].mean(axis=1)
    return float(np.mean([values[number] for number in starts.values()]))


@pytest.mark.nightly
def test_the_random_walk_of_a_small_room_is_exact():
    room = make_room("taxi")
    walk = solve_random_walk(room)
    assert walk.primitives == pytest.approx(iterate_expectation(room), rel=1e-3)
    assert solve_random_walk(room, most=walk.states - 1) is None
    assert solve_random_walk(make_room("four-rooms")) is None  # its moves slip
    assert solve_random_walk(make_room("sokoban")).primitives == np.inf  # boxes get stuck


@pytest.mark.nightly
def test_batched_rooms_escape_as_often_by_random_primitives():
    count, walk, room = 4_096, solve_random_walk(make_room("taxi")), make_room("taxi")
    rooms = EscapeRoomVectorEnv(count, "taxi", output="torch", autoreset_mode="SameStep")
    rooms.reset(seed=0)
    generator = torch.Generator().manual_seed(0)
    escaped = torch.zeros(count, dtype=torch.bool)
    for _ in range(room.horizon):  # the time limit ends no episode before
        _, _, terminated, _, _ = rooms.step(torch.randint(len(room.robot.actions), (count,), generator=generator))
        escaped |= terminated
    # an episode that begins again after an escape changes nothing: its copy has escaped already
    assert float(escaped.float().mean()) == pytest.approx(
        walk.success_rate, abs=4 * (walk.success_rate / count) ** 0.5)


def test_difficulty_ranks_baselines_and_finds_a_short_horizon(capsys, tmp_path):
    room = dataclasses.replace(make_room("taxi"))
    assert "oracle" not in room._repr_svg_() and room.notes == ()
    found = room.difficulty()
    assert room.difficulty() is found and room.notes == found.lines
    assert found.oracle < found.random_options.length and not found.is_horizon_short
    assert 0 < found.random_options.efficiency < 1 and found.random_walk.success_rate < 0.1
    short = measure_difficulty(dataclasses.replace(room, horizon=5), episodes=2)
    assert short.is_horizon_short and dict(short.rows)["horizon"] == "5 primitives, too short for the oracle"
    path = tmp_path / "room.json"
    room.save(path)
    code, out, _ = call(capsys, "room", "--room", path, "--difficulty", "--json")
    assert code == 0 and json.loads(out)["difficulty"] == json.loads(json.dumps(found.to_json()))


def test_every_card_has_the_difficulty_of_its_present_room():
    cards = json.loads(CARDS.read_text())
    assert list(cards) == list(PRESETS)
    assert [name for name in PRESETS if cards[name]["room"] != make_room(name).id] == []


@pytest.mark.nightly
def test_cards_are_measured_again_to_the_same_rows():
    for name in ("taxi", "paper-two-button"):
        assert json.loads(CARDS.read_text())[name]["rows"] == [list(row) for row in make_room(name).difficulty().rows]
