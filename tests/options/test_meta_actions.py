"""Meta-actions synthesised for every preset: what they reach, what they leave alone, and how they cope with noise."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest

from hrl_escape.checks import check_option
from hrl_escape.env.config import RoomConfig, ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import Rectangle, RoomInstance, Start, Target
from hrl_escape.env.kinematics import RoomState
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.puzzles.buttons import ButtonsPuzzle
from hrl_escape.env.puzzles.mixins import Mapped
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import UnknownNameError, UnsupportedError
from hrl_escape.options.meta_actions import list_goals, make_meta_options
from hrl_escape.options.option_sets import option_sets
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.options.skills import make_go_to, make_press, make_reach
from hrl_escape.planning.goals import GripGoal, PressGoal, name_goal, parse_goal
from hrl_escape.planning.planner import get_planner
from tests.covering import cover, thin
from tests.env.rooms import make_ordered_chain

KINEMATIC = [name for name in PRESETS if name != "push-block"]
GRIPPED = ("taxi", "blocks-world", "sokoban", "foraging", "door-key", "key-corridor", "multi-room")


def make_noisy(name: str, **dynamics) -> RoomConfig:
    config = get_preset(name)
    return dataclasses.replace(config, dynamics=dataclasses.replace(config.dynamics, **dynamics))


def run_meta_actions(config: RoomConfig, runs: int, seed: int = 0) -> Counter:
    """Random meta-actions in room after room: how each ended."""
    rng, ends = np.random.default_rng(seed), Counter()
    while sum(ends.values()) < runs:
        env = OptionsEnv(EscapeRoomEnv(instance=generate(config, seed)), include_primitives=False)
        _, info = env.reset(seed=seed)
        for _ in range(10):
            legal = np.flatnonzero(info["action_mask"])
            _, _, terminated, truncated, info = env.step(int(rng.choice(legal)))
            ends["reached" if terminated else info["option"]["ended"]] += 1
            if terminated or truncated:
                break
        env.close()
        seed += 1
    return ends


@pytest.mark.nightly_for("puddle-world")
@pytest.mark.parametrize("name", thin([*PRESETS], 6, 2))
def test_every_preset_has_a_meta_action_for_everything_there_is_to_do(name):
    instance = generate(get_preset(name), 0)
    operators = instance.puzzle.symbolic.make_symbolic_model().operators
    acts = {f"{op.action}-{op.target}" + (f"-to-{op.destination}" if op.action == "push" else "")
            for op in operators if op.action != "press"}
    presses = [] if isinstance(instance.puzzle, Mapped) else [f"press-{target.name}" for target in instance.targets]
    *names, last = [option.name for option in make_meta_options(instance)]
    assert names[:len(presses)] == presses and sorted(names[len(presses):]) == sorted(acts) and last == "go-to-exit"
    assert [name_goal(parse_goal(name, instance), instance) for name in (*names, last)] == [*names, last]


SETS = option_sets.names()
EVERY_SET_IN = ("four-button-chain", "clutter", "arm-two-button", "lights-out", "hanoi", "door-key")
"""Rooms of each kind, in which other option sets than `press` are checked too."""
LONG = ("ten-button", "twenty-button", "random-lights")
"""Chains, and boxes as in light-box."""


@pytest.mark.nightly_for(
    "lights-out-press", "four-button-chain-press-with-ancestors", "clutter-press-reactive",
    "hanoi-press-with-ancestors", "potions-press", "puddle-world-press", "lights-out-press-reactive")
@pytest.mark.parametrize(("name", "option_set"), [
    *thin([(name, "press") for name in KINEMATIC if name not in LONG], 5),
    *cover(EVERY_SET_IN, [option_set for option_set in SETS if option_set != "press"])])
def test_meta_actions_keep_the_option_contract(name, option_set):
    env = EscapeRoomEnv(name)
    env.reset(seed=0)
    plan = get_planner(env.instance).solve(env.get_state())
    states = [plan.states[part.start] for part in plan.parts]
    for option in make_meta_options(env.instance, option_set):
        if name in (*GRIPPED, "deep-sea", "key-chest") and not any(map(option.initiation, states)):
            continue  # for another passenger, worm or door, or an exit that is everywhere
        check_option(option, env, runs=2, states=states)
    env.close()


@pytest.mark.parametrize("name", thin(KINEMATIC, 5, 1))
def test_a_meta_action_presses_its_button_and_no_other(name):
    """Each from the start, or where it is masked there after what it needs; what it could not avoid, it names."""
    room = EscapeRoomEnv(name)
    env = OptionsEnv(room, include_primitives=False)
    goals, done = list_goals(room.instance), 0
    for index, goal in enumerate(goals):
        _, info = env.reset(seed=0)
        order = [goal]
        if not info["action_mask"][index]:
            if name in ("taxi", "foraging", "sokoban"):
                continue  # for another passenger or worm, or a box that cannot be pushed to that side from here
            order = get_planner(room.instance).orders.find_ancestors(room.get_state(), goal)
        for part in order:
            *_, terminated, _, info = env.step(goals.index(part))
            assert info["option"]["ended"] == "reached" and (info["also_pressed"] <= info["unavoidable"]).all()
        done += 1
        if isinstance(goal, PressGoal):
            assert info["pressed"][index] and not info["unavoidable"].any()
            assert terminated or room.get_state().touching >> index & 1
    pads = sum(isinstance(goal, PressGoal) for goal in goals)
    assert done == {"taxi": pads + 1, "foraging": pads + 1, "sokoban": 2}.get(name, len(goals))


@pytest.mark.parametrize("option_set", SETS)
def test_a_key_is_fetched_from_where_it_was_put_down(option_set):
    room = EscapeRoomEnv("door-key")
    env = OptionsEnv(room, include_primitives=False, option_set=option_set)
    *_, leave = (option.name for option in env.options)
    index = {goal.action: number for number, goal in enumerate(list_goals(room.instance)) if isinstance(goal, GripGoal)}
    _, info = env.reset(seed=0)
    first = room.get_state().puzzle
    for action in ("grip", "release", "grip", "use"):
        assert info["action_mask"][index[action]], f"{action} is legal"
        *_, info = env.step(index[action])
        assert info["option"]["ended"] == "reached"
        if action == "release":
            assert room.get_state().puzzle != first, "the key lies elsewhere than at first"
    *_, terminated, _, info = env.step(env.action_names.index(leave))
    assert terminated and info["is_success"]


@pytest.mark.parametrize("option_set", SETS)
def test_doors_are_needed_on_the_way_to_where_a_key_lies_now(option_set):
    """With a key in the corridor no door is; with one behind another shut door that one is, and it is opened first."""
    room = EscapeRoomEnv("key-corridor")
    env = OptionsEnv(room, include_primitives=False, option_set=option_set)
    planner, puzzle = get_planner(room.instance), room.instance.puzzle
    state = planner.rules.make_state(room.instance.starts[0])
    key = puzzle.target_names.index("key-1")
    grip = list_goals(room.instance).index(GripGoal(key))
    (first,) = puzzle.grid.list_doors_before(puzzle.grid.things[0])

    def move(cell: int) -> RoomState:
        return state._replace(puzzle=puzzle._move(state.puzzle, 0, cell))

    free = [cell for cell in puzzle.grid.floor if cell not in puzzle.grid.bottlenecks]
    near = move(next(cell for cell in free if not puzzle.grid.list_doors_before(cell)))
    _, info = env.reset(seed=0, options={"state": near})
    assert info["action_mask"][grip]
    *_, info = env.step(grip)
    assert info["option"]["ended"] == "reached" and puzzle.get_held(room.get_state().puzzle) == 0

    cell, other = next((cell, way[0]) for cell in free for way in [puzzle.grid.list_doors_before(cell)]
                       if len(way) == 1 and way != (first,) and not puzzle.grid.is_locked(way[0]))
    far = move(cell)
    opened = far._replace(puzzle=far.puzzle | 3 << 2 * first)  # the door of the first place is of no use
    for shut in (far, opened):
        _, info = env.reset(seed=0, options={"state": shut})
        assert not info["action_mask"][grip]
        assert planner.orders.find_ancestors(shut, GripGoal(key)) == [GripGoal(other, "use"), GripGoal(key)]
    for goal in (GripGoal(other, "use"), GripGoal(key)):
        number = list_goals(room.instance).index(goal)
        assert info["action_mask"][number]
        *_, info = env.step(number)
        assert info["option"]["ended"] == "reached"


def make_corridor() -> RoomInstance:
    """A corridor whose far end is a button; a second one hangs across the way to it."""
    targets = (
        Target("button-1", 0.0, 0.0, 0.5, half_x=1.5, half_y=0.05, half_z=0.5, yaw=np.pi / 2),
        Target("button-2", 5.9, 0.0, 0.5, half_x=1.0, half_y=0.05, half_z=0.5, yaw=np.pi / 2),
    )
    wide = generate(RoomConfig(room=ShapeConfig(width=12, depth=5)), 0)
    config = wide.robot
    return RoomInstance(
        name="corridor", half_width=6.0, half_depth=1.5,
        solids=tuple(
            dataclasses.replace(wide.solids[0], x=x, y=y, half_x=hx, half_y=hy, yaw=0.0)
            for x, y, hx, hy in ((0, 1.6, 6.2, 0.1), (0, -1.6, 6.2, 0.1), (6.1, 0, 0.1, 1.7), (-6.1, 0, 0.1, 1.7))
        ),
        targets=targets, exit=Rectangle(-5.0, -4.0, -1.0, 1.0), starts=(Start(-3.0, 0.0),), robot=config,
        puzzle=ButtonsPuzzle(2, (), 1),
    )


def test_a_button_that_cannot_be_avoided_is_pressed_and_named():
    env = OptionsEnv(EscapeRoomEnv(instance=make_corridor()), include_primitives=False)
    env.reset(seed=0)
    info = env.step(1)[4]
    assert info["option"]["ended"] == "reached" and info["pressed"].tolist() == [1, 1]
    assert info["unavoidable"].tolist() == info["also_pressed"].tolist() == [1, 0]
    env.reset(seed=0)
    info = env.step(0)[4]
    assert not info["also_pressed"].any() and not info["unavoidable"].any()


@pytest.mark.parametrize(("name", "meta", "option_set", "published"), [
    ("larg-2019", "press-button-1", "press", 17),
    ("larg-2019", "press-button-2", "press-with-ancestors", 37),
    ("larg-2019", "go-to-exit", "press", 15),
])
def test_meta_actions_cost_no_more_than_the_published_codes(name, meta, option_set, published):
    """Costs from the start of seed 14, handicap 6, measured by running the published 2019 code."""
    env = OptionsEnv(EscapeRoomEnv(name), option_set=option_set)
    env.reset(seed=0)
    info = env.step(env.action_names.index(meta))[4]
    assert info["option"]["ended"] == "reached" and info["duration"] <= published


def test_with_ancestors_presses_what_must_be_on_before():
    env = OptionsEnv(EscapeRoomEnv(make_ordered_chain()), option_set="press-with-ancestors", include_primitives=False)
    env.reset(seed=0)
    info = env.step(2)[4]
    assert info["pressed"].tolist() == [1, 1, 1, 0]
    assert info["buttons_on"].tolist() == [1, 1, 1, 0]
    info = env.step(3)[4]
    assert info["pressed"].tolist() == [0, 0, 0, 1], "what is on already is not pressed again"
    info = env.step(3)[4]
    assert info["pressed"].tolist() == [0, 0, 0, 1], "the button itself always is"


def test_pressing_a_touched_button_again_leaves_it_first():
    env = OptionsEnv(EscapeRoomEnv("paper-two-button"), include_primitives=False)
    env.reset(seed=0)
    env.step(0)
    assert env.unwrapped.get_state().touching == 1
    info = env.step(0)[4]
    assert np.flatnonzero(info["pressed"]).tolist() == [0] and info["duration"] >= 2


def test_touching_is_no_press_until_it_begins_anew():
    """Under slip, a button that is to be pressed again stays touched for a while."""
    env = OptionsEnv(EscapeRoomEnv(make_noisy("paper-two-button", slip=0.6)), include_primitives=False)
    for seed in range(5):
        env.reset(seed=seed)
        env.step(0)
        info = env.step(0)[4]
        assert info["option"]["ended"] == "reached" and np.flatnonzero(info["pressed"]).tolist() == [0]
        assert info["duration"] >= 2


def test_the_exit_behind_a_shut_door_is_masked_until_it_opens():
    env = OptionsEnv(EscapeRoomEnv("clutter"), include_primitives=False)
    _, info = env.reset(seed=0)
    assert info["action_mask"].tolist() == [1, 1, 1, 1, 0]
    planner = get_planner(env.unwrapped.instance)
    for goal in planner.order_goals(env.unwrapped.get_state())[:-1]:
        info = env.step(goal.target)[4]
    assert info["action_mask"][-1] == 1
    assert env.step(4)[2]


@pytest.mark.nightly_for("arm-two-button-30", "clutter-30")
@pytest.mark.parametrize("runs", [30, pytest.param(100, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["paper-two-button", "clutter", "arm-two-button"])
def test_noise_and_slip_are_met_by_planning_anew(name, runs):
    ends = run_meta_actions(make_noisy(name, noise=0.1, slip=0.1), runs)
    assert ends["reached"] >= 0.99 * runs, ends


@pytest.mark.nightly
@pytest.mark.parametrize("runs", [12, pytest.param(40, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("name", "seed", "dynamics"), [
    ("paper-two-button", 0, {"noise": 0.1, "slip": 0.1}),
    pytest.param("arm-two-button", 9, {}, marks=pytest.mark.slow)])
def test_physics_is_met_by_planning_anew(name, seed, dynamics, runs):
    ends = run_meta_actions(make_noisy(name, kind="physics", **dynamics), runs, seed)
    assert ends["reached"] >= 0.95 * runs, ends


def test_an_option_gives_up_after_its_cap_on_plans():
    config = make_noisy("arm-two-button", noise=0.3)
    env = EscapeRoomEnv(config)
    options = make_meta_options(env.instance)
    for option in options:
        option.max_replans = 0
    wrapped = OptionsEnv(env, options)
    ends = []
    for seed in range(10):
        wrapped.reset(seed=seed)
        ends.append(wrapped.step(12)[4]["option"] | {"replans": wrapped.planning_report.replans})
    failed = [end for end in ends if end["ended"] == "planning-failed"]
    assert failed and all("budget exhausted" in end["reason"] and end["replans"] == 0 for end in failed)


@pytest.mark.nightly
def test_a_block_is_pushed_onto_its_plate():
    env = OptionsEnv(EscapeRoomEnv("push-block", instance_seed=1), include_primitives=False)
    env.reset(seed=0)
    info = env.step(0)[4]
    assert info["option"]["ended"] == "reached"
    assert env.unwrapped.instance.puzzle.is_solved(env.unwrapped.get_state().puzzle)
    assert env.step(1)[2], "and the exit is open"


def test_an_unknown_option_set_is_refused():
    with pytest.raises(UnknownNameError, match="press-with-ancestors"):
        make_meta_options(generate(get_preset("paper-two-button"), 0), "pres")


# --- skills ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["paper-two-button", "arm-two-button"])
def test_press_goes_and_then_reaches_at_the_cost_of_one_plan(name):
    env = EscapeRoomEnv(name)
    planner = get_planner(env.instance)
    nested, whole = (OptionsEnv(env, options, include_primitives=False) for options in (
        [make_press(planner, 0), make_press(planner, "button-2")], make_meta_options(env.instance)))
    for number in range(2):
        nested.reset(seed=0)
        info = nested.step(number)[4]
        assert info["option"]["ended"] == "reached" and np.flatnonzero(info["pressed"]).tolist() == [number]
        whole.reset(seed=0)
        assert info["duration"] == whole.step(number)[4]["duration"]
    check_option(make_press(planner, 1), env, runs=4)


def test_reach_moves_only_the_arm():
    env = EscapeRoomEnv("arm-two-button")
    planner = get_planner(env.instance)
    reach = make_reach(planner, "button-1")
    wrapped = OptionsEnv(env, [reach, make_meta_options(env.instance)[0]], trace=True)
    _, info = wrapped.reset(seed=0)
    count = len(env.rules.actions)
    assert info["action_mask"][count] == 0, "out of reach from the start"
    trace = wrapped.step(count + 1)[4]["trace"]
    arm = len([step for step in trace if step.action >= 6])
    before = trace[-arm].state if all(step.action >= 6 for step in trace[-arm:]) else None
    if before is None:
        pytest.skip("this plan moves base and arm in turns")
    wrapped.reset(seed=0, options={"state": before})
    info = wrapped.step(count)[4]
    assert info["option"]["ended"] == "reached" and info["duration"] == arm
    assert all(step.action >= 6 for step in info["trace"])
    check_option(reach, env, states=[before])


def test_reach_without_an_arm_is_refused():
    with pytest.raises(UnsupportedError, match="use press"):
        make_reach(get_planner(generate(get_preset("paper-two-button"), 0)), 0)
    with pytest.raises(UnknownNameError, match="button-2"):
        make_press(get_planner(generate(get_preset("paper-two-button"), 0)), "button-3")


def test_go_to_stands_where_it_was_told():
    env = EscapeRoomEnv("paper-two-button")
    planner = get_planner(env.instance)
    wrapped = OptionsEnv(env, [make_go_to(planner, "3,-4,90")])
    wrapped.reset(seed=0)
    assert wrapped.step(6)[4]["option"]["ended"] == "reached"
    state = env.get_state()
    assert np.hypot(state.x - 3, state.y + 4) <= 0.5 and state.heading_steps == 9
