"""Managers read the transcript alone, and their choices are the ones they claim."""

from __future__ import annotations

import importlib.metadata
from typing import Any

import numpy as np
import pytest

from hrl_escape.env.puzzles.graphs import find_ancestors
from hrl_escape.errors import PlanningFailed, PluginError, UnknownNameError
from hrl_escape.text import ToolCall, ToolsAgent, Turn, make_model, models
from hrl_escape.text.text_env import TextEnv
from tests.text.rooms import get_room, make_env, make_session, play_manager

TOOLS = [{"name": "run_option", "inputSchema": {"properties": {"option": {"enum": [
    "press-a", "press-b", "press-c", "go-to-exit"]}}}}]
BEGUN = 'You are at (0.0, 0.0).\nExit at (1.0, 1.0): shut.\nHere are "a" at (5.0, 0.0), off; "b" at (1.0, 0.0), off; ' \
    '"c" at (3.0, 0.0), off.'


def choose(name: str, *turns: tuple[str, str], begun: str = BEGUN, seed: int = 0) -> str:
    model = make_model(name)
    vars(model)["rng"] = np.random.default_rng(seed)
    talk = [Turn(None, begun), *(Turn(ToolCall("run_option", {"option": option}), text) for option, text in turns)]
    return model(talk, TOOLS).arguments["option"]


def test_the_nearest_takes_what_is_off_and_untried_and_near():
    assert choose("search-nearest") == "press-b"
    nothing = ("press-b", 'Took 1 primitive, 1 of 9. Pressed "b": nothing changed. You are at (1.0, 0.0).')
    assert choose("search-nearest", nothing) == "press-c"
    lit = ("press-c", 'Took 2 primitives, 3 of 9. Pressed "c": it came on. You are at (3.0, 0.0).')
    assert choose("search-nearest", nothing, lit) == "press-a"  # and b, untried again, is as far: the first listed
    also = ("press-a", 'Took 2 primitives, 5 of 9. Pressed "b": nothing changed. Pressed "a": nothing changed. '
                       "You are at (5.0, 0.0).")
    assert choose("search-nearest", nothing, lit, also) == "press-c"  # all that is off was tried
    others = ("press-c", 'Pressed "c": "a" and "b" came on. You are at (3.0, 0.0).')
    assert choose("search-nearest", others) == "press-c"
    on_the_way = ("press-a", 'Pressed "c": it came on. Pressed "a": nothing changed. You are at (3.5, 0.0).')
    assert choose("search-nearest", on_the_way) == "press-b"  # a was tried after the change


def test_where_all_was_tried_in_vain_everything_is_tried_once_more():
    walk = [(f"press-{name}", f'Pressed "{name}": nothing changed. You are at ({x}, 0.0).')
            for name, x in (("b", 1.0), ("c", 3.0), ("a", 5.0))]
    assert choose("search-nearest", *walk) == "press-a"  # the round begins anew, where one stands
    assert choose("search-nearest", *walk, walk[-1]) == "press-c"
    assert choose("search-nearest", *walk, walk[-1], walk[1]) == "press-b"


def test_options_of_any_name_are_tried_once_in_a_round():
    tools = [{"name": "run_option", "inputSchema": {"properties": {"option": {"enum": [
        "carry-a", "carry-b", "carry-c", "go-to-exit"]}}}}]  # before `go-to-exit` in the alphabet
    talk = [Turn(None, BEGUN), *(Turn(ToolCall("run_option", {"option": f"carry-{name}"}), "Took 1 primitive, 1 of 9.")
                                 for name in "ab")]
    for seed in range(10):
        model = make_model("search-random")
        vars(model)["rng"] = np.random.default_rng(seed)
        assert model(talk, tools).arguments["option"] == "carry-c"


def test_an_agent_names_the_action_that_its_call_means():
    env = TextEnv(make_env(get_room("pair", 3))[0])
    observation, info = env.reset(seed=0)
    agent = ToolsAgent(env, lambda transcript, tools: ToolCall("run_option", {"option": "press-button-2"}))
    mask = info["action_mask"] != 0
    assert agent.act(observation, mask) == env._actions["press-button-2"] != int(np.flatnonzero(mask)[0])


@pytest.mark.parametrize("name", ["random", "search-random", "search-nearest"])
def test_who_sees_the_exit_open_leaves_and_who_cannot_start_does_not(name: str):
    opened = ("press-b", 'Pressed "b": it came on; the exit opened. You are at (1.0, 0.0).')
    assert choose(name, opened) == "go-to-exit"
    assert choose(name, opened, ("press-b", 'Pressed "b": it went out; the exit shut.')) != "go-to-exit"
    assert {choose(name, ("press-a", 'Now only: "press-c".'), seed=seed) for seed in range(20)} == {"press-c"}
    rest = {choose(name, ("press-a", 'Not now: "press-c", "press-b", "go-to-exit".'), seed=seed) for seed in range(20)}
    assert rest == {"press-a"}
    assert choose(name, begun=BEGUN.replace("shut", "open")) == "go-to-exit"


def test_chance_takes_every_option_alike():
    taken = [choose("random", seed=seed) for seed in range(300)]
    counts = [taken.count(option) for option in ("press-a", "press-b", "press-c")]
    assert sum(counts) == 300 and min(counts) > 70


@pytest.mark.nightly_for("code", "lattice-5", "freight", "pair")
@pytest.mark.parametrize("rung", ["pair", "code", "lattice-5", "freight"])
def test_the_planner_escapes_by_the_fewest_actions_of_the_model_that_it_is_told(rung: str):
    pytest.importorskip("unified_planning")
    room = get_room(rung, 2)
    states, told = play_manager("oracle", room, 0, "model")
    puzzle: Any = room.puzzle
    fewest = {"pair": lambda: 2, "code": lambda: len(puzzle.code),
              "freight": lambda: len(puzzle.plan(puzzle.make_state())),
              "lattice-5": lambda: len({puzzle.goal, *find_ancestors(puzzle.edges, (puzzle.goal,))})}[rung]()
    assert puzzle.is_solved(states[-1].puzzle) and len(told.log) == fewest + 1


def test_the_planner_needs_the_model():
    with pytest.raises(PlanningFailed, match="level model"):
        play_manager("oracle", get_room("pair"), 0, "places")


def test_models_have_names(monkeypatch: pytest.MonkeyPatch):
    assert list(models) == ["random", "search-random", "search-nearest", "oracle"]
    with pytest.raises(UnknownNameError, match="search-nearest"):
        make_model("untired-nearest")
    points = (importlib.metadata.EntryPoint("mine", "tests.text.test_managers:leave", "hrl_escape.models"),
              importlib.metadata.EntryPoint("broken", "tests.text.nowhere:leave", "hrl_escape.models"))
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points)
    assert make_model("mine")([], []) == leave([], [])
    models.unregister("mine")
    with pytest.raises(PluginError, match="broken"):
        make_model("broken")


def leave(transcript, tools) -> ToolCall:
    return ToolCall("run_option", {"option": "go-to-exit"})


def test_a_manager_that_is_told_nothing_new_says_the_same():
    session = make_session(get_room("lattice-5"))
    assert isinstance(session.env, TextEnv)
    first = choose("search-random", seed=3)
    assert first == choose("search-random", seed=3)
