"""Training: budgets in primitives, honest curves, evaluations that disturb nothing, errors that name the run."""

import hashlib
import json
import os
import subprocess
import sys
import warnings
from pathlib import Path
from typing import ClassVar

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import SyncVectorEnv

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.agents import TensorBoard, evaluate, make_agent, play_episode, train
from hrl_escape.agents.registry import get_agent_class
from hrl_escape.agents.training.checkpoint import compute_state_digest
from hrl_escape.agents.training.results import METRICS
from hrl_escape.agents.training.train import TrainResult
from hrl_escape.errors import (
    AgentSettingsError,
    DivergenceError,
    FileWriteError,
    RunMismatchError,
    StepContractError,
    UnsupportedSpaceError,
)
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.settings import read_record
from tests.agents.small_envs import ButtonGrid, Outcome, SmdpEnv
from tests.agents.training.test_resuming import SMALL, flatten
from tests.forks import run_fork

ROOT = Path(__file__).parents[3]
LEARNERS = ["random", "q-learning", "intra-option-q", "dqn", "sarsa", "ddpg", "ppo", "option-critic", "a2oc", "dac",
            "ppoc", "diayn"]


def run(name="q-learning", env=None, **more):
    env = env or ButtonGrid(trace=True, horizon=40)
    arguments = {"primitives": 300, "seed": 1, "settings": SMALL.get(name, {}), "eval_every": 100, "eval_episodes": 2}
    return train(name, env, **(arguments | more))


# --- what is counted ------------------------------------------------------------------------


def test_trap_6_the_budget_and_every_curve_are_in_primitives_not_decisions():
    always_ten = SmdpEnv([[[Outcome(1.0, 0, (-1.0,) * 10)]]], horizon=50)
    result = run(env=always_ten, primitives=400, eval_every=100)
    assert (result.primitives, result.decisions) == (400, 40)
    assert [e.primitives for e in result.evaluations] == [0, 100, 200, 300, 400]
    assert [e.decisions for e in result.evaluations] == [0, 10, 20, 30, 40]
    assert [r.primitives for r in result.episodes] == list(range(50, 401, 50))
    assert result.curve()[0].tolist() == [0, 100, 200, 300, 400]
    assert result.curve(against="decisions")[0].tolist() == [0, 10, 20, 30, 40]
    assert {r.length for r in result.episodes} == {50}
    assert result.evaluations[-1].decision_counts == (5, 5)
    assert result.evaluations[-1].lengths == (50, 50)


def test_a_budget_of_decisions_ends_a_run_whichever_is_spent_first():
    always_ten = SmdpEnv([[[Outcome(1.0, 0, (-1.0,) * 10)]]], horizon=50)
    by_decisions = run(env=always_ten, primitives=400, decisions=12, eval_every=100)
    assert (by_decisions.primitives, by_decisions.decisions) == (120, 12)
    assert [e.decisions for e in by_decisions.evaluations] == [0, 10, 12]
    assert (by_decisions.episodes[-1].end, by_decisions.episodes[-1].length) == ("budget", 20)
    by_primitives = run(env=always_ten, primitives=400, decisions=41, eval_every=100)
    assert (by_primitives.primitives, by_primitives.decisions) == (400, 40)
    with pytest.raises(AgentSettingsError, match="decisions"):
        run(decisions=0)


def test_trap_6_planner_calls_are_counted(tmp_path):
    result = run("random", out=tmp_path)
    rows = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    chosen = [row["option/choices"] for row in rows if row["kind"] == "episode"]
    options = sum(count for counts in chosen for name, count in counts.items() if int(name[-1]) >= 4)
    assert result.planner_calls == options > 0


def test_returns_are_undiscounted_sums_of_primitive_rewards():
    option = SmdpEnv([[[Outcome(1.0, 0, (-1.0,) * 15 + (99.0,), True)]]])
    result = run(env=option, primitives=16, eval_every=16)
    assert result.episodes[0].episode_return == 84.0
    assert result.evaluations[-1].returns == (84.0, 84.0)
    assert (result.episodes[0].end, result.episodes[0].success) == ("terminated", True)


def test_the_episode_that_the_budget_cuts_is_marked():
    result = run("random", ButtonGrid(with_options=False, horizon=40), primitives=50)
    assert [record.end for record in result.episodes] == ["truncated", "budget"]
    assert result.primitives == 50


def test_is_success_in_info_decides_success():
    class Judged(SmdpEnv):
        def step(self, action):
            *rest, info = super().step(action)
            return *rest, info | {"is_success": False}

    result = run(env=Judged([[[Outcome(1.0, 0, (-1.0,), True)]]]), primitives=3)
    assert not any(record.success for record in result.episodes)
    assert result.evaluations[-1].success_rate == 0


def test_failed_options_and_the_primitives_of_each_are_counted_by_episode(tmp_path):
    class Told(SmdpEnv):
        """Every third decision is an option whose plan failed."""

        def reset(self, **arguments):
            self.decisions = 0
            return super().reset(**arguments)

        def step(self, action):
            *rest, info = super().step(action)
            self.decisions += 1
            ended = "planning-failed" if self.decisions % 3 == 0 else "reached"
            return *rest, info | {"option": {"name": "go", "ended": ended}}

    run(env=Told([[[Outcome(1.0, 0, (-1.0,) * 5)]]], horizon=50), primitives=100, out=tmp_path, eval_episodes=0)
    rows = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [row["option/failures"] for row in rows] == [3, 3]
    assert [row["option/choices"] for row in rows] == [{"go": 10}] * 2
    assert [row["option/primitives"] for row in rows] == [{"go": 50}] * 2


def test_an_evaluation_episode_without_an_end_is_cut_in_primitives():
    class Endless(SmdpEnv):
        def step(self, action):
            assert self.elapsed < 100, "asked on and on"
            return super().step(action)

    endless = Endless([[[Outcome(1.0, 0, (-1.0,) * 5)]]], horizon=10**9)
    agent = make_agent("random", endless.observation_space, endless.action_space, 0)
    found = evaluate(agent, endless, 2, max_primitives=40)
    assert (found.lengths, found.decision_counts, found.successes) == ((40, 40), (8, 8), (False, False))


def test_progress_of_an_episode_is_the_best_on_its_way():
    class Slipping(SmdpEnv):
        def step(self, action):
            *rest, info = super().step(action)
            return *rest, info | {"progress": 0.75 if self.elapsed == 2 else 0.25}

    env = Slipping([[[Outcome(1.0, 0, (-1.0,))]]], horizon=5)
    agent = make_agent("random", env.observation_space, env.action_space, 0)
    assert evaluate(agent, env, 1).progress == (0.75,)


def test_a_logged_metric_is_the_mean_over_the_decisions_that_gave_it(tmp_path):
    class Sometimes(get_agent_class("random")):
        decisions = 0

        def observe(self, transition):
            self.decisions += 1
            return {"loss": float(self.decisions)} if self.decisions % 2 == 0 else {}

    env = SmdpEnv([[[Outcome(1.0, 0, (-1.0,))]]], horizon=4)
    train(Sometimes(env.observation_space, env.action_space, 0), env, primitives=8, out=tmp_path, eval_episodes=0)
    rows = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [row["train/loss"] for row in rows] == [3.0, 7.0]


# --- reproducible ----------------------------------------------------------------------------
# --- reproducible ----------------------------------------------------------------------------


def list_choices(agent, env, seed):
    return [(t.action, t.observation.tobytes()) for t, _ in play_episode(agent, env, seed)]


@pytest.mark.nightly_for("ppoc", "dac", "a2oc", "sarsa", "option-critic", "dqn", "ddpg", "ppo", "diayn")
@pytest.mark.parametrize("name", LEARNERS)
def test_trap_17_evaluating_twice_gives_the_same_bits_and_changes_nothing(name):
    agent = run(name).agent
    before = flatten(agent.state_dict())
    env = ButtonGrid(trace=True, horizon=40)
    assert evaluate(agent, env, 5, seed=7) == evaluate(agent, env, 5, seed=7)
    one, other = ([list_choices(agent, env, seed) for seed in range(5)] for _ in range(2))
    assert one == other
    assert len(set(map(tuple, one))) > 1, "the episodes are not all the same one"
    assert flatten(agent.state_dict()) == before


@pytest.mark.nightly_for("ppoc", "dac", "diayn", "ddpg", "a2oc", "sarsa", "option-critic", "dqn", "ppo")
@pytest.mark.parametrize("name", LEARNERS)
def test_how_often_one_evaluates_does_not_change_what_is_learned(name):
    often, never = run(name, eval_every=20), run(name, eval_episodes=0)
    assert often.episodes == never.episodes
    assert flatten(often.agent.state_dict()) == flatten(never.agent.state_dict())
    assert never.evaluations == ()


def test_evaluation_episodes_are_the_same_for_every_agent_and_training_seed():
    class Recording(ButtonGrid):
        starts = []

        def reset(self, *, seed=None, options=None):
            observation, info = super().reset(seed=seed)
            self.starts.append(tuple(observation))
            return observation, info

    seen = []
    for name, seed in (("q-learning", 0), ("dqn", 3)):
        env = Recording(trace=True, horizon=40)
        env.starts = []
        run(name, seed=seed, eval_env=env, eval_every=300)
        seen.append(env.starts)
    assert seen[0] == seen[1]


def compute_digest():
    """One number of everything that three runs decide."""
    seen = []
    for name in ("dqn", "ppo", "q-learning"):
        result = run(name)
        seen.append((result.episodes, flatten(result.agent.state_dict())))
    texts = [repr(([record.episode_return for record in episodes], state)) for episodes, state in seen]
    return hashlib.sha256("".join(texts).encode()).hexdigest()


@pytest.mark.nightly
def test_the_same_run_gives_the_same_bits_in_another_process():
    code = "from tests.agents.training.test_train import compute_digest; print(compute_digest())"
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == compute_digest()


class CountsThreads(ButtonGrid):
    """Remembers with how many threads it was stepped."""

    seen: ClassVar[set[int]] = set()

    def step(self, action):
        self.seen.add(torch.get_num_threads())
        return super().step(action)


@pytest.mark.nightly
def test_threads_are_a_part_of_the_run_and_those_around_it_are_not(tmp_path):
    before = torch.get_num_threads()
    try:
        keys, digests = [], []
        for around, threads in ((1, 1), (2, 1), (1, 2)):
            torch.set_num_threads(around)
            CountsThreads.seen.clear()
            result = run("dqn", CountsThreads(trace=True, horizon=40), out=tmp_path / str(around) / "{key}",
                         primitives=100, threads=threads)
            assert torch.get_num_threads() == around and CountsThreads.seen == {threads}
            keys.append(result.folder.name)
            digests.append(compute_state_digest(result.agent.state_dict()))
    finally:
        torch.set_num_threads(before)
    assert keys[0] == keys[1] != keys[2] and digests[0] == digests[1]
    with pytest.raises(RunMismatchError, match="threads: 2 there, None now"):
        run("dqn", CountsThreads(trace=True, horizon=40), out=tmp_path / "1" / keys[2], primitives=100)


@pytest.mark.nightly
def test_a_run_ends_with_two_evaluations_in_a_row_that_are_good_enough(tmp_path):
    arguments = {"env": gymnasium.make("CartPole-v1"), "primitives": 2_000, "seed": 2, "settings": {}}
    whole = run(out=tmp_path / "{key}", **arguments)
    ended = run(out=tmp_path / "{key}", **arguments, until_return=32)
    assert whole.folder != ended.folder, "the rule is a part of the run"
    goods = [found.mean_return >= 32 for found in whole.evaluations]
    last = next(number for number in range(1, len(goods)) if goods[number - 1] and goods[number])
    assert goods.index(True) < last - 1 and last < len(goods) - 1, "one alone comes before"
    assert ended.evaluations == whole.evaluations[: last + 1]
    assert ended.episodes == whole.episodes[: len(ended.episodes)]
    assert run(out=tmp_path / "{key}", **arguments, until_return=32) == ended
    with pytest.raises(AgentSettingsError, match="until_return"):
        run(until_return=32, eval_episodes=0)


def test_another_seed_gives_another_run():
    assert run(seed=1).episodes != run(seed=2).episodes


@pytest.mark.nightly
def test_the_global_random_state_is_neither_read_nor_touched():
    import torch

    numpy_before, torch_before = np.random.get_state()[1].copy(), torch.get_rng_state()  # noqa: NPY002  # what is watched
    for name in LEARNERS:
        run(name)
    assert (np.random.get_state()[1] == numpy_before).all()  # noqa: NPY002  # what is watched
    assert (torch.get_rng_state() == torch_before).all()


# --- what it leaves ----------------------------------------------------------------------------


def test_a_result_survives_json():
    result = run("dqn")
    assert read_record(TrainResult, json.loads(json.dumps(result.to_json()))) == result


@pytest.mark.nightly_for("ppoc", "a2oc", "sarsa", "dqn", "ddpg", "dac")
@pytest.mark.parametrize("name", LEARNERS)
def test_every_logged_name_is_explained(tmp_path, name):
    run(name, out=tmp_path)
    logged = set()
    for line in (tmp_path / "log.jsonl").read_text().splitlines():
        logged |= {key for key in json.loads(line) if "/" in key}
    assert logged <= set(METRICS)
    assert {"train/return", "eval/return", "time/seconds"} <= logged


@pytest.mark.nightly_for("sarsa-settings0", "ddpg-settings3", "dqn-settings2")
@pytest.mark.parametrize(("name", "settings"), [
    ("sarsa", {}), ("sarsa", {"replay_capacity": 0, "expected": False}), ("dqn", {}), ("ddpg", {}),
])
def test_the_log_tells_how_actions_are_chosen(tmp_path, name, settings):
    """With epsilon 0 all actions are greedy and a policy of action values has no entropy; with 1 it is uniform."""
    for epsilon in (0.0, 1.0):
        chosen = {"epsilon_start": epsilon, "epsilon_end": epsilon} | settings
        run(name, out=tmp_path / f"{epsilon}", settings=chosen)
        log = map(json.loads, (tmp_path / f"{epsilon}/log.jsonl").read_text().splitlines())
        rows = [row for row in log if row["kind"] == "episode"]
        assert all((row["train/greedy"] == 1) == (epsilon == 0) or row["train/decisions"] < 4 for row in rows)
        assert all(1 <= row["train/longest_repeat"] <= row["train/decisions"] for row in rows)
        if name != "ddpg":
            assert all(row["train/entropy"] == 0 if epsilon == 0 else 1 < row["train/entropy"] < 2 for row in rows)


@pytest.mark.nightly
def test_every_explained_name_is_logged_by_some_agent(tmp_path):
    logged = set()
    for name in (*LEARNERS, "skill-chaining", "hrc", "factored-r-max"):
        run(name, out=tmp_path / name)
    streams = SyncVectorEnv([lambda: ButtonGrid(with_options=False, horizon=20)] * 2)
    run("ppo", streams, out=tmp_path / "streams", eval_env=ButtonGrid(with_options=False, horizon=20))
    for log in tmp_path.glob("*/log.jsonl"):
        for line in log.read_text().splitlines():
            logged |= set(json.loads(line))
    assert set(METRICS) <= logged


def test_tensorboard_files_hold_the_logged_numbers(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    result = run(out=tmp_path, callbacks=[TensorBoard()])
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    points = [(event.step, event.value) for event in events.Scalars("eval/return")]
    assert points == [(e.primitives, pytest.approx(e.mean_return)) for e in result.evaluations]


def test_the_progress_line_ends_with_the_last_evaluation(capsys):
    result = train("q-learning", ButtonGrid(trace=True), primitives=1_750, seed=4, eval_every=250, eval_episodes=2,
                   progress=True)
    before, last = (f"eval {evaluation.mean_return:.1f}" for evaluation in result.evaluations[-2:])
    final = capsys.readouterr().err.rstrip().splitlines()[-1]
    assert last != before and last in final and "1,750/1,750" in final


def test_progress_shows_rate_returns_and_time_left_and_is_silent_by_default(capsys):
    run(progress=None)
    assert capsys.readouterr().err == ""
    run(progress=True, primitives=2_000)
    shown = capsys.readouterr().err
    assert "2,000/2,000" in shown and "/s" in shown and "return" in shown and "eval" in shown and "0:00" in shown


# --- errors ------------------------------------------------------------------------------------


class Unbounded(SmdpEnv):
    """Gives a reward that float32 cannot hold after a while."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        if self.np_random.random() < 0.02:
            reward, info = 1e40, info | {"rewards": (1e40,)}
        return observation, reward, terminated, truncated, info


@pytest.mark.nightly_for("sarsa")
@pytest.mark.filterwarnings("ignore:overflow encountered")
@pytest.mark.parametrize("name", ["dqn", "sarsa", "ddpg", "ppo"])
def test_a_loss_that_is_nan_names_run_and_primitive_and_keeps_the_checkpoint(tmp_path, name):
    env = Unbounded([[[Outcome(1.0, 0, (-1.0,))]] * 2], one_hot=True, horizon=10)
    with pytest.raises(DivergenceError, match=rf"{name}, seed 1, .*run: the loss of {name}.*primitive \d+") as caught:
        run(name, env, primitives=2_000, out=tmp_path / "run", checkpoint_seconds=0)
    assert caught.value.primitives > 0 and (tmp_path / "run" / "run.json").exists()


@pytest.mark.nightly_for("dqn", "sarsa", "ddpg")
@pytest.mark.parametrize("name", ["dqn", "sarsa", "ddpg", "ppo"])
def test_a_learning_rate_that_diverges_is_told_with_loss_and_gradient(tmp_path, name):
    settings = SMALL[name] | {"learning_rate": 10.0, "updates_per_step": 1.0}
    if name == "ppo":
        settings.pop("updates_per_step")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            run(name, primitives=400, settings=settings, out=tmp_path, eval_episodes=0)
            told = [str(warning.message) for warning in caught]
        except DivergenceError as error:
            told = [str(error)]
    words = " ".join(told)
    assert f"{name} diverges: its weights have grown" in words or f"of {name} is no longer" in words, words
    assert "loss is" in words and "the norm of its gradient" in words and "Lower learning_rate" in words
    rows = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert any(row.get("train/gradient_norm", 0.0) > 0 for row in rows)


@pytest.mark.parametrize("name", ["dqn", "sarsa", "ddpg", "ppo"])
def test_an_ordinary_learning_rate_is_not_called_divergent(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(name, primitives=400, settings=SMALL[name], eval_episodes=0)


def test_an_environment_that_offers_no_legal_action_is_named():
    with pytest.raises(StepContractError, match="at least one action must always be legal"):
        run(env=SmdpEnv([[[Outcome(1.0, 1, (-1.0,))]], [[]]]))


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(FileWriteError, match=r"cannot write .*file/run"):
        run(out=tmp_path / "file" / "run")


FULL_DISK = """
import resource, sys
from hrl_escape.agents import train
from hrl_escape.errors import FileWriteError
from tests.agents.small_envs import ButtonGrid
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), -1))
try:
    train("q-learning", ButtonGrid(trace=True, horizon=40), primitives=300, seed=1, eval_every=100, eval_episodes=2,
          out=sys.argv[1], checkpoint_seconds=0)
except FileWriteError as error:
    print(error)
"""


@pytest.mark.nightly_for("1200-checkpoint.npz", "3000-log.jsonl")
@pytest.mark.parametrize(("limit", "file"), [(3_000, "log.jsonl"), (1_200, "checkpoint.npz")])
def test_a_full_disk_is_one_clear_error_and_spoils_nothing(tmp_path, limit, file):
    done = run_fork(FULL_DISK, tmp_path / "run", limit, cwd=ROOT)
    assert f"cannot write {tmp_path}/run/" in done.stdout and "Free some space" in done.stdout, done.stderr
    assert not list((tmp_path / "run").glob(".writing*")), "no half files"
    assert run("q-learning", out=tmp_path / "run") == run("q-learning"), "and the run goes on where there is room"
    assert (tmp_path / "run" / file).exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"primitives": 0}, "primitives = 0"),
        ({"seed": -1}, "seed = -1"),
        ({"eval_every": -5}, "eval_every = -5"),
        ({"eval_every": 0}, "eval_every = 0"),
        ({"env": "CartPole-v1"}, r"an environment, such as gymnasium.make\('CartPole-v1'\)"),
        ({"settings": {"gamma": 2.0}}, "gamma = 2.0"),
        ({"callbacks": [TensorBoard()]}, "give out="),
        ({"callbacks": [print]}, "derived from hrl_escape.agents.Callback"),
    ],
)
def test_impossible_arguments_are_named(arguments, message):
    with pytest.raises(AgentSettingsError, match=message):
        run(**arguments)


# --- learning ----------------------------------------------------------------------------------


@pytest.mark.nightly_for("sarsa", "dqn")
@pytest.mark.parametrize("name", ["q-learning", "dqn", "sarsa"])
def test_agents_over_options_leave_the_button_grid_in_few_primitives(name):
    """The shortest way is 6 + 6 + 18 or so; the random policy over the same options scores -44."""
    result = train(f"smdp-{name}", ButtonGrid(), primitives=6_000, seed=0, eval_every=6_000, eval_episodes=10)
    assert result.evaluations[-1].success_rate == 1
    assert result.evaluations[-1].mean_return > 50


@pytest.mark.nightly
def test_ppo_over_options_leaves_the_button_grid():
    result = train("smdp-ppo", ButtonGrid(), primitives=12_000, seed=0, eval_every=12_000, eval_episodes=10)
    assert result.evaluations[-1].mean_return > 50


@pytest.mark.nightly
def test_pictures_can_be_learned_from():
    class Pictures(gymnasium.ObservationWrapper):
        def __init__(self, env):
            super().__init__(env)
            self.observation_space = gymnasium.spaces.Box(0, 255, (40, 48, 3), np.uint8)

        def observation(self, observation):
            picture = np.zeros((40, 48, 3), np.uint8)
            picture[: 10 + 10 * observation] = 255
            return picture

    for name in ("dqn", "ppo"):
        changes = {"dqn": {"warmup": 20, "batch_size": 4, "replay_capacity": 100}, "ppo": {"rollout": 16}}[name]
        env = Pictures(SmdpEnv([[[Outcome(1.0, 1, (-1.0,))]], [[Outcome(1.0, 0, (1.0,), True)]]]))
        result = train(name, env, primitives=60, settings=changes, eval_every=60, eval_episodes=1)
        assert result.evaluations[-1].returns == (0.0,)


def test_an_agent_object_can_be_trained():
    env = ButtonGrid()
    agent = make_agent("q-learning", env.observation_space, env.action_space, 5)
    assert train(agent, env, primitives=200, seed=1, eval_episodes=1).agent is agent


def test_an_agent_made_for_another_number_of_actions_is_refused_at_the_start():
    """Trained over options and run without them is the usual mistake."""
    flat = gymnasium.make("hrl_escape/PaperTwoButton-v1", disable_env_checker=True)
    grid = ButtonGrid()
    for agent in (make_agent("smdp-q-learning", flat.observation_space, gymnasium.spaces.Discrete(9), 0),
                  get_agent_class("q-learning")(flat.observation_space, action_space=gymnasium.spaces.Discrete(9),
                                                seed=0)):
        for start in (lambda agent=agent: train(agent, flat, primitives=10),
                      lambda agent=agent: evaluate(agent, flat, 1),
                      lambda agent=agent: next(play_episode(agent, flat, 0))):
            with pytest.raises(UnsupportedSpaceError, match="QLearning was made for 9 actions, and the environment"):
                start()
    with pytest.raises(UnsupportedSpaceError, match="was made for 7 actions, and the environment has 6"):
        train(make_agent("q-learning", grid.observation_space, grid.action_space, 0), grid, primitives=10,
              eval_env=flat, eval_episodes=0)


def test_a_hierarchical_agent_without_options_is_told_so():
    flat = gymnasium.make("hrl_escape/PaperTwoButton-v1", disable_env_checker=True)
    with pytest.warns(UserWarning, match=r"random-options chooses options.*give train OptionsEnv\(env\)"):
        train("random-options", flat, primitives=10, eval_episodes=0, progress=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        train("random", flat, primitives=10, eval_episodes=0, progress=False)
        train("random-options+primitives", OptionsEnv(flat), primitives=10, eval_episodes=0, progress=False)
