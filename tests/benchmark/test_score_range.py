"""Scales: what is best, reachable and worst from each start."""

from __future__ import annotations

import dataclasses
import itertools
import json
import shutil
import warnings
from collections import OrderedDict
from collections.abc import Sequence

import gymnasium
import pytest
from gymnasium.wrappers import TransformReward

from hrl_escape.agents import Agent, train
from hrl_escape.agents.spec import SWEEP, AgentSpec, OptionsView
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.execution import execute_run
from hrl_escape.benchmark.score_range import CEILING, PLANNER, compute_score_range
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.planning import best_known
from hrl_escape.planning.best_known import best_known_return, find_best_known, find_by_plan
from hrl_escape.planning.planner import RoomPlanner, get_planner
from hrl_escape.planning.route import get_pose
from tests.benchmark.small import SCHEMATIC, change, run_quietly

ROOM = generate(SCHEMATIC, 0)
STATES = [Kinematics(ROOM).make_state(start) for start in ROOM.starts[:3]]
STARTS = [(ROOM, state) for state in STATES]


def run_plan(state) -> float:
    """Return of the planner's way out, stepped through the room's own kinematics."""
    rules, total = Kinematics(ROOM), 0.0
    for primitive in RoomPlanner(ROOM).solve(state).primitives:
        step = rules.step(state, primitive)
        state, total = step.state, total + step.reward
    assert step.terminated
    return total


@pytest.mark.nightly
def test_the_best_known_is_at_least_what_a_plan_really_earns_and_at_most_what_distance_allows(tmp_path):
    score_range = compute_score_range(STARTS, AgentSpec("dqn"), tmp_path)
    assert score_range.worst == -ROOM.horizon and score_range.source == PLANNER
    assert score_range.reachable == score_range.best and score_range.fewest_reachable == score_range.fewest
    for state, best, fewest in zip(STATES, score_range.best, score_range.fewest, strict=True):
        assert run_plan(state) <= best < 100
        assert best == ROOM.reward.exit - fewest, "each primitive costs 1"


def test_options_alone_reach_what_their_best_sequence_earns(tmp_path):
    """All sequences of three of the three options, run in the environment; primitives between them could do better."""
    room = generate(get_preset("paper-two-button"), 0)
    only = AgentSpec("smdp-dqn", options=OptionsView(include_primitives=False))
    env, recorder = make_agent_env(only, room, "state")
    earned = []
    for sequence in itertools.product(range(3), repeat=3):
        env.reset(seed=0)
        total, terminated = 0.0, False
        for action in sequence:
            if not terminated:
                _, reward, terminated, _, _ = env.step(action)
                total += float(reward)
        earned += [total] if terminated else []
    score_range = compute_score_range([(room, recorder.states[0])], only, tmp_path)
    assert score_range.reachable == (max(earned),) and score_range.reachable < score_range.best
    assert score_range.fewest_reachable == (room.reward.exit - max(earned),) > score_range.fewest
    both = compute_score_range([(room, recorder.states[0])], AgentSpec.parse("smdp-dqn+primitives"), tmp_path)
    assert both.reachable == both.best == score_range.best
    noisy = dataclasses.replace(room, dynamics=dataclasses.replace(room.dynamics, noise=0.1))
    expected = compute_score_range([(noisy, recorder.states[0])], only, tmp_path)
    assert expected.is_expected and expected.best[0] < score_range.best[0]
    gap = score_range.best[0] - score_range.reachable[0]
    assert expected.best[0] - expected.reachable[0] == pytest.approx(gap), "the gap is that without noise"


def test_a_puzzle_that_planners_cannot_do_is_measured_by_an_escape_at_once(tmp_path):
    room = generate(get_preset("push-block"), 0)
    start = room, Kinematics(room).make_state(room.starts[0])
    score_range = compute_score_range([start] * 2, AgentSpec("dqn"), tmp_path)
    assert (score_range.source, score_range.best, score_range.worst) == (CEILING, (99.0, 99.0), -room.horizon)


def test_a_room_that_never_opens_in_time_is_measured_so_too(tmp_path):
    short = dataclasses.replace(ROOM, horizon=2)
    assert compute_score_range([(short, STATES[0])], AgentSpec("dqn"), tmp_path).source == CEILING


def test_what_planners_found_is_kept_for_other_runs_and_a_damaged_file_is_made_again(tmp_path):
    found = compute_score_range(STARTS, AgentSpec("dqn"), tmp_path)
    files = sorted(tmp_path.rglob("*.json"))
    assert len(files) == 3 and {path.parent.name for path in files} == {ROOM.id}
    content = json.loads(files[0].read_text())
    files[0].write_text(json.dumps({**content, "ends": [50.0, 51, 40.0, 61]}))
    kept = compute_score_range(STARTS, AgentSpec("dqn"), tmp_path)
    assert (50.0 in kept.best) and (51 in kept.fewest), "read, not computed"
    for damaged in ("{", "[1]", "{}", '{"ends": [1]}', '{"ends": {}}', '{"ends": [1, 2, 3, "x"]}'):
        files[0].write_text(damaged)
        assert compute_score_range(STARTS, AgentSpec("dqn"), tmp_path) == found, damaged


@pytest.mark.nightly
def test_a_run_that_beats_the_best_known_return_raises_it(tmp_path, monkeypatch):
    (finished, result), = run_quietly(change(agents=(SWEEP,), runs=1, primitives=200), tmp_path).runs
    instance, = (RoomInstance.load(path) for path in (tmp_path / "rooms").glob("*.json"))
    states = [Kinematics(instance).make_state(start) for start in instance.starts]
    poor = {(instance.id, get_pose(state), state.puzzle): find_best_known(instance, state)._replace(value=-70.0)
            for state in states}
    monkeypatch.setattr(best_known, "_KNOWN", OrderedDict(poor))
    shutil.rmtree(tmp_path / "references")
    with pytest.warns(UserWarning, match=f"{SWEEP}, seed 0 reached a return of"):
        execute_run(finished, tmp_path, 60.0)
    reached = max(result.evaluations[0].returns)
    assert max(best_known_return(instance, state=state) for state in states) == reached > -70


class Follower(Agent):
    """A plan, followed by what is seen on its way."""

    Settings = AgentSpec
    gamma = 1.0
    observe = load_state_dict = lambda self, _: {}

    def __init__(self, env: gymnasium.Env, primitives: Sequence[int]) -> None:
        self.settings, self._actions = AgentSpec("random"), {}
        seen, _ = env.reset(seed=0)
        for action in primitives:
            self._actions[seen.tobytes()] = action
            seen, *_ = env.step(action)

    def act(self, observation, action_mask):
        return self._actions[observation.tobytes()]

    def act_greedy(self, observation, action_mask, rng):
        return self.act(observation, action_mask)

    def state_dict(self):
        return {}


@pytest.mark.parametrize("wrap", [lambda env: env, lambda env: TransformReward(env, lambda reward: reward + 1)])
def test_training_raises_what_its_agent_has_beaten_but_believes_no_wrappers_reward(monkeypatch, wrap):
    """The plan leg by leg, 64, stands in for all that is known; the agent goes the shorter joint way, 66."""
    env = gymnasium.make("hrl_escape/PaperTwoButton-v1")
    room = env.unwrapped.instance
    state = Kinematics(room).make_state(room.starts[0])
    best, legs = find_best_known(room, state), find_by_plan(get_planner(room), state, jointly=False)
    monkeypatch.setattr(best_known, "_KNOWN", OrderedDict({(room.id, get_pose(state), state.puzzle): legs}))
    agent, wrapped = Follower(env, best.plan.primitives), wrap(env)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        result = train(agent, wrapped, primitives=50, eval_episodes=1)
    raised = best_known_return(room, state=state)
    if wrapped is env:
        assert raised == result.evaluations[0].returns[0] == best.value > legs.value
        assert any("Follower, seed 0 reached a return of 66 " in str(warning.message) for warning in told)
    else:
        assert result.evaluations[0].returns[0] > best.value and raised == legs.value
