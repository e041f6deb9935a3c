"""Textbook domains beside hierarchies for them, whose price is on the page about hierarchies."""

from __future__ import annotations

import numpy as np

from benchmarks.optima import HierarchyPrice, TabularModel, compute_price
from hrl_escape.agents.hierarchy.machine import choose, do, machine
from hrl_escape.env.sampling.generation import generate
from hrl_escape.hierarchies import synthesise
from tests.agents.hierarchy import taxi_program
from tests.agents.hierarchy.four_rooms_tasks import HOME, make_walks
from tests.agents.hierarchy.taxi_tasks import make_taxi_tasks
from tests.classic.four_rooms import GRID, HALLWAYS, FourRooms, make_room_mask
from tests.classic.parr_maze import ParrMaze
from tests.classic.taxi import Taxi
from tests.hierarchies.tiny import TINY, enumerate_tiny

AWAY = ~make_room_mask("north-west") & ~np.isin(np.arange(len(GRID)), HALLWAYS)
"""Where the task `home` is over."""


def make_tabular_model(env) -> TabularModel:
    return TabularModel(env._rule, env.make_starts(), [env.observe(state) for state in range(env.states)])


def make_traveller(options):
    """A program that runs one option after another; which one is open."""

    @machine
    def run(seen, number):
        option = options[number]
        while not option.termination[seen().observation]:
            yield do(int(option.policy[seen().observation].argmax()))

    @machine
    def travel(seen):
        while True:
            cell = seen().observation
            yield from run((yield choose([number for number, each in enumerate(options) if each.initiation[cell]])))

    return travel


def list_prices() -> list[tuple[str, str, HierarchyPrice]]:
    """(environment, hierarchy, price)."""
    taxi, fickle = make_tabular_model(Taxi()), make_tabular_model(Taxi(fickle=True))
    graph, program = "task graph: get, put, navigate", "program: get, then put"
    rows = [
        ("Taxi", graph, compute_price(taxi, make_taxi_tasks())),
        ("Taxi", program, compute_price(taxi, taxi_program.drive, read=taxi_program.read)),
        ("Taxi, moves may slip", graph, compute_price(make_tabular_model(Taxi(noisy=True)), make_taxi_tasks())),
        ("Taxi, fickle passenger", graph, compute_price(fickle, make_taxi_tasks())),
        ("Taxi, fickle passenger", program, compute_price(fickle, taxi_program.drive, read=taxi_program.read)),
    ]
    rooms, walks = FourRooms(HOME, "direction"), make_walks(lambda seen: bool(AWAY[seen.observation]))
    rows.append(("Four Rooms, gamma 0.9", "task graph: walk to a hallway, or home",
                 compute_price(make_tabular_model(rooms), walks, 0.9)))
    maze = ParrMaze(2, horizon=None)
    rows.append(("Maze of Parr and Russell, 2 x 2", "program: one hallway after another",
                 compute_price(make_tabular_model(maze), make_traveller(maze.make_hallway_options()))))
    rows.append(("A room of 5 x 5 m, two buttons", "synthesised task graph, a planned low level",
                 compute_price(enumerate_tiny(), synthesise(generate(TINY, 0)))))
    return rows
