"""Options found while learning: of the graph that was met, in slots, used for exploration or as choices."""

import numpy as np
import pytest

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.algorithms.skills.covering_options import CoveringOptions
from hrl_escape.agents.algorithms.skills.eigenoptions import Eigenoptions
from hrl_escape.agents.discovery import NOTHING, TableSkill
from tests.agents.running import interact
from tests.classic.diffusion import compute_diffusion_time, make_next_states
from tests.classic.four_rooms import GRID, FourRooms

ALL = np.ones(4, np.bool_)
AFTER = make_next_states(FourRooms(None, "none").make_tables())


def show_everything(agent, reward=0.0):
    """Every action in every cell, the cells in an order of their own, once."""
    for state in np.random.default_rng(0).permutation(104).tolist():
        for action in range(4):
            after = int(AFTER[state, action])
            agent.observe(SMDPTransition(state, action, ALL, reward, reward, 1, agent.gamma, after, ALL, False, False))


def make(agent_class, **settings):
    env = FourRooms(None, "none")
    settings = {"discover_every": 416} | settings
    return agent_class(env.observation_space, env.action_space, 0, agent_class.Settings(**settings))


def list_skills(agent):
    """The found options, by the number of the cell."""
    order = [agent.graph.find(agent._discretise(cell)) for cell in range(104)]
    return [TableSkill(skill.name, skill.actions[order], skill.starts[order]) for skill in agent.skills]


@pytest.mark.nightly_for("successor-267.11", "random-walk-206.98", "combinatorial-267.11")
@pytest.mark.parametrize(("representation", "primitives"), [
    ("random-walk", 206.98), ("combinatorial", 267.11), ("normalised", 667.47), ("successor", 267.11),
])
def test_eigenoptions_of_a_graph_that_was_met_are_those_of_the_graph_that_is(representation, primitives):
    """The diffusion time with both signs of eight directions, as in `test_spectral`, from experience."""
    agent = make(Eigenoptions, representation=representation)
    show_everything(agent)
    skills = list_skills(agent)
    assert len(skills) == 16 and skills[0].name == "direction-1+"
    assert compute_diffusion_time(AFTER, skills)[0] == pytest.approx(primitives, rel=1e-3)


def test_covering_options_join_the_corners_both_ways():
    agent = make(CoveringOptions, edges=2)
    show_everything(agent)
    ends = []
    for skill in list_skills(agent):
        (start,) = np.flatnonzero(skill.starts)
        state = start
        while skill.actions[state] != NOTHING:
            state = AFTER[state, skill.actions[state]]
        ends.append((GRID.cells[start], GRID.cells[state]))
    assert set(map(frozenset, ends)) == {frozenset({(11, 1), (1, 11)}), frozenset({(1, 1), (11, 11)})}
    assert ends[0] == ends[1][::-1] and ends[2] == ends[3][::-1]


def test_nothing_is_found_before_its_time_and_states_met_later_end_an_option():
    agent = make(Eigenoptions, discover_every=100, directions=2)
    env = FourRooms(None, "none", starts=[0])
    for decision, _ in enumerate(interact(agent, env, 199), 1):
        assert (agent.skills == [None] * 4) == (decision < 100)
    known = len(agent.skills[0].actions)
    assert known < len(agent.graph)
    late = next(cell for cell in range(104) if (agent.graph.find(agent._discretise(cell)) or 0) >= known)
    assert all(agent.get_skill_action(slot, late) == NOTHING for slot in range(4))
    assert not agent.compute_available(late, ALL).any()


def test_exploration_runs_an_option_to_its_end_and_the_policy_is_over_primitives():
    agent = make(Eigenoptions, directions=1, option_share=1.0, epsilon_start=1.0, epsilon_end=1.0)
    show_everything(agent)
    up, _ = agent.skills
    peak = next(cell for cell in range(104) if agent.get_skill_action(0, cell) == NOTHING)
    rng = np.random.default_rng(0)
    runs = 0
    for _ in range(20):
        state = int(rng.integers(104))
        action = agent.act(state, ALL)
        slot = agent._running
        if slot != 0:
            agent._running = NOTHING
            continue
        runs += 1
        while agent._running == 0 and agent.get_skill_action(0, state) != NOTHING:
            assert action == agent.get_skill_action(0, state)
            assert [call.task for call in agent.list_calls()] == [up.name]
            state = int(AFTER[state, action])
            if state != peak:
                action = agent.act(state, ALL)
        assert state == peak
        agent._running = NOTHING
    assert runs > 3
    agent.table.update(agent._discretise(5), 2, 1.0)
    assert agent.act_greedy(5, ALL, rng) == 2
    assert agent.compute_values(5).shape == (4,)


def test_an_illegal_primitive_ends_an_option():
    agent = make(Eigenoptions, directions=1, option_share=1.0, epsilon_start=1.0, epsilon_end=1.0)
    show_everything(agent)
    state = next(cell for cell in range(104) if agent.get_skill_action(0, cell) != NOTHING)
    mask = ALL.copy()
    mask[agent.get_skill_action(0, state)] = False
    assert not agent.compute_available(state, mask)[0]
    agent._running = 0
    assert mask[agent.act(state, mask)]


def test_a_chosen_option_is_worth_what_it_earns_on_its_way_and_the_best_choice_where_it_ends():
    """A corridor of four cells: on by action 0, back to the first by the others; the option runs through two cells.

    In the second cell action 1 leaves it at once for more than the option gets there.
    """
    agent = make(CoveringOptions, edges=1, use="choose", gamma=0.9, learning_rate=1.0, discover_every=10**6)
    rewards = [-1.0, -30.0, 5.0]  # in the second cell it is better to go back

    def show():
        for state in range(3):
            for action in range(4):
                after, reward = (state + 1, rewards[state]) if action == 0 else (0, -2.0)
                if (state, action) == (1, 1):
                    after, reward = 3, 10.0
                over = after == 3
                agent.observe(SMDPTransition(state, action, ALL, reward, reward, 1, 0.9, after, ALL, over, False))

    show()
    agent.skills[1] = TableSkill("through", np.array([0, 0, NOTHING, NOTHING]), np.array([True, False, False, False]))
    for _ in range(200):
        show()
    best = [0.0] * 3
    for _ in range(400):
        best = [max(rewards[s] + 0.9 * (best[s + 1] if s < 2 else 0.0), -2.0 + 0.9 * best[0],
                    10.0 if s == 1 else -np.inf) for s in range(3)]
    table = [agent.table.get_values(agent._discretise(state)) for state in range(3)]
    assert [row[:4].max() for row in table] == pytest.approx(best)
    assert table[1][5] == pytest.approx(-30.0 + 0.9 * best[2])
    assert table[0][5] == pytest.approx(-1.0 + 0.9 * (-30.0 + 0.9 * best[2]))
    assert [row[4] for row in table] == [0.0] * 3, "an empty slot learns nothing"
    assert agent._compute_choices(0, ALL)[1].tolist() == [True] * 4 + [False, True]
    assert not agent._compute_choices(1, ALL)[1][5], "it may begin in the first cell alone"


@pytest.mark.parametrize("agent_class", [Eigenoptions, CoveringOptions])
def test_it_resumes_with_its_options_and_within_one(agent_class):
    """Between two discoveries, while an option runs."""
    env = FourRooms(GRID.numbers[11, 11], "none")
    settings = {"discover_every": 300, "epsilon_steps": 1, "epsilon_end": 1.0, "option_share": 1.0}
    agent = make(agent_class, **settings)
    steps = interact(agent, env, 5_000)
    running = next(step for n, step in enumerate(steps) if n > 700 and agent._running != NOTHING)
    other = make(agent_class, **settings)
    other.load_state_dict(agent.state_dict())
    for state in (running.next_observation, *range(60)):
        assert other.act(state, ALL) == agent.act(state, ALL)
        assert other.list_calls() == agent.list_calls()
