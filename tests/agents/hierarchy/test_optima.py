"""Flat, hierarchical and recursive optima against other ways of computing them."""

from __future__ import annotations

import itertools

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.optima import TabularModel, compute_price, enumerate_model, read_model
from hrl_escape.agents.hierarchy.goal_space import make_goal_hierarchy, make_goals
from hrl_escape.agents.hierarchy.task_graph import flat, maxq
from hrl_escape.errors import UnsupportedError
from tests.agents.hierarchy import taxi_program
from tests.agents.hierarchy.four_rooms_tasks import HOME, make_nested_walks, make_walks
from tests.agents.hierarchy.priced import AWAY, make_tabular_model, make_traveller
from tests.agents.hierarchy.taxi_tasks import make_taxi_tasks
from tests.classic.exact import (
    find_fewest_primitives,
    find_recursive_optimum,
    find_values,
    make_model,
    make_option_model,
)
from tests.classic.four_rooms import FourRooms
from tests.classic.parr_maze import ParrMaze
from tests.classic.taxi import Taxi, make_task_graph

DYNAMICS = {"still": {}, "noisy": {"noisy": True}, "fickle": {"fickle": True}}


@pytest.mark.nightly_for("noisy", "fickle")
@pytest.mark.parametrize("dynamics", DYNAMICS)
def test_taxi_has_the_optima_of_sweeps_and_of_nested_tasks(dynamics):
    env = Taxi(**DYNAMICS[dynamics])
    tables = env.make_tables()
    price = compute_price(make_tabular_model(env), make_taxi_tasks())
    nested = find_recursive_optimum(tables, make_task_graph(env.states), 1.0)
    assert price.flat == pytest.approx(tables.starts @ find_values(make_model(tables, 1.0)))
    assert price.recursive == pytest.approx(tables.starts @ nested.values["root"])
    assert price.recursive <= price.hierarchical + 1e-9 <= price.flat + 2e-9
    if "fickle" not in DYNAMICS[dynamics]:  # the graph costs nothing
        assert price.recursive == pytest.approx(price.flat)
    else:  # `get` may not ride on to learn where the passenger wants to go
        assert price.hierarchical < price.flat - 2.0


@pytest.mark.nightly
def test_a_program_for_taxi_loses_nothing_where_passengers_stand_by_their_word():
    price = compute_price(make_tabular_model(Taxi()), taxi_program.drive, read=taxi_program.read)
    assert price.hierarchical == pytest.approx(price.flat) and price.recursive is None


def test_walks_to_hallways_are_priced_as_nested_tasks_are():
    """A walk may be used for any way there is, so the graph forbids nothing; but each walks for its own hallway."""
    env = FourRooms(HOME, "direction")
    tables = env.make_tables()
    price = compute_price(make_tabular_model(env), make_walks(lambda seen: bool(AWAY[seen.observation])), 0.9)
    solution = find_recursive_optimum(tables, make_nested_walks(AWAY), 0.9)
    assert price.recursive == pytest.approx(tables.starts @ solution.values["root"])
    assert price.recursive < price.hierarchical - 1e-3 and price.hierarchical == pytest.approx(price.flat)


def test_a_program_that_runs_options_is_worth_what_the_options_are():
    """Parr and Russell's use: at an intersection only the next hallway is open."""
    env = ParrMaze(2, horizon=None)
    tables, options = env.make_tables(), env.make_hallway_options()

    price = compute_price(make_tabular_model(env), make_traveller(options), 0.99)
    assert price.hierarchical == pytest.approx(
        tables.starts @ find_values(make_option_model(tables, options, 0.99)), abs=1e-9
    )
    assert price.hierarchical < price.flat


def test_one_task_over_all_primitives_costs_nothing():
    price = compute_price(make_tabular_model(Taxi()), flat(6))
    assert price.hierarchical == price.recursive == price.flat


# --- tiny worlds, every policy tried -----------------------------------------------------

STATES, GAMMA = 3, 0.9
"""States 0 to 2, and 3, where every episode ends."""


@st.composite
def draw_world(draw):
    """Two actions; going on and ending have chances that are drawn, and so have rewards."""
    outcomes = []
    for _ in range(STATES):
        row = []
        for _ in range(2):
            reached = draw(st.lists(st.integers(0, STATES), min_size=1, max_size=2))
            reward = draw(st.integers(-3, 3))
            row.append([(1 / len(reached), after, float(reward), after == STATES) for after in reached])
        outcomes.append(row)
    outcomes.append([[(1.0, STATES, 0.0, True)]] * 2)
    return TabularModel(outcomes, np.array([1.0, 0, 0, 0]), range(STATES + 1))


UNTIL = {"a": {1, 3}, "b": {2, 3}}


def make_two_tasks(pseudo=0.0):
    return maxq(
        {"root": ["a", "b", 0], "a": [0, 1], "b": [0, 1]},
        {name: lambda seen, over=over: seen.observation in over for name, over in UNTIL.items()},
        pseudo={"a": lambda seen: pseudo},
    )


def follow(model, root, tasks):
    """Value of the first state under given choices: `root` by state, `tasks` by name and state."""
    pairs = [(state, name) for state in range(STATES) for name in ("root", "a", "b")]
    system, paid = np.eye(len(pairs)), np.zeros(len(pairs))
    for row, (state, name) in enumerate(pairs):
        chosen = root[state] if name == "root" else None
        runs = name if chosen is None else chosen
        action = 0 if runs == 0 else tasks[runs][state]
        for probability, after, reward, terminated in model.outcomes[state][action]:
            paid[row] += probability * reward
            if not terminated:
                goes_on = runs != 0 and after not in UNTIL[runs]
                system[row, pairs.index((after, runs if goes_on else "root"))] -= probability * GAMMA
    return np.linalg.solve(system, paid)[0]


@pytest.mark.nightly
@settings(max_examples=12, deadline=None)
@given(draw_world(), st.sampled_from([-2.0, 0.0, 2.0]))
def test_no_policy_of_the_hierarchy_is_better_and_the_recursive_one_is_no_better(model, pseudo):
    price = compute_price(model, make_two_tasks(pseudo), GAMMA)
    choices = [[name for name, over in UNTIL.items() if state not in over] + [0] for state in range(STATES)]
    best = max(
        follow(model, root, {"a": acts[:STATES], "b": acts[STATES:]})
        for root in itertools.product(*choices)
        for acts in itertools.product((0, 1), repeat=2 * STATES)
    )
    assert price.hierarchical == pytest.approx(best, abs=1e-9)
    assert price.recursive <= price.hierarchical + 1e-9 and price.hierarchical <= price.flat + 1e-9


# --- models --------------------------------------------------------------------------------


def test_the_model_that_an_environment_carries_is_read():
    env = gymnasium.make("FrozenLake-v1")
    rules, values = env.unwrapped.P, np.zeros(16)
    for _ in range(2_000):
        values = np.array([max(sum(p * (r + 0.99 * values[s] * (not over)) for p, s, r, over in rules[state][action])
                               for action in range(4)) for state in range(16)])  # fmt: skip
    assert compute_price(read_model(env), flat(4), 0.99).flat == pytest.approx(values[0], abs=1e-9)


def test_a_deterministic_environment_is_enumerated():
    env = FourRooms(HOME, "none", starts=[103])
    model = enumerate_model(env, key=lambda state: state.number)
    fewest = find_fewest_primitives(env.make_tables())
    assert compute_price(model, flat(4), 0.9).flat == pytest.approx(0.9 ** (fewest[103] - 1))


@pytest.mark.nightly
def test_what_has_no_model_or_no_such_price_is_refused():
    with pytest.raises(UnsupportedError, match="no attributes P"):
        read_model(gymnasium.make("CartPole-v1"))
    with pytest.raises(UnsupportedError, match="cannot be enumerated"):
        enumerate_model(gymnasium.make("FrozenLake-v1"))
    with pytest.raises(UnsupportedError, match="more than 10 states"):
        enumerate_model(FourRooms(HOME, "none"), most_states=10)
    env = FourRooms(HOME, "none")
    with pytest.raises(UnsupportedError, match="ends after a time"):
        compute_price(make_tabular_model(env), make_goal_hierarchy(make_goals(env.observation_space, ""), 4, 5), 0.9)
    with pytest.raises(UnsupportedError, match="gamma below 1"):
        compute_price(TabularModel([[[(1.0, 0, -1.0, False)]]], np.ones(1), [0]), flat(1))
