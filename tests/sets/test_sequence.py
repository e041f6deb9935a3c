"""Sequences of rooms as one episode: trials in the same room, and the floors of a tower."""

import dataclasses
import json
from collections.abc import Sequence

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents.agent import FixedPolicy
from hrl_escape.agents.algorithms.random import RandomAgent
from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.env_description import describe_env, make_described_env
from hrl_escape.agents.training.evaluation import compute_episode_seed, evaluate, evaluate_trials
from hrl_escape.benchmark.agent_env import make_agent_env as make_view
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.benchmark.statistics import compute_mean_efficiency
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.cues import CuesConfig
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.options.memory import MEMORY_WORDS, DecisionMemory
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.sets.common_spaces import CommonSpacesEnv, join_spaces
from hrl_escape.sets.grammar import find_sets
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.room_sequence import SEQUENCE_HORIZON, RoomSequence, load_rooms, repeat_set
from hrl_escape.sets.sequence import SequenceEnv, compute_room_seed

CONFIG = RoomConfig(
    room=ShapeConfig(width=8, depth=8), robot=RobotConfig(body_radius=0.4, turn_step_deg=30), horizon=120,
    puzzle=ButtonsConfig(count=2, graph=GraphConfig(kind="chain", relabel=False), buttons=Panels(width=1.0)))
ROOMS = InstanceSet("three", CONFIG, [3, 4, 5])
ESCAPE = (0, 1, 2)  # both buttons in order, then the exit
WAY = ("button-1", "button-2", "exit", "button-1", "exit")


def make_env(trials: int) -> SequenceEnv:
    return SequenceEnv(OptionsEnv(ROOMS.make_env(observation="objects"), include_primitives=False), trials)


def test_an_episode_is_so_many_trials_in_one_room_each_from_its_start():
    env = make_env(3)
    first, begun = env.reset(seed=1, options={"instance_index": 2})
    assert begun["trial"] == 0
    ends = []
    for trial in range(3):
        for number, action in enumerate(ESCAPE):
            observation, _, terminated, truncated, info = env.step(action)
            assert info["trial"] == trial and info["trial_ended"] == (number == 2)
            assert env.unwrapped.instance == ROOMS[2]
        ends.append((terminated, truncated))
        assert info["is_success"]
        if trial < 2:
            np.testing.assert_array_equal(observation, first)
            np.testing.assert_array_equal(info["action_mask"], begun["action_mask"])
    assert ends == [(False, False), (False, False), (True, False)]
    assert env.reset(seed=1)[1]["trial"] == 0, "a new episode begins with its first trial"


def test_a_trial_out_of_time_is_no_success_and_the_last_one_truncates():
    env = make_env(2)
    env.reset(seed=1)
    ended = []
    while len(ended) < 2:
        _, _, terminated, truncated, info = env.step(2)  # at the shut exit, for ever
        if info["trial_ended"]:
            ended.append((info["is_success"], terminated, truncated))
    assert ended == [(False, False, False), (False, False, True)]


def test_a_single_room_can_be_tried_several_times():
    room = gymnasium.make("hrl_escape/EscapeRoom-v1", instance=ROOMS[0], disable_env_checker=True)
    env = SequenceEnv(room, 2)
    env.reset(seed=0)
    done = sum(env.step(0)[4]["trial_ended"] for _ in range(2 * CONFIG.horizon))
    assert done == 2


def test_memories_last_through_trials_and_no_further():
    env = DecisionMemory(make_env(2))
    words = len(env.observation_space.words)

    def read(observation):
        rows = len(env.observation_space.rows)
        return observation[: rows * words].reshape(rows, words)[:, -len(MEMORY_WORDS):]

    env.reset(seed=1)
    for action in (1, *ESCAPE):  # the second button too early
        observation, *_, info = env.step(action)
    assert info["trial_ended"]
    failed, _, rank = read(observation).T
    assert failed[:3].tolist() == [0, 1, 0], "with nothing lit the second button fails, as the first trial showed"
    assert rank[:2].tolist() == [1, 0.5], "and this is the order in which they came on"
    assert not read(env.reset(seed=1)[0]).any()
    for action in ESCAPE:
        observation, *_ = env.step(action)
    assert not read(observation)[:, 0].any(), "an escape fails nothing, though the next trial's exit is shut again"


def test_each_trial_is_evaluated_over_all_episodes():
    env = make_env(2)
    agent = RandomAgent(env.observation_space, env.action_space, seed=0)
    seen = []
    first, second = evaluate_trials(agent, env, 4, 2, seed=7, after_episode=lambda: seen.append(env.unwrapped.instance))
    assert len(seen) == 4 and len(first.lengths) == len(second.lengths) == 4
    assert first.lengths != second.lengths, "chance draws anew in the second trial"
    whole = evaluate(agent, env, 4, seed=7)
    np.testing.assert_array_equal(np.add(first.lengths, second.lengths), whole.lengths)
    np.testing.assert_array_equal(second.successes, whole.successes)
    np.testing.assert_allclose(np.add(first.returns, second.returns), whole.returns)


def test_no_trial_is_refused():
    with pytest.raises(ConfigError, match="trials"):
        make_env(0)


# --- towers ------------------------------------------------------------------------------

TOP = InstanceSet("one", dataclasses.replace(CONFIG, puzzle=dataclasses.replace(CONFIG.puzzle, count=1)), [6, 7])
FLOORS = RoomSequence([ROOMS, TOP]).sets


def make_tower(*floors: InstanceSet) -> SequenceEnv:
    envs = [OptionsEnv(rooms.make_env(observation="objects"), include_primitives=False) for rooms in floors]
    common = join_spaces(envs)
    first, *above = (CommonSpacesEnv(env, *common) for env in envs)
    return SequenceEnv(first, then=above)


class Script(FixedPolicy):
    """Actions about these objects, in order, in every episode."""

    def __init__(self, env: SequenceEnv, words: Sequence[str]) -> None:
        about = env.action_space.about
        self._actions, self._next = [about.index(word) for word in words], 0

    def act(self, observation, action_mask):
        del observation, action_mask
        self._next += 1
        return self._actions[(self._next - 1) % len(self._actions)]


def test_an_escape_leads_to_the_next_floor_where_the_primitives_below_count():
    env = make_tower(*FLOORS)
    _, begun = env.reset(seed=5)
    assert begun["trial"] == 0 and env.unwrapped.instance.horizon == SEQUENCE_HORIZON
    script, spent = Script(env, WAY), 0
    for number in range(5):
        assert env.unwrapped.get_state().primitives == spent
        _, _, terminated, truncated, info = env.step(script.act(None, None))
        spent += info["duration"]
        assert info["trial"] == number // 3 and info["trial_ended"] == (number in (2, 4)) and not truncated
        assert terminated == (number == 4)
    assert info["is_success"] and env.unwrapped.get_state().primitives == spent
    assert {room.config.puzzle.count for room in FLOORS} == {1, 2} and info["primitives"] == spent


def test_the_rooms_of_a_tower_follow_from_the_episode_s_seed_alone():
    env = make_tower(*FLOORS)

    def climb(seed: int, *before: str) -> tuple[str, tuple[float, float]]:
        env.reset(seed=seed)
        for action in Script(env, words := [*before, "button-1", "button-2", "exit"])._actions[: len(words)]:
            env.step(action)
        state = env.unwrapped.get_state()
        return env.unwrapped.instance.id, (state.x, state.y)

    first = climb(3)
    assert climb(3) == first == climb(3, "button-2", "exit"), "whatever the way below"
    assert len({climb(seed) for seed in range(8)}) == len(TOP)
    alone = make_tower(*FLOORS).parts[1]
    alone.reset(seed=compute_room_seed(3, 1))
    state = alone.unwrapped.get_state()
    assert (alone.unwrapped.instance.id, (state.x, state.y)) == first and state.primitives == 0


def test_a_floor_without_escape_ends_the_episode_at_the_tower_s_horizon():
    low = [InstanceSet(rooms.name, dataclasses.replace(rooms.config, horizon=60), rooms.seeds) for rooms in FLOORS]
    env = make_tower(*low)
    env.reset(seed=5)
    waste = Script(env, ["button-1", "button-2", "exit"]).act
    ended = False
    while not ended:
        over = env.unwrapped.get_state().primitives
        _, _, terminated, truncated, info = env.step(waste(None, None) if info_of(env) == 0 else 0)
        ended = terminated or truncated
    assert (terminated, truncated, info["trial"], info["is_success"]) == (False, True, 1, False)
    assert over < 60 == env.unwrapped.get_state().primitives, "on both floors together"


def info_of(env: SequenceEnv) -> int:
    """Floor that the robot is on."""
    return [floor.unwrapped for floor in env.parts].index(env.unwrapped)


def test_every_floor_counts_as_an_episode_and_one_not_come_to_as_a_failure():
    """By hand: who escapes from both floors by the plan has 1 on each; who stops on the second has 1 and 0."""
    env = make_tower(*FLOORS)
    env.reset(seed=compute_episode_seed(0, "evaluation", 0))
    durations = [env.step(action)[4]["duration"] for action in Script(env, WAY)._actions]
    below, above = int(sum(durations[:3])), int(sum(durations[3:]))
    found = evaluate(Script(env, WAY), env, 1, trials=2)
    assert found.lengths == (below, above) and found.successes == (True, True) and found.decision_counts == (3, 2)
    assert found.returns == (100.0 - below, 100.0 - above)
    low = [InstanceSet(rooms.name, dataclasses.replace(rooms.config, horizon=below + 2), rooms.seeds)
           for rooms in FLOORS]
    cut = evaluate(Script(make_tower(*low), WAY), make_tower(*low), 1, trials=2)
    assert cut.lengths == (below, 2) and cut.successes == (True, False) and cut.returns == (100.0 - below, -2.0)
    stuck = evaluate(Script(env, ["button-2", "exit"]), make_tower(*low), 1, trials=2)
    assert stuck.lengths == (below + 2, 0) and stuck.successes == (False, False)
    fewest = (below / 2, above)  # as if the best known way below took half as many
    assert compute_mean_efficiency(found.successes, found.lengths, fewest, False) == 0.75
    assert compute_mean_efficiency(cut.successes, cut.lengths, fewest, False) == 0.25
    assert compute_mean_efficiency(stuck.successes, stuck.lengths, fewest, False) == 0.0


def test_a_tower_is_made_again_from_its_description():
    env = make_tower(*FLOORS)
    env.reset(seed=5)
    again = make_described_env(describe_env(env))
    for action in Script(env, WAY)._actions[:4]:
        env.step(action)
    assert describe_env(env) == describe_env(again), "whatever floor it is on"
    assert evaluate(Script(again, WAY), again, 2, trials=2) == evaluate(Script(env, WAY), env, 2, trials=2)


def test_floors_have_the_same_spaces():
    with pytest.raises(UnsupportedError, match="room 1 of the sequence has other spaces"):
        SequenceEnv(ROOMS.make_env(observation="objects"), then=[TOP.make_env(observation="objects")])
    with pytest.raises(ConfigError, match="where rooms follow"):
        SequenceEnv(ROOMS.make_env(), 2, [ROOMS.make_env()])


# --- towers that repeat one rule ---------------------------------------------------------

RULES = CuesConfig("rank", levels=3, symbols=3, latent_codes=6)
SAME = InstanceSet("same", RoomConfig(
    name="same", room=ShapeConfig(width=7, depth=7), robot=RobotConfig(body_radius=0.3, turn_step_deg=90.0),
    puzzle=ButtonsConfig(count=3, buttons=Panels(width=0.8), cues=RULES)), list(range(40)))


def find_code(room):
    return RULES.find_code(room.puzzle.cues, room.puzzle.edge_list, room.puzzle.goal)


@pytest.mark.nightly
def test_repeated_sets_have_one_latent_code_and_other_rooms():
    tower = repeat_set(SAME, 3)
    assert tower.paired and len({len(floor) for floor in tower.sets}) == 1 and len(tower.sets[0]) > 30
    seeds = np.array([floor.seeds for floor in tower.sets])
    assert all(len(set(rooms)) == 3 for rooms in seeds.T.tolist())
    assert [find_code(room) for room in tower.sets[1]] == [find_code(room) for room in tower.sets[0]]
    assert len({find_code(room) for room in tower.sets[0]}) > 3
    assert load_rooms(json.loads(json.dumps(tower.describe()["content"]))).describe() == tower.describe()
    first, *above = (floor.make_env(options=True, observation="objects") for floor in tower.sets)
    env = make_described_env(json.loads(json.dumps(describe_env(SequenceEnv(first, then=above, paired=True)))))
    for seed in range(3):  # without a schedule, as in training
        env.reset(seed=seed)
        rooms = [env.unwrapped.instance]
        env.env.unwrapped.set_state(env.unwrapped.get_state()._replace(puzzle=7))
        while len(rooms) < 3:
            info = env.step(env.action_space.n - 1)[4]
            if info["trial_ended"]:
                rooms.append(env.unwrapped.instance)
                env.unwrapped.set_state(env.unwrapped.get_state()._replace(puzzle=7))
        assert len({find_code(room) for room in rooms}) == 1 and len({room.id for room in rooms}) == 3


@pytest.mark.nightly
def test_the_ceiling_needs_no_search_on_the_second_floor_and_all_of_it_where_nothing_repeats():
    spec, tower = AgentSpec.parse("bayes"), repeat_set(SAME, 2)
    presses = {}
    for paired in (True, False):
        env, recorder = make_view(spec, RoomSequence(tower.sets, paired), "objects", {str(n): n for n in range(6)})
        player = make_reference("bayes", env, recorder)
        counts = np.zeros(2)
        for seed in range(6):
            observation, info = env.reset(seed=seed)
            done = False
            while not done:
                observation, _, ended, cut, info = env.step(player.act(observation, info["action_mask"]))
                counts[info["trial"]] += 1
                done = ended or cut
        presses[paired] = counts / 6 - 1  # one decision is to leave
    assert presses[True][1] == 3, "three in a chain, whose order the first floor has shown"
    assert presses[True][0] == presses[False][0] > 3.5 and presses[False][1] > 3.5


@pytest.mark.parametrize(("text", "words"), [
    ("cues-1/symbols/test#0..8 x 2", "requires cues with latent codes"),
    ("cues-1/latent-codes/test#0..8 x 1", "2 to 1,000 rooms"),
    ("cues-1/latent-codes/test#0..2 x 5", "needs 5 rooms of one latent code")])
def test_sets_that_cannot_repeat_are_refused(text, words):
    with pytest.raises(ConfigError, match=words):
        find_sets(text)
