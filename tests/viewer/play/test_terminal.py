"""Manual mode without a browser."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import time

from hrl_escape.viewer.play.episode import Episode
from hrl_escape.viewer.play.saved_episode import load_episode
from hrl_escape.viewer.play.terminal import play_in_terminal, read_keys

COMMAND = [sys.executable, "-m", "hrl_escape.cli", "play", "--no-browser"]


def test_keys_are_read_one_by_one_and_arrows_as_one_key():
    here, there = os.pipe()
    os.write(there, b"w\x1b[A\x1b[DM1\n\x1bOCz")
    os.close(there)
    assert list(read_keys(here)) == ["w", "up", "left", "m", "1", "right", "z"]
    os.close(here)


def test_a_game_that_is_piped_in_escapes_and_is_saved(two_buttons, tmp_path, capfd, monkeypatch):
    def play(keys: bytes, episode: Episode) -> str:
        here, there = os.pipe()
        os.write(there, keys)
        os.close(there)
        with open(here) as stdin:
            monkeypatch.setattr(sys, "stdin", stdin)
            play_in_terminal(episode, tmp_path)
        return next(line for line in capfd.readouterr().out.splitlines() if "primitives, return" in line)

    tally = play(b"wzm1m2m0f", Episode(two_buttons))
    assert "escaped" in tally
    (file,) = tmp_path.iterdir()
    saved = load_episode(file)
    again = Episode(saved.instance, seed=saved.seed)
    again.replay(saved)
    assert play(b"", again) == tally


def test_in_a_real_terminal_keys_work_at_once_and_q_leaves_it_as_it_was():
    ours, theirs = pty.openpty()
    game = subprocess.Popen([*COMMAND, "--preset", "paper-one-button"], stdin=theirs, stdout=theirs, stderr=theirs,
                            env=os.environ | {"TERM": "xterm", "COLUMNS": "100", "LINES": "40"})
    os.close(theirs)
    shown = b""
    try:
        for key, expected in ((b"", b"0\x1b[0m primitives"), (b"w", b"1\x1b[0m primitives"), (b"z", b"taken back"),
                              (b"q", b"")):
            os.write(ours, key)
            end = time.monotonic() + 600
            while expected and expected not in shown and time.monotonic() < end:
                shown += os.read(ours, 65536)
            assert expected in shown, shown[-500:].decode(errors="replace")
            shown = b""
        assert game.wait(600) == 0
    finally:
        game.kill()
        game.wait()
        os.close(ours)
