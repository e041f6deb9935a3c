"""A scripted policy for `push-block`: get behind the block, push it towards the plate, look, repeat, leave.

It reads where things are, plans nothing and knows nothing of physics; what the primitives really do
is looked at after each. Distances in m, directions in turn steps of 10 degrees.
"""

import itertools
import math

import numpy as np

STEPS = 36
MOVES = {0: 0, 9: 2, 18: 1, 27: 3}  # direction relative to the heading: forward, left, back, right
GAP = 0.1  # least distance between robot and block before a push
TRIPLES = np.array(list(itertools.product(range(STEPS), repeat=3)))
UNITS = np.stack([np.cos(np.radians(10 * np.arange(STEPS))), np.sin(np.radians(10 * np.arange(STEPS)))], axis=1)


class Driver:
    """Drives a room's robot by primitives and remembers how the last one ended."""

    def __init__(self, room):
        self.room, self.last, self.total = room, None, 0.0
        self.step = room.instance.robot.move_step
        prop = room.instance.props[0].prop
        self.touch = room.instance.robot.body_radius + prop.half_size
        self.clear = room.instance.robot.body_radius + math.sqrt(2) * prop.half_size + 0.05

    def do(self, action):
        if self.last is not None and self.last.terminated:
            return
        self.last = self.room.step(action)
        self.total += self.last.reward

    @property
    def at(self):
        return np.array([self.room.state.x, self.room.state.y])

    @property
    def block(self):
        return np.array(self.room.state.physics.props[0][:2])

    def move(self, direction):
        """One move in an absolute direction, by the primitive that needs the fewest turns."""
        heading = self.room.state.heading_steps
        turns = {action: (direction - offset - heading + STEPS // 2) % STEPS - STEPS // 2
                 for offset, action in MOVES.items()}
        action = min(turns, key=lambda a: abs(turns[a]))
        for _ in range(abs(turns[action])):
            self.do(4 if turns[action] > 0 else 5)
        self.do(action)

    def drive_to(self, place):
        """Whole moves while it is far, then three moves that end nearest without touching the block."""
        for _ in range(40):
            dx, dy = np.asarray(place) - self.at
            if math.hypot(dx, dy) < 2.0 * self.step:
                break
            self.move(round(math.atan2(dy, dx) / math.radians(10)) % STEPS)
        way = self.at + self.step * np.cumsum(UNITS[TRIPLES], axis=1)  # (triples, 3 moves, 2)
        error = np.linalg.norm(way[:, 2] - place, axis=1)
        middles = way - self.step * UNITS[TRIPLES] / 2
        room = np.minimum(np.linalg.norm(way[:, :2] - self.block, axis=2).min(axis=1),
                          np.linalg.norm(middles - self.block, axis=2).min(axis=1))
        inside = np.abs(way).max(axis=(1, 2)) < self.room.instance.half_width - self.room.instance.robot.body_radius
        for direction in TRIPLES[np.argmin(error + 10.0 * (room < self.clear) + 10.0 * ~inside)]:
            self.move(int(direction))


    def go_behind(self, place):
        """Drive to a place beside the block, round it where it is in the way."""
        for _ in range(6):
            here, there = self.at - self.block, np.asarray(place) - self.block
            share = np.clip(here @ (here - there) / max((here - there) @ (here - there), 1e-9), 0.0, 1.0)
            if np.linalg.norm(here + share * (there - here)) >= min(self.clear, np.linalg.norm(there) - 1e-6):
                break
            turn = math.remainder(math.atan2(there[1], there[0]) - math.atan2(here[1], here[0]), math.tau)
            angle = math.atan2(here[1], here[0]) + math.copysign(min(abs(turn), math.radians(50)), turn)
            limit = self.room.instance.half_width - self.room.instance.robot.body_radius - 0.1
            self.drive_to(np.clip(self.block + 1.7 * np.array([math.cos(angle), math.sin(angle)]), -limit, limit))
        self.drive_to(place)


def push(driver, plate):
    """Push the block once through the middle of the face that helps most, then step back."""
    x, y, z, w = driver.room.state.physics.props[0][3:7]
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    normals = [round(math.degrees(yaw + n * math.pi / 2) / 10) % STEPS for n in range(4)]
    direction = max(normals, key=lambda n: UNITS[n] @ (plate - driver.block))
    way = min(float(UNITS[direction] @ (plate - driver.block)), 1.0)
    moves = math.ceil((way + GAP) / driver.step)
    limit = driver.room.instance.half_width - driver.room.instance.robot.body_radius - 0.05
    away = driver.touch + driver.step * moves - way
    driver.go_behind(np.clip(driver.block - away * UNITS[direction], -limit, limit))
    for _ in range(moves):
        driver.move(direction)
    driver.move((direction + STEPS // 2) % STEPS)


def solve(room):
    """Play an episode of `push-block` to its end, or until nothing seems to help; returns the driver."""
    driver, plate = Driver(room), np.array([room.instance.props[1].x, room.instance.props[1].y])
    for _ in range(20):
        if room.instance.puzzle.is_solved(room.state.puzzle):
            driver.go_behind(room.instance.exit.centre)
            break
        push(driver, plate)
    return driver
