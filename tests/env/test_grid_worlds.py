"""Published grid worlds are rooms cell by cell: transitions, optimal values and learning curves, all exact."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import hrl_escape
from benchmarks.conformance import compare
from hrl_escape.env.config import DynamicsConfig, RoomConfig, ShapeConfig
from hrl_escape.env.kinematics import Kinematics, RoomState
from hrl_escape.env.noise import compute_noise, draw_chance
from hrl_escape.env.presets import FOUR_ROOMS, get_preset
from hrl_escape.env.puzzles.taxi import RIDING, Ride, TaxiPuzzle
from hrl_escape.env.sampling.generation import generate
from hrl_escape.errors import ConfigError, ContractError
from hrl_escape.planning.planner import RoomPlanner
from tests.classic.four_rooms import EAST_HALLWAY, GRID, FourRooms
from tests.env.isomorphism import GridOutcome, check_isomorphism

assert hrl_escape  # registers the environments

SOUTH, NORTH, EAST, WEST = "strafe-right", "strafe-left", "forward", "back"
TAXI_ACTIONS = (SOUTH, NORTH, EAST, WEST, "grip", "release")
"""Primitives at heading 0 that Gymnasium's actions are."""
TAXI = TaxiPuzzle()
DYNAMICS = [(False, False), (True, False), (False, True), (True, True)]


def find_keys(bounds: list[float], draw) -> list[int]:
    """A noise key for each stretch between two bounds in which the uniform number of its first primitive lies."""
    keys: dict[int, int] = {}
    for key in range(100_000):
        place = int(np.searchsorted(bounds, draw(key), side="right")) - 1
        keys.setdefault(place, key)
        if len(keys) == len(bounds) - 1:
            return [keys[n] for n in range(len(keys))]
    raise AssertionError("no such keys")


def iterate_values(outcomes: list[list[list[tuple[float, int, float, bool]]]], gamma: float) -> np.ndarray:
    """Optimal values of a finite domain: outcomes[state][action] is a list of (probability, state, reward, is over)."""
    most = max(len(rows) for row in outcomes for rows in row)
    table = np.array([[[*rows, *[(0.0, 0, 0.0, True)] * (most - len(rows))] for rows in row] for row in outcomes])
    chance, after, reward, over = np.moveaxis(table, -1, 0)
    values = np.zeros(len(outcomes))
    for _ in range(5_000):
        last, values = values, (chance * (reward + gamma * (1 - over) * values[after.astype(int)])).sum(2).max(1)
        if np.abs(values - last).max() < 1e-12:
            return values
    raise AssertionError("values must converge")


# --- Four Rooms ---------------------------------------------------------------------------


@pytest.mark.nightly_for("any", "neighbour")
@pytest.mark.parametrize("slip", ["none", "any", "neighbour"])
def test_four_rooms_have_the_published_values(slip):
    room = generate(get_preset("four-rooms", slip=slip), 0)
    rules = Kinematics(room)
    places = {(start.x, start.y): start for start in room.starts}
    cells = [(column - 6.0, 6.0 - row) for row, column in GRID.cells]
    assert set(cells) - set(places) == {cells[EAST_HALLWAY]}
    numbers = {cell: number for number, cell in enumerate(cells)}
    bounds = np.arange(37) / 36  # each slip is a whole number of these
    keys = find_keys(bounds.tolist(), lambda key: compute_noise(key, 0)[1])
    actions = [rules.actions.find(name) for name in (NORTH, SOUTH, WEST, EAST)]
    outcomes = []
    for cell in cells:
        if cell not in places:
            outcomes.append([[(1.0, 0, 0.0, True)]] * 4)
            continue
        start = rules.make_state(places[cell])
        steps = [[rules.step(start._replace(noise_key=key), action) for key in keys] for action in actions]
        outcomes.append([[(1 / 36, numbers[s.state.x, s.state.y], s.reward, s.terminated) for s in row]
                         for row in steps])
    values = iterate_values(outcomes, 0.9)
    published = FourRooms(slip="direction" if slip == "any" else slip)  # type: ignore[arg-type]  # the other two
    tables = [[[(o.probability, o.next_state, o.reward, o.terminated) for o in published.outcomes(cell, action)]
               for action in range(4)] for cell in range(len(GRID))]
    tables[EAST_HALLWAY] = outcomes[EAST_HALLWAY]
    assert np.abs(values - iterate_values(tables, 0.9)).max() < 1e-10
    if slip == "none":
        assert values[0] == pytest.approx(0.9**13), "fourteen moves from the corner"
        plan = RoomPlanner(room).solve(rules.make_state(room.starts[0]))
        assert plan.cost == 14 and plan.compute_return() == 1.0


# --- Taxi ---------------------------------------------------------------------------------


class GymTaxi:
    """Gymnasium's own table of Taxi, its fickle rule, and what chances stand for; states end with `settled`."""

    primitives = TAXI_ACTIONS

    def __init__(self, rainy: bool, fickle: bool) -> None:
        self.env, self.rainy, self.fickle = gymnasium.make("Taxi-v4", is_rainy=rainy).unwrapped, rainy, fickle

    def list_states(self):
        for number in range(500):
            row, column, passenger, destination = self.env.decode(number)
            if passenger != destination:
                yield number, False
                if self.fickle:
                    yield number, True

    def list_drifts(self, state, action):
        """Outcomes (probability, state, reward, is over) for each way the taxi may go: a fickle passenger's choices."""
        number, settled = state
        before = self.env.decode(number)
        for probability, after, reward, over in self.env.P[number][action]:
            row, column, passenger, destination = self.env.decode(after)
            if not self.fickle or settled or before[2] != RIDING or (row, column) == before[:2]:
                yield [(probability, (after, settled), float(reward), over)]
                continue
            changed = [self.env.encode(row, column, passenger, (destination + turn) % 4) for turn in range(4)]
            yield [((0.1 if turn else 0.7) * probability, (other, True), float(reward), over)
                   for turn, other in enumerate(changed)]

    def list_outcomes(self, state, action):
        return [outcome for outcomes in self.list_drifts(state, action) for outcome in outcomes]

    def step(self, state, action, slip, chance):
        """A slip below 0.2 goes to one side, then to the other; a chance of 0.7 or more turns the destination."""
        drifts = list(self.list_drifts(state, action))
        drift = 0
        if len(drifts) == 3 and slip < 0.2:
            left_first = action in (0, 2)  # of north and west, Gymnasium's left is the room's second side
            drift = 1 if (slip < 0.1) == left_first else 2
        outcomes = drifts[drift]
        _, after, reward, over = outcomes[0 if chance < 0.7 or len(outcomes) == 1 else 1 + int((chance - 0.7) / 0.1)]
        return GridOutcome(after, reward, over)

    def encode(self, state):
        number, settled = state
        row, column, passenger, destination = self.env.decode(number)
        delivered = passenger == destination
        return 2.0 * column - 4.0, 4.0 - 2.0 * row, TAXI.encode(Ride(passenger, destination, settled, delivered))


def make_taxi(rainy: bool, fickle: bool) -> gymnasium.Env:
    return gymnasium.make("hrl_escape/EscapeRoom-v1", config=get_preset("taxi", rainy=rainy, fickle=fickle))


def decode(state: RoomState) -> int:
    """Gymnasium's number of a room's state."""
    ride = TAXI.decode(state.puzzle)  # type: ignore[arg-type]  # of this puzzle
    return ((round(2 - state.y / 2) * 5 + round(state.x / 2 + 2)) * 5 + ride.passenger) * 4 + ride.destination


@pytest.mark.nightly_for("True-True-None", "False-True-None")
@pytest.mark.parametrize(("rainy", "fickle", "published"), [
    (False, False, 7.93), (True, False, 3.9546), (False, True, None), (True, True, None)])
def test_optimal_values_of_taxi_in_the_room_are_those_of_the_domain(rainy, fickle, published):
    """Dynamic programming over the room's own steps, beside that over Gymnasium's table."""
    domain = GymTaxi(rainy, fickle)
    states = list(domain.list_states())
    numbers = {state: n for n, state in enumerate(states)}
    tables = [[[(p, numbers.get(s, 0), r, over) for p, s, r, over in domain.list_outcomes(state, action)]
               for action in range(6)] for state in states]
    rules = Kinematics(generate(get_preset("taxi", rainy=rainy, fickle=fickle), 0))
    slips = [0.0, 0.1, 0.2, 1.0] if rainy else [0.0, 1.0]
    chances = [0.0, 0.7, 0.8, 0.9, 1.0] if fickle else [0.0, 1.0]
    odds = np.outer(np.diff(slips), np.diff(chances)).ravel()
    draws = [[compute_noise(key, 0)[1], draw_chance(key, 0)] for key in range(400)]
    bins = [(np.searchsorted(slips, a) - 1) * (len(chances) - 1) + np.searchsorted(chances, b) - 1 for a, b in draws]
    keys = [bins.index(n) for n in range(len(odds))]
    actions = [rules.actions.find(name) for name in TAXI_ACTIONS]
    codes = {domain.encode(state): n for state, n in numbers.items()}
    start = rules.make_state(rules.instance.starts[0])
    outcomes = []
    for state in states:
        x, y, puzzle = domain.encode(state)
        touching = rules.compute_touching(x, y, *start.pose[2:])
        here = start._replace(x=x, y=y, puzzle=puzzle, touching=touching)
        rows = []
        for action in actions:
            steps = [rules.step(here._replace(noise_key=key), action) for key in (keys if action < 6 else keys[-1:])]
            rows.append([(p, codes.get((s.state.x, s.state.y, s.state.puzzle), 0), s.reward, s.terminated)
                         for p, s in zip(odds if action < 6 else (1.0,), steps, strict=True)])
        outcomes.append(rows)
    inside, outside = iterate_values(outcomes, 1.0), iterate_values(tables, 1.0)
    assert np.abs(inside - outside).max() < 1e-9
    begins = [n for (number, settled), n in numbers.items()
              if not settled and domain.env.initial_state_distrib[number] > 0]
    assert len(begins) == 300
    assert published is None or inside[begins].mean() == pytest.approx(published, abs=5e-5)


@pytest.mark.parametrize(("rainy", "fickle"), DYNAMICS)
def test_taxi_is_gymnasiums_transition_by_transition(rainy, fickle):
    assert check_isomorphism(make_taxi(rainy, fickle), GymTaxi(rainy, fickle), pairs=800) == 800


def test_a_planted_difference_is_found():
    with pytest.raises(ContractError, match="what the action does"):
        check_isomorphism(make_taxi(False, False), GymTaxi(True, False), pairs=800)


def learn(reset, step, episodes: int) -> list[float]:
    """Returns of tabular Q-learning; all that differs between two domains is where they come from."""
    rng, table, returns = np.random.default_rng(7), np.zeros((500, 6)), []
    for episode in range(episodes):
        state, total, over = reset(episode), 0.0, False
        while not over:
            action = int(rng.integers(6)) if rng.random() < 0.1 else int(table[state].argmax())
            after, reward, terminated, truncated = step(action)
            table[state, action] += 0.5 * (reward + 0.99 * (not terminated) * table[after].max() - table[state, action])
            state, total, over = after, total + reward, terminated or truncated
        returns.append(total)
    return [*returns, float(table.sum())]


@pytest.mark.nightly
def test_learning_curves_of_taxi_carry_over_to_the_bit():
    """The same starts and the same learner: Gymnasium's Taxi and the room's give the same curve and the same table."""
    room, taxi = make_taxi(False, False), gymnasium.make("Taxi-v4")
    actions = [room.unwrapped.rules.actions.find(name) for name in TAXI_ACTIONS]

    def reset_room(seed: int) -> int:
        room.reset(seed=seed)
        return decode(room.unwrapped.get_state())

    def reset_taxi(seed: int) -> int:
        taxi.reset(seed=seed)
        taxi.unwrapped.s = reset_room(seed)
        return taxi.unwrapped.s

    def step_room(action: int):
        _, reward, terminated, truncated, _ = room.step(actions[action])
        return decode(room.unwrapped.get_state()), float(reward), terminated, truncated

    def step_taxi(action: int):
        state, reward, terminated, truncated, _ = taxi.step(action)
        return state, float(reward), terminated, truncated

    starts = {reset_room(seed) for seed in range(200)}
    assert len(starts) > 100
    curve = learn(reset_room, step_room, 40)
    assert curve == learn(reset_taxi, step_taxi, 40)
    assert np.mean(curve[30:40]) > np.mean(curve[:10]), "something is learned"


@pytest.mark.nightly_for("four-rooms", "puddle-world", "foraging")
@pytest.mark.parametrize("config", [
    get_preset("taxi", rainy=True, fickle=True), get_preset("four-rooms", slip="neighbour"), get_preset("puddle-world"),
    get_preset("foraging"),
], ids=lambda c: c.name)
@pytest.mark.nightly_for("taxi")
def test_both_engines_agree_on_the_grid(config):
    found = compare([generate(config, 0)], 3_000, copies=30)
    assert not found.disagreements, found.disagreements[0]
    assert found.worst == 0.0 and found.close_calls == 0


@pytest.mark.parametrize(("rainy", "fickle"), [(False, False), (True, True)])
def test_the_planner_drives_every_ride(rainy, fickle):
    """Without rain, in as many primitives as the optimum; in rain and with fickle passengers, by planning anew."""
    from hrl_escape.options import pursue

    env = make_taxi(rainy, fickle)
    planner = RoomPlanner(env.unwrapped.instance)
    for seed in range(6):
        env.reset(seed=seed)
        if not rainy:
            state = env.unwrapped.get_state()
            plan = planner.solve(state)
            assert plan.compute_return() == 21 - plan.cost
        done = pursue(env, planner=planner)
        assert done.escaped and sum(done.rewards) <= 15


# --- Puddle World --------------------------------------------------------------------------


class Puddles:
    """The published square without its noise, on the lattice of its moves; places count twentieths."""

    primitives = (EAST, WEST, NORTH, SOUTH)
    moves = ((1, 0), (-1, 0), (0, 1), (0, -1))

    def list_states(self):
        return [(i, j) for i in range(21) for j in range(21) if not self.is_goal(i, j)]

    def is_goal(self, i, j):
        return i + j >= 38

    def price(self, i, j):
        """400 times the distance to the nearest edge of a puddle, by cases; its middle line is along an axis."""
        x, y = i / 20, j / 20
        first = np.hypot(x - np.clip(x, 0.1, 0.45), y - 0.75)
        second = np.hypot(x - 0.45, y - np.clip(y, 0.4, 0.8))
        return 400 * max(0.1 - min(first, second), 0.0)

    def step(self, state, action, slip, chance):
        i, j = (min(max(at + by, 0), 20) for at, by in zip(state, self.moves[action], strict=True))
        return GridOutcome((i, j), float(np.round(-1.0 - self.price(i, j), 9)), self.is_goal(i, j))

    def encode(self, state):
        return state[0] - 10.0, state[1] - 10.0, int(self.is_goal(*state))


class RoundedRewards(gymnasium.RewardWrapper):
    """Rewards to nine digits, for square roots differ in the last one."""

    def reward(self, reward):
        return float(np.round(reward, 9))


@pytest.mark.nightly
def test_puddle_world_is_the_published_square_and_its_values_are_those_of_the_domain():
    env = RoundedRewards(gymnasium.make("hrl_escape/PuddleWorld-v1"))
    domain = Puddles()
    states = domain.list_states()
    assert len(states) == 441 - 6
    assert check_isomorphism(env, domain) == 4 * len(states)
    numbers = {state: n for n, state in enumerate(states)}
    published = [[[(1.0, numbers.get(o.state, 0), o.reward, o.is_over)]
                  for o in (domain.step(state, action, 0.0, 0.0) for action in range(4))] for state in states]
    rules = Kinematics(env.unwrapped.instance)
    actions = [rules.actions.find(name) for name in domain.primitives]
    places = {domain.encode(state)[:2]: n for state, n in numbers.items()}
    start = rules.make_state(rules.instance.starts[0])
    inside = []
    for place in places:
        steps = [rules.step(start._replace(x=place[0], y=place[1], touching=0), action) for action in actions]
        inside.append([[(1.0, places.get((s.state.x, s.state.y), 0), s.reward, s.terminated)] for s in steps])
    values = iterate_values(inside, 1.0)
    assert np.abs(values - iterate_values(published, 1.0)).max() < 1e-6
    assert values[numbers[0, 0]] == -38.0, "along the edges, past both puddles"
    between = values[numbers[4, 12]]  # (0.2, 0.6) lies between the puddles: the way out goes round
    shortest = RoomPlanner(rules.instance).solve(start._replace(x=-6.0, y=2.0))
    assert shortest.cost == 22 and shortest.compute_return() < between < -22, "the shortest way wades"


@pytest.mark.nightly
def test_all_starts_of_puddle_world_are_outside_the_corner():
    room = generate(get_preset("puddle-world"), 0)
    assert len(room.starts) == 441 - 9


# --- Foraging ------------------------------------------------------------------------------


class Worms:
    """A bird in three corridors joined at the left, and a worm at the right end of one; row 0 is the upper one."""

    primitives = (*TAXI_ACTIONS[:4], "grip")
    moves = ((1, 0), (-1, 0), (0, 1), (0, -1))

    def list_states(self):
        return [(row, column, worm, eaten) for row in range(3) for column in range(3) for worm in range(3)
                for eaten in range(4)]

    def list_outcomes(self, state, action):
        """Outcomes of one action, all alike: of a worm eaten, the two corridors of the next."""
        row, column, worm, eaten = state
        if action == 4:
            if (row, column) != (worm, 2):
                return [(state, 0.0, False)]
            return [((row, column, (worm + turn) % 3, eaten + 1), 1.0, eaten == 3) for turn in (1, 2)]
        down, right = self.moves[action]
        then = (row + down, column + right)
        is_open = 0 <= then[0] < 3 and 0 <= then[1] < 3 and (not down or column == 0)
        return [((*(then if is_open else (row, column)), worm, eaten), 0.0, False)]

    def step(self, state, action, slip, chance):
        outcomes = self.list_outcomes(state, action)
        return GridOutcome(*outcomes[int(chance * len(outcomes))])

    def encode(self, state):
        row, column, worm, eaten = state
        return 2.0 * column - 2.0, 2.0 - 2.0 * row, 3 * eaten + worm


def test_foraging_is_three_corridors_and_the_best_bird_is_the_domains():
    env = gymnasium.make("hrl_escape/Foraging-v1")
    domain = Worms()
    states = domain.list_states()
    assert check_isomorphism(env, domain) == 5 * len(states)
    numbers = {state: n for n, state in enumerate(states)}
    codes = {domain.encode(state): n for state, n in numbers.items()}
    published = [[[(1 / len(found), numbers.get(s, 0), r, over) for s, r, over in found]
                  for found in (domain.list_outcomes(state, action) for action in range(5))] for state in states]
    rules = Kinematics(env.unwrapped.instance)
    start = rules.make_state(rules.instance.starts[0])
    keys = [next(key for key in range(99) if (draw_chance(key, 0) < 0.5) == half) for half in (True, False)]
    actions = [rules.actions.find(name) for name in domain.primitives]
    inside = []
    for x, y, puzzle in codes:
        touching = rules.compute_touching(x, y, *start.pose[2:])
        begins = [start._replace(x=x, y=y, puzzle=puzzle, touching=touching, noise_key=key) for key in keys]
        steps = [[rules.step(begin, action) for begin in begins] for action in actions]
        inside.append([[(0.5, codes.get((s.state.x, s.state.y, s.state.puzzle), 0), s.reward, s.terminated)
                        for s in pair] for pair in steps])
    values = iterate_values(inside, 0.95)
    assert np.abs(values - iterate_values(published, 0.95)).max() < 1e-9
    # each next worm is five or six moves away, or seven primitives with the eating at most
    assert values[numbers[0, 2, 0, 3]] == 1.0
    assert values[numbers[1, 2, 1, 2]] == pytest.approx(1 + 0.95**6), "from the middle both others are five moves away"
    assert values[numbers[0, 2, 0, 2]] == pytest.approx(1 + (0.95**6 + 0.95**7) / 2)


def test_the_planner_eats_every_worm_wherever_it_appears():
    from hrl_escape.options import pursue

    env = gymnasium.make("hrl_escape/Foraging-v1")
    planner = RoomPlanner(env.unwrapped.instance)
    for seed in range(4):
        env.reset(seed=seed)
        done = pursue(env, planner=planner)
        assert done.escaped and sum(done.rewards) == 4.0
        assert 4 + 3 * 5 <= len(done.rewards) <= 4 * 7


# --- what is refused ------------------------------------------------------------------------


def test_maps_must_fill_the_floor_and_physics_has_no_lattice():
    with pytest.raises(ConfigError, match="rows and columns of cells"):
        ShapeConfig(width=10, depth=11, map=FOUR_ROOMS)
    with pytest.raises(ConfigError, match="under physics"):
        RoomConfig(dynamics=DynamicsConfig(kind="physics", blocked="stay"))
