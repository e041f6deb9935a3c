"""Recovery of a graph: edges that matter, precision and recall, and the longest chain."""

import dataclasses

import numpy as np
import pytest

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.training.results import EpisodeRecord
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.score_range import ScoreRange
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Contacts
from hrl_escape.env.puzzles.graphs import find_edges_that_matter
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.settings import Between
from studies.scaling.results import compute_edge_depth
from studies.scaling.solved_probe import SolvedProbe, compare_graphs


def test_an_edge_that_a_longer_way_implies_does_not_matter():
    assert find_edges_that_matter([(0, 1), (1, 2), (0, 2)], goals=[2]) == {(0, 1), (1, 2)}


def test_edges_to_what_no_goal_needs_do_not_matter():
    assert find_edges_that_matter([(0, 1), (0, 3), (3, 4), (1, 2)], goals=[2]) == {(0, 1), (1, 2)}
    assert find_edges_that_matter([(0, 1), (0, 3), (3, 4), (1, 2)], goals=[2, 3]) == {(0, 1), (1, 2), (0, 3)}
    assert find_edges_that_matter([(0, 1)], goals=[0]) == set()


def test_a_believed_graph_may_have_cycles():
    found = find_edges_that_matter([(0, 1), (1, 0), (1, 2)], goals=[2])
    assert found == {(0, 1), (1, 0), (1, 2)}


def test_precision_and_recall_of_edges():
    true = frozenset({(0, 1), (1, 2)})
    assert compare_graphs(frozenset({(0, 1), (0, 2), (5, 6), (7, 8)}), true) == (0.25, 0.5)
    assert compare_graphs(frozenset(), true) == (0.0, 0.0)
    assert compare_graphs(frozenset(), frozenset()) == (1.0, 1.0)


def test_depth_counts_the_edges_in_a_row_that_lead_to_a_goal():
    assert compute_edge_depth([(0, 1), (1, 2), (3, 2), (2, 4), (5, 6)], goals=[4]) == 3
    assert compute_edge_depth([(0, 1)], goals=[0]) == 0


def test_a_policy_near_the_best_counts_from_the_first_of_two_checks_after_an_escape():
    room = generate(get_preset("paper-one-button"), 0)
    env = OptionsEnv(EscapeRoomEnv(instance=room, observation="features"), include_primitives=False)
    agent = train("smdp-q-learning", env, primitives=300, eval_episodes=0).agent
    known = ScoreRange(-200.0, ((0.0,),), (91.0,), (91.0,), (9.0,), (9.0,), "planner")
    probes = [SolvedProbe(0.99, env, room, AgentSpec(name), known)
              for name in ("smdp-q-learning", "random-options")]
    for at, success in ((100, False), (250, False), (400, True), (450, False), (900, False)):
        for probe in probes:
            probe.after_episode(agent, EpisodeRecord(at, at, 0.0, 10, success, "terminated", 0.0))
    assert [probe.near_best for probe in probes] == [400, None]
    assert [probe.is_done for probe in probes] == [True, True]


@pytest.mark.parametrize("observation", ["features", "state"])
def test_a_believed_graph_is_read_by_the_places_of_the_lights(observation):
    preset = get_preset("four-button-chain")
    several = dataclasses.replace(preset, puzzle=dataclasses.replace(preset.puzzle, count=Between(2, 4)))
    room = next(room for room in (generate(several, seed) for seed in range(20)) if len(room.targets) == 3)
    env = OptionsEnv(EscapeRoomEnv(instance=room, observation=observation), include_primitives=False)
    known = ScoreRange(-200.0, ((0.0,),), (91.0,), (91.0,), (9.0,), (9.0,), "planner")
    probe = SolvedProbe(0.99, env, room, AgentSpec("smdp-factored-r-max"), known)
    train("smdp-factored-r-max", env, primitives=600, eval_episodes=0, probe=probe)
    assert probe.structure[-1][1:] == (1.0, 1.0) and probe.edges == 2


@pytest.mark.parametrize(("preset", "observation"), [
    ("arm-two-button", "state"), ("arm-two-button", "features"), ("clutter", "egocentric"), ("lights-out", "state"),
    ("clutter", "objects"), ("hanoi", "state")])
def test_the_places_of_the_lights_are_the_numbers_that_change_with_them(preset, observation):
    env = EscapeRoomEnv(preset, observation=observation)
    env.reset(seed=0)
    puzzle, places, begun = env.instance.puzzle, env.observer.light_places, env.get_state()
    assert (len(places) == len(puzzle.target_names)) == (observation != "objects" and preset != "hanoi")
    for target in range(len(puzzle.target_names) if places else 0):
        state = puzzle.update(begun.puzzle, Contacts((target,), uniform=0.0))
        after = env.observer.observe(begun._replace(puzzle=state))
        changed = set(np.flatnonzero(after != env.observer.observe(begun)))
        lit = np.flatnonzero(np.array(puzzle.get_lit(state)) != puzzle.get_lit(begun.puzzle))
        assert changed == {places[number] for number in lit} or observation == "egocentric" and not changed


def test_a_graph_is_kept_once_until_the_agent_believes_another():
    room = generate(get_preset("four-button-chain"), 0)
    env = OptionsEnv(EscapeRoomEnv(instance=room, observation="features"), include_primitives=False)
    known = ScoreRange(-200.0, ((0.0,),), (91.0,), (91.0,), (9.0,), (9.0,), "planner")
    probe = SolvedProbe(0.99, env, room, AgentSpec("smdp-factored-r-max"), known)
    agent = train("smdp-factored-r-max", env, primitives=3_000, eval_episodes=0).agent
    for primitives in (0, 50, 100, 200, 300):
        probe.after_decision(agent, primitives)
    assert probe.structure == [(0, 1.0, 1.0)]
    before = train("smdp-factored-r-max", env, primitives=10, eval_episodes=0).agent
    probe.after_decision(before, 350)  # the graph is looked at every hundred primitives
    assert len(probe.structure) == 1
    probe.after_decision(before, 410)
    assert [at for at, *_ in probe.structure] == [0, 410]
