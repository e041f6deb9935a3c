"""Data sets of one's own play, from the files that the player saves."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.data.materialise import load_data
from hrl_escape.data.record import make_played_recording
from hrl_escape.data.recording import load_recording, save_recording
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import EpisodeFileError
from hrl_escape.viewer.play.episode import Episode, save_episode


def play(path, seed=0, moves=(0, 6, 4, 7, 8), preset="paper-two-button"):
    episode = Episode(generate(get_preset(preset), 0), None, seed)
    for move in moves:
        episode.do(move)
    save_episode(path, episode.to_saved())
    episode.close()
    return path


def test_saved_play_becomes_decisions_with_the_moves_that_were_made(tmp_path):
    paths = [play(tmp_path / f"{seed}.json", seed) for seed in range(3)]
    recording = make_played_recording("mine", "paper-two-button#0", paths)
    save_recording(tmp_path / "mine.npz", recording)
    data = load_data(tmp_path / "mine.npz", observation="features")
    decisions = data.read()
    assert load_recording(tmp_path / "mine.npz").digest == recording.digest
    assert decisions.action[:3].tolist() == [0, 6, 4] and decisions.duration[0] == 1 < decisions.duration[1]
    assert decisions.mask.shape[1] == 9 and decisions.mask[0, 6:8].all()
    assert len(np.unique(decisions.trajectory)) == 3
    assert data.test_rooms.seeds[0] == 0


def test_play_in_another_room_or_without_a_move_is_refused_by_its_file(tmp_path):
    with pytest.raises(EpisodeFileError, match=r"other.json: its room is none of paper-two-button#0"):
        other = play(tmp_path / "other.json", preset="paper-one-button", moves=(0,))
        make_played_recording("mine", "paper-two-button#0", [other])
    with pytest.raises(EpisodeFileError, match=r"still.json: nobody moved"):
        make_played_recording("mine", "paper-two-button#0", [play(tmp_path / "still.json", moves=())])
    with pytest.raises(EpisodeFileError, match="no episode"):
        make_played_recording("mine", "paper-two-button#0", [])
