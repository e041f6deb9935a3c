"""Calls of the public API with states, goals and arguments of right and wrong kinds and ranges, drawn by hypothesis."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from hypothesis import strategies as st

from hrl_escape.env import EscapeRoomEnv, Kinematics, generate, get_preset
from hrl_escape.errors import EscapeError
from hrl_escape.options import (
    OptionDegradation,
    OptionsEnv,
    make_go_to,
    make_meta_options,
    make_press,
    make_reach,
    pursue,
)
from hrl_escape.planning import (
    ExitGoal,
    Navigator,
    PoseGoal,
    PressGoal,
    PushGoal,
    RegionGoal,
    RoomPlanner,
    best_known_return,
    find_best_known,
    get_planner,
    list_planners,
    parse_goal,
)

__all__ = ["make_calls", "run_call"]

ROOMS = {name: generate(dataclasses.replace(get_preset(name), horizon=30), 0)
         for name in ("paper-two-button", "clutter", "arm-two-button", "push-block")}
BUDGET = 2_000
"""Search nodes of a plan, so that a call takes milliseconds."""

_numbers = st.sampled_from([0, 1, -1, 2, 35, 36, 37, 10**6, 10**9, 2**63, 2**64, 10**400, -(10**9), True, 0.5, 1e-300,
                            1e300, math.nan, math.inf, -math.inf]) | st.integers(-40, 40) | st.floats(-12.0, 12.0)
_junk = st.sampled_from([None, "", "x", "button-1", b"x", (), (1, 2), [], [0, 0], {}, {"x": 1}, object(),
                         np.zeros(2), np.float64("nan"), np.int64(3), float, PressGoal, 1j, range(3)])
_anything = _numbers | _junk
_wrong = _anything.filter(lambda value: value is not None)
_small = st.floats(-10.0, 10.0) | st.integers(-10, 10)
_goals = (
    st.builds(PressGoal, st.integers(0, 3) | _anything)
    | st.just(ExitGoal())
    | st.builds(PoseGoal, _small, _small, st.none() | _small, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
    | st.builds(PoseGoal, _anything, _anything, _anything, _anything, _anything)
    | st.builds(RegionGoal, _small, _small, _small, _small)
    | st.builds(RegionGoal, _anything, _anything, _anything, _anything)
    | st.builds(PushGoal, st.integers(0, 1) | _anything, st.integers(0, 1) | _anything)
)
_texts = st.sampled_from(["exit", "button-1", "button-2", "bit-1", "block-1->plate-1", "block->plate", "->", ",", "1,2",
                          "1,2,90", "nan,1", "1e999,0", "1,2,3,4", "a,b", " exit "]) | st.text(max_size=8)
_any_goal = _goals | _texts | _anything
_methods = st.sampled_from([None, "auto", "fields", "corridor", "RRTConnect", "BITstar"]) | _anything


@st.composite
def _states(draw: st.DrawFn, name: str) -> Any:
    """A state of an episode, with some fields of any value; sometimes no state at all."""
    rules = Kinematics(ROOMS[name])
    state = rules.make_state(rules.instance.starts[0])
    for action in draw(st.lists(st.integers(0, len(rules.actions) - 1), max_size=6)):
        state = rules.step(state, action).state
    changes = draw(st.dictionaries(st.sampled_from(state._fields), _anything, max_size=2))
    return draw(st.just(state) | st.just(state._replace(**changes)) | _anything)


_PLANNERS = {name: RoomPlanner(room, budget=BUDGET) for name, room in ROOMS.items()}
_NAVIGATORS = {name: Navigator(room) for name, room in ROOMS.items()}
_ENVS: dict[str, EscapeRoomEnv] = {}


def _get_env(name: str) -> EscapeRoomEnv:
    if name not in _ENVS:
        _ENVS[name] = EscapeRoomEnv(instance=ROOMS[name])
    _ENVS[name].reset(seed=0)
    return _ENVS[name]


def _step_options(name: str, actions: Any) -> None:
    env = OptionsEnv(_get_env(name))
    env.reset(seed=0)
    for action in actions:
        env.step(action)


def _set_and_step(name: str, state: Any, action: Any) -> None:
    env = _get_env(name)
    env.set_state(state)
    env.step(action)


_places = st.tuples(_small, _small) | _anything
_arrays = st.sampled_from([np.zeros((2, 2)), np.full((1, 2), np.nan), np.zeros((0, 2)), np.zeros(3),
                           np.array(["a", "b"]), np.array([[3, 4]]), np.array(None), np.zeros((2, 2, 2))])
_actions = st.integers(0, 20) | _anything

CALLS: dict[str, tuple[Callable[..., Any], Callable[[str], tuple[st.SearchStrategy, ...]]]] = {
    "RoomPlanner": (lambda name, *a: RoomPlanner(*a),
                    lambda n: (st.just(ROOMS[n]) | _anything, _methods, _anything, _anything)),
    "plan": (lambda name, *a: _PLANNERS[name].plan(*a), lambda n: (_states(n), _any_goal, _methods)),
    "solve": (lambda name, *a: _PLANNERS[name].solve(*a), lambda n: (_states(n), _methods)),
    "order_goals": (lambda name, *a: _PLANNERS[name].order_goals(*a), lambda n: (_states(n),)),
    "find_ancestors": (lambda name, *a: _PLANNERS[name].orders.find_ancestors(*a),
                      lambda n: (_states(n), _goals | _anything)),
    "find_route": (lambda name, *a: _PLANNERS[name].routes.find_route(*a),
                  lambda n: (_states(n), _goals | _anything)),
    "can_start": (lambda name, *a: _PLANNERS[name].routes.can_start(*a),
                 lambda n: (_states(n), _goals | _anything)),
    "remember": (lambda name, *a: _PLANNERS[name].routes.remember(*a),
                 lambda n: (_states(n), _goals | _anything, st.lists(_actions, max_size=4) | _anything)),
    "make_plan": (lambda name, *a: _PLANNERS[name].make_plan(*a, planner="fuzz"),
                  lambda n: (_states(n), st.lists(_actions, max_size=4) | _anything, st.lists(_goals, max_size=2))),
    "parse_goal": (lambda name, text: parse_goal(text, ROOMS[name]), lambda n: (_any_goal,)),
    "get_planner": (lambda name, method: get_planner(ROOMS[name], method), lambda n: (_methods,)),
    "best_known_return": (lambda name, state: best_known_return(ROOMS[name], state=state),
                          lambda n: (_states(n) if n == "paper-two-button" else _wrong,)),
    "find_best_known": (lambda name, state: find_best_known(ROOMS[name], state), lambda n: (_anything,)),
    "navigate": (lambda name, start, goal, planner, seed, budget: _NAVIGATORS[name].plan(
        start, goal, planner, seed=seed, budget=budget),
        lambda n: (_places, _goals | _anything | _arrays, st.sampled_from([*list_planners(), "RRT"]) | _anything,
                   st.integers(0, 3) | _anything, st.integers(1, 2_000) | _junk)),
    "make_go_to": (lambda name, goal: make_go_to(_PLANNERS[name], goal), lambda n: (_any_goal,)),
    "make_press": (lambda name, target: make_press(_PLANNERS[name], target), lambda n: (_any_goal,)),
    "make_reach": (lambda name, target: make_reach(_PLANNERS[name], target), lambda n: (_any_goal,)),
    "make_meta_options": (lambda name, option_set: make_meta_options(ROOMS[name], option_set), lambda n: (_anything,)),
    "OptionDegradation": (lambda name, *a: OptionDegradation(*a), lambda n: (_anything, _anything)),
    "pursue": (lambda name, goal: pursue(_get_env(name), goal, _PLANNERS[name]),
               lambda n: (_texts | _goals | _wrong,)),
    "OptionsEnv": (lambda name, option_set, gamma, longest, planner: OptionsEnv(
        _get_env(name), option_set=option_set, discount=gamma, max_duration=longest, planner=planner),
        lambda n: (st.just("press") | _anything, st.floats(0.5, 1.0) | _anything, st.none() | _anything, _methods)),
    "OptionsEnv.step": (_step_options, lambda n: (st.lists(_actions, max_size=3),)),
    "set_state": (_set_and_step, lambda n: (_states(n), _actions)),
    "reset": (lambda name, seed, options: _get_env(name).reset(seed=seed, options=options),
              lambda n: (_anything, _anything | st.fixed_dictionaries({"state": _states(n)}))),
    "generate": (lambda name, *a: generate(*a),
                 lambda n: (st.just(get_preset("paper-two-button")) | _anything, _anything)),
    "get_preset": (lambda name, *a: get_preset(*a), lambda n: (_anything,)),
}
"""Public doors: how each is called, and what it is called with, in a room."""


@st.composite
def make_calls(draw: st.DrawFn) -> tuple[str, str, tuple[Any, ...]]:
    """Door, room and arguments of one call."""
    door, name = draw(st.sampled_from(sorted(CALLS))), draw(st.sampled_from(sorted(ROOMS)))
    if name == "push-block" and door in ("pursue", "OptionsEnv.step", "set_state"):
        name = "paper-two-button"  # physics takes seconds a push
    return door, name, tuple(draw(strategy) for strategy in CALLS[door][1](name))


def run_call(call: tuple[str, str, tuple[Any, ...]]) -> bool:
    """Make one call; False if it is refused. Any error that is neither ours nor Gymnasium's is raised."""
    door, name, arguments = call
    try:
        CALLS[door][0](name, *arguments)
    except (EscapeError, gymnasium.error.Error):
        return False
    return True
