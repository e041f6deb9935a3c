"""Recorded games replay to the same bytes, and a change in one is found."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.errors import FileReadError, UnsupportedError, VerificationError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.text import (
    RecordedModel,
    RoomSession,
    TextEnv,
    ToolCall,
    ToolsAgent,
    load_games,
    record_game,
    save_games,
    verify_games,
)
from tests.text.rooms import get_room, make_env, make_session, play_manager


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Games on four rungs at three levels, one of them with wrong calls and moves."""
    games = [record_game(play_manager(name, get_room(rung), seed, text)[1])
             for name, rung, seed, text in (("search-random", "pair", 1, "names"),
                                            ("search-nearest", "drift", 2, "places"),
                                            ("random", "freight", 4, "model"))]
    session = make_session(get_room("code"), seed=5, include_primitives=True, option_set="press-with-ancestors")
    for call in (("fly", [1, {"x": "\ud800"}]), ("look", {}), ("move", {"primitive": "forward", "times": 3}),
                 ("run_option", {"option": "press-digit-1"})):
        session.call(*call)
    path = tmp_path_factory.mktemp("games") / "games.jsonl"
    save_games(path, [*games, record_game(session)])
    return path


@pytest.mark.nightly
def test_games_replay_to_the_same_bytes(file: Path, tmp_path: Path):
    games = verify_games(file)
    assert games == load_games(file) and len(games) == 4 and games[3].options == {"option_set": "press-with-ancestors"}
    save_games(tmp_path / "again.jsonl", games)
    assert (tmp_path / "again.jsonl").read_bytes() == file.read_bytes()
    assert [game.score.escaped for game in games[:2]] == [True, True]


@pytest.mark.nightly_for("<lambda>-differs3")
@pytest.mark.parametrize(("change", "problem"), [
    (lambda lines: lines[:1] + [lines[1].replace("Took ", "Took 1")] + lines[2:], "differs"),
    (lambda lines: [lines[0].replace("a closed room", "an open room", 1), *lines[1:]], "differs"),
    (lambda lines: [lines[0].replace('"reveal": "names"', '"reveal": "places"', 1), *lines[1:]], "differs"),
    (lambda lines: [*lines[:1], *lines[2:]], "differs"),
    (lambda lines: [line.replace('"efficiency": 0', '"efficiency": 1') for line in lines], "differs"),
])
def test_a_changed_game_is_found(change, problem: str, file: Path, tmp_path: Path):
    lines = file.read_text().splitlines()
    first = lines[:1 + next(n for n, line in enumerate(lines) if "score" in json.loads(line))]
    changed = change(first)
    assert changed != first
    (tmp_path / "changed.jsonl").write_text("\n".join(changed) + "\n")
    with pytest.raises(VerificationError, match=problem):
        verify_games(tmp_path / "changed.jsonl")


@pytest.mark.parametrize("content", ["", "{}\n", "[1]\n", '{"score": {}}\n', '{"kind": "game"}\n', "nonsense\n", "\x00",
                                     '{"kind": "game", "schema": 1}\n{"score": 3}\n'])
def test_a_damaged_file_is_one_error_that_names_it(content: str, tmp_path: Path):
    (tmp_path / "bad.jsonl").write_text(content)
    for read in (load_games, RecordedModel):
        with pytest.raises(FileReadError, match="bad.jsonl"):
            read(tmp_path / "bad.jsonl")


@pytest.mark.parametrize(("line", "change", "words"), [
    (0, {"options": {"domain": "x"}}, "unknown field of game.options 'domain'"),
    (0, {"options": {"discount": 2}}, "game.options.discount = 2"),
    (0, {"seed": -1}, "game.seed = -1"), (0, {"reveal": "all"}, "game.reveal = 'all'"), (0, {"room": 3}, "game.room"),
    (1, {"call": ["look"]}, "turn 1.call"), (1, {"is_error": 1}, "turn 1.is_error"), (-1, {"score": {}}, "end.score"),
])
def test_a_game_with_a_value_that_no_game_has_is_refused(line: int, change: Any, words: str, tmp_path: Path):
    session = make_session(get_room("pair"))
    session.call("look")
    lines = [json.loads(text) for text in record_game(session).to_lines()]
    lines[line] |= change
    (tmp_path / "bad.jsonl").write_text("".join(f"{json.dumps(each)}\n" for each in lines))
    with pytest.raises(FileReadError, match=re.escape(words)):
        load_games(tmp_path / "bad.jsonl")


def test_a_game_keeps_the_arguments_of_its_environment(tmp_path: Path):
    session = make_session(get_room("pair"), discount=0.5)
    session.call("look")
    save_games(tmp_path / "games.jsonl", [record_game(session)])
    assert load_games(tmp_path / "games.jsonl")[0].options == {"discount": 0.5}
    verify_games(tmp_path / "games.jsonl")


@pytest.mark.nightly
def test_a_file_cut_in_the_middle_is_refused(file: Path, tmp_path: Path):
    lines = file.read_text().splitlines()
    (tmp_path / "cut.jsonl").write_text("\n".join(lines[:-2]) + "\n")
    with pytest.raises(FileReadError, match="no end"):
        load_games(tmp_path / "cut.jsonl")


@pytest.mark.nightly
def test_a_recorded_model_plays_the_game_again_and_no_other(file: Path):
    game = load_games(file)[1]
    env, recorder = make_env(game.room)
    text = TextEnv(env, game.reveal)
    text.reset(seed=game.seed)
    agent = ToolsAgent(text, RecordedModel(file))
    while not text.is_over:
        text.step(agent.act(None, text._mask))
    assert record_game(text) == game
    text.reset(seed=99)
    with pytest.raises(VerificationError, match="after"):
        while not text.is_over:
            text.step(agent.act(None, text._mask))


def test_a_script_scores_the_same_through_either_door():
    room = get_room("pair", 3)
    names = "press-button-2", "press-button-1", "press-button-2"
    calls = [ToolCall("run_option", {"option": name}) for name in names]
    calls += [ToolCall("fly", {}), ToolCall("look", {}), ToolCall("run_option", {"option": "go-to-exit"})]
    session = make_session(room, "names", include_primitives=False)
    for call in calls:
        session.call(*call)
    env, _ = make_env(room, include_primitives=False)
    text = TextEnv(env, "names")

    def call_in_order(transcript, tools):
        """The calls of the list, whatever the room says."""
        return calls[sum(turn.call is not None for turn in transcript)]

    found = evaluate(ToolsAgent(text, call_in_order), text, episodes=1)
    assert found.returns[0] == session.score().reward and found.lengths[0] == session.score().primitives
    assert found.decision_counts[0] == session.score().decisions == 5 and found.successes[0]
    assert text.score().invalid_calls == 1


def test_what_cannot_be_replayed_is_not_recorded():
    session = RoomSession(OptionsEnv(make_env(get_room("pair"))[1]))
    session.reset()
    with pytest.raises(UnsupportedError, match="seed"):
        record_game(session)
    inner, recorder = make_env(get_room("pair"))
    own = RoomSession(OptionsEnv(recorder, list(inner.options)))
    own.reset(seed=0)
    with pytest.raises(UnsupportedError, match="of your own"):
        record_game(own)
