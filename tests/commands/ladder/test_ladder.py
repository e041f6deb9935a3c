"""`hrl-escape ladder`: lists, shows and verifies rungs; the maintainers' commands calibrate and freeze them."""

import dataclasses
import json

import pytest

from hrl_escape.benchmark.comparison import read_comparison
from hrl_escape.cli import main
from hrl_escape.env.instance import RoomInstance
from hrl_escape.sets.benchmark import Benchmark, load_benchmark
from hrl_escape.sets.manifest import AxisRecord
from hrl_escape.sets.room_sequence import SEQUENCE_HORIZON
from tests.command_line import call_script
from tests.sets.small import make_config, make_manifest


def call(capsys, *arguments: str):
    code = main(["ladder", *arguments])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


@pytest.mark.nightly
def test_rungs_are_listed(capsys):
    code, out, _ = call(capsys, "list")
    assert code == 0 and all(f"\n{rung.name} " in out for rung in load_benchmark("ladder-1"))
    code, out, _ = call(capsys, "list", "--json")
    assert json.loads(out)["rungs"][0]["sets"] == {"train": 1000, "valid": 100, "test": 100}


@pytest.mark.nightly
def test_a_rung_is_shown_with_a_room_of_it(capsys, tmp_path):
    files = ["--draw", str(tmp_path / "room.svg"), "--save", str(tmp_path / "room.json")]
    code, out, _ = call(capsys, "show", "pair", "--role", "test", "--index", "2", *files)
    rung = load_benchmark("ladder-1")["pair"]
    assert code == 0 and rung.record.test.root in out and (tmp_path / "room.svg").stat().st_size > 1000
    assert RoomInstance.load(tmp_path / "room.json").digest == rung.test[2].digest


@pytest.mark.nightly
def test_a_rung_is_known_by_the_name_that_other_commands_give_it(capsys):
    code, out, _ = call(capsys, "show", "cues-1/colours")
    assert code == 0 and load_benchmark("cues-1")["colours"].record.test.root in out
    code, _, err = call(capsys, "show", "cues-1/colours", "--benchmark", "ladder-1")
    assert code == 2 and "--benchmark does not go with cues-1/colours" in err and err.count("\n") == 1


@pytest.mark.parametrize(("protocol", "option", "value", "suits"), [
    ("per-instance", "--train-sizes", "4", "generalise, transfer, few-shot or sequence"),
    ("generalise", "--trials", "3", "few-shot"), ("few-shot", "--repeats", "2", "sequence")])
def test_an_option_of_other_protocols_is_refused(capsys, protocol, option, value, suits):
    code, _, err = call(capsys, "run", "oracle", "--rung", "pair", "--protocol", protocol, option, value, "--dry-run")
    assert code == 2 and err.count("\n") == 1
    assert f"{option} does nothing with --protocol {protocol}; it is for {suits}" in err


@pytest.mark.nightly
def test_runs_of_each_benchmark_have_a_folder_that_no_other_command_writes_to(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, out, _ = call(capsys, "run", "random-options", "--rung", "doormat", "--dry-run")
    assert "runs/ladder-1/per-instance/doormat" in out
    _, out, _ = call(capsys, "run", "random-options", "--rung", "depth-1", "--benchmark", "ladder-2", "--dry-run")
    assert "runs/ladder-2/per-instance/depth-1" in out
    code, _, err = call(capsys, "report")
    assert code == 2 and "runs/ladder-1/per-instance: no rung was run here" in err
    assert main(["compare", "ladder", "--dry-run"]) == 0 and "runs/ladder-1" not in capsys.readouterr().out


def test_mistakes_are_one_line(capsys):
    code, _, err = call(capsys, "show", "latice")
    assert code == 2 and err.count("\n") == 1 and "did you mean 'lattice'" in err
    code, _, err = call(capsys, "show", "pair", "--role", "test_task", "--draw", "room.svg")
    assert code == 2 and err.count("\n") == 1 and "of which there are 0" in err


def test_a_frozen_manifest_verifies_and_a_changed_one_does_not(capsys, tmp_path):
    path = tmp_path / "mine.json"
    sizes = {"train": {"count": 3}, "valid": {"count": 2}, "test": {"count": 2}}
    path.write_text(json.dumps({"name": "mine", "rungs": [
        {"name": "one", "config": make_config(2, "chain").to_dict(), **sizes}]}))
    assert call_script(capsys, "benchmarks.ladder", "freeze", path)[:2] == (0, f"mine: 1 rungs; wrote {path}\n")
    code, out, _ = call(capsys, "verify", "--benchmark", str(path))
    assert code == 0 and out.startswith("one: train 3 (1 task), valid 2 (1 task), test 2")
    path.write_text(path.read_text().replace('"room": {', '"horizon": 77, "room": {', 1))
    code, _, err = call(capsys, "verify", "--benchmark", str(path))
    assert code == 2 and "mine/one: the root of train is" in err and err.count("\n") == 1


def test_a_room_of_the_small_benchmark_can_be_shown(capsys, tmp_path):
    make_manifest().save(tmp_path / "small.json")
    code, out, _ = call(capsys, "show", "five", "--benchmark", str(tmp_path / "small.json"), "--json")
    assert code == 0 and set(json.loads(out)["sets"]) == {"train", "valid", "test", "test_task"}


def test_a_rung_is_run_goes_on_and_is_reported(capsys, tmp_path):
    options = ["--rung", "doormat", "--protocol", "generalise", "--rooms", "1", "--train-sizes", "1", "--runs", "1",
               "--primitives", "10", "--eval-episodes", "1", "--workers", "1", "--out", str(tmp_path)]
    code, out, err = call(capsys, "run", "random-options", "oracle", *options)
    assert code == 0 and "doormat: 2 runs finished, 0 failed" in out
    assert err.startswith("no agent is trained\n")
    code, out, err = call(capsys, "run", "random-options", "oracle", *options)
    assert code == 0 and "2 of 2 runs were finished before" in err
    assert (tmp_path / "generalise" / "doormat" / "report.html").exists()
    code, out, _ = call(capsys, "report", str(tmp_path), "--protocol", "generalise", "--json")
    told = json.loads(out)
    assert code == 0 and told["highest"] == {"random-options": "none", "oracle": "none"}
    planner = next(row for row in told["rungs"] if row["agent"] == "oracle")
    assert planner["efficiency"]["value"] == 1.0 and planner["success_rate"][0] == 1.0 and not planner["passed"]
    assert all(row["core_hours"] >= 0 for row in told["rungs"])
    assert told["score_rungs"] == ["doormat"] and told["scores"]["oracle"]["value"] == 1.0
    code, _, err = call(capsys, "report", str(tmp_path), "--protocol", "per-instance")
    assert code == 2 and "no rung was run here" in err


@pytest.mark.nightly
def test_a_benchmark_of_one_s_own_is_run_from_its_file(capsys, tmp_path):
    make_manifest().save(tmp_path / "mine.json")
    options = ["--protocol", "per-instance", "--rooms", "1", "--runs", "1", "--primitives", "10", "--eval-episodes",
               "1", "--benchmark", str(tmp_path / "mine.json"), "--out", str(tmp_path / "out"), "--workers", "1"]
    code, out, err = call(capsys, "run", "random", "--rung", "one", *options)
    assert code == 0 and "one: 1 runs finished, 0 failed" in out, err
    (place,) = read_comparison(tmp_path / "out" / "per-instance" / "one").places
    assert place.instance == Benchmark(make_manifest())["one"].test[0] and place.name.endswith("one/test#0")


@pytest.mark.nightly
def test_agents_trained_on_one_rung_are_tested_on_another(capsys, tmp_path):
    options = ["--from", "doormat", "--protocol", "transfer"]
    budget = ["--rung", "pair", "--rooms", "1", "--train-sizes", "1", "--runs", "1", "--primitives", "10",
              "--workers", "1", "--out", str(tmp_path)]
    agents = ["smdp-dqn+objects+memory", "oracle"]
    code, out, err = call(capsys, "run", *agents, *options, *budget)
    assert code == 0 and "pair: 2 runs finished, 0 failed" in out, err
    code, out, _ = call(capsys, "report", str(tmp_path), *options, "--json")
    rows = {row["agent"]: row for row in json.loads(out)["rungs"]}
    assert rows["oracle"]["efficiency"]["value"] == 1.0 and rows["oracle"]["seen"] is None
    assert rows[agents[0]]["rung"] == "pair" and rows[agents[0]]["seen"] is not None
    (place,) = read_comparison(tmp_path / "transfer-from-doormat" / "pair").places
    assert {len(room.targets) for room in place.split.train} == {1}
    assert {len(room.targets) for room in place.split.test} == {2}
    code, _, err = call(capsys, "run", "smdp-dqn", *options, *budget)
    assert code == 2 and "smdp-dqn+objects" in err and err.count("\n") == 1


@pytest.mark.parametrize("option", ["rooms", "primitives", "runs", "eval-episodes"])
@pytest.mark.parametrize("rungs", [["pair"], ["pair", "chain", "--protocol", "sequence"]], ids=len)
def test_no_rooms_runs_primitives_or_episodes_are_refused(capsys, option, rungs):
    code, out, err = call(capsys, "run", "oracle", "--rung", *rungs, f"--{option}", "0", "--dry-run")
    assert code == 2 and out == "" and f"{option.replace('-', '_')} = 0 is not possible" in err


@pytest.mark.nightly
def test_a_benchmark_with_axes_gives_a_profile(capsys, tmp_path):
    axes = (AxisRecord("size", ("one",), "objects"), AxisRecord("depth", ("five",)))
    dataclasses.replace(make_manifest(), axes=axes).save(tmp_path / "mine.json")
    benchmark, out = ["--benchmark", str(tmp_path / "mine.json")], tmp_path / "out"
    code, _, err = call(capsys, "run", "oracle", "--rung", "one", "--rooms", "1", "--runs", "1", "--primitives", "10",
                        "--eval-episodes", "1", "--out", str(out), "--workers", "1", *benchmark)
    assert code == 0, err
    assert read_comparison(out / "per-instance/one").grid.observation == "objects"
    code, told, _ = call(capsys, "report", str(out), *benchmark, "--json")
    assert code == 0 and json.loads(told)["profiles"] == {"oracle": {"size": [1.0]}}
    code, told, _ = call(capsys, "report", str(out), *benchmark)
    assert code == 0 and "1.00 (1.00)" in told and (out / "per-instance/profile.svg").stat().st_size > 5_000


@pytest.mark.nightly
def test_parts_of_a_rung_are_counted_made_apart_and_reported(capsys, tmp_path):
    options = ["run", "random-options", "oracle", "--rung", "doormat", "--rooms", "1", "--runs", "1",
               "--primitives", "10", "--eval-episodes", "1", "--workers", "1", "--out", str(tmp_path)]
    told = call(capsys, *options, "--dry-run")[1]
    assert "doormat: 2 runs, 2 to be made" in told and "no agent is trained" in told
    code, out, _ = call(capsys, *options, "--shard", "2/2")
    assert code == 0 and "doormat: 1 runs finished" in out
    code, out, _ = call(capsys, *options, "--report")
    assert code == 0 and "doormat: 1 runs finished" in out
    assert call(capsys, *options, "--shard", "1/2")[0] == 0
    assert "2 runs, 0 to be made" in call(capsys, *options, "--dry-run")[1]
    code, out, _ = call(capsys, *options, "--report")
    assert code == 0 and "doormat: 2 runs finished" in out
    command = (tmp_path / "per-instance" / "doormat" / "summary.md").read_text()
    assert "hrl-escape ladder run random-options oracle --rung doormat --workers 1 --runs 1" in command
    code, _, err = call(capsys, *options, "--resources", "num_gpus=1")
    assert code == 2 and "with --ray or --slurm" in err and err.count("\n") == 1


@pytest.mark.nightly
def test_trials_in_unseen_rooms_are_scored_one_by_one(capsys, tmp_path):
    agents = ["smdp-dqn+objects+memory", "sweep", "oracle"]
    options = ["run", *agents, "--rung", "pair", "--protocol", "few-shot", "--trials", "3", "--rooms", "1",
               "--train-sizes", "2", "--runs", "1", "--primitives", "10", "--workers", "1", "--out", str(tmp_path)]
    code, out, err = call(capsys, *options)
    assert code == 0 and "pair: 3 runs finished, 0 failed" in out, err
    code, out, _ = call(capsys, "report", str(tmp_path), "--protocol", "few-shot", "--json")
    rows = {row["agent"]: [trial["value"] for trial in row["trials"]] for row in json.loads(out)["rungs"]}
    assert rows["oracle"] == [1.0] * 3 and len(rows[agents[0]]) == 3
    assert 0 < rows[agents[1]][0] < 1 and len(set(rows[agents[1]])) == 1, "what remembers nothing stays as it is"
    out = call(capsys, "report", str(tmp_path), "--protocol", "few-shot")[1]
    assert "trial 3" in out and "Ladder score over pair:" in out
    told = (tmp_path / "few-shot" / "pair" / "summary.md").read_text()
    assert "`oracle` 1.00, 1.00, 1.00" in told
    assert "No memory, so the same policy at every trial" in told
    trials = (tmp_path / "few-shot" / "pair" / "trials.csv").read_text().splitlines()
    assert len(trials) == 1 + 3 * 3 and trials[0].endswith("trial,efficiency,success,length")


@pytest.mark.nightly
def test_a_rung_that_chance_solves_is_told_by_calibration(capsys, tmp_path):
    code, out, _ = call_script(
        capsys, "benchmarks.ladder", "calibrate", "--rung", "doormat", "--rooms", "2", "--workers", "1", "--json",
        "--out", tmp_path, "--agents", "smdp-q-learning", "--primitives", "10", "--eval-episodes", "1")
    told = json.loads(out)
    assert (tmp_path / "per-instance" / "doormat" / "grid.json").exists(), "learned from nothing in each"
    assert 0 <= told["efficiency"]["doormat"]["smdp-q-learning"] <= 1
    assert told["efficiency"]["doormat"]["oracle"] == 1.0
    chance = told["efficiency"]["doormat"]["random-options"]
    assert code == int(chance >= 0.5) == len(told["faults"]["doormat"])


@pytest.mark.nightly
@pytest.mark.parametrize(("agents", "rooms", "trained"), [
    (["random-options", "oracle"], 1, 1),
    pytest.param(["random-options", "smdp-dqn+objects+memory", "oracle"], 2, 3, marks=pytest.mark.slow)])
def test_the_oracle_escapes_a_sequence_of_rooms_and_a_random_policy_does_not(capsys, tmp_path, agents, rooms, trained):
    make_manifest().save(tmp_path / "mine.json")
    options = ["--protocol", "sequence", "--benchmark", str(tmp_path / "mine.json"), "--rooms", str(rooms),
               "--train-sizes", str(trained), "--runs", "1", "--primitives", "10", "--workers", "1", "--out",
               str(tmp_path)]
    code, out, err = call(capsys, "run", *agents, *options)
    assert code == 0 and f"sequence: {len(agents)} runs finished, 0 failed" in out, err
    code, out, _ = call(capsys, "report", str(tmp_path), *options[:4], "--json")
    rows = {row["agent"]: row for row in json.loads(out)["rungs"]}
    planner, chance = rows["oracle"], rows[agents[0]]
    assert code == 0 and planner["rooms"] == planner["rooms_escaped"] == 2 and planner["efficiency"]["value"] == 1.0
    assert chance["efficiency"]["value"] < 0.5
    assert all(0 <= rows[learner]["seen"]["value"] <= 1 for learner in agents[1:-1])
    out = call(capsys, "report", str(tmp_path), *options[:4])[1]
    assert "2.00 of 2" in out and "Ladder score over sequence:" in out
    (place,) = read_comparison(tmp_path / "sequence" / "sequence").places
    assert [len(floor) for floor in place.split.train.sets] == [trained, trained]
    assert len(place.split.test) == 2 * rooms
    assert place.split.room_overlap == 0 and place.instance.horizon == SEQUENCE_HORIZON
    command = (tmp_path / "sequence" / "sequence" / "summary.md").read_text()
    assert (f"hrl-escape ladder run {' '.join(agents)} --rung one five --workers 1 --runs 1 --primitives 10 "
            f"--rooms {rooms} --train-sizes {trained} --protocol sequence") in command


def test_an_impossible_sequence_of_rooms_is_refused_in_one_line(capsys, tmp_path):
    def refuse(*words: str) -> str:
        code, _, err = call(capsys, "run", *words, "--protocol", "sequence", "--out", str(tmp_path))
        assert code == 2 and err.count("\n") == 1
        return err

    assert "two or more" in refuse("oracle", "--rung", "pair")
    assert "each once" in refuse("oracle", "--rung", "pair", "pair")
    assert "has 0 joints and that of ladder-1/reach" in refuse("oracle", "--rung", "pair", "reach")
    assert "follow the numbers of options" in refuse("sweep", "--rung", "doormat", "pair")
    assert "smdp-dqn+objects" in refuse("smdp-dqn", "--rung", "doormat", "pair")
    assert "from 1 to 64" in refuse("oracle", "--rung", "doormat", "clutter", "--rooms", "65")


def test_a_sequence_has_the_rungs_whose_robots_have_the_same_primitives(capsys, tmp_path):
    manifest = make_manifest()
    config = manifest.rungs[0].config
    other = dataclasses.replace(config, robot=dataclasses.replace(config.robot, drive="differential"))
    rungs = (*manifest.rungs, dataclasses.replace(manifest.rungs[0], name="driven", config=other))
    dataclasses.replace(manifest, rungs=rungs).save(tmp_path / "mine.json")
    code, out, _ = call(capsys, "run", "oracle", "--protocol", "sequence", "--dry-run", "--out", str(tmp_path),
                        "--benchmark", str(tmp_path / "mine.json"), "--rooms", "1", "--train-sizes", "1")
    left_out = "Left out of the sequence, because their robots have other primitives: driven\n"
    assert code == 0 and out.startswith(left_out)
    assert "sequence: 10 runs, 10 to be made" in out
