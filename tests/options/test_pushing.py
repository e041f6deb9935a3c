"""Pushing under physics: blocks come onto their plates, and nothing that was done is undone."""

from __future__ import annotations

import dataclasses

import pytest

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.push_block import PushBlockConfig
from hrl_escape.options.closed_loop import pursue
from hrl_escape.planning.goals import ExitGoal
from hrl_escape.planning.planner import get_planner
from hrl_escape.planning.props import list_blocks, list_obstacles


def escape(env, seed):
    env.reset(seed=seed)
    run = pursue(env)
    facts = [env.instance.puzzle.symbolic.get_facts(state.puzzle) for state in run.states]
    return run, [not before <= after for before, after in zip(facts[:-1], facts[1:], strict=True)]


@pytest.mark.nightly_for("14", "32")
@pytest.mark.parametrize("seed", [14, 32])
def test_the_way_out_leaves_the_block_on_its_plate(seed):
    """The straight way from the last push to the exit of these rooms leads through the block."""
    run, undone = escape(EscapeRoomEnv("push-block", instance_seed=seed), seed)
    assert run.escaped and not any(undone)


@pytest.mark.nightly
def test_a_second_push_goes_round_the_first_block():
    config = dataclasses.replace(get_preset("push-block"), puzzle=PushBlockConfig(count=2))
    run, undone = escape(EscapeRoomEnv(config, instance_seed=17), 17)
    assert run.escaped and not any(undone)


def test_a_plan_never_crosses_a_block_that_must_stay():
    env = EscapeRoomEnv("push-block", instance_seed=32)
    run, _ = escape(env, 32)
    solved = next(state for state in run.states if env.instance.puzzle.is_solved(state.puzzle))
    planner = get_planner(env.instance)
    plan = planner.plan(solved, "go-to-exit")
    (block,) = list_blocks(solved, env.instance, only_done=True)
    x, y = plan.path[len(plan.path) // 2].tolist()
    in_the_way = (block._replace(x=x, y=y),)
    assert planner.routes.replay(solved, plan.primitives, ExitGoal()) is not None
    assert planner.routes.replay(solved, plan.primitives, ExitGoal(), in_the_way) is None
    assert list_obstacles(solved, env.instance)[-1][0].half_x < block.half_x, "a graze moves nothing"
