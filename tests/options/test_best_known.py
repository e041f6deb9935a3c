"""Best known returns: against an exhaustive search in a small room, bounds, option gaps, and records."""

from __future__ import annotations

import dataclasses
import json
import warnings

import numpy as np
import pytest

from hrl_escape.env.config import ExitConfig, RobotConfig, RoomConfig, ShapeConfig, StartConfig
from hrl_escape.env.generation import generate
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.errors import ConfigError, FileReadError
from hrl_escape.options import best_known
from hrl_escape.options.best_known import best_known_return, find_best_known, record_return
from hrl_escape.options.option import ScriptedOption
from hrl_escape.options.planner import RoomPlanner


@pytest.fixture(autouse=True)
def forget(monkeypatch):
    monkeypatch.setattr(best_known, "_KNOWN", {})


def make_start(instance) -> RoomState:
    return RoomPlanner(instance).rules.make_state(instance.starts[0])


def count_fewest_by_force(rules: Kinematics, state: RoomState, most: int) -> int:
    """Breadth-first over all primitives; poses equal to a millimetre are one."""
    layer, seen = [state], set()
    for depth in range(1, most + 1):
        following = []
        for here in layer:
            for action in range(len(rules.primitives)):
                step = rules.step(here, action)
                if step.terminated:
                    return depth
                after = step.state
                key = (round(after.x, 3), round(after.y, 3), after.heading_steps, after.puzzle, after.touching)
                if key not in seen:
                    seen.add(key)
                    following.append(after)
        layer = following
    raise AssertionError(f"not within {most}")


@pytest.mark.parametrize("seed", range(4))
def test_in_a_small_room_it_is_the_best_there_is(seed):
    """Two buttons, 5 x 5 m, quarter turns: small enough to try everything."""
    config = RoomConfig(
        room=ShapeConfig(width=5, depth=5), robot=RobotConfig(body_radius=0.4, turn_step_deg=90),
        puzzle=ButtonsConfig(count=2, graph=GraphConfig(kind="chain"), buttons=Panels(width=1.0)),
        start=StartConfig(place="fixed"), exit=ExitConfig(width=1.0, depth=1.0),
    )
    instance = generate(config, seed)
    start = make_start(instance)
    fewest = count_fewest_by_force(Kinematics(instance), start, 25)
    known = find_best_known(instance, start, bound=True)
    assert known.value == 100 - fewest
    assert known.upper_bound >= known.value


@pytest.mark.parametrize("name", ["paper-one-button", "paper-two-button", "four-button-chain", "bit-flip",
                                  "arm-two-button"])
def test_options_are_no_better_than_primitives_and_bounds_hold(name):
    instance = generate(get_preset(name), 0)
    start = make_start(instance)
    free = find_best_known(instance, start, bound=True)
    press, ancestors = (best_known_return(instance, options=flavour, state=start)
                        for flavour in ("press", "press-with-ancestors"))
    assert ancestors <= free.value and press <= free.value <= free.upper_bound
    assert press == RoomPlanner(instance).solve(start).compute_return()


def test_the_papers_room_with_one_button_is_worth_91():
    """The paper's figure: nine strafes; the geometric bound proves that nothing is better."""
    instance = generate(get_preset("paper-one-button"), 0)
    assert find_best_known(instance, make_start(instance), bound=True)[::2] == (91.0, 91.0)


def test_planning_legs_together_beats_one_after_the_other():
    instance = generate(get_preset("paper-two-button"), 0)
    assert best_known_return(instance) > best_known_return(instance, options="press")


def test_given_options_are_searched_by_running_them():
    instance = generate(get_preset("paper-one-button"), 0)
    slow = [ScriptedOption("west-east", [3, 2, 2]), ScriptedOption("north", [2] * 5)]
    assert best_known_return(instance, options=slow) == 100 - 10 + 1, "two norths, the second cut short by the exit"
    assert best_known_return(instance, options=[ScriptedOption("turn", [4])]) == -1000
    with pytest.raises(ConfigError):
        best_known_return(instance, options="pres")


def test_it_is_the_mean_over_the_starts():
    config = dataclasses.replace(get_preset("paper-one-button"), start=StartConfig(choices=5))
    instance = generate(config, 0)
    rules = RoomPlanner(instance).rules
    each = [best_known_return(instance, state=rules.make_state(start)) for start in instance.starts]
    assert len(set(each)) > 1 and best_known_return(instance) == pytest.approx(np.mean(each))


def test_what_no_one_can_do_is_worth_the_horizon():
    instance = generate(get_preset("four-button-chain"), 0)
    assert best_known_return(dataclasses.replace(instance, horizon=10)) == -10


def test_a_better_return_is_taken_over_and_said(tmp_path):
    instance, path = generate(get_preset("four-button-chain"), 0), tmp_path / "best.json"
    start = make_start(instance)
    before = best_known_return(instance)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not record_return(instance, start, before, "dqn", path), "as good is not better"
        assert not path.exists()
    with pytest.warns(UserWarning, match=r"dqn, seed 3 reached a return of"):
        assert record_return(instance, start, before + 2, "dqn, seed 3", path)
    assert best_known_return(instance, records=path) == before + 2
    assert find_best_known(instance, start, records=path).source == "dqn, seed 3"
    best_known._KNOWN.clear()
    assert best_known_return(instance) == before, "another process without the file"
    assert best_known_return(instance, records=path) == before + 2, "and with it"
    assert best_known_return(instance, options="press", records=path) <= before
    assert len(json.loads(path.read_text())) == 1


def test_luck_is_no_record():
    config = get_preset("paper-one-button")
    noisy = generate(dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, noise=0.1)), 0)
    assert not record_return(noisy, make_start(noisy), 99.0, "luck")


def test_a_damaged_file_of_records_is_an_error(tmp_path):
    path = tmp_path / "best.json"
    path.write_text("[1, 2")
    instance = generate(get_preset("paper-one-button"), 0)
    with pytest.raises(FileReadError):
        best_known_return(instance, records=path)
