"""Cost-to-go fields of batched options against Bellman's equation, backed up state by state by the scalar rules."""

import dataclasses
import math

import numpy as np
import pytest

from hrl_escape.env.config import CONTACT_SKIN, ObstaclesConfig
from hrl_escape.env.geometry import compute_distance, compute_first_contact
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.batched.cost_to_go import OTHER_PRESS_COST, compute_instance_fields
from tests.options.batched.test_batched_env import SMALL, WITH_DOOR

UNREACHABLE = 10_000.0
CLUTTERED = dataclasses.replace(SMALL, obstacles=ObstaclesConfig(count=3, size_max=0.8))


@pytest.mark.nightly_for("cluttered", "door")
@pytest.mark.parametrize("config", [SMALL, CLUTTERED, WITH_DOOR], ids=["small", "cluttered", "door"])
def test_every_cost_is_one_more_than_the_best_that_a_primitive_leads_to(config):
    instance = generate(config, 1)
    fields, rules = compute_instance_fields(instance), Kinematics(instance, is_still=True)
    costs = np.where(fields.values < 0, UNREACHABLE, fields.values * fields.scales[:, None, None])
    (columns, rows), classes = fields.shape, costs.shape[2]
    exit_, reaches = instance.exit, [instance.compute_press_reach(target) for target in instance.targets]
    solids, radius = [solid.footprint for solid in instance.solids], instance.robot.body_radius + CONTACT_SKIN
    rng, errors = np.random.default_rng(0), []

    def look(x, y):
        """Targets touched at a place, and whether it is in the exit."""
        touched = {k for k, target in enumerate(instance.targets) if compute_distance(x, y, target.footprint)
                   <= reaches[k]}
        return touched, exit_.x_min <= x <= exit_.x_max and exit_.y_min <= y <= exit_.y_max

    def interpolate(field, x, y, c):
        u, v = (x - fields.low[0]) / fields.size - 0.5, (y - fields.low[1]) / fields.size - 0.5
        i, j = min(max(math.floor(u + 1e-9), 0), columns - 2), min(max(math.floor(v + 1e-9), 0), rows - 2)
        total = weight = 0.0
        for k in range(4):
            at = (i + k // 2) * rows + j + k % 2
            share = (u - i if k // 2 else 1 - u + i) * (v - j if k % 2 else 1 - v + j)
            if fields.values[field, at, c] >= 0 and share > 0.0:
                total += share * costs[field, at, c]
                weight += share
        return total / weight if weight > 1e-6 else UNREACHABLE

    def fits(x, y):
        return all(compute_distance(x, y, solid) >= radius for solid in solids)

    last = len(costs) - 1
    for n in rng.integers(columns * rows * classes, size=1_500):
        cell, c = divmod(int(n), classes)
        x, y = (np.array(divmod(cell, rows)) + 0.5) * fields.size + fields.low
        field = int(rng.integers(len(costs)))
        goal = field // 2 if field < last else None
        is_solved = field == last or field % 2 == 1
        around = [fits(x + dx, y + dy) for dx in (-0.3, 0.0, 0.3) for dy in (-0.3, 0.0, 0.3)]
        is_by_door = instance.door is not None and compute_distance(x, y, instance.door.footprint) < 1.0
        if not all(around) or is_by_door or costs[field, cell, c] > 1_000.0:
            continue
        start = look(x, y)[0]
        best = 1.0 + min(costs[field, cell, (c + 1) % classes], costs[field, cell, c - 1])
        angle = c * rules.turn_step + fields.offset
        moves = rules.actions.compute_moves(np.array([math.cos(angle)]), np.array([math.sin(angle)]))[0]
        for dx, dy in instance.robot.move_step * moves:
            stands = solids if is_solved or instance.door is None else [*solids, instance.door.footprint]
            free = min(1.0, *(compute_first_contact(x, y, dx, dy, radius, solid) for solid in stands))
            touched, is_in_exit = look(x + free * dx, y + free * dy)
            begun = touched - start
            if goal in begun or (goal is None and is_in_exit):
                cost = 1.0
            elif free * instance.robot.move_step < 0.01 or (is_solved and is_in_exit):
                continue
            else:
                cost = 1.0 + interpolate(field, x + free * dx, y + free * dy, c)
            best = min(best, cost + OTHER_PRESS_COST * bool(begun - {goal}))
        errors.append(abs(costs[field, cell, c] - best))
    assert len(errors) > 200
    assert np.mean(np.array(errors) > 0.06) < 0.005, "all but those whose moves end on the very edge of the exit"
