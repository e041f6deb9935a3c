"""Goal spaces made from rooms: what counts as reached, on the way and at the end of plans, and who learns with them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hrl_escape.agents.hierarchy_kinds import find_kind, list_privileges
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.training.callbacks import Callback
from hrl_escape.agents.training.train import load_agent, load_env, train
from hrl_escape.checks import check_hierarchy
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import AgentSettingsError, UnsupportedError
from hrl_escape.hierarchies import HierarchyEnv, HierarchyVectorEnv, synthesise
from hrl_escape.planning.planner import RoomPlanner
from tests.hierarchies.tiny import TINY

AGENTS = {"hac-finite": "events", "sol": "events", "option-keyboard": "events", "hiro-finite": "displacements",
          "hrac-finite": "displacements"}


def make_env(config, kind, **arguments):
    return HierarchyEnv(EscapeRoomEnv(config), kind, "learned", **arguments)


def is_in_exit(room, state):
    (x, y), area = (state.x, state.y), room.exit
    return max(area.x_min - x, x - area.x_max, area.y_min - y, y - area.y_max) <= 0


@pytest.mark.nightly_for("four-button-chain")
@pytest.mark.parametrize("preset", ["paper-two-button", "four-button-chain", "arm-two-button"])
def test_events_are_reached_where_the_state_says_so_all_along_a_plan(preset):
    env = make_env(preset, "events")
    space, room = env.structure["goal_space"], env.unwrapped.instance
    count = len(room.targets)
    assert len(space.goals) == 2 * count + 1 and space.privileges == ("landmarks", "state")
    buttons = [target.name for target in room.targets]
    assert list(space.names) == [*(f"touch({name})" for name in buttons), *(f"on({name})" for name in buttons), "exit"]
    observation, info = env.reset(seed=0)
    seen = np.zeros(len(space.goals), np.bool_)
    for primitive in RoomPlanner(room).solve(env.unwrapped.get_state()).primitives:
        state, reached = env.unwrapped.get_state(), space.list_reached(observation)
        assert reached[:count].tolist() == [bool(state.touching >> target & 1) for target in range(count)]
        assert reached[count:-1].tolist() == info["buttons_on"].astype(bool).tolist(), "a button has one fact, in order"
        assert reached[-1] == is_in_exit(room, state)
        seen |= reached
        observation, _, terminated, _, info = env.step(primitive)
    seen |= space.list_reached(observation)
    assert terminated and seen.all(), "every button was touched and lit, and the exit reached"
    assert space.list_reached(observation)[-1] and is_in_exit(room, env.unwrapped.get_state())


def test_a_displacement_is_reached_by_as_many_moves_and_told_as_what_is_left():
    env = make_env("paper-two-button", "displacements")
    space = env.structure["goal_space"]
    lengths = np.hypot(*space.goals.T)
    assert [space.names[goal] for goal in (0, 1, 6)] == ["+4, +0 moves", "+3, +3 moves", "+0, -4 moves"]
    assert len(space.goals) == 8 and space.is_relative and 4 <= lengths.min() <= lengths.max() <= 4.5
    assert len({tuple(goal) for goal in space.goals}) == 8 and np.allclose(space.goals.sum(axis=0), 0)
    observation, _ = env.reset(seed=0)
    begun = space.project(observation)
    state = env.unwrapped.get_state()
    stride = env.unwrapped.instance.robot.actions.stride
    assert begun.tolist() == [round(state.x / stride), round(state.y / stride)]
    goal, lefts = space.goals[0], []
    for _ in range(4):  # the start looks along +x
        before, (observation, *_) = observation, env.step(0)
        goal = space.advance(goal, before, observation)
        lefts.append(float(space.measure(goal, observation)))
    moved = env.unwrapped.get_state()
    assert lefts == [3.0, 2.0, 1.0, 0.0] and space.is_reached(goal, observation)
    assert (moved.x - state.x, moved.y - state.y) == pytest.approx((4 * stride, 0.0))


def test_tables_see_pose_touched_targets_and_facts_and_nothing_else():
    for kind in ("events", "displacements"):
        env = make_env("paper-two-button", kind)
        space, room = env.structure["goal_space"], env.unwrapped
        env.reset(seed=0)
        state = room.get_state()
        views = [space.view.see(env.observe(changed)).tolist() for changed in (
            state, state._replace(primitives=99), state._replace(x=state.x + 2), state._replace(touching=2),
            state._replace(puzzle=3))]
        assert views[0] == views[1] and all(view != views[0] for view in views[2:])
        assert all(space.view.space.contains(np.array(view)) for view in views)


@pytest.mark.nightly_for("hac-finite-events", "option-keyboard-events", "hrac-finite-displacements",
                         "hiro-finite-displacements")
@pytest.mark.parametrize(("agent", "kind"), AGENTS.items())
def test_every_agent_of_goals_keeps_its_promises_in_a_room(agent, kind):
    assert find_kind(agent) == kind
    env = make_env(TINY, kind)
    made = make_agent(agent, env.observation_space, env.action_space, 0, structure=env.structure)
    assert set(made.privileges) <= set(list_privileges(agent, "learned"))
    check_hierarchy(made.hierarchy, env, primitives=200)


class EndsWithTheFirstEscape(Callback):
    """What a learner does after it is not asked."""

    def on_evaluation(self, agent, evaluation):
        return evaluation.success_rate == 1.0


@pytest.mark.nightly
@pytest.mark.parametrize("config", ["paper-one-button", TINY], ids=["one button", "tiny"])
def test_with_events_of_the_room_skills_over_moves_find_the_way_out(config):
    """Without them, over bounds of the observation, the same learner never escapes at an evaluation."""
    budget = {"primitives": 15_000, "eval_every": 3_000, "eval_episodes": 1, "seed": 0, "progress": False}
    given = train("option-keyboard", make_env(config, "events"), **budget, callbacks=[EndsWithTheFirstEscape()])
    flat = train("option-keyboard", EscapeRoomEnv(config), **budget)
    assert any(each.success_rate == 1.0 for each in given.evaluations)
    assert not any(each.success_rate for each in flat.evaluations)


def test_goals_and_their_names_are_as_many():
    space = synthesise(generate(TINY, 0), "events", "learned")
    with pytest.raises(AgentSettingsError, match=r"4 names.*one for each of 5 goals"):
        dataclasses.replace(space, names=space.names[:-1])
    with pytest.raises(AgentSettingsError, match="at least one goal"):
        dataclasses.replace(space, goals=np.zeros((0, 5)))


@pytest.mark.nightly
def test_a_folder_brings_back_an_agent_with_its_goals(tmp_path):
    env = make_env(TINY, "displacements")
    result = train("hiro-finite", env, primitives=300, eval_episodes=1, out=tmp_path / "run", progress=False)
    agent, again = load_agent(tmp_path / "run"), load_env(tmp_path / "run")
    assert isinstance(again, HierarchyEnv) and np.array_equal(agent.space.goals, env.structure["goal_space"].goals)
    same = train("hiro-finite", env, primitives=300, eval_episodes=1, out=tmp_path / "run", progress=False)
    assert same.evaluations == result.evaluations


def test_leaves_that_nobody_plans_and_bodies_that_do_not_go_there_are_refused_in_words():
    for kind in ("events", "displacements"):
        with pytest.raises(UnsupportedError, match=f"a hierarchy over {kind} learns its low level"):
            synthesise(generate(TINY, 0), kind, "planned")
    with pytest.raises(UnsupportedError, match="learns its low level: take low_level='learned'"):
        find_kind("hiro-finite", "planned")
    with pytest.raises(UnsupportedError, match="learns its low level"):
        HierarchyVectorEnv(EscapeRoomVectorEnv(2, TINY), "events")
    with pytest.raises(UnsupportedError, match="presses by hand"):
        synthesise(generate(get_preset("arm-two-button"), 0), "displacements", "learned")
    armed = dataclasses.replace(TINY, robot=dataclasses.replace(TINY.robot, joints=2))
    assert synthesise(generate(armed, 0), "displacements", "learned").is_relative, "its arm presses nothing"
