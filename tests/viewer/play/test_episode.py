"""Episodes that people play: undo, saving, replaying."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from hrl_escape.commands.play import PlayArgs
from hrl_escape.env.config import DynamicsConfig
from hrl_escape.env.kinematics import EpisodeEnd
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EpisodeFileError, FileReadError, UnsupportedError
from hrl_escape.viewer.play.episode import Episode, load_episode, save_episode


def play(episode: Episode, names: list[str]) -> None:
    for name in names:
        assert episode.do(episode.names.index(name)) is not None


def test_undo_returns_the_exact_state_before_each_move(two_buttons):
    episode = Episode(two_buttons)
    states = [episode.state]
    for name in ("forward", "turn-left", "press-button-1", "strafe-left", "press-button-2", "go-to-exit"):
        play(episode, [name])
        states.append(episode.state)
    assert episode.end is EpisodeEnd.ESCAPED
    for state in reversed(states[:-1]):
        assert episode.undo() is not None
        assert episode.state == state
        assert episode.total == -state.primitives
        assert not episode.is_over
    assert episode.undo() is None


def test_what_is_done_after_an_undo_is_what_would_have_happened_without(two_buttons):
    straight, back = Episode(two_buttons), Episode(two_buttons)
    play(straight, ["forward", "press-button-1"])
    play(back, ["forward", "strafe-left", "press-button-2"])
    back.undo()
    back.undo()
    play(back, ["press-button-1"])
    assert back.state == straight.state and back.total == straight.total


@pytest.mark.parametrize("kind", ["kinematic", "physics"])
def test_undo_is_exact_under_noise_and_slip_too(kind: str):
    config = get_preset("paper-one-button")
    noisy = config.from_dict(config.to_dict() | {"dynamics": DynamicsConfig(kind=kind, noise=0.1, slip=0.2).to_dict()})
    episode = Episode(generate(noisy, 0), seed=5)
    actions = np.random.default_rng(0).integers(6, size=8).tolist()
    states = [episode.state]
    for action in actions:
        episode.do(action)
        states.append(episode.state)
    for _ in range(4):
        episode.undo()
    assert episode.state == states[4]
    for number, action in enumerate(actions[4:], 5):
        episode.do(action)
        assert episode.state == states[number]


def test_a_masked_meta_action_is_refused_and_costs_nothing(clutter):
    episode = Episode(clutter)
    assert not episode.is_legal(episode.names.index("go-to-exit"))
    assert episode.do(episode.names.index("go-to-exit")) is None
    assert episode.state.primitives == 0


def test_a_saved_episode_replays_to_the_same_state_and_can_be_undone(two_buttons, tmp_path: Path):
    episode = Episode(two_buttons, seed=3)
    play(episode, ["forward", "press-button-1", "press-button-2", "go-to-exit"])
    save_episode(tmp_path / "mine.json", episode.to_saved())
    saved = load_episode(tmp_path / "mine.json")
    again = Episode(saved.instance, seed=saved.seed)
    again.replay(saved)
    assert again.state == episode.state and again.end is EpisodeEnd.ESCAPED and again.total == episode.total
    assert [move.name for move in again.moves] == ["forward", "press-button-1", "press-button-2", "go-to-exit"]
    again.undo()
    assert again.state == episode.moves[-1].steps[0].before
    assert PlayArgs(hidden=True).make_episode(saved).instance == saved.instance
    with pytest.raises(UnsupportedError, match="--room chooses what to play, and --replay"):
        PlayArgs(room="clutter").make_episode(saved)


def test_the_next_room_is_the_room_configurations_next_instance():
    config = get_preset("paper-one-button")
    episode = Episode(generate(config, 4), config)
    episode.enter_next_room()
    assert episode.instance.id == generate(config, 5).id and episode.state.primitives == 0


def test_a_room_from_a_file_has_no_next(two_buttons):
    with pytest.raises(UnsupportedError, match="no next room"):
        Episode(two_buttons).enter_next_room()


def _spoil(path: Path, **changes: object) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


@pytest.mark.parametrize(("changes", "message"), [
    ({"kind": "other"}, "no recorded episode"),
    ({"schema": 99}, "schema 99"),
    ({"moves": [{"name": "jump", "primitives": [77], "ended": "reached"}]}, "numbers from 0 to 5"),
    ({"moves": None}, "NoneType"),
    ({"instance": {}}, "schema"),
])
def test_a_damaged_episode_gives_one_message_with_its_path(two_buttons, tmp_path: Path, changes, message: str):
    episode = Episode(two_buttons)
    play(episode, ["forward"])
    path = tmp_path / "mine.json"
    save_episode(path, episode.to_saved())
    _spoil(path, **changes)
    with pytest.raises(EpisodeFileError, match=message) as caught:
        load_episode(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_an_episode_that_does_not_play_out_as_it_says_is_refused(two_buttons, tmp_path: Path):
    episode = Episode(two_buttons)
    play(episode, ["press-button-1", "press-button-2", "go-to-exit"])
    path = tmp_path / "mine.json"
    save_episode(path, episode.to_saved())
    _spoil(path, **{"return": 99.0})
    saved = load_episode(path)
    with pytest.raises(EpisodeFileError, match="the file states 99"):
        Episode(saved.instance, seed=saved.seed).replay(saved)


def test_an_episode_that_does_not_escape_as_it_says_is_refused(two_buttons, tmp_path: Path):
    episode = Episode(two_buttons)
    play(episode, ["press-button-1"])
    save_episode(tmp_path / "mine.json", episode.to_saved())
    _spoil(tmp_path / "mine.json", end="escaped")
    saved = load_episode(tmp_path / "mine.json")
    with pytest.raises(EpisodeFileError, match="the replay ends stopped, the file states escaped"):
        Episode(saved.instance, seed=saved.seed).replay(saved)
    _spoil(tmp_path / "mine.json", end="fled")
    with pytest.raises(EpisodeFileError, match="'fled' is not a valid EpisodeEnd"):
        load_episode(tmp_path / "mine.json")


def test_a_truncated_episode_names_file_and_place(tmp_path: Path):
    path = tmp_path / "half.json"
    path.write_text('{"kind": "episode", ')
    with pytest.raises(FileReadError, match="half.json"):
        load_episode(path)


def test_an_escape_that_was_undone_can_be_made_again_by_an_option(two_buttons):
    episode = Episode(two_buttons)
    play(episode, ["press-button-1", "press-button-2", "go-to-exit"])
    ended, total = episode.state, episode.total
    episode.undo()
    play(episode, ["go-to-exit"])
    assert episode.end is EpisodeEnd.ESCAPED and episode.state == ended and episode.total == total


def test_a_file_that_is_one_primitive_off_in_its_return_is_refused(tmp_path, two_buttons):
    episode = Episode(two_buttons)
    play(episode, ["forward", "press-button-1"])
    saved = episode.to_saved()
    for wrong in (saved.total + 1.0, saved.total - 1.0, saved.total + 1e-3):
        with pytest.raises(EpisodeFileError, match="the file states"):
            Episode(saved.instance, seed=saved.seed).replay(dataclasses.replace(saved, total=wrong))
