"""Options whose policy was learned, and runs over options that are written down: training, resuming, identity."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents import load_agent, make_agent, train
from hrl_escape.agents.training.env_description import describe_env
from hrl_escape.agents.training.train import load_env
from hrl_escape.errors import OptionError, RunMismatchError
from hrl_escape.options.domain import OptionDomain
from hrl_escape.options.learned import LearnedOption
from hrl_escape.options.option import FunctionOption, ScriptedOption, TableOption
from hrl_escape.options.options_env import OptionsEnv

LEFT, DOWN, RIGHT, UP = range(4)
SMALL = {"hidden": (8,), "batch_size": 8, "warmup": 20, "updates_per_step": 0.05, "replay_capacity": 200}


def make_lake(**arguments):
    return gymnasium.make("FrozenLake-v1", **{"is_slippery": False} | arguments)


def is_low(cell):
    return float(cell >= 8)


def make_lake_options(env):
    """Named by module, so that a run's folder can make them again."""
    return [FunctionOption("down", go_down, is_low, is_high), ScriptedOption("two-right", [RIGHT] * 2),
            TableOption("round-the-hole", {8: RIGHT, 9: DOWN, 13: RIGHT}, {8: 0.0, 9: 0.0, 13: 0.0})]


def go_down(cell):
    return DOWN


def is_high(cell):
    return cell < 8


# --- policies that were learned -------------------------------------------------------------


@pytest.fixture(scope="module")
def lake_run(tmp_path_factory):
    """A run that learned to cross the ice."""
    folder = tmp_path_factory.mktemp("lake") / "run"
    settings = {"learning_rate": 1.0, "gamma": 0.9, "epsilon_end": 1.0, "epsilon_start": 1.0, "initial_value": 0.0}
    return train("q-learning", make_lake(), primitives=8000, eval_episodes=0, settings=settings, out=folder)


@pytest.mark.nightly
def test_an_agent_from_a_runs_folder_is_an_option(lake_run):
    option = LearnedOption("cross", load_agent(lake_run.folder), lambda cell: float(cell == 14), legal=4)
    env = OptionsEnv(make_lake(), [option], trace=True)
    env.reset(seed=0)
    *_, info = env.step(4)
    cells = [step.next_state for step in info["trace"]]
    assert cells[-1] == 14 and len(cells) == 5, "the shortest way, to the cell before the goal"
    assert info["option"]["ended"] == "reached"
    greedy = [lake_run.agent.act_greedy(cell, np.ones(4, bool), np.random.default_rng(0)) for cell in [0, *cells[:-1]]]
    assert [step.action for step in info["trace"]] == greedy
    assert all(dict(step.consistent)[4] in (0.0, 1.0) for step in info["trace"]), "it is a function of the state"


def test_an_agent_that_draws_draws_from_the_callers_generator():
    agent = make_agent("random", make_lake().observation_space, make_lake().action_space, 0)
    before = agent.state_dict()
    option = LearnedOption("anything", agent, lambda cell: 0.0, is_stochastic=True, legal=4)

    def play(seed):
        env = OptionsEnv(make_lake(), [option], trace=True)
        env.reset(seed=seed)
        return [step.action for step in env.step(4)[4]["trace"]]

    assert play(1) == play(1) and len({tuple(play(seed)) for seed in range(5)}) > 1
    assert agent.state_dict() == before, "the agent's own generator is left alone"


@pytest.mark.nightly
def test_an_agent_is_told_what_is_legal(lake_run):
    option = LearnedOption("cross", lake_run.agent, lambda cell: 1.0,
                           legal=lambda cell: np.array([True, False, False, True]))
    env = OptionsEnv(make_lake(), [option], trace=True)
    env.reset(seed=0)
    assert env.step(4)[4]["trace"][0].action in (LEFT, UP)


def test_an_agent_trained_over_options_is_an_option_above_them():
    lower = OptionsEnv(make_lake(), make_lake_options, include_primitives=False, discount=0.9)
    settings = {"learning_rate": 1.0, "gamma": 0.9, "epsilon_end": 1.0}
    result = train("smdp-q-learning", lower, primitives=2000, eval_episodes=0, settings=settings)
    option = LearnedOption("by-options", result.agent, lambda cell: 0.0, legal=lambda cell: lower.action_masks())
    env = OptionsEnv(lower, [option], discount=0.9, trace=True)
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(3)
    assert reward == 1.0 and terminated
    assert [step.name for step in info["trace"]] == ["down", "round-the-hole", "two-right"]
    assert info["duration"] == 6 and info["discounted_reward"] == pytest.approx(0.9**5)


class Model:
    """As much of a Stable-Baselines3 model as an option asks for."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        assert deterministic
        return np.array(RIGHT), None


def test_a_model_with_predict_is_an_option():
    env = OptionsEnv(make_lake(), [LearnedOption("right", Model(), lambda cell: float(cell % 4 == 3))])
    env.reset(seed=0)
    observation, *_, info = env.step(4)
    assert observation == 3 and info["duration"] == 3


@pytest.mark.slow  # importing it takes longer than all other tests here together
def test_a_model_of_stable_baselines_is_an_option():
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    env = gymnasium.make("CartPole-v1")
    model = stable_baselines3.PPO("MlpPolicy", env, seed=0, device="cpu", n_steps=64)
    option = LearnedOption("balance", model, lambda state: float(abs(state[0]) > 0.05))
    wrapped = OptionsEnv(env, [option], trace=True)
    wrapped.reset(seed=0)
    *_, info = wrapped.step(2)
    assert info["duration"] > 1
    assert all(model.predict(step.state, deterministic=True)[0] == step.action for step in info["trace"])
    other = stable_baselines3.PPO("MlpPolicy", env, seed=1, device="cpu", n_steps=64)
    again, different = (describe_env(OptionsEnv(env, [LearnedOption("balance", each, is_low)]))
                        for each in (model, other))
    assert again != different, "another network is another option"


@pytest.mark.parametrize(("arguments", "message"), [
    ({"policy": 3}, "give a function, an agent with act_greedy, or a model with predict"),
    ({"policy": Model(), "is_stochastic": True}, "torch's global generator"),
    ({"policy": make_agent("random", make_lake().observation_space, make_lake().action_space, 0)}, "legal actions"),
])
def test_impossible_policies_are_refused(arguments, message):
    with pytest.raises(OptionError, match=message):
        LearnedOption("x", **{"termination": is_low} | arguments)


# --- runs over such options -----------------------------------------------------------------


def train_on_lake(folder, env=None, **arguments):
    env = env or OptionsEnv(make_lake(), make_lake_options)
    settings = {"learning_rate": 1.0, "gamma": 0.9}
    return train("smdp-q-learning+primitives", env, out=folder,
                 **{"primitives": 1500, "settings": settings} | arguments)


@pytest.mark.nightly
def test_frozen_lake_is_learned_over_options():
    result = train_on_lake(None, primitives=3000)
    assert result.evaluations[-1].mean_return == 1.0
    assert result.decisions < result.primitives


class Interrupting(OptionDomain):
    """Stops the run at the n-th primitive of its life, as Ctrl-C does."""

    left = 10**9

    def get_state(self, observation):
        Interrupting.left -= 1
        if Interrupting.left < 0:
            raise KeyboardInterrupt
        return super().get_state(observation)


@pytest.mark.nightly
def test_a_run_over_options_resumes_to_the_same_numbers(tmp_path):
    def make():
        return OptionsEnv(make_lake(), make_lake_options, domain=Interrupting)

    def run(name):
        return train_on_lake(tmp_path / name, make(), primitives=400, eval_episodes=1, checkpoint_seconds=0)

    whole = run("whole")
    Interrupting.left = 700
    with pytest.raises(KeyboardInterrupt):
        run("cut")
    Interrupting.left = 10**9
    assert (tmp_path / "cut" / "checkpoint.npz").exists()
    resumed = run("cut")
    assert resumed.episodes == whole.episodes and resumed.decisions == whole.decisions
    assert np.array_equal(resumed.agent.compute_values(0), whole.agent.compute_values(0))


def test_a_deep_agent_balances_cart_pole_by_options(tmp_path):
    """The contract through a network: two options that lean against the fall, beside the primitives."""
    def make():
        return OptionsEnv(gymnasium.make("CartPole-v1", max_episode_steps=60), [
            FunctionOption("catch", lambda s: int(s[2] + 0.3 * s[3] > 0), lambda s: 0.2),
            FunctionOption("right", lambda s: 1, lambda s: float(s[2] < 0), lambda s: s[2] > 0)])

    cut = train("smdp-dqn+primitives", make(), primitives=300, eval_episodes=1, settings=SMALL, out=tmp_path / "run")
    again = train("smdp-dqn+primitives", make(), primitives=300, eval_episodes=1, settings=SMALL, out=tmp_path / "run")
    assert again == cut and cut.decisions < cut.primitives
    observation, info = make().reset(seed=1)
    loaded = load_agent(tmp_path / "run", make())
    assert np.array_equal(loaded.compute_values(observation), cut.agent.compute_values(observation))


# --- identity ------------------------------------------------------------------------------------


def describe(*options, **arguments):
    return describe_env(OptionsEnv(make_lake(), list(options), **arguments))


def test_a_run_names_its_options():
    described = describe(*make_lake_options(None))
    listed = described["wrappers"][-1]["arguments"]["options"]
    assert [option["name"] for option in listed] == ["down", "two-right", "round-the-hole"]
    assert listed[0]["object"] == "hrl_escape.options.option:FunctionOption"
    assert "domain" not in described["wrappers"][-1]["arguments"]


@pytest.mark.parametrize(("one", "other"), [
    (FunctionOption("a", go_down, is_low), FunctionOption("a", lambda cell: RIGHT, is_low)),
    (FunctionOption("a", go_down, is_low), FunctionOption("a", go_down, is_low, is_high)),
    (FunctionOption("a", go_down, lambda cell: 0.1), FunctionOption("a", go_down, lambda cell: 0.2)),
    (FunctionOption("a", go_down, is_low), FunctionOption("a", go_down, is_low, is_stochastic=True)),
    (TableOption("a", [1, 2], [0, 1]), TableOption("a", [1, 3], [0, 1])),
    (TableOption("a", [1, 2], [0, 1]), TableOption("a", [1, 2], [0, 0.5])),
    (ScriptedOption("a", [1, 2]), ScriptedOption("a", [2, 1])),
    (LearnedOption("a", go_down, is_low), LearnedOption("a", go_down, is_low, observe=is_low)),
    (LearnedOption("a", ScriptedOption("x", [1]).policy, is_low), LearnedOption("a", ScriptedOption("x", [2]).policy,
                                                                               is_low)),
], ids=["policy", "initiation", "constant", "stochastic", "table", "termination", "script", "observe", "method"])
def test_options_of_one_name_are_told_apart_by_their_content(one, other):
    assert describe(one) != describe(other)
    assert describe(one) == describe(one)


def test_agents_of_one_name_are_told_apart_by_what_they_learned(lake_run):
    def option(agent):
        return LearnedOption("cross", agent, is_low, legal=4)

    blank = make_agent("q-learning", make_lake().observation_space, make_lake().action_space, 0)
    loaded = load_agent(lake_run.folder)
    assert describe(option(loaded)) == describe(option(load_agent(lake_run.folder))) != describe(option(blank))


def test_a_run_over_other_options_is_refused_and_over_named_ones_made_again(tmp_path):
    train_on_lake(tmp_path / "run", primitives=200, eval_episodes=0)
    with pytest.raises(RunMismatchError, match="environment.wrappers"):
        train_on_lake(tmp_path / "run", OptionsEnv(make_lake(), make_lake_options(None)[:2]), primitives=200,
                      eval_episodes=0)
    env = load_env(tmp_path / "run", trust=True)
    assert env.action_names[4:] == ("down", "two-right", "round-the-hole")
    assert load_agent(tmp_path / "run", trust=True)


def test_the_domain_is_part_of_a_run():
    class Other(OptionDomain):
        pass

    named, other = (describe(*make_lake_options(None), domain=kind) for kind in (OptionDomain, Other))
    assert named != describe(*make_lake_options(None)) and named != other
