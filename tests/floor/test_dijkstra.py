"""The kernels one by one on small grids: against scipy, and against loops over the rules and the exact geometry."""

from __future__ import annotations

import dataclasses
import itertools
import math
from functools import lru_cache

import numpy as np
import pytest
from scipy import ndimage, sparse
from scipy.sparse.csgraph import dijkstra as shortest_paths

from hrl_escape.clock import Clock, OutOfTime
from hrl_escape.env.config import ExitConfig, ObstaclesConfig, RobotConfig, RoomConfig, ShapeConfig
from hrl_escape.env.geometry import Solid, compute_distance, compute_distance_many, make_footprint, stack_footprints
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.puzzles.buttons import ButtonsConfig
from hrl_escape.env.sampling.generation import generate
from hrl_escape.floor import cost_to_go, dijkstra
from hrl_escape.floor.cost_to_go import FieldMaker
from hrl_escape.floor.sweeps import is_clear_of_all, measure_clearance, sweep_body, turns_anywhere
from hrl_escape.kernels import kernel
from hrl_escape.planning.areas import compute_goal_area, get_presser
from hrl_escape.planning.goals import ExitGoal, PressGoal

DISC = RobotConfig(body_radius=0.35, move_step=0.8, turn_step_deg=45)
BOX = dataclasses.replace(DISC, footprint="rectangle", body_length=0.9, body_width=0.4)


@lru_cache
def make_maker(robot: RobotConfig = DISC, size: tuple[float, float] = (7.0, 5.0)) -> tuple[Kinematics, FieldMaker]:
    """A room that is no square, with a shut door, and its grid."""
    config = RoomConfig(room=ShapeConfig(width=size[0], depth=size[1]), robot=robot, puzzle=ButtonsConfig(count=2),
                        exit=ExitConfig(door=True, width=1.6), obstacles=ObstaclesConfig(count=3, size_max=0.6))
    rules = Kinematics(generate(config, 3))
    return rules, FieldMaker(rules.instance, rules, door_shut=True)


# --- Dijkstra's search and the fields -----------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_the_fewest_primitives_are_the_shortest_paths_of_scipy(seed):
    """Random links, turns, walls for turns and seeds; the search is cut into calls and its buckets must grow."""
    rng = np.random.default_rng(seed)
    cells, classes, translations = 60, 4, 3
    headings, turn_steps = (4, 8)[seed % 2], np.array([1, -1, 2])[: 2 + seed % 2]
    landing = rng.integers(-cells // 2, cells, cells * classes * translations).clip(-1).astype(np.int32)
    link_cost = rng.integers(1, 4, len(landing)).astype(np.int16)
    can_turn = rng.random(cells * classes) < 0.5 if headings == classes and seed else np.zeros(0, dtype=bool)
    allowed = rng.random(cells) < 0.9
    seeds = rng.choice(cells * headings, 5, replace=False).astype(np.int64)
    seed_costs = np.sort(rng.integers(0, 30, 5))

    starts, sources, costs = dijkstra.link_cells(landing, link_cost, classes, translations)
    best = np.full(cells * headings, dijkstra.UNREACHED, dtype=np.int16)
    levels, wide = 4, 16 + int(np.diff(starts).max())
    buckets, filled = np.empty((levels, wide), dtype=np.int32), np.zeros(levels, dtype=np.int64)
    counts, calls = np.array([0, 0, 0, int(np.diff(starts).max())]), 0
    while counts[0] >= 0:
        buckets = dijkstra.run_dijkstra(starts, sources, costs, classes, headings, turn_steps, can_turn, allowed,
                                        seeds, seed_costs, best, buckets, filled, counts, 20)
        calls += 1
    assert calls > 3 and buckets.shape[1] > wide

    links: dict[tuple[int, int], int] = {}  # from the state that is entered to the one that it is entered from
    for at, end in enumerate(landing.tolist()):
        state, cell = at // translations, at // translations // classes
        for heading in range(state % classes, headings, classes) if end >= 0 and allowed[cell] else ():
            link = end * headings + heading, cell * headings + heading
            links[link] = min(int(link_cost[at]), links.get(link, 99))
    for state in range(cells * headings):
        cell, heading = divmod(state, headings)
        for turn in turn_steps.tolist():
            passed = range(heading, heading + turn) if turn > 0 else range(heading + turn, heading)
            if not len(can_turn) or all(can_turn[cell * classes + step % classes] for step in passed):
                links[cell * headings + (heading + turn) % headings, state] = 1
    source = cells * headings
    for state, cost in zip(seeds.tolist(), seed_costs.tolist(), strict=True):
        if allowed[state // headings]:
            links[source, state] = cost + 1  # scipy takes a link of no cost for none
    at = tuple(zip(*links, strict=True))
    matrix = sparse.csr_matrix((list(links.values()), at), shape=(source + 1, source + 1))
    expected = shortest_paths(matrix, indices=source)[:-1] - 1
    assert best.tolist() == np.where(np.isinf(expected), -1, expected).tolist()


@pytest.mark.parametrize("layers", [1, 4])
def test_gaps_take_the_least_of_the_eight_cells_around(layers):
    rng = np.random.default_rng(layers)
    columns, rows, headings = 12, 9, 4
    field = rng.integers(-1, 50, (columns, rows, headings)).astype(np.int16)
    known = rng.random((columns, rows, layers)) < 0.25
    everywhere = np.broadcast_to(known, field.shape)
    shown = np.where(everywhere & (field >= 0), field, 999)
    around = ndimage.minimum_filter(shown, (3, 3, 1), mode="constant", cval=999)
    expected = np.where(everywhere, field, np.where(around == 999, -1, around))
    assert (expected == -1).any() and 0.1 < everywhere.mean() < 0.4
    assert dijkstra.fill_gaps(field.ravel(), known.ravel(), headings, rows).tolist() == expected.ravel().tolist()


# --- places, links and seeds ----------------------------------------------------------------------


@pytest.mark.parametrize("robot", [DISC, BOX], ids=["disc", "box"])
def test_a_cell_s_place_is_its_centre_or_the_most_open_of_twenty_five(robot):
    rules, maker = make_maker(robot)
    solids, sizes = maker.collision.solids, np.arange(-2, 3) * maker.size / 5
    centres = maker.grid.get_centres()
    tries = centres[:, None] + np.stack(np.meshgrid(sizes, sizes, indexing="ij"), -1).reshape(25, 2)
    clearance = compute_distance_many(tries.reshape(-1, 2), solids).reshape(-1, 25)
    least = compute_distance_many(centres, solids)
    tight = (least < maker.collision.radius) & (least + maker.size > maker.collision.inner)
    chosen = np.where(tight & (clearance.max(axis=1) > least), clearance.argmax(axis=1), 12)
    expected = tries[np.arange(len(tries)), chosen]
    assert maker.points == pytest.approx(expected, abs=1e-12) and 20 < (chosen != 12).sum()
    assert maker.standing.tolist() == (compute_distance_many(expected, solids) >= maker.collision.inner).tolist()
    assert 0.2 < maker.standing.mean() < 0.8


def test_a_box_fits_and_turns_where_the_exact_geometry_lets_it():
    rules, maker = make_maker(BOX)
    begin, can_turn = rules.make_state(rules.instance.starts[0]), []
    for cell in np.flatnonzero(maker.standing)[::7].tolist():
        x, y = maker.points[cell].tolist()
        turns = [rules.get_rotation(n, 0.0) for n in range(maker.classes + 1)]
        fits = [maker.collision.base.measure_gap(x, y, turn, maker.collision.footprints) >= 0.0 for turn in turns]
        assert maker.get_fits(np.array([cell]), maker.classes).tolist() == [fits[:-1]]
        for n in range(maker.classes):
            state = begin._replace(x=x, y=y, heading_steps=n)
            free = fits[n] and fits[n + 1] and rules.can_turn(state, turns[n + 1], rules.turn_step)
            can_turn.append(bool(maker._can_turn[cell * maker.classes + n]) == free)
    assert np.mean(can_turn) > 0.99, "but for poses in touch"


def list_ends(rules: Kinematics, maker: FieldMaker, cell: int, heading: int) -> list[tuple[float, float, int]]:
    """Where each move from a cell's place ends by the rules, and the primitives that it takes."""
    (x, y), rotation = maker.points[cell].tolist(), rules.get_rotation(heading, 0.0)
    moves = rules.actions.compute_moves(*np.array([rotation]).T, maker.macro)[0].tolist()
    puzzle = rules.instance.puzzle.make_state()
    shares = [rules.compute_free_fraction(x, y, dx, dy, puzzle, rotation) for dx, dy in moves]
    return [(x + share * dx, y + share * dy, max(1, math.ceil(share * maker.macro - 1e-9)))
            for share, (dx, dy) in zip(shares, moves, strict=True)]


@pytest.mark.nightly_for("box")
@pytest.mark.parametrize(("robot", "size"), [(DISC, (7.0, 5.0)), (BOX, (5.0, 7.0))], ids=["disc", "box"])
def test_moves_land_where_the_rules_end_them(robot, size):
    rules, maker = make_maker(robot, size)
    columns, rows = maker.shape
    moves = rules.actions.compute_moves(*maker.turns[:-1].T, maker.macro)
    landing = np.full(maker.states * moves.shape[1], -1, dtype=np.int32)
    link_cost = np.zeros(len(landing), dtype=np.int16)
    dijkstra.find_landings(maker.scene, maker.points, maker.fits, maker.turns, rows, maker.low, maker.size, moves,
                           maker.macro, 0, columns * rows, landing, link_cost)
    landing, link_cost = (each.reshape(-1, maker.classes, moves.shape[1]) for each in (landing, link_cost))
    fits, beside = maker.get_fits(np.arange(columns * rows), maker.classes), 0
    for cell, heading in zip(*np.nonzero(fits), strict=True):
        for move, (x, y, cost) in enumerate(list_ends(rules, maker, cell, heading)):
            i, j = (math.floor((at - low) / maker.size) for at, low in zip((x, y), maker.low, strict=True))
            near = [cell for cell in (near_i * rows + near_j for near_i in range(max(i - 1, 0), min(i + 2, columns))
                                      for near_j in range(max(j - 1, 0), min(j + 2, rows))) if fits[cell, heading]]
            inside = 0 <= i < columns and 0 <= j < rows and fits[i * rows + j, heading]
            end = i * rows + j if inside else min(near, default=-1, key=lambda n: math.dist(maker.points[n], (x, y)))
            beside += end >= 0 and not inside
            assert landing[cell, heading, move] == (-1 if end == cell else end)
            assert link_cost[cell, heading, move] == (0 if end in (cell, -1) else cost)
    assert (landing[~fits] == -1).all() and beside > 0


@pytest.mark.nightly_for(
    "box-press-None", "box-exit-None", "box-press-facing1", "disc-press-None", "disc-press-facing1",
    "disc-exit-facing1", "box-exit-facing1")
@pytest.mark.parametrize("facing", [None, (0, 3)])
@pytest.mark.parametrize("goal", [PressGoal(1), ExitGoal()], ids=["press", "exit"])
@pytest.mark.parametrize("robot", [DISC, BOX], ids=["disc", "box"])
def test_seeds_are_the_places_in_a_goal_and_those_a_move_away(robot, goal, facing):
    rules, maker = make_maker(robot)
    maker = maker if isinstance(goal, PressGoal) else FieldMaker(rules.instance, rules, door_shut=False)
    solved = rules.instance.puzzle.make_state() if maker.door_shut else 2 ** len(rules.instance.targets) - 1
    area, reach = compute_goal_area(goal, rules.instance)
    presser = get_presser(goal, rules.instance)
    base = rules.instance.robot.base

    def touches(x: float, y: float, rotation: tuple[float, float]) -> bool:
        near = compute_distance(x, y, area) <= reach
        if turns_anywhere(presser.outline):
            return near
        return near and base.distance(x, y, *rotation, base.size, area) <= reach - presser.outer + 1e-12

    headings = range(rules.headings) if facing else range(maker.classes)
    mask = None if facing is None else np.isin(np.arange(rules.headings), facing)
    found = maker.find_seeds(area, reach, mask, presser)
    expected: dict[int, int] = {}
    fits = maker.get_fits(np.arange(len(maker.points)), rules.headings)
    for cell in np.flatnonzero(maker.standing).tolist():
        for heading in headings:
            if not fits[cell, heading] or (facing and heading not in facing):
                continue
            (x, y), rotation = maker.points[cell].tolist(), rules.get_rotation(heading, 0.0)
            if touches(x, y, rotation):
                expected[cell * len(headings) + heading] = 0
                continue
            moves = rules.actions.compute_moves(*np.array([rotation]).T, maker.macro)[0].tolist()
            for dx, dy in moves:
                share = rules.compute_free_fraction(x, y, dx, dy, solved, rotation)
                if touches(x + share * dx, y + share * dy, rotation):
                    expected[cell * len(headings) + heading] = max(1, math.ceil(share * maker.macro - 1e-9))
    assert found.headings == len(headings) and set(expected.values()) == {0, 1}
    got = dict(zip(found.states.tolist(), found.costs.tolist(), strict=True))
    differ = {state for state in got.keys() | expected.keys() if got.get(state) != expected.get(state)}
    assert len(found.states) == len(got) and len(differ) <= 0.01 * len(expected)  # rounding, in touch


# --- sweeps ---------------------------------------------------------------------------------------


@kernel
def sweep_all(scene, places, turns, moves, needs):
    """Free fraction of a move from each place, its clearance, and whether it is clear by the grid; shape (n, 3)."""
    found = np.empty((places.shape[0], 3))
    for n in range(places.shape[0]):
        x, y, dx, dy = places[n, 0], places[n, 1], moves[n, 0], moves[n, 1]
        found[n, 0] = sweep_body(scene, x, y, turns[n], dx, dy, math.hypot(dx, dy))
        found[n, 1] = measure_clearance(scene, x, y)
        found[n, 2] = is_clear_of_all(scene, x, y, needs[n])
    return found


@pytest.mark.nightly_for("disc-size0", "box-size0")
@pytest.mark.parametrize("size", [(9.0, 5.0), pytest.param((5.0, 9.0), marks=pytest.mark.slow)])
@pytest.mark.parametrize("robot", [DISC, BOX], ids=["disc", "box"])
def test_sweeps_and_clearances_are_those_of_all_solids_from_anywhere_on_the_floor(robot, size):
    rules, maker = make_maker(robot, size)
    rng, collision, puzzle = np.random.default_rng(0), maker.collision, rules.instance.puzzle.make_state()
    places = maker.low + rng.random((1500, 2)) * maker.size * np.array(maker.shape)
    places = places[collision.are_free(places)]
    turns = np.array([rules.get_rotation(n, 0.0) for n in rng.integers(rules.headings, size=len(places)).tolist()])
    angles, lengths = rng.uniform(-math.pi, math.pi, len(places)), maker.span * rng.uniform(0.1, 1.0, len(places))
    moves = np.stack([lengths * np.cos(angles), lengths * np.sin(angles)], axis=1)
    needs = rng.uniform(0.0, collision.horizon - collision.radius - 2 * collision.slack, len(places))
    shares, near, clear = sweep_all(maker.scene, places, turns, moves, needs).T
    expected = [rules.compute_free_fraction(*place, *move, puzzle, tuple(turn)) for place, move, turn in zip(
        places.tolist(), moves.tolist(), turns.tolist(), strict=True)]
    assert shares.tolist() == expected and (shares < 1.0).sum() > 50
    exact, radius = compute_distance_many(places, collision.solids), collision.radius
    listed = np.minimum(near, exact) <= radius + maker.span
    assert near[listed] == pytest.approx(exact[listed], abs=1e-12)
    assert not clear[exact < radius + needs].any() and clear[exact > radius + needs + 2 * collision.slack].all()
    beyond = np.array([[0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [-1.0, 0.0]]) * (2 * max(size))
    assert not sweep_all(maker.scene, beyond, turns[:4], moves[:4], needs[:4] - 99.0)[:, 2].any(), "off the floor"


# --- corridors, edits, sizes ----------------------------------------------------------------------


def test_a_corridor_holds_the_cells_within_its_width_of_a_path():
    rules, whole = make_maker()
    path = np.array([(-2.0, -1.2), (0.5, -0.8), (1.5, 1.0), (1.5, 1.4)])
    width = 1.1
    maker = FieldMaker(rules.instance, rules, door_shut=True, path=path, width=width)
    away = np.full(len(maker.points), np.inf)
    for (x, y), (to_x, to_y) in zip(path[:-1].tolist(), path[1:].tolist(), strict=True):
        leg, start = np.array([to_x - x, to_y - y]), maker.grid.get_centres() - (x, y)
        share = np.clip(start @ leg / (leg @ leg), 0.0, 1.0)
        away = np.minimum(away, np.linalg.norm(start - share[:, None] * leg, axis=1))
    within = away <= width * max(rules.actions.stride, 2 * maker.size)
    assert 0.1 < within.mean() < 0.5
    assert maker.standing.tolist() == (whole.standing & within).tolist()


def list_edits(rules: Kinematics):
    """Rooms before and after an edit, and the footprints that have changed."""
    rng, room = np.random.default_rng(1), rules.instance
    box, post = (Solid(shape, *rng.uniform(-1.5, 1.5, 2).tolist(), *rng.uniform(0.1, 0.3, 2).tolist(), yaw=yaw)
                 for shape, yaw in (("box", 0.7), ("cylinder", 0.0)))
    pole = Solid("cylinder", -0.13206, -1.10908, 0.11485, 0.11485)
    nudged = dataclasses.replace(pole, x=-0.13573, y=-1.11263)
    for before, after in (((), (box,)), ((box,), (post,)), ((post,), ()), ((pole,), (nudged,))):
        rooms = [dataclasses.replace(room, solids=(*room.solids, *solids)) for solids in (before, after)]
        yield *rooms, [solid.footprint for solid in (*before, *after)]


def test_what_an_edit_leaves_is_equal_to_what_is_made_anew():
    rules, _ = make_maker()
    area, moved = compute_goal_area(PressGoal(0), rules.instance), []
    for before, after, changed in list_edits(rules):
        old, anew = (FieldMaker(room, rules, door_shut=True) for room in (before, after))
        field = old.get_field("goal", lambda maker: maker.find_seeds(*area))
        collision = old.collision.adapt(after, True, changed)
        adapted = old.adapt(after, collision, changed, lambda key: key == "goal")
        assert (collision.distance == anew.collision.distance).all()
        assert (adapted.points == anew.points).all() and (adapted.standing == anew.standing).all()
        expected = anew.make_field(anew.find_seeds(*area))
        assert (adapted.get_field("goal", lambda maker: maker.find_seeds(*area)) == expected).all()
        assert (expected != field).any()
        moved.append((anew.standing != old.standing).any() or (anew.points != old.points).any())
    assert moved == [True, True, True, False], "the last changes ends of moves only"


def test_an_edit_that_changes_no_cell_keeps_the_fields_whose_goals_it_keeps():
    rules, maker = make_maker()
    area = compute_goal_area(PressGoal(0), rules.instance)
    fields = {key: maker.get_field(key, lambda maker: maker.find_seeds(*area)) for key in ("kept", "lost")}
    wall = Solid(x=0.0, y=-20.0, half_x=0.1, half_y=0.1)
    room = dataclasses.replace(rules.instance, solids=(*rules.instance.solids, wall))
    adapted = maker.adapt(room, maker.collision.adapt(room, True, [wall.footprint]), [wall.footprint],
                          lambda key: key == "kept")
    made = []
    assert adapted.get_field("kept", made.append) is fields["kept"]
    assert (adapted.get_field("lost", lambda new: made.append(new) or new.find_seeds(*area)) == fields["lost"]).all()
    assert made == [adapted]


@pytest.mark.parametrize(("step", "size"), [(0.4, 0.1), (1.0, 0.25), (2.0, 0.25)])
def test_cells_are_a_quarter_of_a_stride_and_at_most_a_quarter_of_a_metre(step, size):
    config = RoomConfig(room=ShapeConfig(width=7, depth=5), robot=dataclasses.replace(DISC, move_step=step))
    rules = Kinematics(generate(config, 0))
    maker = FieldMaker(rules.instance, rules, door_shut=False)
    assert maker.size == pytest.approx(size) and maker.grid.shape == tuple(
        math.ceil(2 * reach / size - 1e-9) for reach in (rules.instance.reach_x, rules.instance.reach_y))
    assert stack_footprints(list(maker.collision.footprints)).shape == maker.collision.solids.shape


# --- what is cut off ------------------------------------------------------------------------------


def make_pockets(robot: RobotConfig) -> tuple[Kinematics, FieldMaker]:
    """A room with a closed corner, one whose gap is a little too narrow, and one that is open."""
    rules, _ = make_maker(robot)
    walls = [Solid(x=x, y=y, half_x=half_x, half_y=half_y) for x, y, half_x, half_y in (
        (-2.2, 1.0, 1.2, 0.1), (-1.1, 1.8, 0.1, 0.7), (2.2, 0.9, 1.2, 0.1), (1.1, 2.35, 0.1, 0.15),
        (2.2, -1.0, 0.9, 0.1))]
    room = dataclasses.replace(rules.instance, solids=(*rules.instance.solids, *walls))
    rules = Kinematics(room)
    return rules, FieldMaker(room, rules, door_shut=True)


@pytest.mark.nightly_for("box-the goal's", "disc-the goal's", "box-the start's")
@pytest.mark.parametrize("side", ["the goal's", "the start's"])
@pytest.mark.parametrize("robot", [DISC, BOX], ids=["disc", "box"])
def test_what_is_cut_off_is_exactly_what_no_field_reaches(robot, side, monkeypatch):
    rules, maker = make_pockets(robot)
    monkeypatch.setattr(cost_to_go, "EXPLORED", 1)
    if side == "the start's":
        monkeypatch.setattr(dijkstra, "grow_back", lambda *_: dijkstra.UNDECIDED)
    rng, begin, found = np.random.default_rng(0), rules.make_state(rules.instance.starts[0]), []
    for number in range(40):
        x, y = maker.points[rng.choice(np.flatnonzero(maker.standing))].tolist()
        facing = rng.random(rules.headings) < 0.3 if number % 2 else None
        seeds = maker.find_seeds(make_footprint(x, y, 0.0, 0.0, 0.0, True), 0.1, facing)
        allowed = rng.random(len(maker.points)) < 0.9 if number % 3 == 0 else None
        field = maker.make_field(seeds, allowed)
        for x, y in rng.uniform((-3.6, -2.6), (3.6, 2.6), (20, 2)).tolist():
            state = begin._replace(x=x, y=y, heading_steps=int(rng.integers(rules.headings)),
                                   heading_offset=float(rng.uniform(-0.3, 0.3)))
            found.append(maker.is_cut_off(state, seeds, allowed))
            assert found[-1] == (maker.get_cost(field, state) < 0)
    assert 0.1 < np.mean(found) < 0.9


@pytest.mark.parametrize(("explored", "decides"), [(3, True), (1000, False)])
def test_one_side_is_enough_to_explore_and_what_stays_undecided_is_not_cut_off(explored, decides, monkeypatch):
    monkeypatch.setattr(cost_to_go, "EXPLORED", explored)
    rules, maker = make_pockets(DISC)
    begin = rules.make_state(rules.instance.starts[0])
    places = {"closed": (-2.5, 1.8), "middle": (0.0, 0.0), "open": (2.5, -1.8)}
    states = {name: begin._replace(x=x, y=y) for name, (x, y) in places.items()}
    seeds = {name: maker.find_seeds(make_footprint(x, y, 0.0, 0.0, 0.0, True), 0.1) for name, (x, y) in places.items()}
    assert all(len(each.states) for each in seeds.values())
    cut_off = {(a, b) for a, b in itertools.permutations(places, 2) if maker.is_cut_off(states[a], seeds[b])}
    assert cut_off == {(a, b) for a, b in itertools.permutations(places, 2) if decides and "closed" in (a, b)}
    assert maker._known_links is None, "no field has needed them"


def test_a_field_without_seeds_needs_no_links_and_one_that_ran_out_of_time_is_made_later():
    rules, maker = make_pockets(DISC)
    nowhere = maker.find_seeds(make_footprint(0.0, 0.0, 0.0, 0.0, 0.0, True), 0.1, np.zeros(rules.headings, dtype=bool))
    assert (maker.make_field(nowhere) == -1).all() and maker._known_links is None
    seeds = maker.find_seeds(*compute_goal_area(PressGoal(0), rules.instance))
    with pytest.raises(OutOfTime):
        maker.make_field(seeds, clock=Clock(0.0))
    assert np.array_equal(maker.make_field(seeds), make_pockets(DISC)[1].make_field(seeds))


def test_an_edit_before_any_field_leaves_what_is_made_anew():
    rules, _ = make_maker()
    area = compute_goal_area(PressGoal(0), rules.instance)
    for before, after, changed in list_edits(rules):
        old, anew = (FieldMaker(room, rules, door_shut=True) for room in (before, after))
        adapted = old.adapt(after, old.collision.adapt(after, True, changed), changed, lambda key: True)
        seeds = anew.find_seeds(*area)
        assert np.array_equal(adapted.make_field(seeds), anew.make_field(seeds))
