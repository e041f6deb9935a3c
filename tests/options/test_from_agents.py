"""What agents learned, as options: the calls of a hierarchy run as they ran inside the agent, and say where from."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json

import gymnasium
import numpy as np
import pytest

from hrl_escape.agents import StackAgent, load_agent, make_agent, maxq, train
from hrl_escape.agents.agent import make_transition
from hrl_escape.agents.algorithms.q_learning import QLearning
from hrl_escape.agents.algorithms.task_hierarchies.feudal_rl import FeudalRl, Quadtree
from hrl_escape.agents.algorithms.task_hierarchies.h_dqn import HDqn
from hrl_escape.agents.algorithms.task_hierarchies.hamq import Hamq
from hrl_escape.agents.algorithms.task_hierarchies.hdg import Hdg, Landmarks
from hrl_escape.agents.algorithms.task_hierarchies.macro_q import MacroQ
from hrl_escape.agents.algorithms.task_hierarchies.maxq_q import MaxqQ
from hrl_escape.agents.algorithms.task_hierarchies.r_maxq import RMaxq
from hrl_escape.agents.hierarchy.goal_space import GoalSet
from hrl_escape.agents.hierarchy.task import Seen
from hrl_escape.agents.registry import list_agents
from hrl_escape.checks import check_option
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.errors import OptionError, RunMismatchError
from hrl_escape.hierarchies import HierarchyEnv
from hrl_escape.options import LearnedOption, OptionsEnv, make_learned_options
from tests.agents.hierarchy.four_rooms_tasks import make_walks
from tests.agents.hierarchy.taxi_program import drive, read
from tests.agents.hierarchy.taxi_tasks import GRAPH, SEE, UNTIL, make_taxi_tasks
from tests.agents.hierarchy.wall_macros import make_wall_macros
from tests.agents.running import learn
from tests.agents.test_registry import SMALL
from tests.classic.empty_room import GRID as ROOM
from tests.classic.empty_room import EmptyRoom
from tests.classic.four_rooms import GRID, HALLWAYS, FourRooms
from tests.classic.taxi import DEPOTS, Taxi
from tests.covering import thin

ALL = np.ones(4, np.bool_)
GOALS = GoalSet(len(HALLWAYS), lambda observation, goal: observation == HALLWAYS[goal])
FAST = {"learning_rate": 1.0, "epsilon_start": 1.0, "epsilon_end": 1.0, "gamma": 0.9}


def make(agent_class, env, *structure, **settings):
    return agent_class(env.observation_space, env.action_space, 0, agent_class.Settings(**settings), *structure)


def find_cell(observation):
    row, column = GRID.cells[int(observation)]
    return row / 13, column / 13


def make_stack(env):
    settings = QLearning.Settings(**FAST)
    walks = make_walks()
    learners = dict.fromkeys(walks.tasks, lambda views, choices, seed: QLearning(views, choices, seed, settings))
    return StackAgent(dataclasses.replace(walks, learners=learners), env.observation_space, 0)


ROOMS = functools.partial(FourRooms, slip="none", goal=0, horizon=40)
HIERARCHICAL = {
    "maxq-q": (ROOMS, lambda env: make(MaxqQ, env, make_walks(), **FAST)),
    "stack": (ROOMS, make_stack),
    "macro-q": (functools.partial(EmptyRoom, horizon=40), lambda env: make(MacroQ, env, make_wall_macros(), **FAST)),
    "h-dqn": (ROOMS, lambda env: make(HDqn, env, GOALS, values="table", worker_warmup=500, gamma=0.9)),
    "feudal-rl": (ROOMS, lambda env: make(FeudalRl, env, Quadtree(2, find_cell), **FAST)),
}


class FirstAmongEquals(np.random.Generator):
    """Draws the first of equals, so that one and the same policy runs in two episodes."""

    def __init__(self):
        super().__init__(np.random.PCG64(0))

    def integers(self, *_, **__):
        return 0


def replay(agent, env, seed):
    """A greedy episode of a hierarchical agent, as (call of the root, its primitives), by its stack."""
    rng, mask = np.random.default_rng(seed), np.ones(env.action_space.n, np.bool_)
    observation, _ = env.reset(seed=seed)
    calls = []
    while True:
        action = agent.act_greedy(observation, mask, rng)
        _, stack, *_ = agent._evaluation
        if stack[0].decision.duration == 0:
            names = {} if len(stack) == 1 else {told: name for name, told in stack[1].task.list_calls().items()}
            calls.append((names.get(stack[1].context) if names else action, []))
        calls[-1][1].append(action)
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            return calls


@pytest.mark.nightly_for("feudal-rl", "maxq-q")
@pytest.mark.parametrize("name", HIERARCHICAL)
def test_the_calls_of_a_hierarchy_are_options_that_run_as_they_ran_inside_it(name):
    make_env, make_hierarchical = HIERARCHICAL[name]
    env = make_env()
    agent = make_hierarchical(env)
    learn(agent, env, 1_500)
    draw, first = agent.choose_greedy, FirstAmongEquals()
    agent.choose_greedy = lambda stack, view, legal, seen, rng: draw(stack, view, legal, seen, first)
    before = json.dumps(agent.state_dict(), default=repr)
    wrapped = OptionsEnv(make_env(), make_learned_options(agent, 4), trace=True)
    assert len(wrapped.options) == sum(len(task.list_calls()) for task in agent.hierarchy.below)
    compared = 0
    for seed in range(8):
        _, info = wrapped.reset(seed=seed)
        for call, primitives in replay(agent, env, seed):
            index = call if isinstance(call, int) else wrapped.action_names.index(call)
            assert info["action_mask"][index], f"{call} may be called where the agent called it"
            *_, terminated, truncated, info = wrapped.step(index)
            assert [step.action for step in info["trace"]] == primitives, call
            assert (info["option"]["ended"] == "episode-over") <= (terminated or truncated)
            compared += len(primitives)
    assert compared > 20
    assert json.dumps(agent.state_dict(), default=repr) == before, "running its options teaches an agent nothing"


def test_a_call_inside_an_option_runs_to_its_own_end():
    """Nothing is learned here: each turn at a wall is drawn, and none is made on the way."""
    def is_at_wall(direction):
        return lambda seen: ROOM.move(seen.observation, direction) == seen.observation

    walls = {"north": is_at_wall(0), "south": is_at_wall(1)}
    wander = maxq({"root": ["wander"], "wander": list(walls), "north": [0], "south": [1]},
                  walls | {"wander": lambda seen: False})
    env = EmptyRoom(goal=None, horizon=60)
    wrapped = OptionsEnv(env, make_learned_options(StackAgent(wander, env.observation_space, 0), 4), trace=True)
    turns = 0
    for seed in range(3):
        wrapped.reset(seed=seed)
        trace = wrapped.step(wrapped.action_names.index("wander"))[4]["trace"]
        assert len(trace) == 60
        for before, after in itertools.pairwise(trace):
            if before.action != after.action:
                assert walls[("north", "south")[before.action]](Seen(before.next_state, ALL)), "it turns at a wall"
                turns += 1
    assert turns > 3


@functools.cache
def _walk(start, goal):
    """Steps of the shortest way."""
    front, steps, met = {start}, 0, {start}
    while goal not in front:
        front = {there for cell in front for there in GRID.list_neighbours(cell)} - met
        met |= front
        steps += 1
    return steps


@pytest.mark.nightly
def test_walks_learned_in_one_task_are_the_shortest_ways_in_another():
    agent = make_stack(ROOMS())
    learn(agent, ROOMS(), 20_000)
    env = OptionsEnv(FourRooms(None, "none", horizon=40), make_learned_options(agent, 4))
    walked = 0
    for hallway in HALLWAYS:
        index = env.action_names.index(f"to {hallway}")
        for seed in range(12):
            start, info = env.reset(seed=seed)
            assert info["action_mask"][index] == (start not in HALLWAYS)
            reached, *_, info = env.step(index)
            if reached == hallway:
                assert info["option"]["ended"] == "reached" and info["duration"] == _walk(start, hallway)
                walked += 1
    assert walked > 12


@pytest.mark.nightly
def test_the_tasks_of_taxi_keep_the_contract_of_options_and_deeper_calls_run_inside_them():
    env = Taxi()
    agent = make(MaxqQ, env, make_taxi_tasks(), **FAST | {"gamma": 1.0, "epsilon_end": 0.2})
    learn(agent, env, 8_000)
    options = make_learned_options(agent, 6)
    assert [option.name for option in options] == [name for name in GRAPH if name != "root"]
    for option in options[:1] + options[2:4]:
        check_option(option, Taxi(), runs=3)
    wrapped = OptionsEnv(Taxi(), options, include_primitives=False)
    for seed in range(5):
        observation, info = wrapped.reset(seed=seed)
        assert list(info["action_mask"][:2]) == [1, 0], "there is nobody to put down"
        observation, *_ = wrapped.step(0)
        assert read(observation).riding
        _, _, terminated, _, info = wrapped.step(1)
        assert terminated and info["option"]["ended"] in ("reached", "episode-over")


@pytest.fixture(scope="module")
def driver():
    """A program of Taxi, somewhat trained."""
    env = Taxi()
    agent = Hamq(env.observation_space, env.action_space, 0,
                 Hamq.Settings(**FAST | {"gamma": 1.0, "epsilon_end": 0.2}), drive, read=read)
    assert [each.name for each in agent.get_options()] == ["policy"], "nothing is learned yet"
    learn(agent, env, 6_000)
    return agent


@pytest.mark.nightly
def test_the_machines_of_a_program_are_options_named_with_their_callers(driver):
    options = {option.name: option for option in make_learned_options(driver, 6)}
    assert set(options) == {"deliver", "fetch"} | {
        f"{caller} > navigate({depot})" for caller in ("deliver", "fetch") for depot in range(4)}
    wrapped = OptionsEnv(Taxi(horizon=200), list(options.values()), trace=True)
    for seed in range(5):
        observation, info = wrapped.reset(seed=seed)
        place = (read(observation).row, read(observation).column)
        legal = dict(zip(wrapped.action_names, info["action_mask"], strict=True))
        assert legal["fetch"] and not legal["deliver"]
        assert [legal[f"fetch > navigate({depot})"] for depot in range(4)] == [place != depot for depot in DEPOTS]
        observation, *_, info = wrapped.step(wrapped.action_names.index("fetch"))
        assert info["option"]["ended"] == ("reached" if read(observation).riding else "episode-over")


@pytest.mark.nightly
def test_a_program_run_in_parts_is_the_program(driver):
    agent, env = driver, Taxi(horizon=200)
    wrapped = OptionsEnv(Taxi(horizon=200), make_learned_options(agent, 6), trace=True)
    for seed in range(5):
        rng, actions = FirstAmongEquals(), []
        observation, _ = env.reset(seed=seed)
        over = False
        while not over:
            actions.append(agent.act_greedy(observation, np.ones(6, np.bool_), rng))
            observation, _, terminated, truncated, _ = env.step(actions[-1])
            over = terminated or truncated
        wrapped.reset(seed=seed)
        parts, names, over = [], iter(("fetch", "deliver")), False
        while not over:
            _, _, terminated, truncated, info = wrapped.step(wrapped.action_names.index(next(names)))
            parts += [step.action for step in info["trace"]]
            over = terminated or truncated
        assert parts == actions


@pytest.mark.nightly
def test_landmarks_are_options_that_lead_there_by_the_shortest_way():
    near = Landmarks(HALLWAYS, lambda cell: min(range(4), key=lambda number: _walk(cell, HALLWAYS[number])))
    env = FourRooms(None, "none")
    agent = Hdg(env.observation_space, env.action_space, 0,
                Hdg.Settings(epsilon_start=1.0, epsilon_end=1.0, learning_rate=1.0), near, goal=lambda observation: 0)
    cells = [agent.number(cell) for cell in range(len(GRID))]
    for cell, number in enumerate(cells):  # as if it had learned all of them
        for action in range(4):
            there = GRID.move(cell, action)
            if near.region(cell) != near.region(there):
                agent.observe(make_transition(cell, action, ALL, (there, -1.0, False, False, {}), 0.99))
            agent.distances[number, cells, action] = [1 + _walk(there, goal) for goal in range(len(GRID))]
    options = make_learned_options(agent, 4)
    assert all(option.is_markov for option in options) and len(options) == 4
    wrapped = OptionsEnv(FourRooms(None, "none"), options, trace=True)
    for seed in range(10):
        start, info = wrapped.reset(seed=seed)
        for number, hallway in enumerate(HALLWAYS):
            if info["action_mask"][4 + number]:
                wrapped.reset(seed=seed)
                reached, *_, after = wrapped.step(4 + number)
                assert reached == hallway and after["duration"] == _walk(start, hallway)
                agreeing = {index for step in after["trace"] for index, _ in step.consistent}
                assert 4 + number in agreeing, "intra-option learning may use it"


OTHERS = ("option-critic", "a2oc", "dac", "diayn", "ppoc", "hrc")
"""Agents whose options are tested elsewhere: some give options of their own, one wants bits."""


@pytest.mark.parametrize("name", thin([name for name in list_agents() if name not in OTHERS], 3))
def test_any_agent_gives_its_policy(name):
    lake = gymnasium.make("FrozenLake-v1")
    agent = make_agent(name, lake.observation_space, lake.action_space, 0, **SMALL.get(name, {}))
    (option,) = make_learned_options(agent, lake.action_space.n, until=lambda cell: float(cell in (6, 14)),
                                     prefix=f"{name}: ")
    assert option.name == f"{name}: policy"
    env = OptionsEnv(lake, [option], trace=True, max_duration=30)

    def play(seed):
        env.reset(seed=seed)
        *_, info = env.step(4)
        return [step.action for step in info["trace"]], info["trace"][-1].next_state, info["option"]["ended"]

    runs = [play(seed) for seed in range(4)]
    assert runs == [play(seed) for seed in range(4)]
    assert all(last in (6, 14) for _, last, ended in runs if ended == "reached")
    if option.is_markov:
        assert all(step == option.policy(0) for actions, *_ in runs for step in actions[:1])
    else:
        with pytest.raises(OptionError, match="sample_action"):
            option.policy(0)


def test_until_adds_to_an_end_of_ones_own():
    agent = make(RMaxq, ROOMS(), make_walks(), gamma=0.9)
    (plain, *_), (halved, *_) = make_learned_options(agent, 4), make_learned_options(agent, 4, until=lambda cell: 0.5)
    for option in (plain, halved):
        option.start(5)
        option.sample_action(5, np.random.default_rng(0))
    assert (plain.termination(6), halved.termination(6)) == (0.0, 0.5)
    assert plain.termination(HALLWAYS[0]) == halved.termination(HALLWAYS[0]) == 1.0
    (never, *_) = make_learned_options(agent, 4, until=lambda cell: 1.0)
    assert plain.initiation(5) and not never.initiation(5)


def test_a_call_that_begins_nowhere_is_masked():
    agent = make(MaxqQ, Taxi(), maxq(GRAPH, UNTIL, SEE, read=read))
    options = make_learned_options(agent, lambda observation: np.zeros(6, np.bool_))
    assert not any(option.initiation(0) for option in options)


@pytest.mark.parametrize(("agent", "legal", "message"), [
    (3, 4, "no get_options: give a trained agent"),
    (make_agent("random", Taxi().observation_space, Taxi().action_space, 0), "all", "legal is 'all'"),
    (make_agent("random", Taxi().observation_space, Taxi().action_space, 0), 0, "the number of the agent's actions"),
])
def test_what_gives_no_options_is_refused(agent, legal, message):
    with pytest.raises(OptionError, match=message):
        make_learned_options(agent, legal)


@pytest.mark.parametrize("as_option", [
    lambda agent, legal: make_learned_options(agent, legal, until=lambda cell: 1.0)[0],
    lambda agent, legal: LearnedOption("policy", agent, lambda cell: 1.0, legal=legal),
])
@pytest.mark.parametrize(("legal", "said"), [
    (5, "its legal is 5"),
    (lambda cell: np.ones(3, np.bool_), r"its legal gives an array of shape \(3,\)"),
    (lambda cell: True, r"its legal gives an array of shape \(\)"),
])
def test_legal_has_an_entry_for_every_action_of_the_environment(as_option, legal, said):
    lake = gymnasium.make("FrozenLake-v1")
    agent = make_agent("q-learning", lake.observation_space, lake.action_space, 0)
    with pytest.raises(OptionError, match=f"'policy' acts in an environment of 4 actions, and {said}: give that"):
        OptionsEnv(lake, [as_option(agent, legal)]).reset(seed=0)


# --- provenance ---------------------------------------------------------------------------------


def test_options_say_which_run_they_come_from_and_a_run_over_them_keeps_it(tmp_path):
    lake = functools.partial(gymnasium.make, "FrozenLake-v1", is_slippery=False)
    result = train("q-learning", lake(), primitives=500, seed=3, eval_episodes=0, out=tmp_path / "lower")
    (told,) = make_learned_options(result.agent, 4)
    (option,) = make_learned_options(load_agent(tmp_path / "lower"), 4, until=lambda cell: float(cell % 4 == 3))
    key = json.loads((tmp_path / "lower" / "result.json").read_text())["key"]
    assert told.origin == option.origin == {"agent": "q-learning", "run": key, "seed": 3,
                                            "primitives": result.primitives}

    def train_above(each, **arguments):
        return train("smdp-q-learning+primitives", OptionsEnv(lake(), [each]), primitives=200, eval_episodes=0,
                     out=tmp_path / "upper", **arguments)

    train_above(option)
    kept = json.loads((tmp_path / "upper" / "run.json").read_text())
    (described,) = kept["environment"]["wrappers"][-1]["arguments"]["options"]
    assert described["name"] == "policy" and described["origin"] == option.origin
    other = train("q-learning", lake(), primitives=500, seed=4, eval_episodes=0).agent
    with pytest.raises(RunMismatchError):
        train_above(*make_learned_options(other, 4, until=lambda cell: float(cell % 4 == 3)))


def test_what_a_synthesised_hierarchy_learned_is_options_of_the_room():
    room = HierarchyEnv(EscapeRoomEnv("paper-two-button"), "maxq", "planned")
    result = train("maxq-q", room, primitives=300, eval_episodes=1)
    flat = EscapeRoomEnv("paper-two-button")
    env = OptionsEnv(flat, make_learned_options(result.agent, flat.action_space.n, observe=room.observe),
                     include_primitives=False)
    _, info = env.reset(seed=0)
    total, over = 0.0, False
    presses = [name for name in env.action_names if name.startswith("press") or name == "exit"]
    while not over:
        legal = [name for name in presses if info["action_mask"][env.action_names.index(name)]]
        _, reward, terminated, truncated, info = env.step(env.action_names.index(legal[-1]))
        total, over = total + reward, terminated or truncated
    assert total == result.evaluations[-1].mean_return == 64
