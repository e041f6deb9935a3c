"""Random domains: every one is solvable, its optimum is known by enumeration, and it does what its tables say."""


import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hrl_escape.checks import check_puzzle
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.factored import FactoredConfig, FactoredPuzzle
from hrl_escape.env.puzzles.light_box import LightBoxPuzzle
from hrl_escape.errors import ConfigError
from hrl_escape.options import pursue
from hrl_escape.planning.planner import RoomPlanner

SIZES = st.sampled_from([(1, 2, 0), (2, 3, 1), (3, 2, 2), (4, 3, 3), (5, 2, 3), (6, 2, 0)])


def explore(puzzle) -> networkx.DiGraph:
    """All states that presses lead to, and the presses that change them."""
    graph, queue = networkx.DiGraph(), [puzzle.make_state()]
    graph.add_node(queue[0])
    for state in queue:
        for target in range(len(puzzle.target_names)):
            after = puzzle.update(state, Contacts((target,)))
            if after not in graph:
                queue.append(after)
            graph.add_edge(state, after)
    return graph


def draw(size: tuple[int, int, int], seed: int) -> FactoredPuzzle:
    count, arity, parents = size
    return FactoredConfig(count, arity, parents, 1.0).make_puzzle(np.random.default_rng(seed))


@given(SIZES, st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_every_drawn_domain_is_solvable_from_everywhere_and_its_goal_is_a_furthest_state(size, seed):
    puzzle = draw(size, seed)
    graph = explore(puzzle)
    assert networkx.is_strongly_connected(graph), "every press can be undone by others"
    distances = networkx.single_source_shortest_path_length(graph, puzzle.make_state())
    assert distances[puzzle.goal] == max(distances.values()) >= puzzle.count
    plan = puzzle.make_symbolic_model().find_fewest(puzzle.get_facts(puzzle.make_state()))
    assert plan is not None and len(plan) == distances[puzzle.goal], "the model's optimum is the domain's"


@pytest.mark.nightly
@given(SIZES, st.integers(0, 2**32), st.lists(st.tuples(st.integers(0, 5), st.floats(0, 1)), max_size=40))
@settings(max_examples=60, deadline=None)
def test_presses_do_what_the_tables_say(size, seed, presses):
    puzzle = FactoredPuzzle.from_dict(draw(size, seed).to_dict() | {"success": 0.7})
    state, values = puzzle.make_state(), [0] * puzzle.count
    for factor, chance in presses:
        if factor < puzzle.count:
            state = puzzle.update(state, Contacts((factor,), uniform=chance))
            if chance < 0.7:
                table = np.reshape(puzzle.turns[factor], (puzzle.arity,) * (len(puzzle.parents[factor]) + 1))
                values[factor] = int(table[(*(values[p] for p in reversed(puzzle.parents[factor])), values[factor])])
        assert list(puzzle.decode(state)) == values and puzzle.is_state(state)


def test_the_optimum_grows_by_the_chance_that_a_press_does_nothing():
    """Value iteration at success 0.9: the fewest presses divided by it."""
    puzzle = FactoredConfig().make_puzzle(np.random.default_rng(4))
    graph = explore(puzzle)
    states = list(graph)
    numbers = {state: n for n, state in enumerate(states)}
    after = np.array([[numbers[puzzle.turn(state, factor)] for factor in range(puzzle.count)] for state in states])
    solved = np.array([puzzle.is_solved(state) for state in states])
    presses = np.zeros(len(states))
    for _ in range(400):
        presses = np.where(solved, 0.0, 1 + (0.9 * presses[after] + 0.1 * presses[:, None]).min(axis=1))
    fewest = networkx.shortest_path_length(graph, 0, puzzle.goal)
    assert presses[0] == pytest.approx(fewest / 0.9, abs=1e-9)


@given(st.integers(0, 2**32))
@settings(max_examples=30, deadline=None)
def test_random_lights_take_one_press_for_each_light_that_the_goal_depends_on(seed):
    puzzle = get_preset("random-lights").puzzle.make_puzzle(np.random.default_rng(seed))
    assert isinstance(puzzle, LightBoxPuzzle) and puzzle.success == 0.9
    graph = explore(puzzle)
    solved = [state for state in graph if puzzle.is_solved(state)]
    fewest = min(networkx.shortest_path_length(graph, 0, state) for state in solved)
    lights = networkx.DiGraph(puzzle.edges)
    lights.add_node(puzzle.goal)
    assert fewest == 1 + len(networkx.ancestors(lights, puzzle.goal))


@pytest.mark.parametrize("success", [1.0, 0.8])
def test_domains_keep_the_contract(success):
    for seed in range(3):
        check_puzzle(FactoredConfig(count=4, success=success).make_puzzle(np.random.default_rng(seed)), steps=60)
    assert FactoredPuzzle.from_dict(draw((4, 3, 3), 1).to_dict()) == draw((4, 3, 3), 1)


@pytest.mark.nightly_for("factored")
@pytest.mark.parametrize("name", ["random-lights", "factored"])
def test_the_planner_escapes_by_planning_anew_where_a_press_did_nothing(name):
    env = EscapeRoomEnv(name, instance_seed=2)
    planner, presses = RoomPlanner(env.instance), []
    for seed in range(2):
        env.reset(seed=seed)
        done = pursue(env, planner=planner)
        assert done.escaped
        presses.append(sum(before.touching != after.touching and after.touching > 0
                           for before, after in zip(done.states, done.states[1:], strict=False)))
    assert len(set(presses)) > 1, "some press did nothing, and was made again"
    env.close()


def test_what_does_not_fit_is_refused():
    with pytest.raises(ConfigError, match="the limit of the enumeration"):
        FactoredConfig(count=8, arity=3)
    with pytest.raises(ConfigError, match="one permutation"):
        FactoredPuzzle(1, 2, ((),), ((1, 1),))
    with pytest.raises(ConfigError, match="other factors"):
        FactoredPuzzle(2, 2, ((0,), ()), ((0, 1, 1, 0), (1, 0)))
