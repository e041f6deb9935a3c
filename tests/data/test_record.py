"""Recordings: the same bytes however often they were stopped, and behaviours that are what they are called."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hrl_escape.data
from hrl_escape.data.catalogue import DataSpec, list_specs, parse_spec
from hrl_escape.data.materialise import load_data
from hrl_escape.data.published import read_published
from hrl_escape.data.record import record, train_medium
from hrl_escape.data.recording import Recording, load_recording, save_recording
from hrl_escape.planning.best_known import find_best_known, list_start_states
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.step_info import ENDINGS
from tests.data.small import make_recording, save_small

SHIPPED = Path(hrl_escape.data.__file__).parent / "recordings"


def keep_first(recording, episodes):
    """The first episodes of a recording, as a process leaves them that was killed after them."""
    decisions = int(recording.decisions[:episodes].sum())
    primitives = int(recording.duration[:decisions].sum())
    counts = {"legal": decisions + episodes, "action": primitives}
    whole = {name: getattr(recording, name) for name in Recording.__annotations__ if name != "about"}
    arrays = {name: array[: counts.get(name, episodes if len(array) == len(recording.room) else decisions)]
              for name, array in whole.items()}
    return Recording({**recording.about, "scores": {}}, **arrays)


@pytest.mark.nightly_for("12")
@pytest.mark.parametrize("episodes", [1, 12, 26])  # the third when the second room has begun
def test_a_killed_recording_goes_on_to_the_same_bytes(tmp_path, episodes):
    path = tmp_path / "again.npz"
    save_recording(path.with_suffix(".part"), keep_first(make_recording(), episodes))
    record(DataSpec("pair", "play"), path, primitives=2_000)
    assert path.read_bytes() == save_small().read_bytes()
    assert not path.with_suffix(".part").exists()


def test_what_another_recording_left_is_not_taken_up(tmp_path):
    path = tmp_path / "again.npz"
    save_recording(path.with_suffix(".part"), keep_first(make_recording("stitch"), 3))
    record(DataSpec("pair", "play"), path, primitives=2_000)
    assert path.read_bytes() == save_small().read_bytes()


def test_noisy_options_fail_as_often_as_is_said_and_experts_escape_in_the_fewest_decisions():
    noisy, expert, play = (make_recording(kind) for kind in ("noisy", "expert", "play"))
    failed = np.mean(noisy.ended == ENDINGS.index("planning-failed"))
    assert 0.1 < failed < 0.3 and (noisy.duration[noisy.ended == 3] == 1).all()
    assert not (play.ended == 3).any()
    whole = expert.end != 0
    assert (expert.end[whole] == 1).all() and (expert.decisions[whole] <= 3).all()
    assert play.decisions.mean() > 2 * expert.decisions.mean()


def test_stitched_episodes_are_cut_after_every_one_or_two_decisions_until_they_end():
    recording = make_recording("stitch")
    cuts = np.split(recording.cut, np.cumsum(recording.decisions)[:-1])
    pieces = [np.diff([0, *np.flatnonzero(cut) + 1]) for cut in cuts]
    assert set(np.concatenate(pieces)) == {1, 2} and max(map(len, pieces)) > 3
    assert all(count - piece.sum() <= 1 for count, piece in zip(recording.decisions, pieces, strict=True)), "to the end"
    assert not make_recording("play").cut.any()


def test_exploration_is_of_primitives_alone():
    recording = make_recording("explore")
    assert recording.primitive_count == len(recording.about["actions"]) == 6
    assert np.array_equal(recording.option, recording.action) and (recording.duration == 1).all()
    np.testing.assert_allclose(np.bincount(recording.action) / len(recording.action), 1 / 6, atol=0.04)


@pytest.mark.nightly
def test_medium_learns_as_it_is_recorded_exploring_a_tenth_of_the_time(tmp_path, monkeypatch):
    monkeypatch.setitem(train_medium.__globals__, "MEDIUM_PRIMITIVES", 40)
    agent = train_medium(load_benchmark("ladder-1")["pair"].train[:2], tmp_path / "run")
    assert agent.settings.epsilon_start == agent.settings.epsilon_end == 0.1


def test_a_card_counts_the_whole_episodes_and_those_that_escape():
    for kind, escapes in (("play", 1.0), ("explore", 0.0)):  # an escape each, but where a room's share ends; none
        recording, scores = make_recording(kind), make_recording(kind).about["scores"]
        assert scores["whole_episodes"] == len(recording.end) - np.sum(recording.end == 0) > 0
        assert scores["escapes"] == escapes
    cut = make_recording("explore", primitives=200).about["scores"]  # below the horizon
    assert (cut["whole_episodes"], cut["escapes"]) == (0, 0.0)


@pytest.mark.slow
def test_medium_is_half_way_between_what_learns_nothing_and_the_planner(tmp_path):
    recording = record(DataSpec("pair", "medium"), tmp_path / "medium.npz", primitives=4_000)
    best = [find_best_known(room, list_start_states(room)[0]).primitives for room in recording.rooms]
    lengths = np.add.reduceat(recording.duration, np.concatenate([[0], np.cumsum(recording.decisions)[:-1]]))
    whole = recording.end != 0
    efficiency = np.mean([best[room] / length * (end == 1) for room, length, end in
                          zip(recording.room[whole], lengths[whole], recording.end[whole], strict=True)])
    assert 0.4 < efficiency < 0.85


def test_every_data_set_of_the_smallest_size_comes_with_the_package():
    assert {path.stem for path in SHIPPED.glob("*.npz")} == {spec.name for spec in list_specs() if not spec.size}


def test_every_data_set_of_the_two_smaller_sizes_is_published_and_the_larger_one_holds_ten_times_as_much():
    published = read_published()
    assert set(published) == {spec.name for spec in list_specs() if spec.size != "10m"}
    for name in filter(lambda name: name.endswith("-1m-v1"), published):
        large, small = published[name], published[name.replace("-1m", "")]
        assert 1_000_000 <= large.primitives < 1_010_000 and large.content != small.content
        assert large.scores["best_known"] == small.scores["best_known"], "the same rooms"
        escapes = large.scores["escapes"], small.scores["escapes"]
        assert abs(escapes[0] - escapes[1]) < 0.15, f"{name}: the same players"


def test_what_comes_with_the_package_is_what_the_table_of_published_recordings_says():
    published = read_published()
    for path in sorted(SHIPPED.glob("*.npz")):
        recording, known = load_recording(path), published[path.stem]
        counts = len(recording.action), len(recording.option), len(recording.room)
        assert (recording.content, path.stat().st_size, *counts) == (
            known.content, known.bytes, known.primitives, known.decisions, known.episodes)
        assert known.scores == {name: round(recording.about["scores"][name], 3) for name in known.scores}


@pytest.mark.parametrize("path", [
    pytest.param(path, marks=pytest.mark.nightly if path.stem == "chain-expert-v1" else pytest.mark.slow)
    for path in sorted(SHIPPED.glob("*.npz"))], ids=lambda path: path.stem)
def test_what_comes_with_the_package_replays_to_the_scores_on_its_card(path):
    recording, spec = load_recording(path), parse_spec(path.stem)
    assert (recording.about["name"], recording.about["kind"], recording.about["command"]) == (
        spec.name, spec.kind, f"hrl-escape data make {spec.name}")
    assert len(recording.action) >= spec.primitives and path.stat().st_size < 120_000
    returns = []
    for block in load_data(recording, observation="features").blocks("decisions"):
        returns += np.bincount(block.trajectory - block.trajectory[0], block.summed_reward).tolist()
    assert np.mean(returns) == pytest.approx(recording.about["scores"]["mean_return"], rel=1e-12)
