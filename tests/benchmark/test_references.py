"""References follow their rule in real rooms, and run through a comparison without training."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from hrl_escape.agents.spec import ORACLE, SWEEP, SWEEP_RANDOM, AgentSpec
from hrl_escape.agents.training.evaluation import Evaluation, evaluate
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.recording import record_episode
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.summary import summarise
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import GridError
from tests.benchmark.small import change, run_quietly

CHAIN = generate(get_preset("four-button-chain"), 0)


def play(name: str, instance: RoomInstance, episodes: int = 2) -> tuple[Evaluation, dict]:
    env, recorder = make_agent_env(AgentSpec(name), instance, "features")
    reference = make_reference(name, env, recorder)
    found = evaluate(reference, env, episodes)
    episode = record_episode(reference, env).to_json()
    env.close()
    return found, episode


def test_index_order_presses_every_button_by_number_then_leaves_and_begins_again():
    _, episode = play(SWEEP, CHAIN)
    names = [name for name, _, _ in episode["decisions"]]
    order = [*(f"press-button-{number}" for number in range(1, len(CHAIN.targets) + 1)), "go-to-exit"]
    assert names[:5] == order
    assert names == [order[number % 5] for number in range(len(names))]


def test_a_shuffled_round_presses_every_button_once_in_an_order_of_the_episode_s_own():
    room = generate(get_preset("ten-button"), 0)
    env, recorder = make_agent_env(AgentSpec(SWEEP_RANDOM), room, "features")
    reference = make_reference(SWEEP_RANDOM, env, recorder)
    buttons, orders = [f"press-button-{number}" for number in range(1, 11)], []
    for seed in (0, 1, 0):
        names = [name for name, _, _ in record_episode(reference, env, seed).decisions]
        order = [*names[:10], "go-to-exit"]
        assert sorted(order[:10]) == sorted(buttons)
        assert names == [order[number % 11] for number in range(len(names))], "round after round the same"
        orders.append(order)
    env.close()
    assert orders[0] == orders[2] != orders[1] and orders[0][:10] != buttons


@pytest.mark.nightly_for("four-button-chain")
@pytest.mark.parametrize("name", ["paper-two-button", "four-button-chain",
                                  pytest.param("ten-button", marks=pytest.mark.slow)])
def test_the_planner_is_as_efficient_as_the_best_known_in_every_episode(name: str, tmp_path: Path):
    instance = generate(get_preset(name), 0)
    found, _ = play(ORACLE, instance, episodes=1)
    env, recorder = make_agent_env(AgentSpec(ORACLE), instance, "features")
    env.reset(seed=0)
    from hrl_escape.benchmark.score_range import compute_score_range

    assert found.lengths == compute_score_range([(instance, recorder.states[0])], AgentSpec(ORACLE), tmp_path).fewest
    assert found.successes == (True,) and found.progress == (1.0,)


@pytest.mark.nightly
def test_the_planner_makes_a_new_plan_where_noise_leads_it_away():
    noisy = dataclasses.replace(CHAIN, dynamics=dataclasses.replace(CHAIN.dynamics, noise=0.1, slip=0.05))
    found, _ = play(ORACLE, noisy, episodes=1)
    assert found.successes == (True,)


@pytest.mark.nightly
def test_references_run_in_a_comparison_without_training(tmp_path: Path):
    comparison = run_quietly(change(agents=(SWEEP, ORACLE, "random-options"), primitives=200), tmp_path)
    assert not comparison.failures
    index_order, planner, chance = summarise(comparison).agents
    assert planner.efficiency.value == 1 and planner.success.value == 1
    assert chance.efficiency.value < index_order.efficiency.value <= 1
    results = {run.agent.name: result for run, result in comparison.runs}
    assert results[ORACLE].primitives == 0 and results["random-options"].primitives >= 200
    starts = {(run.seed, result.score_range.starts) for run, result in comparison.runs}
    assert len(starts) == comparison.grid.runs, "all meet the same episodes"


def test_a_reference_takes_no_settings():
    with pytest.raises(GridError, match="a reference has no settings"):
        AgentSpec(ORACLE, settings={"gamma": 0.5}).resolve_settings()
    assert AgentSpec(ORACLE).resolve_settings() == {}
