"""Models behind an endpoint: games that survive its faults, budgets, resumed folders, and rows equal to replays."""

from __future__ import annotations

import json
import math
import time
from pathlib import Path
from typing import Any

import pytest

from hrl_escape.benchmark import evaluate_model, evaluate_recordings
from hrl_escape.cli import main
from hrl_escape.errors import ConfigError, EndpointError, FileReadError, RunMismatchError
from hrl_escape.text import Budget, ChatClient, Reply, make_model, verify_games
from hrl_escape.text.person import Person
from hrl_escape.viewer.play.commands import Command, carry_out
from hrl_escape.viewer.play.episode import Episode
from tests.text.fake_endpoint import FAULTS, KEY, SLOW_FAULTS, run_endpoint
from tests.text.rooms import get_room


def connect(url: str, **arguments: Any) -> ChatClient:
    return ChatClient("fake", url, **{"key": KEY, "request_seconds": 1.5, "backoff": 0.01, **arguments})


def test_a_game_survives_every_fault_and_nothing_holds_the_key(tmp_path: Path):
    faults = [fault for fault in FAULTS if fault not in SLOW_FAULTS]
    with run_endpoint(faults) as bad, run_endpoint() as good:
        found = evaluate_model(connect(bad.url, retries=12), rooms=1, out=tmp_path / "bad")
        alone = evaluate_model(connect(good.url), rooms=2, out=tmp_path / "good")
    (game,) = found.games
    assert game.ended == "over" and game.score.escaped and game.score.invalid_calls >= 1
    assert game.usage.retries == faults.index("words") + 1, "an infinite number of tokens is no JSON"
    assert len(bad.requests) == game.usage.requests + game.usage.retries
    counted = bad.answered + 4  # words, many, unknown and form have usage too
    assert game.usage.prompt_tokens == 1000 * counted and game.usage.completion_tokens == 10 * counted
    assert set(bad.keys) == {f"Bearer {KEY}"}
    assert [each.usage.retries for each in alone.games] == [0, 0] and alone.games[0].exploitation is not None
    for path in tmp_path.rglob("*"):
        assert path.is_dir() or KEY not in path.read_text()
    (recorded,) = verify_games(tmp_path / "good/game-000.jsonl")
    assert recorded.score == alone.games[0].score and verify_games(tmp_path / "bad/game-000.jsonl")
    heard = {message["content"] for request in good.requests for message in request["messages"]}
    assert {turn.text for turn in recorded.turns[:-1]} <= heard, "the model has read what the recording says"


def test_a_refused_key_ends_at_once_and_is_not_shown(capsys, monkeypatch, tmp_path: Path):
    monkeypatch.setenv("MY_KEY", KEY)
    with run_endpoint(lambda number: "refused") as endpoint:
        assert main(["talk", "--model", "fake", "--endpoint", endpoint.url, "--room", "ladder-1/pair/test#0..2",
                     "--key-variable", "MY_KEY", "--at-once", "1", "--out", str(tmp_path / "games")]) == 2
    out, err = capsys.readouterr()
    assert "status 401" in err and "(key)" in err and KEY not in out + err and len(endpoint.requests) == 2


def test_a_redirect_carries_the_key_nowhere():
    with run_endpoint(lambda number: "redirect") as endpoint, pytest.raises(EndpointError, match="status 302"):
        connect(endpoint.url).complete([], [{"function": {"name": "run_option", "parameters": {
            "properties": {"option": {"enum": ["a"]}}}}}])
    assert not endpoint.stolen


@pytest.mark.parametrize("fault", ["silent", "trickle", "trickling head"])
def test_a_slow_endpoint_is_given_up_in_time(fault: str):
    with run_endpoint(lambda number: fault) as endpoint:
        begun = time.monotonic()
        with pytest.raises(EndpointError, match="within 0.4 s|Timeout"):
            connect(endpoint.url, request_seconds=0.4, retries=1).complete([], [{"function": {
                "name": "run_option", "parameters": {"properties": {"option": {"enum": ["a"]}}}}}])
        assert time.monotonic() - begun < 4.0 and len(endpoint.requests) == 2


def test_budgets_stop_games_and_the_same_call_resumes(tmp_path: Path):
    with run_endpoint() as endpoint:
        first = evaluate_model(connect(endpoint.url), rooms=3, games_at_once=1, out=tmp_path,
                               budget=Budget(tokens=7_000, prices=(1.0, 100.0)))
        assert 1 <= len(first.games) < 3 and "budget of 7,000 tokens" in first.unfinished[2]
        assert first.usage.prompt_tokens <= 8_000 and first.cost == pytest.approx(
            (first.usage.prompt_tokens + 100 * first.usage.completion_tokens) / 1e6)
        sent = len(endpoint.requests)
        again = evaluate_model(connect(endpoint.url), rooms=3, out=tmp_path)
        assert len(again.games) == 3 and again.games[:len(first.games)] == first.games and not again.unfinished
        assert again.usage.requests == len(endpoint.requests) > sent
        calls = len(endpoint.requests)
        assert evaluate_model(connect(endpoint.url), rooms=3, out=tmp_path) == again
        assert len(endpoint.requests) == calls
        with pytest.raises(RunMismatchError, match="reveal"):
            evaluate_model(connect(endpoint.url), rooms=3, out=tmp_path, reveal="names")
        with pytest.raises(RunMismatchError, match="options"):
            evaluate_model(connect(endpoint.url, options={"temperature": 0}), rooms=3, out=tmp_path)
        sound = (tmp_path / "game-001.json").read_text()
        huge = sound.replace('"prompt_tokens": ', '"prompt_tokens": 1' + "0" * 400)
        for damaged in ("{}", huge, sound.replace('"invalid_calls": ', '"invalid_calls": -1')):
            (tmp_path / "game-001.json").write_text(damaged)
            with pytest.raises(FileReadError, match="game-001"):
                evaluate_model(connect(endpoint.url), rooms=3, out=tmp_path)
        late = evaluate_model(connect(endpoint.url), rooms=1, budget=Budget(seconds=0.0))
        assert late.unfinished == {0: "the time limit is reached"} and not late.games
    assert not Budget(seconds=0.9).find_reason()
    for wrong in ({"tokens": -1}, {"seconds": math.nan}, {"dollars": 1.0}, {"prices": (-1.0, 1.0)},
                  {"prices": (1.0, math.inf)}):
        with pytest.raises(ConfigError):
            Budget(**wrong)


def test_what_an_unfinished_game_has_used_is_in_the_folder_before_the_next_request(tmp_path: Path):
    counted = []

    class Client(ChatClient):
        def complete(self, *arguments: Any) -> Reply:
            path = tmp_path / "usage.json"
            counted.append(json.loads(path.read_text())["requests"] if path.exists() else 0)
            return super().complete(*arguments)

    with run_endpoint() as endpoint:
        evaluate_model(Client("fake", endpoint.url), rooms=1, out=tmp_path)
    assert counted == [*range(len(counted))] and len(counted) > 2


def test_a_model_that_only_talks_ends_its_game():
    with run_endpoint(lambda number: "words") as endpoint:
        (game,) = evaluate_model(connect(endpoint.url), rooms=1).games
    assert game.ended == "3 replies without a call" and not game.score.escaped and len(endpoint.requests) == 3


def test_scripts_and_people_get_the_row_of_a_model(tmp_path: Path):
    script = evaluate_model(make_model("search-nearest"), rooms=2, out=tmp_path / "script").to_row()
    assert script["caller"] == "search-nearest" and script["success"] == 1.0
    assert script["exploitation"] == 0.0 and script["prompt_tokens"] == 0
    shown, words = [], iter(["1", "dance", "look", "press-button-2", "1", "3", "quit"])
    found = evaluate_model(Person("me", lambda prompt: next(words), shown.append), rooms=2, out=tmp_path / "me")
    (game,) = found.games
    assert game.score.escaped and game.score.invalid_calls == 0 and found.unfinished == {1: "the person stopped"}
    assert shown[0] == verify_games(tmp_path / "me/game-000.jsonl")[0].turns[0].text
    assert set(found.to_row()) == set(script) and "| me | ladder-1/pair/test" in found.describe()


def test_a_first_try_of_hidden_play_becomes_a_row(capsys, tmp_path: Path):
    for takes_back in (False, True):
        episode = Episode(get_room("pair", 3), is_hidden=True)
        for name in ("press-button-2", "turn-left", "press-button-1", "press-button-2", "press-button-1", "go-to-exit"):
            if takes_back:
                carry_out(Command("act", episode.names.index("forward")), episode, tmp_path)
                carry_out(Command("undo"), episode, tmp_path)
            said = carry_out(Command("act", episode.names.index(name)), episode, tmp_path)
        assert episode.end.value == "escaped" and ("recorded as" in said) is not takes_back
        episode.close()
    (path,) = tmp_path.glob("game-*.jsonl")
    assert main(["talk", "--games", str(path), "--model", "me"]) == 0
    assert "| me | pair | places | 1 | 1.00 |" in capsys.readouterr().out
    row = evaluate_recordings("me", [path]).to_row()
    assert row["exploration"] is not None and row["calls"] == 6 and row["wrong_calls"] == 0
    with pytest.raises(ConfigError, match="at least one"):
        evaluate_recordings("me", [])


def test_each_set_of_rooms_and_level_has_a_folder_by_default(capsys, monkeypatch, tmp_path: Path):
    monkeypatch.chdir(tmp_path)
    with run_endpoint() as endpoint:
        for more in (["--room", "ladder-1/pair/test#3..4"], ["--room", "ladder-1/pair/test#4..5"],
                     ["--room", "ladder-1/pair/test#4..5", "--reveal", "names"]):
            assert main(["talk", "--model", "org/fake", "--endpoint", endpoint.url, *more]) == 0
    assert len(list(tmp_path.glob("games/org_fake-*/game-000.jsonl"))) == 3


def test_the_command_prints_the_row(capsys, tmp_path: Path):
    with run_endpoint() as endpoint:
        words = ["talk", "--model", "fake", "--endpoint", endpoint.url, "--room", "ladder-1/pair/test#3..5",
                 "--price-read", "1", "--budget-dollars", "5", "--temperature", "0", "--out", str(tmp_path / "games")]
        assert main(words) == 0
        out = capsys.readouterr().out
        assert "room 1: escaped, efficiency" in out and "| fake | ladder-1/pair/test#3..5 | places | 2 | 1.00 |" in out
        assert endpoint.requests[0]["temperature"] == 0 and endpoint.keys[0] in (None, f"Bearer {KEY}")
    settings = json.loads((tmp_path / "games/settings.json").read_text())
    assert settings["caller"] == "fake" and settings["numbers"]
    assert main(["talk", "--me", "--model", "x"]) == 2 and main(["talk", "--model", "x"]) == 2
    assert main(["talk", "--model", "x", "--endpoint", "ftp://x"]) == 2
    capsys.readouterr()
    assert main(["talk", "--model", "x", "--endpoint", f"http://me:{KEY}@x/v1"]) == 2
    assert KEY not in capsys.readouterr().err


@pytest.mark.nightly
def test_forty_games_with_faults_are_finished(tmp_path: Path):
    def fault(number: int) -> str:
        return FAULTS[number // 3 % len(FAULTS)] if number % 3 == 0 else ""

    with run_endpoint(fault) as endpoint:
        found = evaluate_model(connect(endpoint.url, retries=8), rooms=40, games_at_once=8, out=tmp_path)
    assert len(found.games) == 40 and not found.unfinished
    assert all(game.score.escaped for game in found.games) and found.usage.retries > 20
    for number in (0, 39):
        (game,) = verify_games(tmp_path / f"game-{number:03}.jsonl")
        assert game.score == found.games[number].score
