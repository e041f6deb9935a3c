"""Manual mode at a prompt: the tools of a session, in words."""

from __future__ import annotations

import io
import os
import pty
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.errors import UnsupportedError
from hrl_escape.text import RoomSession, ToolCall, verify_games
from hrl_escape.viewer.play.terminal import play_in_terminal, read_command

COMMAND = [sys.executable, "-m", "hrl_escape.cli", "play", "--text"]


def test_lines_mean_calls(two_buttons):
    session = RoomSession(EscapeRoomEnv(instance=two_buttons))
    session.reset(seed=0)
    meanings = {"look": ToolCall("look", {}), "press button-2": ToolCall("run_option", {"option": "press button-2"}),
                "le": ToolCall("run_option", {"option": "leave"}), "press": None, "": None, "dance": None,
                "forward x": None,
                "forward": ToolCall("move", {"primitive": "forward", "times": 1}),
                "turn-l 7": ToolCall("move", {"primitive": "turn-left", "times": 7}),
                "turn-l 99999999999": ToolCall("move", {"primitive": "turn-left", "times": 999999})}
    assert {line: read_command(line, session.tools()) for line in meanings} == meanings


def test_a_game_that_is_piped_in_escapes_and_its_recording_verifies(two_buttons, tmp_path, capsys, monkeypatch):
    lines = "look\nnonsense\npress button-1\npress button-2\nmap\nleave\nsave\nquit\nforward\n"
    monkeypatch.setattr(sys, "stdin", io.StringIO(lines))
    play_in_terminal(RoomSession(EscapeRoomEnv(instance=two_buttons)), 3, tmp_path)
    shown = capsys.readouterr().out
    assert "The game is over: escaped." in shown and "\N{FULL BLOCK}" in shown and "in 3 calls" in shown
    (file,) = tmp_path.iterdir()
    (game,) = verify_games(file)
    assert game.seed == 3 and game.score.escaped and game.score.invalid_calls == 0 and file.suffix == ".jsonl"


def test_the_map_is_for_live_terminals_and_words_for_pipes(two_buttons, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("press button-1\n"))
    play_in_terminal(RoomSession(EscapeRoomEnv(instance=two_buttons)), 0, tmp_path)
    assert "\N{FULL BLOCK}" not in capsys.readouterr().out and not list(tmp_path.iterdir())


def test_text_goes_alone():
    from hrl_escape.commands.play import PlayArgs, run

    for args in (PlayArgs(text=True, hidden=True), PlayArgs(text=True, replay=Path("x.json"))):
        with pytest.raises(UnsupportedError, match="--text"):
            run(args)


def test_in_a_real_terminal_the_map_is_shown_and_quit_ends_it():
    ours, theirs = pty.openpty()
    game = subprocess.Popen([*COMMAND, "--preset", "paper-one-button"], stdin=theirs, stdout=theirs, stderr=theirs,
                            env=os.environ | {"TERM": "xterm", "COLUMNS": "100", "LINES": "40"})
    os.close(theirs)
    try:
        for line, expected in ((b"", "\N{FULL BLOCK}"), (b"press b\n", "came on"), (b"quit\n", "in 1 call")):
            os.write(ours, line)
            shown, end = b"", time.monotonic() + 600
            while expected.encode() not in shown and time.monotonic() < end:
                shown += os.read(ours, 65536)
            assert expected.encode() in shown, shown[-500:].decode(errors="replace")
        assert game.wait(600) == 0
    finally:
        game.kill()
        game.wait()
        os.close(ours)
