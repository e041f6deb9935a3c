"""Callbacks: told of everything that a run logs, without a part in its numbers, and able to end it."""

import json

import gymnasium
import pytest
from gymnasium.vector import SyncVectorEnv

from hrl_escape.agents import Callback, MLflow, OptunaPruning, WeightsAndBiases, load_result, train
from hrl_escape.errors import MissingExtraError
from tests.agents.small_envs import ButtonGrid


class Notes(Callback):
    """Keeps what it is told; ends the run at an evaluation of its choice."""

    def __init__(self, last=None):
        self.last, self.begun, self.rows, self.evaluations, self.saved, self.ends = last, [], [], [], 0, []

    def on_begin(self, run):
        self.begun.append(run)

    def on_row(self, row):
        self.rows.append(dict(row))

    def on_evaluation(self, agent, evaluation):
        self.evaluations.append(evaluation)
        return len(self.evaluations) == self.last

    def on_checkpoint(self, folder):
        assert (folder / "checkpoint.npz").exists()
        self.saved += 1

    def on_end(self, result):
        self.ends.append(result)


def run(**arguments):
    return train("q-learning", ButtonGrid(), primitives=1_200, seed=3, eval_every=300, eval_episodes=2, **arguments)


def test_a_callback_hears_of_every_row_and_changes_no_number(tmp_path):
    notes = Notes()
    told, plain = run(out=tmp_path / "told", callbacks=[notes]), run(out=tmp_path / "plain")
    assert told == plain
    logged = [json.loads(line) for line in (tmp_path / "told" / "log.jsonl").read_text().splitlines()]
    assert json.loads(json.dumps(notes.rows)) == logged
    assert tuple(notes.evaluations) == told.evaluations and notes.saved >= 1
    assert notes.ends == [told]
    (begun,) = notes.begun
    assert (begun.name, begun.seed, begun.first, begun.folder) == ("q-learning", 3, 0, tmp_path / "told")
    assert json.loads((tmp_path / "told" / "run.json").read_text()) == json.loads(json.dumps(begun.identity))


@pytest.mark.nightly
def test_a_run_that_a_callback_ended_goes_on_to_the_same_bits_without_it(tmp_path):
    ended = run(out=tmp_path / "cut", callbacks=[Notes(), Notes(last=3)])
    assert len(ended.evaluations) == 3 and ended.primitives < 1_200
    assert not (tmp_path / "cut" / "result.json").exists()
    later = Notes()
    whole = run(out=tmp_path / "cut", callbacks=[later])
    assert whole == run() and load_result(tmp_path / "cut") == whole
    assert later.begun[0].first > ended.primitives and later.rows[0]["primitives"] >= later.begun[0].first


@pytest.mark.nightly
def test_callbacks_hear_of_runs_in_many_environments():
    notes = Notes(last=2)
    many = SyncVectorEnv([lambda: gymnasium.make("CartPole-v1")] * 4)
    result = train("q-learning", many, primitives=20_000, eval_every=1_000, eval_env=gymnasium.make("CartPole-v1"),
                   eval_episodes=1, callbacks=[notes])
    assert len(result.evaluations) == 2 and result.primitives < 20_000
    assert {row["kind"] for row in notes.rows} == {"segment", "evaluation"}


def test_a_callback_that_fails_at_the_end_is_reported_and_costs_neither_the_result_nor_the_others(tmp_path):
    class Down(Callback):
        def on_end(self, result):
            raise OSError("tracker is down")

    notes = Notes()
    with pytest.warns(RuntimeWarning, match=r"Down\.on_end raised OSError: tracker is down\. The run is complete"):
        result = run(callbacks=[Down(), notes], out=tmp_path)
    assert result == run() == load_result(tmp_path) and notes.ends == [result]

    class Fails(Callback):
        def on_row(self, row):
            raise RuntimeError("no space")

    with pytest.raises(RuntimeError, match="no space"), pytest.warns(RuntimeWarning, match="The run ended"):
        run(callbacks=[notes, Down(), Fails()])
    assert notes.ends == [result, None]


def test_every_callback_that_began_is_told_of_the_end_when_a_run_fails():
    class Fails(Callback):
        def on_row(self, row):
            raise RuntimeError("no space")

    notes = Notes()
    with pytest.raises(RuntimeError, match="no space"):
        run(callbacks=[notes, Fails()])
    assert notes.ends == [None]


@pytest.mark.parametrize(("package", "make"), [("wandb", WeightsAndBiases), ("mlflow", MLflow)])
def test_a_missing_extra_is_named(monkeypatch, package, make):
    monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(MissingExtraError, match=package):
        run(callbacks=[make()])


def test_mlflow_holds_the_logged_numbers(tmp_path, monkeypatch):
    mlflow = pytest.importorskip("mlflow")
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")
    uri = (tmp_path / "runs").as_uri()
    result = run(callbacks=[MLflow(uri)])
    client = mlflow.MlflowClient(tracking_uri=uri)
    (found,) = client.search_runs([client.get_experiment_by_name("hrl-escape").experiment_id])
    points = [(each.step, each.value) for each in client.get_metric_history(found.info.run_id, "eval/return")]
    assert points == [(e.primitives, e.mean_return) for e in result.evaluations]
    assert found.data.params["agent"] == "q-learning" and found.info.status == "FINISHED"


def test_weights_and_biases_keeps_an_offline_run(tmp_path):
    pytest.importorskip("wandb")
    run(callbacks=[WeightsAndBiases(folder=tmp_path)])
    (folder,) = (tmp_path / "wandb").glob("offline-run-*")
    (written,) = folder.glob("*.wandb")
    assert b"eval/return" in written.read_bytes()


@pytest.mark.parametrize("is_pruned", [True, False])
def test_optuna_hears_of_evaluations_and_prunes(is_pruned):
    optuna = pytest.importorskip("optuna")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    results = []

    def objective(trial):
        pruning = OptunaPruning(trial)
        results.append(run(callbacks=[pruning]))
        assert pruning.is_pruned == is_pruned
        if pruning.is_pruned:
            raise optuna.TrialPruned
        return results[-1].evaluations[-1].mean_return

    study = optuna.create_study(direction="maximize", pruner=optuna.pruners.ThresholdPruner(
        lower=1e6 if is_pruned else -1e6, n_warmup_steps=500))
    study.optimize(objective, n_trials=1)
    (trial,), (result,) = study.trials, results
    assert trial.state.name == ("PRUNED" if is_pruned else "COMPLETE")
    assert trial.intermediate_values == {one.primitives: one.mean_return for one in result.evaluations}
    assert (result.primitives < 1_200) == is_pruned


def test_a_resumed_run_is_pruned_by_all_of_its_evaluations(tmp_path):
    optuna = pytest.importorskip("optuna")
    optuna.logging.set_verbosity(optuna.logging.ERROR)

    class Third(optuna.pruners.BasePruner):
        """Prunes at the third evaluation that it is shown."""

        def prune(self, study, trial):
            return len(trial.intermediate_values) >= 3

    def ask():
        return optuna.create_study(direction="maximize", pruner=Third()).ask()

    def prune(out, trial, *others):
        pruning = OptunaPruning(trial)
        return run(out=tmp_path / out, callbacks=[pruning, *others]), pruning

    whole, pruned = prune("whole", ask())
    assert pruned.is_pruned and len(whole.evaluations) == 3
    first, pruned = prune("cut", ask(), Notes(last=2))
    assert not pruned.is_pruned and len(first.evaluations) == 2
    trial = ask()
    resumed, pruned = prune("cut", trial)
    assert pruned.is_pruned and resumed == whole
    reported = trial.study.trials[0].intermediate_values
    assert reported == {one.primitives: one.mean_return for one in whole.evaluations}
    again, pruned = prune("cut", ask())
    assert pruned.is_pruned and again == whole, "nothing more was trained"
