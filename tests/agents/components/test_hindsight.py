"""Hindsight: stored backups against a table by hand, values against exact ones, goals that chance never achieves."""

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.wrappers import TimeLimit

from hrl_escape.agents import load_agent, make_agent, train
from hrl_escape.agents.making import read_structure
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.errors import AgentSettingsError, StepContractError, UnsupportedSpaceError
from tests.agents.goal_envs import BitFlip, Walk
from tests.agents.running import interact, learn
from tests.agents.small_envs import ButtonGrid
from tests.agents.training.test_resuming import flatten

PLAIN = {"gamma": 0.5, "reward_scale": 1.0, "scale_observations": False, "warmup": 10**6}
QUICK = {"n_step": 1, "updates_per_step": 1.0, "learning_rate": 1e-3}


def make(env: gymnasium.Env, seed: int = 0, **settings):
    return make_agent("dqn", env.observation_space, env.action_space, seed, structure=read_structure(env), **settings)


def read_replay(env: gymnasium.Env, primitives: int, **settings) -> list[tuple[float, ...]]:
    """Rows of replay after training: cell, goal, R, b, and next cell and goal where they count; in fifths of a walk."""
    agent = train("dqn", env, primitives=primitives, settings=PLAIN | settings, eval_episodes=0).agent
    rows = agent.replay.take(np.arange(len(agent.replay)))._asdict()
    return [(*np.rint(5 * here).tolist(), float(reward), float(bootstrap),
             *(np.rint(5 * there).tolist() if bootstrap else ()))
            for here, reward, bootstrap, there in zip(*(rows[name] for name in (
                "observation", "reward", "bootstrap", "next_observation")), strict=True)]


# --- relabelling, by hand ------------------------------------------------------------------

ASKED = {1: [(0, 5, -1.0, 0.5, 1, 5), (1, 5, -1.0, 0.5, 2, 5), (2, 5, -1.0, 0.5, 3, 5)],
         2: [(0, 5, -1.5, 0.25, 2, 5), (1, 5, -1.5, 0.25, 3, 5), (2, 5, -1.0, 0.5, 3, 5)]}
IN_HINDSIGHT = {
    1: {(0, 1, 0.0, 0.0), (0, 2, -1.0, 0.5, 1, 2), (0, 3, -1.0, 0.5, 1, 3),
        (1, 2, 0.0, 0.0), (1, 3, -1.0, 0.5, 2, 3), (2, 3, 0.0, 0.0)},
    2: {(0, 1, 0.0, 0.0), (0, 2, -1.0, 0.0), (0, 3, -1.5, 0.25, 2, 3),
        (1, 2, 0.0, 0.0), (1, 3, -1.0, 0.0), (2, 3, 0.0, 0.0)},
}


@pytest.mark.parametrize("n_step", [1, 2])
def test_an_episode_is_stored_as_asked_and_under_goals_it_achieved_later(n_step: int):
    rows = read_replay(Walk(5, horizon=3), 3, n_step=n_step, hindsight_goals=300)
    assert rows[:3] == ASKED[n_step] and len(rows) == 3 + 3 * 300
    assert set(rows[3:]) == IN_HINDSIGHT[n_step]
    drawn = [sum(row[:2] == (0, goal) for row in rows[3:]) for goal in (1, 2, 3)]
    assert min(drawn) > 70, "goals are drawn uniformly from what the episode achieves from there on"


def test_an_episode_that_is_not_over_is_stored_as_asked_alone():
    assert read_replay(Walk(5, horizon=4), 3, n_step=1, hindsight_goals=4) == ASKED[1]


def test_episodes_are_kept_apart():
    rows = read_replay(Walk(5, horizon=1), 3, n_step=2, hindsight_goals=2)
    assert rows == 3 * [(0, 5, -1.0, 0.5, 1, 5), *2 * [(0, 1, 0.0, 0.0)]]


class Continuing(Walk):
    """Achieving a goal ends nothing."""

    def compute_terminated(self, achieved_goal, desired_goal, info):
        return False


def test_where_achieving_ends_nothing_backups_go_on_and_other_ends_stay():
    rows = set(read_replay(Continuing(5, horizon=9, pit=3), 3, n_step=2, hindsight_goals=300)[3:])
    assert rows == {(0, 1, -0.5, 0.25, 2, 1), (0, 2, -1.0, 0.25, 2, 2), (0, 3, -1.5, 0.25, 2, 3),
                    (1, 2, -0.5, 0.0), (1, 3, -1.0, 0.0), (2, 3, 0.0, 0.0)}


def test_a_time_out_that_counts_as_an_end_does_so_under_every_goal():
    rows = set(read_replay(Continuing(5, horizon=2), 2, n_step=1, hindsight_goals=300, bootstrap_on_truncation=False))
    assert (1, 2, 0.0, 0.0) in rows and (0, 2, -1.0, 0.5, 1, 2) in rows


def test_familiar_outcomes_cost_as_much_under_another_goal():
    env = Walk(5, horizon=3)
    agent = make(env, **PLAIN, n_step=1, hindsight_goals=4, bonus="distillation", bonus_weight=8.0)
    learn(agent, env, 300)
    rows = agent.replay.state_dict()
    costs = []
    for first in range(0, 1500, 15):  # an episode: three decisions as asked, then each with four goals
        asked, relabelled = rows["reward"][first : first + 3], slice(first + 3, first + 15)
        costs += (-1 - asked).tolist()
        cells, goals = np.rint(5 * rows["observation"][relabelled]).astype(int).T
        assert rows["reward"][relabelled] == pytest.approx(asked[cells] + (goals == cells + 1), abs=1e-5)
    assert max(costs) > 1 and min(costs) >= 0, "the bonus is never positive"


def test_networks_see_the_scaled_observation_and_the_scaled_goal():
    env = Walk(5, horizon=3)
    agent = make(env, **PLAIN | {"scale_observations": True}, n_step=1, hindsight_goals=300)
    learn(agent, env, 3)
    seen = {tuple(row.tolist()) for row in np.rint(10 * agent.replay.state_dict()["observation"])}
    assert seen >= {(-10, 10), (-10, -6), (-6, -2)}, "cell and goal from -1 to 1"


def test_no_decision_is_stored_under_a_goal_that_was_achieved_before_it():
    rows = train("dqn", BitFlip(2), primitives=200, settings=PLAIN | {"n_step": 1, "hindsight_goals": 4},
                 eval_episodes=0).agent.replay.state_dict()
    states, goals = np.split(rows["observation"], 2, axis=1)
    assert len(states) > 200 and (states != goals).any(axis=1).all()
    assert (rows["bootstrap"] == 0).any() and (rows["bootstrap"] != 0).any()


# --- learning ------------------------------------------------------------------------------


@pytest.mark.slow
def test_values_of_all_goals_come_out_exact():
    """With d bits wrong after an action, 0 if d = 0, else -(1 - gamma^d) / (1 - gamma)."""
    env, gamma = BitFlip(3), 0.9
    settings = QUICK | {"gamma": gamma, "hindsight_goals": 4}
    agent = train("dqn", env, primitives=3_500, settings=settings, eval_episodes=0).agent
    states = [np.array(list(np.binary_repr(n, 3)), np.float32) for n in range(8)]
    for state in states:
        for goal in states:
            wrong = int((state != goal).sum()) + np.where(state == goal, 1, -1)
            if (state == goal).all():
                continue
            exact = -(1 - gamma**wrong) / (1 - gamma)
            values = agent.compute_values({"observation": state, "achieved_goal": state, "desired_goal": goal})
            assert values == pytest.approx(exact, abs=0.3), (state, goal)


@pytest.mark.slow
def test_bits_that_chance_never_sets_right_are_learned_in_hindsight_and_only_so():
    """Andrychowicz et al. (2017), figure 1, in small: 256 goals, episodes of eight flips."""
    reached = {goals: train("dqn", BitFlip(8), primitives=2_500, settings=QUICK | {"hindsight_goals": goals},
                            eval_every=2_500, eval_episodes=50).evaluations[-1].success_rate for goals in (0, 4)}
    assert reached[4] >= 0.9 and reached[0] <= 0.1


@pytest.mark.slow  # two minutes: pytest -m slow tests/agents/components/test_hindsight.py
def test_fifteen_bits_are_learned_in_hindsight_and_only_so():
    """Where plain DQN fails in the paper's figure 1, which ends at 13 for it."""
    settings = QUICK | {"hidden": (256,), "replay_capacity": 200_000}
    reached = {goals: train("dqn", BitFlip(15), primitives=30_000, settings=settings | {"hindsight_goals": goals},
                            eval_every=30_000, eval_episodes=100).evaluations[-1].success_rate for goals in (0, 4)}
    assert reached[4] >= 0.9 and reached[0] <= 0.05


# --- runs ----------------------------------------------------------------------------------


class Stopping(BitFlip):
    """Ctrl-C is pressed at the n-th step of the process."""

    left = 10**9

    def step(self, action):
        Stopping.left -= 1
        if Stopping.left < 0:
            raise KeyboardInterrupt
        return super().step(action)


@pytest.mark.nightly
def test_a_stopped_run_goes_on_to_the_same_bits_and_its_agent_loads(tmp_path):
    settings = {"hindsight_goals": 4, "warmup": 20, "replay_capacity": 150, "hidden": (8,)}
    ask = {"primitives": 120, "settings": settings, "checkpoint_seconds": 0, "eval_episodes": 2, "eval_every": 60}
    whole = train("dqn", Stopping(4), **ask, out=tmp_path / "whole")
    Stopping.left = 100
    with pytest.raises(KeyboardInterrupt):
        train("dqn", Stopping(4), **ask, out=tmp_path / "stopped")
    Stopping.left = 10**9
    resumed = train("dqn", Stopping(4), **ask, out=tmp_path / "stopped")
    assert resumed.evaluations == whole.evaluations
    assert flatten(resumed.agent.state_dict()) == flatten(whole.agent.state_dict())
    assert flatten(load_agent(tmp_path / "stopped", trust=True).state_dict()) == flatten(whole.agent.state_dict())


def test_an_unfinished_episode_is_part_of_the_state(tmp_path):
    env = BitFlip(6)
    settings = {"hindsight_goals": 4, "warmup": 20, "hidden": (8,)}
    agent, restored = make(env, **settings), make(env, seed=1, **settings)
    last = list(interact(agent, env, 46))[-1]
    assert not (last.terminated or last.truncated)
    save_checkpoint(tmp_path / "agent.npz", agent.state_dict())
    restored.load_state_dict(load_checkpoint(tmp_path / "agent.npz"))
    for each in (agent, restored):
        learn(each, BitFlip(6), 30, seed=3)
    assert flatten(restored.state_dict()) == flatten(agent.state_dict())


def test_goals_are_found_below_wrappers_and_other_agents_do_without():
    env = TimeLimit(BitFlip(3), 2)
    assert len(train("dqn", env, primitives=6, settings={"hindsight_goals": 2}, eval_episodes=0).agent.replay) > 6
    train("ppo", env, primitives=40, settings={"rollout": 16, "batch_size": 8}, eval_episodes=0)


@pytest.mark.parametrize("missing", ["compute_reward", "compute_terminated"])
def test_environments_without_goals_are_refused(missing: str):
    with pytest.raises(AgentSettingsError, match=r"hindsight_goals.*the environment has no goals"):
        make(ButtonGrid(), hindsight_goals=4)
    env = BitFlip(3)
    lacks = type("Lacks", (gymnasium.Wrapper,), {
        "has_wrapper_attr": lambda self, name: name.startswith("compute") and name != missing})(env)
    with pytest.raises(AgentSettingsError, match="compute_reward and compute_terminated"):
        make(lacks, hindsight_goals=4)


class Twice(gymnasium.Wrapper):
    """Every action is two primitives."""

    def step(self, action):
        *step, info = self.env.step(action)
        return (*step, info | {"duration": 2, "rewards": (-1.0, 0.0)})


def test_decisions_of_several_primitives_and_many_environments_are_refused():
    env = Twice(BitFlip(3))
    with pytest.raises(StepContractError, match="ran 2 primitives; hindsight_goals need decisions of one"):
        learn(make(env, hindsight_goals=4), env, 1)
    with pytest.raises(AgentSettingsError, match="0 in many environments at once"):
        make(BitFlip(3), hindsight_goals=4).begin_episodes(2, torch.device("cpu"))


def test_pictures_with_goals_are_refused():
    goal, picture = gymnasium.spaces.Box(0, 1, (1,)), gymnasium.spaces.Box(0, 255, (64, 64, 3), np.uint8)
    space = gymnasium.spaces.Dict({"observation": picture, "achieved_goal": goal, "desired_goal": goal})
    with pytest.raises(UnsupportedSpaceError, match="pictures with goals"):
        make_agent("dqn", space, gymnasium.spaces.Discrete(2), 0)
