"""Skill chaining: every option arrives in its target from wherever it may begin, and the chain leads to the end."""

import numpy as np
import pytest
from scipy import sparse

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.algorithms.skills.skill_chaining import SkillChaining
from hrl_escape.agents.discovery import NOTHING, StateModel, make_subgoal_option
from tests.agents.running import interact
from tests.classic.diffusion import make_next_states
from tests.classic.four_rooms import GRID, FourRooms

ALL = np.ones(4, np.bool_)
AFTER = make_next_states(FourRooms(None, "none").make_tables())
START, GOAL = GRID.numbers[1, 1], GRID.numbers[11, 11]


@pytest.fixture(scope="module")
def agent():
    env = FourRooms(GOAL, "none", starts=[START])
    settings = SkillChaining.Settings(initial_value=1.0, epsilon_steps=1, epsilon_end=0.1, learning_rate=1.0,
                                      gamma=0.95, reach=8)
    agent = SkillChaining(env.observation_space, env.action_space, 0, settings)
    for _ in interact(agent, env, 8_000):
        pass
    return agent


def find_number(agent, cell):
    return agent.graph.find(agent._discretise(cell))


def run_skill(agent, slot, cell):
    """The cell where an option ends, and its steps."""
    steps = 0
    while (action := agent.get_skill_action(slot, cell)) != NOTHING and steps < 200:
        cell, steps = int(AFTER[cell, action]), steps + 1
        if cell == GOAL:
            break
    return cell, steps


@pytest.mark.nightly
def test_every_option_arrives_in_its_target_from_wherever_it_may_begin(agent):
    made = [slot for slot, skill in enumerate(agent.skills) if skill is not None]
    assert len(made) >= 3 and made == list(range(len(made)))
    targets = agent.discovery.targets
    for slot in made:
        begins = [cell for cell in range(104) if agent.compute_available(cell, ALL)[slot]]
        assert begins
        for cell in begins:
            end, steps = run_skill(agent, slot, cell)
            assert targets[find_number(agent, end)] == slot, "the target of its level, the end of the task at first"
            assert 0 < steps <= 8


@pytest.mark.nightly
def test_the_chain_leads_from_the_start_to_the_goal(agent):
    cell, slots = START, []
    while cell != GOAL:
        available = np.flatnonzero(agent.compute_available(cell, ALL))
        assert len(available), f"a gap at {GRID.cells[cell]}"
        slots.append(int(available.min()))
        cell, _ = run_skill(agent, slots[-1], cell)
    assert slots == sorted(slots, reverse=True) and slots[-1] == 0
    assert len(slots) >= 3


@pytest.mark.nightly
def test_a_complete_chain_grows_no_further(agent):
    assert agent.discovery.targets[find_number(agent, START)] == sum(skill is not None for skill in agent.skills)


def test_states_without_a_known_way_inside_the_set_are_left_out():
    """A line of five states, of which the second is not in the set: the first is not connected with the target."""
    follow = np.zeros((5, 5))
    follow[np.arange(4), np.arange(1, 5)] = 1.0
    model = StateModel(sparse.csr_matrix(follow), np.ones((5, 1), np.bool_))
    option = make_subgoal_option("on", model, np.array([1, 0, 1, 1, 0], bool), np.arange(5) == 4)
    assert option.starts.tolist() == [False, False, True, True, False]
    assert option.actions.tolist() == [NOTHING, NOTHING, 0, 0, NOTHING]


def test_gestation_and_reach_are_counted_in_arrivals_and_decisions():
    space = FourRooms(None, "none")
    settings = SkillChaining.Settings(gestation=3, reach=2)
    agent = SkillChaining(space.observation_space, space.action_space, 0, settings)
    for arrival in range(1, 4):
        for state in range(4):  # 0, 1, 2, 3, and 4 ends
            agent.observe(SMDPTransition(state, 3, ALL, 0.0, 0.0, 1, 0.99, state + 1, ALL, state == 3, False))
        assert (agent.skills[0] is not None) == (arrival == 3)
    assert [bool(agent.compute_available(cell, ALL)[0]) for cell in range(5)] == [False, False, True, True, False]


def test_the_initiation_set_is_learned_from_runs_that_do_not_arrive():
    """From state 2 a slip now leads off the way as often as on; where it is never tried, the way is still believed."""
    space = FourRooms(None, "none")
    settings = SkillChaining.Settings(gestation=1, reach=3)
    agent = SkillChaining(space.observation_space, space.action_space, 0, settings)

    def see(state, after, over=False):
        agent.observe(SMDPTransition(state, 3, ALL, 0.0, 0.0, 1, 0.99, after, ALL, over, False))

    def list_starts():
        return [bool(agent.compute_available(cell, ALL)[0]) for cell in range(5)]

    for state in range(4):
        see(state, state + 1, over=state == 3)
    assert list_starts() == [False, True, True, True, False]
    for _ in range(3):
        see(1, 2)
        see(2, 9)
    assert list_starts() == [False, False, False, True, False], "states whose runs went through it do not arrive either"
    for _ in range(3):
        see(2, 3)
        see(3, 4, over=True)
    assert list_starts() == [False, False, True, True, False]


def test_it_resumes_within_its_chain(agent):
    other = SkillChaining(FourRooms().observation_space, FourRooms().action_space, 0, agent.settings)
    other.load_state_dict(agent.state_dict())
    env = FourRooms(GOAL, "none", starts=[START])
    ways = [[step.action for step in interact(each, env, 200, seed=5)] for each in (agent, other)]
    assert ways[0] == ways[1]
