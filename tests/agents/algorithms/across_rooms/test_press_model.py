"""The press model learns cues of training rooms, and nothing where there are none."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from gymnasium import spaces

from hrl_escape.agents.algorithms.across_rooms.press_model import PressModel
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.cues import CuesConfig
from hrl_escape.errors import UnsupportedSpaceError
from hrl_escape.sets.instance_set import InstanceSet

SPEC = AgentSpec.parse("smdp-press-model+objects")
CUES = CuesConfig("rank", levels=4, symbols=4)
SHUFFLED = dataclasses.replace(CUES, shuffled=True)
OTHER_CODE = dataclasses.replace(CUES, code=next(
    code for code in range(1, 50) if not (dataclasses.replace(CUES, code=code).meanings == CUES.meanings).any()))
CONFIG = RoomConfig(room=ShapeConfig(width=7, depth=7), robot=RobotConfig(body_radius=0.3, turn_step_deg=90.0),
                    puzzle=ButtonsConfig(count=4, cues=CUES, buttons=Panels(width=0.8)), horizon=300)
TESTED = 6


def make_env(cues: CuesConfig, seeds: range, schedule=None):
    rooms = InstanceSet("pressed", dataclasses.replace(CONFIG, puzzle=dataclasses.replace(CONFIG.puzzle, cues=cues)),
                        list(seeds))
    return make_agent_env(SPEC, rooms, "objects", schedule)[0]


def make_learner(env, seed: int = 0) -> PressModel:
    agent = make_agent(SPEC, env.observation_space, env.action_space, seed)
    assert isinstance(agent, PressModel)
    return agent


@cache
def learn(cues: CuesConfig, rooms: int = 12) -> PressModel:
    env = make_env(cues, range(rooms))
    agent = make_learner(env)
    train(agent, env, primitives=90 * rooms, eval_episodes=0, progress=False, observed=False)
    env.close()
    return agent


def count_decisions(state, cues: CuesConfig) -> float:
    """Mean decisions in unseen rooms: five with a known order, the exit included."""
    seeds = [compute_episode_seed(0, "evaluation", number) for number in range(TESTED)]
    env = make_env(cues, range(500, 500 + TESTED), {str(seed): number for number, seed in enumerate(seeds)})
    agent = make_learner(env)
    if state is not None:
        agent.load_state_dict(state)
    found = evaluate(agent, env, TESTED)
    env.close()
    assert all(found.successes)
    return float(np.mean(found.decision_counts))


def test_a_few_rooms_teach_four_symbols_and_a_checkpoint_keeps_them(tmp_path):
    trained = learn(CUES)
    save_checkpoint(tmp_path / "agent.npz", trained.state_dict())
    assert count_decisions(load_checkpoint(tmp_path / "agent.npz"), CUES) == 5, "four presses and the exit"
    assert count_decisions(None, CUES) > 6, "search in rooms with a code unknown"


@pytest.mark.nightly
def test_a_code_of_another_season_is_no_better_than_search():
    assert count_decisions(learn(CUES).state_dict(), OTHER_CODE) > count_decisions(None, OTHER_CODE) - 1


@pytest.mark.nightly
def test_cues_of_another_graph_teach_nothing():
    assert abs(count_decisions(learn(SHUFFLED).state_dict(), SHUFFLED) - count_decisions(None, SHUFFLED)) < 2


@pytest.mark.nightly
def test_the_same_seed_gives_the_same_numbers():
    env = make_env(CUES, range(12))
    again = make_learner(env)
    train(again, env, primitives=90 * 12, eval_episodes=0, progress=False, observed=False)
    env.close()
    one, other = (agent.learned["tables"]["weights"] for agent in (learn(CUES), again))
    assert all(np.array_equal(one[name], other[name]) for name in one)


def test_directions_do_not_depend_on_the_robot():
    env = make_env(CUES, range(4))
    agent, found = make_learner(env), {}
    for seed in range(16):
        observation, _ = env.reset(seed=seed)
        key, room = agent._describe(agent._look(observation))
        instance = env.unwrapped.instance
        assert tuple(room.symbols) == tuple(instance.puzzle.cues)
        turns = [np.arctan2(target.y, target.x) % (2 * np.pi) * 8 / np.pi for target in instance.targets]
        away = [abs((turn - sector - 0.5 + 8) % 16 - 8) for turn, sector in zip(turns, room.sectors, strict=True)]
        assert max(away) < 3, "the middle is estimated"
        assert found.setdefault(instance.id, key) == key
    env.close()
    assert len(set(found.values())) == len(found) > 1


def test_other_spaces_are_refused_with_the_spec_that_works():
    with pytest.raises(UnsupportedSpaceError, match=r"smdp-press-model\+objects"):
        make_agent("press-model", spaces.Box(-1, 1, (4,)), spaces.Discrete(2), 0)
