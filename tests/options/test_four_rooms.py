"""Four Rooms with hallway options through `OptionsEnv`: models, sweeps and learners against exact values.

Sutton, Precup and Singh (1999), sections 3 and 4 and figure 2.
"""

from __future__ import annotations

from itertools import groupby

import numpy as np
import pytest

from hrl_escape.agents import make_agent, train
from hrl_escape.agents.agent import make_transition
from hrl_escape.options.option import TableOption
from hrl_escape.options.options_env import OptionsEnv
from tests.agents.running import interact
from tests.classic.exact import (
    Model,
    compute_choice_values,
    find_values,
    make_model,
    make_option_model,
    make_primitive_options,
)
from tests.classic.four_rooms import (
    EAST_HALLWAY,
    GRID,
    NORTH_HALLWAY,
    SOUTH_HALLWAY,
    FourRooms,
    make_hallway_options,
    make_room_mask,
)
from tests.classic.tabular import State

GAMMA = 0.9
CELLS = len(GRID)


def make_options(slip="none"):
    """The eight hallway options as tables of ours."""
    return [TableOption(option.name, option.policy, option.termination, np.flatnonzero(option.initiation).tolist())
            for option in make_hallway_options(slip)]


def make_env(slip="none", goal=EAST_HALLWAY, **arguments):
    flat = FourRooms(goal, slip, horizon=None)
    return OptionsEnv(flat, make_options(slip), discount=GAMMA, **arguments)


def enumerate_model(env):
    """The model of every action in every state, by running each once: exact where nothing is random."""
    flat, count = env.unwrapped, int(env.action_space.n)
    rewards, legal = np.zeros((CELLS, count)), np.zeros((CELLS, count), bool)
    follow = np.zeros((CELLS, count, CELLS))
    for cell in range(CELLS):
        if cell == flat.goal:  # the end of the episode: no decision is made there
            continue
        for action in range(count):
            flat.set_state(State(cell))
            legal[cell] = env.resume(cell)
            if legal[cell, action]:
                reached, _, terminated, _, info = env.step(action)
                rewards[cell, action] = info["discounted_reward"]
                follow[cell, action, reached] = 0.0 if terminated else info["discount"]
    return Model(rewards, follow, legal)


def test_option_models_run_by_the_wrapper_are_those_of_the_linear_equations():
    """R^o and P^o of section 3.3, solved from the tables, against one run from every state."""
    run = enumerate_model(make_env(include_primitives=False))
    tables = FourRooms(slip="none").make_tables()
    solved = make_option_model(tables, make_hallway_options("none"), GAMMA)
    inside = np.arange(CELLS) != EAST_HALLWAY
    np.testing.assert_array_equal(run.legal[inside], solved.legal[inside])
    mask = run.legal & inside[:, None]
    np.testing.assert_allclose(run.rewards[mask], solved.rewards[mask], atol=1e-12)
    np.testing.assert_allclose(run.follow[mask], solved.follow[mask], atol=1e-12)
    assert mask.sum() == 2 * (25 + 30 + 25 + 20) + 8 - 2, "two options in each cell of a room, two more in a hallway"


def test_sweeps_over_hallway_options_reach_the_goals_rooms_first_and_then_all():
    """Figure 2: one sweep values every state of the goal's two rooms, the second all others, exactly."""
    model = enumerate_model(make_env(include_primitives=False))
    flat = FourRooms(slip="none")
    exact = find_values(make_model(flat.make_tables(), GAMMA))
    near = make_room_mask("north-east") | make_room_mask("south-east")
    near[[NORTH_HALLWAY, SOUTH_HALLWAY]] = True
    first, second, third = (find_values(model, sweeps) for sweeps in (1, 2, 3))
    np.testing.assert_array_equal(first > 0, near)
    np.testing.assert_allclose(first[near], exact[near], atol=1e-12)
    np.testing.assert_allclose(second, exact, atol=1e-12)
    np.testing.assert_allclose(third, exact, atol=1e-12)


def test_sweeps_over_options_and_primitives_to_a_goal_inside_a_room():
    """Figure 3: with the goal inside a room primitives begin, and options carry the values on, room by room."""
    goal = GRID.numbers[9, 9]
    run = enumerate_model(make_env(goal=goal))
    tables = FourRooms(goal, "none").make_tables()
    options = [*make_primitive_options(CELLS, 4), *make_hallway_options("none")]
    solved, flat = make_option_model(tables, options, GAMMA), make_model(tables, GAMMA)
    for sweeps in (1, 2, 3, None):
        np.testing.assert_allclose(find_values(run, sweeps), find_values(solved, sweeps), atol=1e-12)
    np.testing.assert_allclose(find_values(run), find_values(flat), atol=1e-9)
    reached = [[int((find_values(model, sweeps) > 0).sum()) for sweeps in (1, 3, 6)] for model in (run, flat)]
    assert all(both > alone for both, alone in zip(*reached, strict=True)), reached


def learn(agent, primitives):
    """Largest error of the learned values of options, over all cells and options that may start there."""
    env = make_env(include_primitives=False, trace=agent == "smdp-intra-option-q")
    settings = {"gamma": GAMMA, "learning_rate": 1.0, "epsilon_end": 1.0}
    result = train(agent, env, primitives=primitives, eval_episodes=0, settings=settings, progress=False)
    solved = make_option_model(FourRooms(slip="none").make_tables(), make_hallway_options("none"), GAMMA)
    exact = compute_choice_values(solved, find_values(solved))
    learned = np.array([result.agent.compute_values(cell) for cell in range(CELLS)])
    legal = solved.legal & (np.arange(CELLS) != EAST_HALLWAY)[:, None]
    return np.abs(learned - exact)[legal].max()


@pytest.mark.nightly
def test_smdp_q_learning_comes_to_the_exact_values_of_options():
    """Alpha is 1 and nothing random, so values are exact once each pair was seen often enough."""
    assert learn("smdp-q-learning", 30_000) < 1e-12


@pytest.mark.nightly
def test_intra_option_learning_comes_to_them_with_fewer_primitives():
    """It looks inside options (section 6)."""
    assert learn("smdp-intra-option-q", 20_000) < 1e-12
    assert learn("smdp-q-learning", 20_000) > 0.1


# --- which use of options helps -----------------------------------------------------------


def serve(options_serve, primitives, seed=0, epsilon=1.0, **settings):
    """An agent whose options serve one use, and the decisions that it made: (action, primitives)."""
    env = make_env(trace=True)
    chosen = {"gamma": GAMMA, "learning_rate": 1.0, "epsilon_start": epsilon, "epsilon_end": epsilon}
    agent = make_agent("intra-option-q", env.observation_space, env.action_space, seed,
                       options_serve=options_serve, **chosen | settings)
    return agent, [(each.action, each.duration) for each in interact(agent, env, primitives, seed)]


def read_primitives(agent):
    return np.array([agent.compute_values(cell)[:4] for cell in range(CELLS) if cell != EAST_HALLWAY])


@pytest.mark.nightly
@pytest.mark.nightly_for("exploration")
@pytest.mark.parametrize("options_serve", ["exploration", "nothing"])
def test_options_for_exploration_leave_primitives_worth_what_they_are_and_act_by_them(options_serve):
    """From random choices: exploration runs options all the time, `nothing` each once at most."""
    agent, made = serve(options_serve, 8_000 if options_serve == "exploration" else 16_000)
    flat = make_model(FourRooms(slip="none").make_tables(), GAMMA)
    exact = np.delete(compute_choice_values(flat, find_values(flat)), EAST_HALLWAY, axis=0)
    found = read_primitives(agent)
    assert (found <= exact + 1e-9).all()
    assert np.isclose(found, exact).mean() > (0.95 if options_serve == "exploration" else 0.999)
    runs = sum(action >= 4 for action, _ in made)
    assert runs > 1_000 if options_serve == "exploration" else runs <= 8
    rng = np.random.default_rng(0)
    assert all(agent.act_greedy(cell, np.ones(12, np.bool_), rng) < 4 for cell in range(CELLS))


@pytest.mark.nightly
def test_values_of_options_count_in_backups_where_options_serve_all_and_nowhere_else():
    told = {}
    for options_serve in ("all", "exploration", "nothing"):
        agent, _ = serve(options_serve, 600, seed=1)
        there, below = GRID.numbers[8, 9], GRID.numbers[9, 9]
        for action in range(12):
            agent.table.update(agent._discretise(there), action, 0.5 if action == 11 else 0.0)
        env = make_env(trace=True)
        env.reset(seed=0)
        env.unwrapped.set_state(State(below))
        env.resume(below)
        agent.observe(make_transition(below, 0, np.ones(12, np.bool_), env.step(0), GAMMA))
        told[options_serve] = agent.compute_values(below)[0]
    assert told == pytest.approx({"all": GAMMA * 0.5, "exploration": 0.0, "nothing": 0.0})


def test_random_choices_are_repeated_for_the_lengths_that_are_given():
    _, made = serve("nothing", 600, repeats=(3,))
    actions = [action for action, _ in made if action < 4]
    runs = [len(list(group)) for _, group in groupby(actions)]
    assert np.mean([length % 3 == 0 for length in runs]) > 0.9, "but where an episode ends"
