"""Hierarchies made from rooms: what they reach at once, what they learn exactly, and what they refuse."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from benchmarks.optima import compute_price
from hrl_escape.agents.algorithms.task_hierarchies.feudal_rl import DIRECTIONS
from hrl_escape.agents.hierarchy.machine import Do, MachineRun
from hrl_escape.agents.hierarchy.task import Seen
from hrl_escape.agents.hierarchy_kinds import LOW_LEVELS, list_privileges
from hrl_escape.agents.making import make_agent
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.agents.training.train import load_agent, load_env, train
from hrl_escape.checks import check_hierarchy
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import AgentSettingsError, ConfigError, UnknownNameError, UnsupportedError
from hrl_escape.hierarchies import HierarchyEnv, HierarchyVectorEnv, synthesise
from hrl_escape.hierarchies.situation import Situations
from hrl_escape.planning import best_known_return
from hrl_escape.planning.goals import PressGoal
from tests.covering import cover
from tests.hierarchies.tiny import TINY, enumerate_tiny

AGENTS = {"maxq": "maxq-q", "ham": "hamq", "landmarks": "h-dqn", "feudal": "feudal-rl"}
SETTINGS = {"landmarks": {"values": "table"}}


def make_env(config="paper-two-button", kind="maxq", low_level="planned", **arguments):
    return HierarchyEnv(EscapeRoomEnv(config), kind, low_level, **arguments)


@pytest.mark.nightly_for("ham-four-button-chain", "landmarks-paper-two-button")
@pytest.mark.parametrize(("kind", "preset"), cover(["maxq", "ham", "landmarks"],
                                                   ["paper-two-button", "four-button-chain"]))
def test_with_planned_leaves_an_agent_is_near_the_best_known_after_a_few_episodes(kind, preset):
    env = make_env(preset, kind)
    result = train(AGENTS[kind], env, primitives=500, eval_episodes=1, eval_every=500, progress=False,
                   settings=SETTINGS.get(kind))
    best = best_known_return(generate(get_preset(preset), 0))
    assert result.evaluations[-1].success_rate == 1.0
    assert result.evaluations[-1].mean_return >= best - 0.1 * (best + 1000), "within a tenth of the whole range"


@pytest.mark.nightly_for("landmarks", "maxq", "ham")
@pytest.mark.parametrize("kind", ["maxq", "ham", "landmarks"])
def test_where_presses_can_be_undone_no_task_undoes_them(kind):
    """Bits can be cleared as well as set, and nothing that opens the exit needs one cleared."""
    env = make_env("bit-flip", kind)
    result = train(AGENTS[kind], env, seed=1, primitives=300, eval_episodes=1, eval_every=300, progress=False,
                   settings=SETTINGS.get(kind))
    best = best_known_return(env.unwrapped.instance)
    assert best - 10 <= result.evaluations[0].mean_return <= best, "before training"


@pytest.mark.parametrize(("preset", "differs"), [("paper-two-button", False), ("clutter", True)])
def test_a_pose_tells_of_the_open_exit_only_where_it_has_a_door(preset, differs):
    room = generate(get_preset(preset), 0)
    assert bool(room.door) == differs
    rooms = Situations(room)
    state = rooms.planner.rules.make_state(room.starts[0])
    solved = state._replace(puzzle=rooms.planner.orders.solved_puzzle)
    shut, opened = (Seen(None, np.ones(0, np.bool_), rooms.read(rooms.pack(each))) for each in (state, solved))
    assert opened.state.is_open and not shut.state.is_open
    assert (rooms.see_pose(shut) != rooms.see_pose(opened)) == differs


@pytest.mark.nightly_for("True-planned", "True-learned", "False-planned")
@pytest.mark.parametrize("low_level", LOW_LEVELS)
@pytest.mark.parametrize("abstract", [True, False])
def test_a_synthesised_task_graph_keeps_every_promise(low_level, abstract):
    check_hierarchy(synthesise(generate(TINY, 0), "maxq", low_level, abstract=abstract),
                    make_env(TINY, low_level=low_level), primitives=200)


@pytest.mark.nightly_for("landmarks-planned", "feudal-planned", "feudal-learned")
@pytest.mark.parametrize("low_level", LOW_LEVELS)
@pytest.mark.parametrize("kind", ["landmarks", "feudal"])
def test_goals_and_cells_keep_every_promise(kind, low_level):
    env = make_env(TINY, kind, low_level)
    agent = make_agent(AGENTS[kind], env.observation_space, env.action_space, 0, structure=env.structure,
                       **SETTINGS.get(kind, {}))
    assert agent.hierarchy.source == "synthesised"
    assert set(agent.privileges) <= set(list_privileges(AGENTS[kind], low_level))
    check_hierarchy(agent.hierarchy, env, primitives=200)


def test_a_pose_that_is_packed_is_read_again():
    rooms = Situations(generate(get_preset("arm-two-button"), 0))
    state = rooms.planner.rules.make_state(rooms.instance.starts[0])._replace(
        heading_steps=3, heading_offset=0.05, joint_steps=(1, -2, 3), joint_offsets=(0.0, 0.02, -0.01), touching=2)
    read = rooms.read(rooms.pack(state)).state
    assert read == state._replace(puzzle=read.puzzle) and (read.primitives, read.noise_key) == (0, 0)


def test_what_is_observed_lies_in_the_space_for_one_room_and_for_many():
    for env in (make_env(TINY), HierarchyVectorEnv(EscapeRoomVectorEnv(2, TINY))):
        observation, _ = env.reset(seed=0)
        assert env.observation_space.contains(observation)
        observation, *_ = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation)


def test_a_task_graph_has_the_planner_s_privilege_where_its_leaves_are_planned():
    graphs = {low_level: synthesise(generate(TINY, 0), "maxq", low_level) for low_level in LOW_LEVELS}
    assert {low_level: "planner" in graph.privileges for low_level, graph in graphs.items()} == {
        "planned": True, "learned": False}


@pytest.mark.parametrize(("mode", "fits"), [("NextStep", True), ("Disabled", True), ("SameStep", False)])
def test_many_rooms_begin_anew_in_a_step_of_their_own(mode, fits):
    rooms = EscapeRoomVectorEnv(2, TINY, autoreset_mode=mode)
    if fits:
        assert HierarchyVectorEnv(rooms).num_envs == 2
    else:
        with pytest.raises(ConfigError, match="autoreset_mode"):
            HierarchyVectorEnv(rooms)
    with pytest.raises(UnsupportedError, match="one room, and these are 2"):
        HierarchyVectorEnv(EscapeRoomVectorEnv(2, TINY, num_instances=2, autoreset_mode=mode))


def test_landmarks_open_in_the_order_that_the_puzzle_forces():
    env = HierarchyEnv(EscapeRoomEnv("four-button-chain"), "landmarks")
    goals = env.structure["goals"]
    assert goals.names[-1] == "exit" and len(goals.names) == 5
    observation, _ = env.reset(seed=0)
    opened = []
    for _ in range(5):
        legal = [goal for goal in range(goals.count) if goals.is_open(observation, goal)]
        assert len(legal) == 1, "a chain has one next landmark"
        opened.append(goals.names[legal[0]])
        over = False
        while not over and not goals.reached(observation, legal[0]):
            observation, _, over, *_ = env.step(goals.policy(observation, legal[0]))
    assert over and opened[-1] == "exit" and len(set(opened)) == 5


@pytest.mark.nightly
def test_feudal_managers_are_paid_for_pressing_and_find_their_way_by_regions():
    env = make_env("paper-two-button", "feudal", "planned")
    agent = train("feudal-rl", env, primitives=3_000, eval_episodes=0, progress=False).agent
    assert evaluate(agent, env, 1, 0).success_rate == 1.0
    tree = env.structure["tree"]
    observation, _ = env.reset(seed=0)
    instance = env.unwrapped.instance
    for number, target in enumerate(instance.targets):
        before = observation
        while not env.unwrapped.get_state().touching >> number & 1:
            action = env._situations.plan_first(env._situations.read(observation), PressGoal(number))
            observation, *_ = env.step(action)
        assert tree.has_found(before, observation), target.name
        assert not tree.has_found(observation, observation)


def test_a_planned_order_leads_into_the_cell_that_it_names():
    """From quarter to quarter, wherever there is one: north is a row less, east a column more."""
    env = make_env("paper-two-button", "feudal", "planned")
    tree, seen = env.structure["tree"], set()
    observation, _ = env.reset(seed=0)
    for order in (0, 2, 1, 3, 0, 3, 1, 2):
        cell = tree.find_cell(observation, tree.depth)
        if not tree.has_neighbour(cell, tree.depth, order):
            continue
        for _ in range(40):
            observation, _, terminated, *_ = env.step(tree.policy(observation, cell, order))
            if terminated or tree.find_cell(observation, tree.depth) != cell:
                break
        there = tree.find_cell(observation, tree.depth)
        assert there == tuple(np.add(cell, DIRECTIONS[order]))
        seen.add((cell, order))
    assert {order for _, order in seen} == {0, 1, 2, 3}
    state = env.unwrapped.get_state()
    assert tree.find_cell(observation, 1) == (int(state.y <= 0), int(state.x >= 0)), "rows from the north"


@pytest.mark.parametrize("low_level", LOW_LEVELS)
def test_a_synthesised_program_always_has_a_legal_primitive(low_level):
    env = make_env(TINY, "ham", low_level)
    program, rng, mask = synthesise(generate(TINY, 0), "ham", low_level), np.random.default_rng(0), np.ones(6, bool)
    read = env.structure["read"]
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        run, is_over = MachineRun(program), False
        run.tell(Seen(observation, mask, read(observation)))
        while not is_over:
            while not isinstance(run.request, Do):
                run.tell(int(rng.integers(len(run.request.things))))
            observation, _, terminated, truncated, _ = env.step(run.request.primitive)
            is_over = terminated or truncated
            if not is_over:
                run.tell(Seen(observation, mask, read(observation)))
        assert terminated or low_level == "learned"


def test_the_calls_of_a_program_know_their_places():
    env = make_env("paper-two-button", "ham")
    agent = make_agent("hamq", env.observation_space, env.action_space, 0, structure=env.structure)
    observation, _ = env.reset(seed=0)
    agent.act(observation, np.ones(env.action_space.n, bool))
    root, *calls = agent.list_calls()
    target = env.unwrapped.instance.targets[0]
    assert root.place is None and [call.task for call in calls] == ["apply", "touch", "step"]
    assert {call.place for call in calls} == {(target.x, target.y)}


# --- exactly ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model():
    return enumerate_tiny()


@pytest.fixture(scope="module")
def planned(model):
    return compute_price(model, synthesise(generate(TINY, 0)))


def learn_tiny(abstract, low_level="planned", primitives=600):
    """The value of the start at alpha 1 and gamma 1, and what is greedily earned from there."""
    env = make_env(TINY, low_level=low_level, abstract=abstract, cell=0.01)
    agent = make_agent("maxq-q", env.observation_space, env.action_space, 0, structure=env.structure, gamma=1.0,
                       learning_rate=1.0, epsilon_start=0.3, epsilon_end=0.3)
    result = train(agent, env, primitives=primitives, eval_episodes=1, eval_every=primitives, progress=False)
    observation, _ = env.reset(seed=0)
    seen = agent.hierarchy.see(observation, np.ones(6, bool))
    return agent.compute_task_value(agent.hierarchy.root, seen), result.evaluations[-1].mean_return


@pytest.mark.nightly
def test_abstraction_changes_no_value_and_the_value_is_the_exact_one(planned):
    assert learn_tiny(abstract=True) == learn_tiny(abstract=False) == (pytest.approx(planned.recursive),) * 2
    assert planned.recursive <= planned.hierarchical <= planned.flat


@pytest.mark.nightly
def test_a_program_with_planned_leaves_is_worth_as_much_as_the_task_graph(model, planned):
    """Both leave the order of presses open, and the planner walks in both."""
    structure = make_env(TINY, "ham").structure
    program = compute_price(model, structure["program"], read=structure["read"])
    assert program.hierarchical == pytest.approx(planned.hierarchical)


@pytest.mark.nightly
def test_learned_leaves_may_walk_any_way_so_that_the_graph_costs_nothing(model):
    learned = compute_price(model, synthesise(generate(TINY, 0), low_level="learned"))
    assert learned.recursive <= learned.hierarchical == pytest.approx(learned.flat)


# --- what an observation holds -------------------------------------------------------------


@pytest.mark.parametrize("preset", ["paper-two-button", "arm-two-button", "bit-flip"])
def test_a_situation_is_read_back_from_its_observation(preset):
    env = EscapeRoomEnv(preset)
    rooms = Situations(env.instance)
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(150):
        env.step(env.action_space.sample())
        state = env.get_state()
        read = rooms.read(rooms.pack(state))
        assert read.state.pose == state.pose and read.state.touching == state.touching
        assert read.facts == env.instance.puzzle.symbolic.get_facts(state.puzzle)
        assert read.is_open == env.instance.puzzle.is_solved(state.puzzle)


@pytest.mark.nightly
def test_a_folder_brings_back_agent_and_hierarchy(tmp_path):
    env = make_env(TINY, "ham")
    result = train("hamq", env, primitives=200, eval_episodes=1, out=tmp_path / "run", progress=False)
    agent, again = load_agent(tmp_path / "run"), load_env(tmp_path / "run")
    assert isinstance(again, HierarchyEnv) and again.structure.keys() == env.structure.keys()
    assert agent.state_dict()["table"]["keys"] == result.agent.state_dict()["table"]["keys"]
    same = train("hamq", env, primitives=200, eval_episodes=1, out=tmp_path / "run", progress=False)
    assert same.evaluations == result.evaluations
    other = train("hamq", make_env(TINY, "ham", "learned"), primitives=200, eval_episodes=1, progress=False)
    assert other.evaluations != result.evaluations


# --- what is refused -------------------------------------------------------------------------


def test_what_cannot_be_synthesised_is_refused_in_words():
    with pytest.raises(UnsupportedError, match="must be pushed"):
        synthesise(generate(get_preset("push-block"), 0))
    with pytest.raises(UnsupportedError, match="must be gripped"):
        synthesise(generate(get_preset("taxi"), 0))
    with pytest.raises(UnknownNameError, match="kind of hierarchy"):
        synthesise(generate(TINY, 0), "maxx")
    with pytest.raises(UnknownNameError, match="low_level"):
        make_env(TINY, low_level="plan")
    with pytest.raises(AgentSettingsError, match="hierarchy, which this agent takes"):
        train("maxq-q", make_env(TINY, "ham"), primitives=10)
    with pytest.raises(AgentSettingsError, match="does not use a task hierarchy"):
        train("q-learning", make_env(TINY, "maxq"), primitives=10)
    env = HierarchyEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-random", resample_instance=True))
    with pytest.raises(UnsupportedError, match="train on one instance"):
        env.reset(seed=1)
        env.reset(seed=2)
