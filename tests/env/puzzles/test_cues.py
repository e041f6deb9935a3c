"""Marks: what they tell, that they tell nothing else, and that every view of a room shows them."""

import dataclasses
import itertools
import re
from collections import Counter

import gymnasium
import numpy as np
import pytest

from hrl_escape.env.config import Between, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.observations.objects import OBJECT_WORDS
from hrl_escape.env.pictures import palette
from hrl_escape.env.pictures.maps import make_map_image
from hrl_escape.env.pictures.meshes import make_badges
from hrl_escape.env.pictures.moving_map import describe_room
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.puzzles.cues import CUE_WORDS, MOST_SYMBOLS, CuesConfig, make_cue_rows, split_cue
from hrl_escape.env.puzzles.graphs import GraphConfig
from hrl_escape.env.sampling.generation import generate, sample_puzzle
from hrl_escape.env.vector_env import EscapeRoomVectorEnv
from hrl_escape.errors import ConfigError, UnsupportedError
from hrl_escape.sets.keys import compute_task_key


def make_with(cues, kind="chain", count=4):
    return RoomConfig(
        room=ShapeConfig(width=10, depth=10), robot=RobotConfig(body_radius=0.4),
        puzzle=ButtonsConfig(count=count, graph=GraphConfig(kind=kind, max_parents=2), buttons=Panels(width=1.0),
                             cues=cues),
    )


def draw_puzzles(config, rooms):
    return [sample_puzzle(config, seed)[1] for seed in range(rooms)]


def test_cues_change_nothing_but_what_is_seen():
    plain, cued = (generate(make_with(CuesConfig(kind, levels=4, symbols=40)), 3) for kind in ("none", "rank"))
    assert "cues" not in plain.to_dict()["puzzle"]  # so ids of rooms without cues are what they were
    assert len(cued.puzzle.cues) == 4 and cued.id != plain.id
    assert dataclasses.replace(cued, puzzle=dataclasses.replace(cued.puzzle, cues=())) == plain
    assert cued.symbolic_model == plain.symbolic_model
    assert compute_task_key(cued.puzzle) == compute_task_key(plain.puzzle)
    assert type(cued).from_dict(cued.to_dict()) == cued


def test_a_symbol_means_the_same_class_in_every_room_and_every_class_has_symbols():
    rules = CuesConfig("rank", levels=4, symbols=42)
    meant = {}
    for puzzle in draw_puzzles(make_with(rules), 200):
        order = [puzzle.goal]
        while len(order) < 4:  # along the chain, from the goal back
            order.append(next(parent for parent, child in puzzle.edge_list if child == order[-1]))
        for rank, button in enumerate(order[::-1]):
            assert meant.setdefault(puzzle.cues[button], rank) == rank
    assert len(meant) == 42
    assert [meant[symbol] for symbol in range(42)] == rules.meanings.tolist()
    assert sorted(np.bincount(rules.meanings)) == [10, 10, 11, 11]
    other = dataclasses.replace(rules, code=1)
    assert (other.meanings != rules.meanings).any()


def test_ranks_are_longest_ways_and_the_last_level_stands_for_all_above():
    edges, goal = ((0, 1), (1, 2), (0, 2), (2, 4), (3, 4)), 4
    assert CuesConfig("rank", levels=8).classify(6, edges, goal).tolist() == [0, 1, 2, 0, 3, 0]
    assert CuesConfig("rank", levels=3).classify(6, edges, goal).tolist() == [0, 1, 2, 0, 2, 0]
    assert CuesConfig("needed").classify(6, edges, goal).tolist() == [1, 1, 1, 1, 1, 0]


def count_true(puzzles, rules):
    return np.mean([rules.meanings[list(puzzle.cues)] == rules.classify(puzzle.count, puzzle.edge_list, puzzle.goal)
                    for puzzle in puzzles])


@pytest.mark.nightly
def test_the_share_of_true_cues_is_what_is_asked_for_and_shuffled_ones_are_at_chance():
    for truth in (1.0, 0.8, 0.0):
        rules = CuesConfig("rank", levels=4, symbols=8, truth=truth)
        share = count_true(draw_puzzles(make_with(rules), 400), rules)
        assert share == pytest.approx(truth + (1 - truth) / 4, abs=0.04)  # 1,600 cues: four standard errors or less
    rules = CuesConfig("rank", levels=4, symbols=8, shuffled=True)
    puzzles = draw_puzzles(make_with(rules), 400)
    assert count_true(puzzles, rules) == pytest.approx(0.25, abs=0.05)
    for puzzle in puzzles[:50]:  # the cues of one graph all the same: every rank once
        assert sorted(rules.meanings[list(puzzle.cues)]) == [0, 1, 2, 3]


@pytest.mark.nightly_for("2")
@pytest.mark.parametrize("codes", [1, 2])
def test_likelihoods_are_those_of_the_draws(codes):
    rules = CuesConfig("rank", levels=2, symbols=5, truth=0.7, latent_codes=codes)
    every = list(itertools.product(range(5), repeat=2))
    classes = np.array([[0, 1], [1, 0]])
    table = np.array([rules.compute_likelihood(cues, classes) for cues in every])
    assert table.sum(axis=0) == pytest.approx([1, 1])
    assert np.allclose(table[:, 0], table[:, 1]) == (codes == 2)  # both orders of two: nothing is told any more
    rng = np.random.default_rng(0)
    drawn = [rules.draw(2, ((0, 1),), 1, rng) for _ in range(6_000)]
    shares = np.array([drawn.count(cues) for cues in every]) / len(drawn)
    assert np.abs(shares - table[:, 0]).max() < 0.02
    shuffled = dataclasses.replace(rules, shuffled=True).compute_likelihood((0, 3), classes)
    assert shuffled[0] == shuffled[1]


# --- dependency cues -----------------------------------------------------------------------------------


def read_dependencies(rules, cues):
    """For each target the target that its plug names, None where there is no wire."""
    colours = {mark % 8: target for target, mark in enumerate(cues)}
    return [None if (own := rules.meanings[mark // 8]) == 0 else colours[own - 1] for mark in cues]


def test_a_wire_leads_to_the_button_that_must_be_on_before_and_some_are_hidden():
    rules, shown = CuesConfig("dependencies", truth=0.75), []
    puzzles = [make_with(rules, count=5).puzzle.make_puzzle(np.random.default_rng(seed)) for seed in range(400)]
    for puzzle in puzzles:
        parent = {child: parent for parent, child in puzzle.edge_list}
        assert len({mark % 8 for mark in puzzle.cues}) == 5, "every button has a colour of its own"
        for button, named in enumerate(read_dependencies(rules, puzzle.cues)):
            assert named is None or named == parent[button]
            shown += [named is not None] if button in parent else []
    assert len(shown) == 1600 and np.mean(shown) == pytest.approx(0.75, abs=0.04)  # four standard errors
    assert {mark // 8 for puzzle in puzzles for mark in puzzle.cues} == set(range(12)), "every plug is in use"
    assert set(rules.meanings.tolist()) == set(range(9)), "for every colour, and for no wire, there is a plug"


def test_dependency_cues_of_another_graph_say_nothing():
    rules = CuesConfig("dependencies", shuffled=True)
    puzzles = [make_with(rules, count=5).puzzle.make_puzzle(np.random.default_rng(seed)) for seed in range(400)]
    right = [(named, button) in puzzle.edge_list for puzzle in puzzles
             for button, named in enumerate(read_dependencies(rules, puzzle.cues)) if named is not None]
    assert len(right) == 1600 and np.mean(right) == pytest.approx(0.2, abs=0.04)  # 4 edges among 20 pairs
    classes = np.array([[0, 1, 2], [3, 0, 1]])
    assert rules.compute_likelihood((8, 1, 2), classes).tolist() == [1.0, 1.0]


def test_what_dependency_cues_lead_to_is_as_frequent_as_their_likelihoods_say():
    rules, edges, colours = CuesConfig("dependencies", truth=0.6), ((2, 0), (0, 1)), (4, 7, 0)
    classes = rules.classify(3, edges, 0)[None]
    likely: Counter[tuple[int | None, ...]] = Counter()
    for plugs in itertools.product(range(12), repeat=3):
        cues = tuple(colour + 8 * plug for colour, plug in zip(colours, plugs, strict=True))
        if chance := float(rules.compute_likelihood(cues, classes)[0]):
            likely[tuple(read_dependencies(rules, cues))] += chance
    assert sum(likely.values()) == pytest.approx(1)
    rng = np.random.default_rng(0)
    drawn = Counter(tuple(read_dependencies(rules, rules.draw(3, edges, 1, rng))) for _ in range(4000))
    assert drawn.keys() == likely.keys() and len(drawn) == 4, "each of two dependencies is hidden or not"
    for read, count in drawn.items():
        assert count / 4000 == pytest.approx(likely[read], abs=0.03), read  # four standard errors


@pytest.mark.nightly
@pytest.mark.parametrize("truth", [1.0, 0.6])
def test_likelihoods_of_dependency_cues_are_those_of_the_draws(truth):
    """Given the colours: over all plugs they sum to 1 under every graph, and are the shares of plugs drawn."""
    rules, edges = CuesConfig("dependencies", truth=truth), ((2, 0), (0, 1))
    colours, graphs = (4, 7, 0), (edges, ((0, 1), (1, 2)), ((0, 1), (0, 2)))
    classes = np.array([rules.classify(3, each, 0) for each in graphs])
    assert classes.tolist() == [[3, 1, 0], [0, 1, 2], [0, 1, 1]]
    every = [tuple(colour + 8 * plug for colour, plug in zip(colours, plugs, strict=True))
             for plugs in itertools.product(range(12), repeat=3)]
    table = np.array([rules.compute_likelihood(cues, classes) for cues in every])
    assert table.sum(axis=0) == pytest.approx([1, 1, 1])
    rng = np.random.default_rng(0)
    drawn = [cues for cues in (rules.draw(3, edges, 1, rng) for _ in range(200_000))
             if tuple(mark % 8 for mark in cues) == colours]
    assert len(drawn) > 400
    for cues in set(drawn):
        assert drawn.count(cues) / len(drawn) == pytest.approx(table[every.index(cues), 0], abs=0.08)
    assert not table[[every.index(cues) for cues in set(drawn)], 0].min() == 0


def test_each_room_has_one_code_and_all_codes_are_as_frequent():
    rules = CuesConfig("rank", levels=4, symbols=12, latent_codes=3)
    assert rules.orders[0].tolist() == [0, 1, 2, 3] and len({tuple(order) for order in rules.orders}) == 3
    assert (np.sort(rules.orders, axis=1) == np.arange(4)).all()
    found = []
    for puzzle in draw_puzzles(make_with(rules), 300):
        ranks = rules.classify(4, puzzle.edge_list, puzzle.goal)
        code, = np.flatnonzero((rules.orders[:, rules.meanings[list(puzzle.cues)]] == ranks).all(axis=1))
        found.append(code)
    assert np.bincount(found) == pytest.approx([100, 100, 100], abs=33)  # four standard errors
    assert CuesConfig("rank", levels=2, symbols=2, latent_codes=2).orders.tolist() == [[0, 1], [1, 0]]


def test_every_symbol_looks_different():
    rows = make_cue_rows(tuple(range(MOST_SYMBOLS)))
    assert len(np.unique(rows, axis=0)) == MOST_SYMBOLS == len({split_cue(mark) for mark in range(MOST_SYMBOLS)})
    assert (rows.sum(axis=1) == 3).all()
    puzzle = draw_puzzles(make_with(CuesConfig("rank"), count=6), 1)[0]
    looks = [palette.list_cues(dataclasses.replace(puzzle, cues=tuple(range(first, first + 6))))
             for first in range(0, MOST_SYMBOLS, 6)]
    assert len({(colour, tuple(outline)) for part in looks for colour, outline in part}) == MOST_SYMBOLS


@pytest.mark.nightly_for("egocentric")
@pytest.mark.parametrize("kind", ["objects", "egocentric"])
def test_both_engines_show_cues_on_their_targets_and_nothing_else_moves(kind):
    config = make_with(CuesConfig("rank", symbols=60), "layered", Between(2, 4))
    rooms = [generate(config, seed) for seed in range(6)]
    plain = [dataclasses.replace(room, puzzle=dataclasses.replace(room.puzzle, cues=())) for room in rooms]
    assert len({len(room.targets) for room in rooms}) > 1
    shown = EscapeRoomVectorEnv(6, instance=rooms, observation=kind)
    bare = EscapeRoomVectorEnv(6, instance=plain, observation=kind)
    seen, unmarked = (env.reset(seed=0)[0] for env in (shown, bare))
    words = list(EscapeRoomEnv(instance=rooms[0], observation=kind).unwrapped._observer.names)
    is_mark = np.array([word.rpartition("-")[2] in CUE_WORDS for word in words])
    assert is_mark.sum() == len(CUE_WORDS) * (5 if kind == "objects" else 4)  # the exit has a row, too
    for _ in range(12):
        assert np.array_equal(seen[:, ~is_mark], unmarked)
        action = shown.action_space.sample()
        for number, room in enumerate(rooms):
            single = EscapeRoomEnv(instance=room, observation=kind)
            single.reset(seed=0)
            single.set_state(shown.room.get_room_state(number))
            own = single.unwrapped._observe()
            assert np.abs(own[: len(is_mark) - 16] - seen[number, : len(is_mark) - 16]).max() < 2e-5
            if kind == "objects":
                rows = own.reshape(5, -1)[:, len(OBJECT_WORDS):]
                assert np.array_equal(rows[: len(room.targets)], make_cue_rows(room.puzzle.cues))
                assert not rows[len(room.targets):].any()
            single.close()
        seen, unmarked = (env.step(action)[0] for env in (shown, bare))


def test_cues_out_of_sight_are_not_seen():
    config = dataclasses.replace(make_with(CuesConfig("rank", symbols=60)), room=ShapeConfig(
        width=16, depth=16, rooms=4, doorway_width=2.0))
    hidden = 0
    for seed in range(4):
        env = EscapeRoomEnv(instance=generate(config, seed), observation="egocentric")
        seen, _ = env.reset(seed=0)
        rows = seen[: 4 * (4 + len(CUE_WORDS))].reshape(4, -1)
        for row, full in zip(rows, make_cue_rows(env.instance.puzzle.cues), strict=True):
            assert np.array_equal(row[4:], full if row[0] else np.zeros_like(full))
            hidden += not row[0]
    assert hidden >= 3


def test_pictures_show_the_colour_of_a_mark():
    room = generate(make_with(CuesConfig("rank", symbols=8)), 1)
    colours = [palette.CUE_COLOURS[split_cue(mark)[0]] for mark in room.puzzle.cues]
    image = make_map_image(room).reshape(-1, 3)
    assert all((image == np.round(255 * np.array(palette.to_rgb(colour)))).all(axis=1).any() for colour in colours)
    assert [target["cue"][0] for target in describe_room(room)["targets"]] == colours
    for target, colour in zip(room.targets, colours, strict=True):
        assert make_badges(room, target)[-1][0] == colour
    bare = dataclasses.replace(room, puzzle=dataclasses.replace(room.puzzle, cues=()))
    assert make_badges(bare, bare.targets[0]) == [] and describe_room(bare)["targets"][0]["cue"] is None


def test_pixels_show_cues():
    room = generate(make_with(CuesConfig("rank", symbols=8)), 1)
    others = dataclasses.replace(room, puzzle=dataclasses.replace(
        room.puzzle, cues=tuple((mark + 1) % 8 for mark in room.puzzle.cues)))
    target = room.targets[0]
    x, y = palette.find_front(room, target)
    pictures = []
    for instance in (room, others):
        env = EscapeRoomEnv(instance=instance, observation="pixels")
        env.reset(seed=0)
        heading = round(np.degrees(np.arctan2(-y, -x)) / 10) % 36
        env.set_state(env.get_state()._replace(x=target.x + 2 * x, y=target.y + 2 * y, heading_steps=heading))
        pictures.append(env._observe().astype(int))
        env.close()
    assert 30 < (np.abs(pictures[0] - pictures[1]).sum(axis=2) > 60).sum() < 2000  # the mark, and it alone


def test_cued_and_bare_rooms_are_no_batch_and_batched_cameras_refuse_cues():
    cued, bare = generate(make_with(CuesConfig("rank")), 0), generate(make_with(CuesConfig()), 0)
    with pytest.raises(UnsupportedError, match="cues on targets"):
        EscapeRoomVectorEnv(2, instance=[cued, bare], observation="objects")
    with pytest.raises(UnsupportedError, match="cannot draw cues"):
        EscapeRoomVectorEnv(1, instance=cued, render_mode="rgb_array")


@pytest.mark.parametrize(("changes", "words"), [
    ({"kind": "rank", "levels": 8, "symbols": 6}, "cues.symbols = 6 is not possible: at least 8"),
    ({"kind": "rank", "symbols": 97}, "97"),
    ({"kind": "dependencies", "latent_codes": 2},
     "cues.latent_codes = 2 is not possible: 1 with dependencies"),
    ({"kind": "needed", "latent_codes": 3},
     "cues.latent_codes = 3 is not possible: at most 2, the number of orders of 2 classes"),
    ({"kind": "rank", "truth": 1.5}, "1.5"),
    ({"kind": "colour"}, "needed"),
])
def test_impossible_cues_are_refused(changes, words):
    with pytest.raises(ConfigError, match=re.escape(words)):
        CuesConfig(**changes)
    puzzle = draw_puzzles(make_with(CuesConfig("rank")), 1)[0]
    with pytest.raises(ConfigError, match="one for each of 4 buttons"):
        dataclasses.replace(puzzle, cues=(1, 2))


def test_a_room_with_cues_by_name_alone():
    env = gymnasium.make("hrl_escape/EscapeRoom-v1", observation="objects", config={
        "puzzle": {"kind": "buttons", "count": 3, "cues": {"kind": "rank"}}})
    assert env.observation_space.words == OBJECT_WORDS + CUE_WORDS
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
