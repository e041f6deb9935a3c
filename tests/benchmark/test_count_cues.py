"""The counting baseline learns codes in training rooms, and nothing where cues carry no information."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hrl_escape.agents.spec import COUNT_CUES, AgentSpec
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.references.count_cues import CUE_KINDS, CountCues, CountTable, RoomOrder
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.cues import CuesConfig
from hrl_escape.sets.instance_set import InstanceSet

CUES = CuesConfig("rank", levels=4, symbols=4)
CONFIG = RoomConfig(room=ShapeConfig(width=7, depth=7), robot=RobotConfig(body_radius=0.3, turn_step_deg=90.0),
                    puzzle=ButtonsConfig(count=4, cues=CUES, buttons=Panels(width=0.8)), horizon=300)
TESTED = 4


def make_rooms(cues: CuesConfig, seeds: range) -> InstanceSet:
    puzzle = dataclasses.replace(CONFIG.puzzle, cues=cues)
    return InstanceSet("counted", dataclasses.replace(CONFIG, puzzle=puzzle), list(seeds))


def learn(cues: CuesConfig, rooms: int) -> CountCues:
    env, recorder = make_agent_env(AgentSpec(COUNT_CUES), make_rooms(cues, range(rooms)), "features")
    player = make_reference(COUNT_CUES, env, recorder)
    train(player, env, primitives=90 * rooms, eval_episodes=0, progress=False, observed=False)
    env.close()
    assert isinstance(player, CountCues)
    return player


def count_decisions(trained: CountCues, cues: CuesConfig) -> float:
    """Mean decisions in unseen rooms: five for who knows the order, and the exit."""
    seeds = [compute_episode_seed(0, "evaluation", number) for number in range(TESTED)]
    env, recorder = make_agent_env(AgentSpec(COUNT_CUES), make_rooms(cues, range(500, 500 + TESTED)), "features",
                                   {str(seed): number for number, seed in enumerate(seeds)})
    player = make_reference(COUNT_CUES, env, recorder)
    player.load_state_dict(trained.state_dict())
    found = evaluate(player, env, TESTED)
    env.close()
    assert all(found.successes)
    return float(np.mean(found.decision_counts))


@pytest.mark.nightly
def test_eight_rooms_teach_four_symbols_and_another_code_makes_them_useless():
    trained = learn(CUES, 8)
    assert trained.rooms >= 6
    assert count_decisions(trained, CUES) == 5, "four presses and the exit"
    kinds = CountTable([RoomOrder(*map(tuple, own)) for own in trained.counted["orders"].values()]).kinds
    assert {"symbol", "symbols"} & {CUE_KINDS[kind] for kind in kinds}
    other = dataclasses.replace(CUES, code=next(code for code in range(1, 50) if not (
        dataclasses.replace(CUES, code=code).meanings == CUES.meanings).any()))
    assert count_decisions(trained, other) > 6.5, "a code of another season misleads"


@pytest.mark.nightly
def test_cues_of_another_graph_teach_nothing():
    shuffled = dataclasses.replace(CUES, shuffled=True)
    assert count_decisions(learn(shuffled, 12), shuffled) > 6
