"""The graph of the states met: edges either way, and the part of it that a walk can cover."""

from hrl_escape.agents.agent import SMDPTransition
from hrl_escape.agents.algorithms.skills.eigenoptions import Eigenoptions
from hrl_escape.agents.discovery import NOTHING, StateGraph
from tests.agents.algorithms.skills.test_discovery import ALL, make, show_everything


def make_graph(*edges):
    """A graph of states called by letters, met in the order of the edges, of one action."""
    graph = StateGraph(1)
    for before, after in edges:
        graph.add(before.encode(), 0, after.encode())
    return graph


def test_an_action_joins_states_both_ways_and_one_that_stays_joins_none():
    """A push that cannot be undone joins what it leads between: the Laplacian is that of an undirected graph."""
    graph = make_graph("ab", "ab", "bc", "cc")
    assert graph.make_adjacency().toarray().tolist() == [[0, 1, 0], [1, 0, 1], [0, 1, 0]]


def test_directions_are_those_of_the_largest_connected_part():
    graph = make_graph("xx", "ab", "yz", "bc")
    assert [graph.find(letter.encode()) for letter in "abc"] == graph.find_component(graph.make_adjacency()).tolist()
    agent = make(Eigenoptions, discover_every=417)
    show_everything(agent)
    agent.observe(SMDPTransition(104, 0, ALL, 0.0, 0.0, 1, agent.gamma, 104, ALL, False, False))
    alone = agent.graph.find(agent._discretise(104))
    for skill in agent.skills:
        assert skill is not None, "they were due"
        assert skill.actions[alone] == NOTHING and not skill.starts[alone]
        assert (skill.actions != NOTHING).sum() > 50
