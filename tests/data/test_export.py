"""Exported sets are read by the libraries that they are for, unmodified."""

from __future__ import annotations

import numpy as np
import pytest

from hrl_escape.data.export import to_minari, to_ogbench
from hrl_escape.data.materialise import load_data
from hrl_escape.data.record import make_played_recording
from hrl_escape.errors import UnsupportedError
from tests.data.small import make_recording


@pytest.mark.nightly
def test_ogbench_files_have_a_row_a_state_and_one_trajectory_in_ten_is_for_validation(tmp_path):
    data = load_data(make_recording("stitch"), observation="features")
    whole = data.read()
    training, validation = (dict(np.load(path)) for path in to_ogbench(data, tmp_path))
    trajectories = int(whole.trajectory[-1]) + 1
    assert validation["terminals"].sum() == trajectories // 10
    assert training["terminals"].sum() + validation["terminals"].sum() == trajectories
    assert len(training["actions"]) + len(validation["actions"]) == len(whole.action) + trajectories
    assert all(array.dtype == np.float32 for array in training.values())
    count = int(np.flatnonzero(training["terminals"])[0])
    assert np.array_equal(training["observations"][:count], whole.observation[:count])
    assert np.array_equal(training["observations"][count], whole.next_observation[count - 1])
    assert np.array_equal(training["discounts"][:count], whole.discount[:count].astype(np.float32))
    assert (training["masks"] == 0).sum() + (validation["masks"] == 0).sum() == whole.terminated.sum()


def test_few_trajectories_leave_one_for_validation_and_a_single_one_is_refused(tmp_path):
    data = load_data(make_recording(primitives=200), observation="features")
    count = int(data.read().trajectory[-1]) + 1
    assert 1 < count < 10
    training, validation = (dict(np.load(path)) for path in to_ogbench(data, tmp_path))
    assert (training["terminals"].sum(), validation["terminals"].sum()) == (count - 1, 1)
    with pytest.raises(UnsupportedError, match="two or more"):
        to_ogbench(load_data(make_recording(primitives=5), observation="features"), tmp_path)


def test_ogbenchs_own_loader_gives_the_transitions(tmp_path):
    utils = pytest.importorskip("ogbench.utils")
    data = load_data(make_recording(), observation="features")
    whole = data.read()
    training, _ = to_ogbench(data, tmp_path)
    found = utils.load_dataset(str(training), ob_dtype=np.float32, action_dtype=np.int32)
    kept = whole.trajectory % 10 != 9
    assert np.array_equal(found["observations"], whole.observation[kept])
    assert np.array_equal(found["next_observations"], whole.next_observation[kept])
    assert np.array_equal(found["actions"], whole.action[kept])


@pytest.mark.nightly
def test_minari_reads_both_sets_recovers_their_environments_and_normalises_scores(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    minari = pytest.importorskip("minari")
    data = load_data(make_recording(), observation="features")
    decisions, whole = data.read(), data.read_primitives()
    to_minari(data)
    primitives = minari.load_dataset("hrl_escape/pair/play-primitives-v1")
    options = minari.load_dataset("hrl_escape/pair/play-decisions-v1")
    assert (primitives.total_steps, options.total_steps) == (len(whole.action), len(decisions.action))
    assert primitives.total_episodes == options.total_episodes == decisions.trajectory[-1] + 1
    episode = options[0]
    count = len(episode.actions)
    assert np.array_equal(episode.observations[:-1], decisions.observation[:count])
    assert np.array_equal(episode.infos["duration"], [0, *decisions.duration[:count]])
    assert np.array_equal(episode.infos["discount"][1:], decisions.discount[:count])
    assert np.array_equal(episode.infos["action_mask"][:-1], decisions.mask[:count])
    env, test = options.recover_environment(), options.recover_environment(eval_env=True)
    assert env.action_space.n == 3 and test.spec.kwargs["set"] == "test"
    seen, _ = env.reset(seed=0)
    assert seen.shape == episode.observations.shape[1:]
    assert primitives.recover_environment().action_space.n == 6
    scores = data.recording.about["scores"]
    returns = np.array([scores["chance"], scores["best_known"]])
    assert minari.get_normalized_score(options, returns) == pytest.approx([0, 1])


@pytest.mark.nightly
def test_the_sets_lie_in_the_folder_that_is_given(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "own"))
    made = to_minari(load_data(make_recording(), observation="features"), folder=tmp_path / "there")
    assert not (tmp_path / "own").exists() and list((tmp_path / "there").rglob("*.hdf5"))
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "there"))
    assert {each.spec.dataset_id for each in made} == set(minari.list_local_datasets())


def test_decisions_of_primitives_alone_are_a_set_over_primitives(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    pytest.importorskip("minari")
    for made in to_minari(load_data(make_recording("explore"), observation="features")):
        assert made.recover_environment().action_space.n == made.action_space.n == 6


def test_d3rlpy_learns_from_the_exported_decisions(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    minari, d3rlpy = pytest.importorskip("minari"), pytest.importorskip("d3rlpy")
    _, options = to_minari(load_data(make_recording("expert"), observation="features"))
    episodes = [d3rlpy.dataset.Episode(each.observations[:-1], each.actions.reshape(-1, 1),
                                       each.rewards.reshape(-1, 1), bool(each.terminations[-1]))
                for each in minari.load_dataset(options.spec.dataset_id)]
    buffer = d3rlpy.dataset.ReplayBuffer(d3rlpy.dataset.InfiniteBuffer(), episodes=episodes)
    for config in (d3rlpy.algos.DiscreteBCConfig(), d3rlpy.algos.DiscreteCQLConfig()):
        agent = config.create(device="cpu:0")
        agent.fit(buffer, n_steps=20, n_steps_per_epoch=20, show_progress=False, experiment_name="test",
                  logger_adapter=d3rlpy.logging.NoopAdapterFactory())
        assert agent.predict(episodes[0].observations[:3]).shape == (3,)


def test_rooms_of_no_rung_have_no_environment_that_minari_could_recover(tmp_path):
    pytest.importorskip("minari")
    from tests.data.test_played import play

    recording = make_played_recording("mine", "paper-two-button#0", [play(tmp_path / "a.json")])
    with pytest.raises(UnsupportedError, match="no rung"):
        to_minari(load_data(recording, observation="features"))
