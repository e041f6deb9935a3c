"""Baselines without learning, against what exhaustive play of every graph of a family in one room gives."""

from __future__ import annotations

import dataclasses
import itertools
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from benchmarks.references import compute_entropy, measure_information
from hrl_escape.agents.spec import BAYES, SEARCH_BACKTRACK, SEARCH_NEAREST, SEARCH_RANDOM, SWEEP_RANDOM, AgentSpec
from hrl_escape.agents.training.evaluation import evaluate
from hrl_escape.benchmark.agent_env import make_agent_env
from hrl_escape.benchmark.recording import record_episode
from hrl_escape.benchmark.references import bayes
from hrl_escape.benchmark.references.belief_graph import BeliefGraph
from hrl_escape.benchmark.references.graph_family import (
    GraphFamily,
    condition_on_cues,
    condition_on_room,
    iterate_outcomes,
    list_graphs,
    make_family,
)
from hrl_escape.benchmark.references.graph_particles import GraphParticles
from hrl_escape.benchmark.references.path_lengths import PathLengths, measure_paths
from hrl_escape.benchmark.references.registry import make_reference
from hrl_escape.env.config import RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import QUIET
from hrl_escape.env.presets import get_preset
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import (
    VIOLATION_RULES,
    ButtonsConfig,
    ButtonsPuzzle,
    PositionalCuesConfig,
    ViolationRule,
)
from hrl_escape.env.puzzles.cues import CuesConfig
from hrl_escape.env.puzzles.graphs import GraphConfig, GraphKind, mask_parents, sample_graph, sample_relabelled
from hrl_escape.env.sampling.generation import generate, sample_puzzle
from hrl_escape.errors import UnsupportedError
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.sets.benchmark import load_benchmark
from hrl_escape.sets.instance_set import InstanceSet
from hrl_escape.sets.own_config import find_own_config
from hrl_escape.settings import Between

LADDER = load_benchmark("ladder-1")


def play(name: str, room: RoomInstance, episodes: int = 1) -> tuple[np.ndarray, list[str]]:
    env, recorder = make_agent_env(AgentSpec(name), room, "features")
    reference = make_reference(name, env, recorder)
    found = evaluate(reference, env, episodes)
    decisions = [decision[0] for decision in record_episode(reference, env, 0).decisions]
    env.close()
    return np.where(found.successes, found.lengths, np.inf), decisions


def relabel(room: RoomInstance, order: tuple[int, ...], rule: ViolationRule = "ignore") -> RoomInstance:
    """The same room with a chain in this order."""
    puzzle = ButtonsPuzzle(len(order), tuple(itertools.pairwise(order)), order[-1], rule)
    return dataclasses.replace(room, puzzle=puzzle)


@pytest.mark.parametrize("name", [SEARCH_RANDOM, SEARCH_NEAREST])
def test_a_baseline_never_tries_again_what_failed_under_the_same_lights(name: str):
    room = relabel(generate(get_preset("four-button-chain"), 1), (2, 0, 3, 1))
    _, decisions = play(name, room)
    order, number, failed = ["press-button-3", "press-button-1", "press-button-4", "press-button-2"], 0, set()
    for decision in decisions[:-1]:
        assert decision not in failed | set(order[:number]), "neither what is lit nor what failed since the last light"
        if decision == order[number]:
            number, failed = number + 1, set()
        else:
            failed.add(decision)
    assert number == 4 and decisions[-1] == "go-to-exit"


@pytest.mark.nightly
def test_the_nearest_first_needs_less_than_a_random_order_and_that_less_than_rounds():
    rooms = [LADDER["chain-4"].test[number] for number in range(12)]
    nearest, untried, rounds = (np.mean([play(name, room, 3)[0].mean() for room in rooms])
                                for name in (SEARCH_NEAREST, SEARCH_RANDOM, SWEEP_RANDOM))
    assert nearest < untried < rounds < np.inf


@pytest.mark.parametrize("order", [(2, 0, 3, 1), (0, 1, 2, 3), (3, 2, 1, 0), (1, 3, 0, 2)])
def test_retracing_repeats_what_worked_after_a_reset_and_tries_nothing_twice(order: tuple[int, ...]):
    _, decisions = play(SEARCH_BACKTRACK, relabel(generate(get_preset("four-button-chain"), 1), order, "reset"))
    names = [f"press-button-{number}" for number in range(1, 5)]
    lit, best, failed = 0, 0, set()
    for decision in decisions[:-1]:
        pressed = names.index(decision)
        if lit < best:
            assert pressed == order[lit], "after a reset it repeats what worked, and nothing else"
        if pressed == order[lit]:
            lit, best = lit + 1, max(best, lit + 1)
        else:
            assert (lit, pressed) not in failed
            failed.add((lit, pressed))
            lit = 0
    assert lit == 4 and decisions[-1] == "go-to-exit"


@pytest.mark.nightly
@pytest.mark.nightly_for("code")
@pytest.mark.parametrize("rung", ["code", "switchboard"])
def test_retracing_finds_its_way_where_the_nearest_first_goes_round_in_circles(rung: str):
    rooms = [LADDER[rung].test[number] for number in range(8)]
    retraced, nearest = (np.array([play(name, room)[0].mean() for room in rooms])
                         for name in (SEARCH_BACKTRACK, SEARCH_NEAREST))
    assert np.isfinite(retraced).all() and np.isinf(nearest).any()


# --- families of graphs ------------------------------------------------------------------


def test_every_outcome_of_a_draw_is_listed_once_with_its_probability():
    found = dict(iterate_outcomes(lambda rng: (rng.integers(2, 4), tuple(rng.choice([5, 6, 7], 2, replace=False)))))
    assert len(found) == 6 and all(each == pytest.approx(1 / 6) for each in found.values())


@pytest.mark.nightly_for("layered", "lattice")
@pytest.mark.parametrize(("config", "count"), [
    (GraphConfig(kind="tree"), 4),
    (GraphConfig(kind="layered", max_parents=2), 5),
    (GraphConfig(kind="layered", max_parents=Between(1, 3)), 4),
], ids=["tree", "layered", "lattice"])
def test_listed_graphs_are_as_likely_as_drawn_ones(config: GraphConfig, count: int):
    exact, rng, draws = list_graphs(config, count), np.random.default_rng(0), 4000
    assert sum(exact.values()) == pytest.approx(1)
    counts = dict.fromkeys(exact, 0)
    for number in range(draws):
        most = config.max_parents if isinstance(config.max_parents, int) else 1 + number % 3
        counts[sample_graph(dataclasses.replace(config, max_parents=most), count, rng)] += 1
    for edges, probability in exact.items():
        assert abs(counts[edges] / draws - probability) < 4.5 * np.sqrt(probability / draws) + 1e-3


def test_a_family_holds_every_labelling():
    chain = make_family(ButtonsConfig(count=4), 4)
    assert len(chain.weights) == 24 and chain.weights == pytest.approx(1 / 24)
    told = make_family(ButtonsConfig(count=2, graph=GraphConfig(relabel=False)), 2)
    assert told.parents.tolist() == [[0, 1]] and told.goals.tolist() == [1]
    with pytest.raises(UnsupportedError, match="too many to list"):
        make_family(ButtonsConfig(count=7), 7)
    with pytest.raises(UnsupportedError, match="cannot be listed"):
        make_family(ButtonsConfig(count=4, graph=GraphConfig(kind="random")), 4)


def test_the_room_configuration_of_a_room_is_the_one_that_draws_its_puzzle():
    assert find_own_config(LADDER["lattice-5"].test[0]) == LADDER["lattice-5"].config
    assert find_own_config(generate(get_preset("paper-random"), 3)) == get_preset("paper-random")
    with pytest.raises(UnsupportedError, match="is not known"):
        find_own_config(relabel(generate(get_preset("paper-two-button"), 0), (1, 0)))


# --- beliefs -------------------------------------------------------------------------------


@pytest.mark.nightly_for("6")
@pytest.mark.parametrize("count", range(1, 7))
def test_a_chain_takes_the_presses_that_are_known_exactly(count: int):
    """With one primitive a press, a chain of n needs n(n + 3)/4 presses in the mean and no baseline fewer."""
    graph = BeliefGraph(make_family(ButtonsConfig(count=count), count))
    costs = graph.solve(PathLengths(np.ones((1, count)), np.zeros((1, count), int), np.zeros(1)))
    assert costs[graph.root] == pytest.approx(count * (count + 3) / 4)


def search(family: GraphFamily, ways: np.ndarray, leaving: np.ndarray, failure: float) -> float:
    """Fewest expected cost by plain recursion over sets of graphs, from the place behind the buttons."""
    count = family.count

    def expect(place: int, lit: int, graphs: frozenset[int]) -> float:
        total, best = sum(family.weights[g] for g in graphs), np.inf
        for button in range(count):
            allowed = {g for g in graphs if not int(family.parents[g, button]) & ~lit}
            if lit >> button & 1 or not allowed:
                continue
            opened = {g for g in allowed if family.goals[g] == button}
            cost = ways[place, button] * total + sum(family.weights[g] for g in opened) * leaving[button]
            if allowed - opened:
                part = frozenset(allowed - opened)
                cost += sum(family.weights[g] for g in part) * expect(button, lit | 1 << button, part)
            after: dict[int | None, set[int]] = {}  # what is lit after a mistake, None once all is over
            for g in graphs - allowed:
                then = {"ignore": lit, "reset": 0, "fail": None}[VIOLATION_RULES[family.rules[g]]]
                after.setdefault(then, set()).add(g)
            for then, part in after.items():
                weight = sum(family.weights[g] for g in part)
                cost += weight * (failure if then is None else expect(button, then, frozenset(part)))
            best = min(best, cost / total)
        return best

    return expect(count, 0, frozenset(range(len(family.weights))))


@pytest.mark.parametrize("rule", [*VIOLATION_RULES, "drawn"])
@pytest.mark.parametrize("kind", ["chain", "layered"])
def test_the_pass_over_beliefs_gives_what_plain_recursion_gives(rule: Any, kind: GraphKind):
    rng = np.random.default_rng(5)
    family = make_family(ButtonsConfig(count=3, graph=GraphConfig(kind=kind, max_parents=2), on_violation=rule), 3)
    ways, leaving = rng.uniform(1, 20, (4, 3)), rng.uniform(1, 20, 3)
    graph = BeliefGraph(family)
    for failure in (5.0, 100.0):
        made = PathLengths(ways, np.tile(np.arange(3), (4, 1)), np.append(leaving, 0.0), failure)
        assert graph.solve(made)[graph.root, 3] == pytest.approx(search(family, ways, leaving, failure), rel=1e-5)


@pytest.mark.nightly
def test_who_must_find_out_what_a_mistake_does_pays_what_was_foretold(monkeypatch: pytest.MonkeyPatch):
    """Played against each of the six orders under each of the three rules; to fail costs what the exit is worth."""
    config = dataclasses.replace(get_preset("four-button-chain"), puzzle=ButtonsConfig(count=3, on_violation="drawn"))
    monkeypatch.setattr(bayes, "find_own_config", lambda room: config)  # the room's name is that of another
    room, orders = generate(config, 5), itertools.permutations(range(3))
    rooms = [relabel(room, order, rule) for order in orders for rule in VIOLATION_RULES]
    assert np.mean([pay(BAYES, each) for each in rooms]) == pytest.approx(foretell(room, config.puzzle), rel=0.02)


def pay(name: str, room: RoomInstance) -> float:
    """Primitives of an episode, and a hundred more if it fails."""
    env, recorder = make_agent_env(AgentSpec(name), room, "features")
    found = evaluate(make_reference(name, env, recorder), env, 1)
    env.close()
    return float(found.lengths[0]) + 100.0 * (not found.successes[0])


@pytest.mark.nightly
def test_over_all_graphs_of_a_room_who_knows_the_odds_needs_least_and_what_was_foretold():
    """Played against each of the 24 orders in turn; ways between buttons are known to a primitive or two."""
    config = get_preset("four-button-chain")
    seeds = {sample_puzzle(config, seed)[1]: seed for seed in range(300)}
    assert len(seeds) == 24
    room = generate(config, 5)
    rooms = [dataclasses.replace(room, puzzle=puzzle, seed=seed) for puzzle, seed in seeds.items()]
    lengths = {name: np.mean([play(name, each)[0].mean() for each in rooms])
               for name in (SEARCH_RANDOM, SEARCH_NEAREST, BAYES)}
    assert lengths[BAYES] < min(lengths[SEARCH_RANDOM], lengths[SEARCH_NEAREST]), lengths
    assert foretell(room, ButtonsConfig(count=4)) == pytest.approx(lengths[BAYES], rel=0.04)


def foretell(room: RoomInstance, puzzle: Any) -> float:
    """Expected primitives from the start, by the pass over beliefs."""
    planner, count = RoomPlanner(room), len(room.targets)
    graph, ways = BeliefGraph(make_family(puzzle, count)), measure_paths(RoomPlanner(room))
    costs, start, root = graph.solve(ways), planner.rules.make_state(room.starts[0]), np.array([graph.root])
    return min(planner.plan(start, f"press-button-{button + 1}").cost
               + graph.compute_costs_after(costs, root, button, ways)[0, count * count + button]
               for button in range(count))


@pytest.mark.nightly
def test_who_knows_the_odds_goes_on_where_an_inner_door_bars_the_open_exit():
    """The goal lights fifth in this room, and another button opens the way to the exit."""
    env, recorder = make_agent_env(AgentSpec(BAYES), load_benchmark("ladder-1")["doors"].test[40], "features")
    found = evaluate(make_reference(BAYES, env, recorder), env, 1)
    env.close()
    assert found.successes == (True,)


@pytest.mark.nightly
def test_where_graphs_are_too_many_a_sample_has_their_odds():
    puzzle, count = LADDER["lattice-5"].config.puzzle, 5
    assert isinstance(puzzle, ButtonsConfig)
    family = make_family(puzzle, count)
    rng = np.random.default_rng(1)
    for _ in range(4):
        edges, goal = sample_relabelled(GraphConfig(kind="layered", max_parents=2), count, rng)
        masks = [sum(1 << parent for parent, child in edges if child == button) for button in range(count)]
        particles = GraphParticles(puzzle, count, np.random.default_rng(0))
        kept, lit = np.arange(len(family.weights)), 0
        for button in rng.permutation(count).tolist():
            has_lit = not masks[button] & ~lit
            particles.learn((button, lit, has_lit, has_lit and button == goal))
            allowed = (family.parents[kept, button] & np.uint64(~lit & 31)) == 0
            agrees = (allowed == has_lit) & (~allowed | ((family.goals[kept] == button) == (button == goal)))
            kept, lit = kept[agrees], lit | has_lit << button
            weights, could_light = family.weights[kept], (family.parents[kept] & np.uint64(~lit & 31)) == 0
            assert particles.compute_odds(lit) == pytest.approx(weights @ could_light / weights.sum(), abs=0.12)


# --- cues ------------------------------------------------------------------------------------


def make_cued(count: int, kind: GraphKind = "chain", **cues: Any) -> ButtonsConfig:
    return ButtonsConfig(count=count, graph=GraphConfig(kind=kind, max_parents=2), cues=CuesConfig("rank", **cues))


def count_presses(family: GraphFamily) -> float:
    """Fewest expected presses, one primitive each."""
    graph, count = BeliefGraph(family), family.count
    return float(graph.solve(PathLengths(np.ones((1, count)), np.zeros((1, count), int), np.zeros(1)))[graph.root, 0])


@pytest.mark.parametrize(("truth", "presses"), [(1.0, 4.0), (0.0, 7.0)])
def test_wires_save_every_wrong_press_and_hidden_ones_none(truth: float, presses: float):
    """A chain of n: n presses for who sees all dependency cues, n(n + 3)/4 for who sees none."""
    config = dataclasses.replace(make_cued(4), cues=CuesConfig("dependencies", truth=truth))
    for seed in range(12):
        puzzle = config.make_puzzle(np.random.default_rng(seed))
        told = condition_on_cues(make_family(config, 4), config.cues, puzzle.cues)
        assert count_presses(told) == pytest.approx(presses)
        assert told.weights[(told.parents == np.array(puzzle.parent_masks, np.uint64)).all(axis=1)].sum() > 0
    assert compute_entropy(told) == pytest.approx(np.log2(24) if truth == 0 else 0, abs=1e-9)


def test_samples_of_many_buttons_refuse_wires():
    config = dataclasses.replace(make_cued(7), cues=CuesConfig("dependencies"))
    cues = config.make_puzzle(np.random.default_rng(0)).cues
    with pytest.raises(UnsupportedError, match="dependency cues of 7 buttons"):
        GraphParticles(config, 7, np.random.default_rng(0), cues)


@pytest.mark.parametrize("truth", [1.0, 0.8, 0.4, 0.0])
def test_marks_are_worth_what_follows_by_hand(truth: float):
    """Two buttons in a chain, a symbol a rank: 2 + (1 - truth)/2 presses in the mean over all cues, 2.5 without."""
    config = make_cued(2, levels=2, symbols=2, truth=truth)
    family = make_family(config, 2)
    expected = 0.0
    for cues in itertools.product(range(2), repeat=2):
        ranks = np.array([[0, 1] if goal == 1 else [1, 0] for goal in family.goals])
        likelihood = config.cues.compute_likelihood(cues, ranks).mean()
        if likelihood:
            expected += likelihood * count_presses(condition_on_cues(family, config.cues, cues))
    assert expected == pytest.approx(2 + (1 - truth) / 2)


@pytest.mark.parametrize(("codes", "presses"), [(1, 3.0), (2, 3.5), (6, 4.5)])
def test_latent_codes_cost_the_presses_that_find_out_which_holds(codes: int, presses: float):
    """Three in a chain: one press fails in half of the rooms if two orders are possible; all six tell nothing."""
    rules = CuesConfig("rank", levels=3, symbols=9, latent_codes=codes)
    family = make_family(make_cued(3, levels=3, symbols=9), 3)
    cues = rules.draw(3, ((0, 1), (1, 2)), 2, np.random.default_rng(0))
    assert count_presses(condition_on_cues(family, rules, cues)) == pytest.approx(presses)
    with pytest.raises(UnsupportedError, match="latent codes with") if codes > 1 else nullcontext():
        GraphParticles(make_cued(7, levels=3, symbols=9, latent_codes=codes), 7, np.random.default_rng(0), (0,) * 7)


@pytest.mark.parametrize(("levels", "presses"), [(5, 5.0), (2, 1 + 4 * 7 / 4)])
def test_true_marks_leave_a_chain_its_buttons_or_the_rest_of_its_search(levels: int, presses: float):
    """Five ranks tell all; two tell the first button, and the four others take 4 x 7/4 presses as ever."""
    config = make_cued(5, levels=levels, symbols=5)
    puzzle = config.make_puzzle(np.random.default_rng(1))
    family = make_family(config, 5)
    told = condition_on_cues(family, config.cues, puzzle.cues)
    assert count_presses(told) == pytest.approx(presses)
    shuffled = dataclasses.replace(config.cues, shuffled=True)
    assert condition_on_cues(family, shuffled, puzzle.cues) is family


def test_places_tell_a_whole_chain_and_of_other_graphs_what_their_depths_tell():
    sections, shape = PositionalCuesConfig(sections=6, code=1), ShapeConfig(width=9, depth=9)
    for kind, chances in (("chain", 1), ("tree", None)):
        puzzle = ButtonsConfig(count=4, graph=GraphConfig(kind=kind), buttons=Panels(width=0.8),
                               positional_cues=sections)
        config = RoomConfig(room=shape, robot=RobotConfig(body_radius=0.3), puzzle=puzzle)
        rooms = InstanceSet("places", config, range(4))
        for room in rooms:
            family = condition_on_room(make_family(puzzle, 4), puzzle, room)
            true = mask_parents(room.puzzle.edge_list, 4)
            assert list(true) in family.parents.tolist() and len(family.weights) == (chances or len(family.weights))
            assert kind == "tree" or count_presses(family) == pytest.approx(4)
        told, hidden = measure_information(puzzle, rooms)
        assert 0 < told <= hidden and (kind == "tree" or told == pytest.approx(hidden) == pytest.approx(np.log2(24)))
        bare = dataclasses.replace(puzzle, positional_cues=PositionalCuesConfig())
        assert measure_information(bare, rooms)[0] == pytest.approx(0)
    with pytest.raises(UnsupportedError, match="positional cues with"):
        GraphParticles(dataclasses.replace(puzzle, count=7), 7, np.random.default_rng(0))


def test_the_bits_of_marks_follow_by_hand():
    """Three in a chain have log2(6) bits: two orders leave one of them, truth 0 leaves all."""
    every = np.log2(6)
    for changes, left in (({}, 0.0), ({"latent_codes": 2}, 1.0), ({"truth": 0.0}, every), ({"shuffled": True}, every)):
        config = dataclasses.replace(make_cued(3, levels=3, symbols=9), cues=CuesConfig(
            "rank", levels=3, symbols=9, **changes))
        rooms = InstanceSet("bits", RoomConfig(room=ShapeConfig(width=9, depth=9), puzzle=config), range(3))
        assert measure_information(config, rooms) == pytest.approx((every - left, every))


def test_two_buttons_touched_at_once_confuse_no_belief():
    """Button 1 lights and lets button 3 light in one move: of two at once the lower number counts first."""
    config = load_benchmark("cues-1")["latent-codes"].config
    cues = dataclasses.replace(config.puzzle.cues, latent_codes=2)
    rooms = InstanceSet("", dataclasses.replace(config, puzzle=dataclasses.replace(config.puzzle, cues=cues)),
                        [699512341362768345])
    env, recorder = make_agent_env(AgentSpec(BAYES), rooms, "features", {"0": 0})
    assert evaluate(make_reference(BAYES, env, recorder), env, 1).successes == (True,)
    assert any((after.puzzle & ~before.puzzle).bit_count() > 1 for before, after in itertools.pairwise(recorder.states))
    env.close()


@pytest.mark.parametrize("rule", ["ignore", "drawn"])
def test_a_press_in_vain_beside_one_that_lights_is_no_reset(rule: Any, monkeypatch: pytest.MonkeyPatch):
    """Of two buttons touched in one move the first does not light and the second does: nothing went off."""
    config = dataclasses.replace(get_preset("four-button-chain"), puzzle=ButtonsConfig(count=3, on_violation=rule))
    monkeypatch.setattr(bayes, "find_own_config", lambda room: config)  # the room's name is that of another
    room = relabel(generate(config, 5), (1, 0, 2))
    env, recorder = make_agent_env(AgentSpec(BAYES), room, "features")
    baseline = make_reference(BAYES, env, recorder)
    observation, info = env.reset(seed=0)
    baseline.act(observation, info["action_mask"] != 0)
    recorder.states.append(recorder.states[-1]._replace(puzzle=0b010, touching=0b011))
    recorder.events.append(QUIET._replace(pressed=0b011, turned_on=0b010))
    baseline.act(observation, info["action_mask"] != 0)
    assert list(baseline.describe_presses().values()) == ["lights with 50%", "lit", "lights with 50%"]
    env.close()


@pytest.mark.nightly_for("hidden-rules-360")
@pytest.mark.parametrize(("rung", "graphs"), [("hidden-rules", 360), ("dependencies", 120)])
def test_every_graph_of_five_in_a_chain_is_listed_where_marks_deceive_and_rules_are_drawn(rung: str, graphs: int):
    """A ceiling is a ceiling only where beliefs are listed: a sample does not plan."""
    rooms = load_benchmark("cues-1")[rung].test[:1]
    env, recorder = make_agent_env(AgentSpec(BAYES), rooms, "features", {"0": 0})
    baseline: Any = make_reference(BAYES, env, recorder)
    observation, info = env.reset(seed=0)
    baseline.act(observation, info["action_mask"] != 0)
    assert baseline._posterior.graph is not None
    assert len(make_family(rooms.config.puzzle, 5).weights) == graphs
    env.close()


@pytest.mark.nightly
def test_a_sample_of_graphs_believes_marks_as_the_list_of_all_does():
    rng = np.random.default_rng(3)
    for truth in (1.0, 0.7):
        config = make_cued(5, "layered", levels=4, symbols=12, truth=truth)
        for _ in range(3):
            puzzle = config.make_puzzle(rng)
            family = condition_on_cues(make_family(config, 5), config.cues, puzzle.cues)
            particles = GraphParticles(config, 5, np.random.default_rng(0), puzzle.cues)
            could_light = (family.parents & np.uint64(31)) == 0
            assert particles.compute_odds(0) == pytest.approx(family.weights @ could_light, abs=0.12)


@pytest.mark.nightly
def test_who_reads_marks_needs_less_in_the_same_rooms_than_who_cannot(monkeypatch: pytest.MonkeyPatch):
    lengths = {}
    for shuffled in (False, True):
        cues = CuesConfig("rank", levels=4, symbols=20, shuffled=shuffled)
        config = RoomConfig(room=ShapeConfig(width=10, depth=10), robot=RobotConfig(body_radius=0.4),
                            puzzle=ButtonsConfig(count=4, cues=cues, buttons=Panels(width=1.0)))
        monkeypatch.setattr(bayes, "find_own_config", lambda room, config=config: config)
        rooms = [generate(config, seed) for seed in range(5)]
        lengths[shuffled] = np.mean([play(BAYES, room)[0].mean() for room in rooms])
        nearest = np.mean([play(SEARCH_NEAREST, room)[0].mean() for room in rooms])
    assert lengths[False] < 0.9 * nearest and lengths[False] < 0.95 * lengths[True]


def test_bayes_says_where_it_has_no_beliefs():
    with pytest.raises(UnsupportedError, match=r"use search-backtrack"):
        play(BAYES, generate(get_preset("pin-pad"), 0))
