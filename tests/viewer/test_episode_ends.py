"""A failed episode is called failed on every page, in every file and by every command, whatever puzzle it is."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.cli import main
from hrl_escape.env.config import RoomConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.env.presets import PRESETS, get_preset
from hrl_escape.env.puzzles.base import Puzzle, get_puzzle_kind, list_puzzles
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.batched.vector_env import OptionsVectorEnv
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.text.text_env import RoomSession
from hrl_escape.viewer.pages.offline import make_replay
from hrl_escape.viewer.play.commands import Command, carry_out
from hrl_escape.viewer.play.episode import Episode, load_episode, save_episode
from hrl_escape.viewer.recording import record_saved
from hrl_escape.viewer.watch.drivers import open_driver
from hrl_escape.viewer.watch.watch import Gate, Watch

SHIPPED = {kind: found for kind in list_puzzles()
           if (found := get_puzzle_kind(kind).puzzle_type).__module__.startswith("hrl_escape.")}
FAILING = [kind for kind, found in SHIPPED.items() if found.is_failed is not Puzzle.is_failed]
"""Puzzles of this package that can be failed."""


def make_room(kind: str):
    """Small room of a puzzle that can be failed: that of its preset where it has one."""
    preset = next((get_preset(name) for name in PRESETS if get_preset(name).puzzle.kind == kind), None)
    config = preset or RoomConfig(puzzle=get_puzzle_kind(kind).config_type())
    if kind == "buttons":  # they can be where a wrong press says so
        config = dataclasses.replace(config, puzzle=ButtonsConfig(count=3, on_violation="fail"))
    return generate(config, 0)


def fail(episode: Episode, chance: np.random.Generator, folder: Path) -> str:
    """Press targets at random until the puzzle is failed; what the page says of the last move."""
    said = ""
    while not episode.is_over:
        legal = [action for action in range(episode.primitive_count, len(episode.names)) if episode.is_legal(action)]
        said = carry_out(Command("act", int(chance.choice(legal))), episode, folder)
    return said


@pytest.fixture(scope="module", params=FAILING)
def failed(request, tmp_path_factory):
    """An episode whose puzzle was failed, and what play said of it."""
    room = make_room(request.param)
    for seed in range(50):
        episode = Episode(room)
        said = fail(episode, np.random.default_rng(seed), tmp_path_factory.mktemp("play"))
        if episode.end is EpisodeEnd.FAILED:
            return episode, said
    raise AssertionError(f"no random episode of {request.param} fails")


def test_some_puzzle_can_be_failed():
    assert "deep-sea" in FAILING


def test_play_its_file_the_recorded_page_and_a_session_say_failed(failed, tmp_path, capsys):
    episode, said = failed
    assert said == "Failed" and episode.is_over
    save_episode(tmp_path / "mine.json", episode.to_saved())
    assert json.loads((tmp_path / "mine.json").read_text())["end"] == "failed"
    recording = record_saved(load_episode(tmp_path / "mine.json"), "mine")
    assert recording.end is EpisodeEnd.FAILED
    page = make_replay(recording)
    assert json.loads(re.search(r'id="r-data">(\{.*?\})</script>', page, re.S)[1])["end"] == "failed"
    assert main(["record", str(tmp_path / "mine.json"), "--out", str(tmp_path / "mine.html")]) == 0
    assert "mine: failed after" in capsys.readouterr().out
    session = RoomSession(EscapeRoomEnv(instance=episode.instance))
    session.reset(episode.seed)
    for step in episode.steps:
        turn = session.call("move", {"primitive": episode.names[step.primitive]})
    assert "The game is over: failed." in turn.text


def test_watching_says_failed(failed):
    """The agent chooses what failed before, one after another."""
    episode, _ = failed
    driver = dataclasses.replace(open_driver("random-options", episode.instance), trains=False)
    moves = iter([driver.names.index(move.name) for move in episode.moves])
    driver.agent.act_greedy = lambda observation, mask, rng: next(moves)
    watch = Watch(driver, Gate(None))
    watch.run(1)
    assert [line for line in watch.events if ", return " in line][0].split("  ")[1].startswith("failed")


def test_agents_over_options_are_told_of_no_success(failed):
    episode, _ = failed
    chosen = [episode.names.index(move.name) for move in episode.moves]
    one = OptionsEnv(EscapeRoomEnv(instance=episode.instance))
    many = OptionsVectorEnv(2, instance=episode.instance)
    one.reset(seed=0)
    many.reset(seed=[0, 0])
    for action in chosen:
        _, _, terminated, _, info = one.step(action)
        _, _, ended, _, infos = many.step(np.array([action, action]))
    assert terminated and not info["is_success"]
    assert np.asarray(ended).all() and not np.asarray(infos.get("final_info", infos)["is_success"]).any()
