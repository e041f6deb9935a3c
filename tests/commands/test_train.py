"""`hrl-escape train` through the command line."""

import json
import re
import signal
import subprocess
import time

import gymnasium
import numpy as np
import pytest

from hrl_escape import OptionsEnv, train
from hrl_escape.agents import load_agent, load_env
from hrl_escape.agents.training.checkpoint import load_checkpoint
from hrl_escape.agents.training.env_description import load_file
from hrl_escape.commands.train import SHOWN_EVALUATIONS
from hrl_escape.errors import TrustError
from tests.command_line import PROGRAM, assert_refused, call, run_program


def test_a_run_leaves_its_description_log_and_checkpoint_and_reports_them(capsys, tmp_path):
    code, out, _ = call(capsys, "train", "smdp-q-learning", "--primitives", "300", "--eval-episodes", "1",
                        "--out", tmp_path / "run", "--json")
    report = json.loads(out)
    assert code == 0 and report["folder"] == str(tmp_path / "run")
    assert report["best_known"] == 66
    first, *_, last = (np.mean(evaluation["returns"]) for evaluation in report["evaluations"])
    code, out, _ = call(capsys, "train", "smdp-q-learning", "--primitives", "300", "--eval-episodes", "1",
                        "--out", tmp_path / "run")  # finished, so it is told and not trained
    assert code == 0 and f"return {last:.1f} at the end" in out and first != last
    shown = [line.split() for line in out.splitlines() if re.match(r" *[\d,]+ +[\d,]+ +-?[\d.]+ ", line)]
    assert [float(row[2]) for row in shown][:: len(shown) - 1] == [round(first, 1), round(last, 1)]
    assert 2 <= len(shown) <= SHOWN_EVALUATIONS + 1
    assert {"run.json", "log.jsonl", "checkpoint.npz"} <= {path.name for path in (tmp_path / "run").iterdir()}


@pytest.mark.nightly
def test_ctrl_c_saves_the_run_and_the_same_command_goes_on_with_it(tmp_path):
    command = [PROGRAM, "train", "smdp-q-learning", "--eval-episodes", "1", "--eval-every", "500", "--out", "run"]
    log = tmp_path / "run" / "log.jsonl"
    begun = subprocess.Popen([*command, "--primitives", "4000"], cwd=tmp_path, text=True, stdout=subprocess.PIPE,
                             stderr=subprocess.PIPE, preexec_fn=heed_ctrl_c)
    while not log.exists() or log.read_bytes().count(b"\n") < 3:
        assert begun.poll() is None
        time.sleep(0.01)
    begun.send_signal(signal.SIGINT)
    error = begun.communicate(timeout=600)[1]
    assert begun.returncode == 130 and error.count("\n") == 1 and "run holds the run" in error
    saved, length = load_checkpoint(tmp_path / "run" / "checkpoint.npz")["primitives"], log.stat().st_size
    assert f"after {saved:,} primitives" in error and 0 < saved < 4000
    head = log.read_bytes()
    done = run_program(*command[1:], "--primitives", "4000", cwd=tmp_path)
    assert done.returncode == 0 and log.read_bytes()[:length] == head, "nothing was trained twice"
    assert f"this run resumed at {saved:,} of 4,000 primitives\n" in done.stdout
    assert "best evaluation: return" in done.stdout and (tmp_path / "run" / "best.npz").exists()


def test_parts_of_a_spec_train_what_settings_train(capsys, tmp_path):
    shared = ["--room", "paper-one-button", "--primitives", "60", "--eval-episodes", "1"]
    options = ["smdp-ppo+memory", "--settings", "network=objects"]
    said = call(capsys, "train", "smdp-ppo+objects+memory", *shared, "--out", tmp_path / "run")[1]
    assert "smdp-ppo+objects+memory, seed 0: " in said
    assert "this run was finished: nothing was trained" in call(capsys, "train", *options, *shared, "--out",
                                                                tmp_path / "run")[1], "both are one run"
    assert_refused(capsys, ["train", "smdp-dqn+reactive", "--option-set", "press-with-ancestors"],
                   "press-reactive, as in smdp-dqn+reactive, or left out")
    assert_refused(capsys, ["train", "dqn+memory"], "smdp-dqn+memory, which chooses among options")
    assert_refused(capsys, ["train", "smdp-dqn+no-primitives"], "it is smdp-dqn now")


def test_a_finished_run_says_that_nothing_was_trained(capsys, tmp_path):
    command = ["train", "random-options", "--primitives", "50", "--eval-episodes", "0", "--out", tmp_path / "run"]
    assert "this run" not in call(capsys, *command)[1]
    written = (tmp_path / "run" / "result.json").read_bytes()
    assert "this run was finished: nothing was trained\n" in call(capsys, *command)[1]
    assert (tmp_path / "run" / "result.json").read_bytes() == written and b"resumed" not in written


def test_an_agent_without_the_hierarchy_that_it_is_made_for_says_what_it_does(capsys, tmp_path):
    command = ["train", "maxq-q", "--primitives", "30", "--eval-episodes", "0", "--out", tmp_path / "flat"]
    code, _, said = call(capsys, *command)
    assert code == 0 and said == ("maxq-q is given no hierarchy: it learns over primitives, as one task. "
                                  "maxq-q+planned and maxq-q+learned give it one\n")
    planned = ["train", "maxq-q+planned", *command[2:-1], tmp_path / "planned"]
    assert call(capsys, *planned)[2] == ""


OPTIONS = """
from hrl_escape.options import FunctionOption

def make(env):
    return [FunctionOption(name, lambda state, push=push: push, lambda state: 0.3)
            for push, name in enumerate(("left", "right"))]
"""


def test_an_environment_from_elsewhere_is_trained_in_resumed_and_loaded(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(OPTIONS)
    command = ["train", "smdp-q-learning", "--env", "CliffWalking-v1", "--options", "mine.py:make", "--seed", "3",
               "--primitives", "300", "--eval-episodes", "0"]
    code, out, _ = call(capsys, *command, "--json")
    folder = json.loads(out)["folder"]
    assert code == 0 and re.fullmatch(r"runs/smdp-q-learning-CliffWalking-v1-3-[0-9a-f]{8}", folder)
    assert "this run was finished: nothing was trained" in call(capsys, *command)[1]
    env = OptionsEnv(gymnasium.make("CliffWalking-v1"), load_file("mine.py").make, include_primitives=False)
    alone = train("smdp-q-learning", env, seed=3, primitives=300, eval_episodes=0, progress=False)
    assert alone.primitives == json.loads(out)["primitives"] and alone.decisions < alone.primitives
    with pytest.raises(TrustError, match="mine.py:make"):
        load_env(folder)
    agent, again = load_agent(folder, trust=True), load_env(folder, trust=True)
    state, mask = again.reset(seed=0)[0], np.ones(2, dtype=bool)
    assert alone.agent is not None and agent.act_greedy(state, mask, np.random.default_rng(0)) == \
        alone.agent.act_greedy(state, mask, np.random.default_rng(0)) and again.get_wrapper_attr("primitive_count") == 0
    for shows in ("watch", "record"):
        assert_refused(capsys, [shows, folder], "only rooms can be shown")
    (tmp_path / "mine.py").write_text(OPTIONS.replace("0.3", "0.5"))
    assert_refused(capsys, [*command, "--out", folder], "files.mine.py")


def test_copies_of_an_environment_from_elsewhere_are_trained_in(capsys, tmp_path):
    code, out, error = call(capsys, "train", "hiro", "--env", "hrl_escape/PointMaze-v1", "--num-envs", "8", "--json",
                            "--primitives", "160", "--eval-episodes", "1", "--out", str(tmp_path / "run"),
                            "--settings", "hidden=[8]", "warmup=50", "window=5")
    assert code == 0, error
    assert json.loads(out)["primitives"] >= 160
    make = tmp_path / "mine.py"
    make.write_text("import gymnasium\n\ndef make():\n    return gymnasium.make('CartPole-v1')\n")
    assert_refused(capsys, ["train", "dqn", "--env", f"{make}:make", "--num-envs", "4"], "need a Gymnasium id")


@pytest.mark.parametrize(("words", "says"), [
    (["dqn", "--env", "CartPole-v1", "--room", "clutter"], "--room does not go with --env"),
    (["dqn", "--env", "nowhere.py:make", "--num-envs", "4"], "nowhere.py"),
    (["dqn", "--env", "CartPole-v1", "--device", "cuda"], "--device does not go with --env"),
    (["smdp-dqn", "--env", "CartPole-v1"], "CartPole-v1 has none: give options="),
    (["maxq-q+planned", "--env", "CartPole-v1"], "needs a room"),
    (["dqn", "--options", "mine.py:make"], "--options is for --env"),
    (["smdp-iql", "--data", "pair-play-v1", "--env", "CartPole-v1"], "--env does not go with --data"),
    (["dqn", "--env", "nowhere.py:make"], "nowhere.py"),
])
def test_what_cannot_be_trained_in_an_environment_is_refused(capsys, words, says):
    assert_refused(capsys, ["train", *words], says)


def test_names_that_cannot_be_trained_are_told_what_to_do_instead(capsys):
    assert_refused(capsys, ["train", "search-nearest"], "hrl-escape watch search-nearest")
    said = call(capsys, "train", "maxq")[2]
    assert "did you mean 'maxq-q'" in said
    known = said.partition("Known: ")[2]
    assert "maxq-q" in known and "hamq" in known and known.endswith(
        "each also with smdp- in front, which chooses among options\n")


def heed_ctrl_c():
    """A shell starts what runs in its background with Ctrl-C ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


SHORT = ["train", "random-options", "--room", "four-button-chain", "--primitives", "50", "--eval-episodes", "0"]


@pytest.mark.nightly_for(
    "changes0-option_set: 'press' there, 'press-with-ancestors' now", "changes1-environment.arguments.instance",
    "changes2-seed: 0 there, 1 now", "changes3-environment.arguments.observation: 'features' there, 'state' now")
@pytest.mark.parametrize(("changes", "field"), [
    (["--option-set", "press-with-ancestors"], "option_set: 'press' there, 'press-with-ancestors' now"),
    (["--room", "four-button-chain#1"], "environment.arguments.instance"),
    (["--seed", "1"], "seed: 0 there, 1 now"),
    (["--observation", "state"], "environment.arguments.observation: 'features' there, 'state' now"),
])
def test_a_folder_that_holds_another_run_is_refused_and_the_default_folder_is_another(
    capsys, tmp_path, monkeypatch, changes, field
):
    monkeypatch.chdir(tmp_path)
    assert call(capsys, *SHORT, "--out", "run")[0] == 0
    code, _, err = call(capsys, *SHORT, *changes, "--out", "run")
    assert code == 2 and field in err and err.count("\n") == 1
    assert call(capsys, *SHORT)[0] == call(capsys, *SHORT, *changes)[0] == call(capsys, *SHORT)[0] == 0
    assert len(list((tmp_path / "runs").iterdir())) == 2


def test_settings_are_listed_with_their_documentation_and_nothing_is_trained(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, _ = call(capsys, "train", "smdp-dqn", "--settings", "gamma=0.5", "--list-settings", "--json")
    settings = json.loads(out)
    assert code == 0 and settings["gamma"]["value"] == 0.5
    assert all(setting["about"] for setting in settings.values())
    code, out, _ = call(capsys, "train", "smdp-dqn", "--settings", "gamma=0.5", "--list-settings")
    first, *rest = (line.split() for line in out.splitlines() if line.strip())
    assert first == ["setting", "value"] and ["gamma", "0.5"] in [line[:2] for line in rest]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("arguments", "words"), [
    (["dqn", "--settings", "gamma"], "--settings = 'gamma' is not possible: name=value is needed"),
    (["dqn", "--threads", "0"], "threads = 0 is not possible"),
    (["smdp-q-learning", "--primitives", "0"], "primitives = 0 is not possible"),
    (["smdp-q-learning", "--eval-every", "0"], "eval_every = 0 is not possible"),
    (["smdp-iql", "--data", "pair-play-v1", "--primitives", "0"], "primitives = 0 is not possible"),
    (["smdp-iql", "--data", "pair-play-v1", "--room", "clutter"], "--room does not go with --data"),
    (["q-learning", "--option-set", "press"],
     "--option-set is for agents that choose among options, such as smdp-q-learning"),
    (["hamq+planned", "--option-set", "press-reactive"],
     "--option-set is for agents that choose among options"),
])
@pytest.mark.nightly_for("arguments4-primitives = 0 is not possible")
def test_a_mistake_is_one_line_and_leaves_no_file(capsys, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, ["train", *arguments], words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("agent", ["ppo", "smdp-ppo"])
def test_a_batch_trains_in_many_rooms_at_once(capsys, tmp_path, agent):
    code, out, _ = call(capsys, "train", agent, "--num-envs", "8", "--room", "paper-one-button", "--primitives", "200",
                        "--eval-episodes", "0", "--settings", "rollout_per_env=4", "rollout=32", "epochs=1", "--out",
                        tmp_path / "run", "--json")
    report = json.loads(out)
    assert code == 0 and report["primitives"] >= 200 and report["segments"] and not report["episodes"]
    assert (report["primitives"] == report["decisions"]) == (agent == "ppo")


def test_what_a_batch_cannot_do_is_refused(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(capsys, ["train", "intra-option-q", "--num-envs", "4"], "many environments at once")
    assert_refused(capsys, ["train", "smdp-ppo+memory", "--num-envs", "4", "--observation", "features"],
                   "observation='objects'")
    assert_refused(capsys, ["train", "ppo", "--compile"], "--compile is for many copies of the room: give --num-envs N")
    assert_refused(capsys, ["train", "ppo", "--device", "cuda"], "--device is for many copies")


@pytest.mark.slow  # compiles two kernels
@pytest.mark.parametrize("agent", ["ppo", "smdp-ppo"])
def test_compiled_copies_learn_the_same(capsys, tmp_path, agent):
    learned = []
    for more in ([], ["--compile"]):
        code, out, _ = call(capsys, "train", agent, "--num-envs", "8", "--room", "paper-one-button", "--primitives",
                            "2000", "--eval-episodes", "0", "--out", tmp_path / f"run{len(more)}", "--json", *more)
        assert code == 0
        learned.append([{name: value for name, value in segment.items() if "second" not in name}
                        for segment in json.loads(out)["segments"]])
    assert learned[0] == learned[1] != []


@pytest.mark.nightly
def test_a_batch_trains_task_hierarchies_and_agents_with_a_memory(capsys, tmp_path):
    for number, arguments in enumerate((["maxq-q+learned"], ["smdp-dqn+objects+memory"])):
        code, out, _ = call(capsys, "train", *arguments, "--num-envs", "4", "--room", "paper-one-button",
                            "--primitives", "60", "--eval-episodes", "1", "--out", tmp_path / str(number), "--json")
        report = json.loads(out)
        assert code == 0 and report["primitives"] >= 60 and len(report["evaluations"]) >= 2
