"""Whoever plays through the tools plays the same game: primitive for primitive, on eleven rungs."""

from __future__ import annotations

import pytest

from hrl_escape.agents.agent import make_transition
from hrl_escape.text import RoomSession
from tests.covering import thin
from tests.text.rooms import RUNGS, get_room, make_env, play_manager, play_reference

SEARCH_BASELINES = ("search-random", "search-nearest", "search-backtrack", "sweep")


@pytest.mark.nightly_for("clutter", "freight")
@pytest.mark.parametrize("rung", thin(RUNGS, 2, 1))
def test_a_searcher_that_reads_the_text_alone_does_what_the_searcher_that_reads_the_room_does(rung: str):
    room = get_room(rung)
    expected, _ = play_reference("search-random", room, 7)
    states, text = play_manager("search-random", room, 7, "names")
    assert states == expected and len(states) > 5
    assert sum(part.duration for part in text.log) == len(states) - 1


def through_the_tools(name: str, rung: str, number: int, seed: int) -> None:
    """A searcher's calls, made in a session of its own, lead to its states, and to the words that its game left."""
    room = get_room(rung, number)
    expected, text = play_reference(name, room, seed, "places")
    assert expected == play_reference(name, room, seed)[0], "telling changes the game"
    assert text is not None
    env, recorder = make_env(room)
    session = RoomSession(env)
    session.reset(seed=seed)
    for turn in text.transcript[1:]:
        assert turn.call is not None
        session.call(*turn.call)
    assert recorder.states == expected and session.transcript == text.transcript
    assert [part[3:7] for part in session.log] == [part[3:7] for part in text.log]
    assert session.env.characters == text.characters


@pytest.mark.nightly_for("freight", "clutter")
@pytest.mark.parametrize("rung", thin(RUNGS, 2))
def test_calls_made_one_by_one_lead_to_the_states_of_the_searcher(rung: str):
    through_the_tools("search-nearest", rung, 1, 3)


@pytest.mark.slow
@pytest.mark.parametrize("rung", RUNGS)
@pytest.mark.parametrize("name", SEARCH_BASELINES)
def test_calls_of_every_searcher_do_in_more_rooms(name: str, rung: str):
    for number in range(2, 6):
        through_the_tools(name, rung, number, number)


def test_the_log_holds_the_transitions_that_an_agent_gets():
    room = get_room("lattice-5")
    env, _ = make_env(room)
    session = RoomSession(make_env(room)[0])
    session.reset(seed=1)
    observation, info = env.reset(seed=1)
    for name in ("press-button-2", "press-button-2", "go-to-exit", "press-button-5"):
        action = session.env._actions[name]
        step = env.step(action)
        session.call("run_option", {"option": name})
        mask = info["action_mask"].astype(bool)
        expected, found = make_transition(observation, action, mask, step, env.gamma), session.log[-1]
        assert found[1] == action and found[3:7] == expected[3:7] and found[9:11] == expected[9:11]
        assert (found.observation == expected.observation).all()
        assert (found.next_observation == expected.next_observation).all()
        observation, info = step[0], step[4]
