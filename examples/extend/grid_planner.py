"""A path planner: breadth-first search on a square grid, and straight lines between places in sight."""

from collections import deque

import numpy as np

CELL = 0.5  # side of a cell, m


def make_grid_planner(collision):
    """Make the planner of a room, which keeps nothing between queries."""
    return find_grid_path


def find_grid_path(problem):
    """Find places from the start to the first goal that is met, shape (n, 2), or None."""
    start, goals = tuple(problem.start.tolist()), [tuple(goal) for goal in problem.goals.tolist()]
    before, queue = {(0, 0): None}, deque([(0, 0)])
    while queue:
        cell = queue.popleft()
        x, y = start[0] + CELL * cell[0], start[1] + CELL * cell[1]
        for goal in goals:
            if np.hypot(goal[0] - x, goal[1] - y) < 2 * CELL and problem.is_move_free(x, y, *goal):
                return shorten([*trace(before, cell, start), goal], problem)
        for column, row in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            near = cell[0] + column, cell[1] + row
            if near not in before and problem.is_move_free(x, y, x + CELL * column, y + CELL * row):
                before[near] = cell
                queue.append(near)
    return None


def trace(before, cell, start):
    """Return the places from the start to a cell."""
    places = []
    while cell is not None:
        places.append((start[0] + CELL * cell[0], start[1] + CELL * cell[1]))
        cell = before[cell]
    return places[::-1]


def shorten(places, problem):
    """Leave out places between two that are in sight of each other."""
    kept = [places[0]]
    for place, following in zip(places[1:], places[2:], strict=False):
        if not problem.is_move_free(*kept[-1], *following):
            kept.append(place)
    return np.array([*kept, places[-1]])
