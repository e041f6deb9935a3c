"""Batched options of a rectangular base: fields beside the scalar rules, and decisions beside `OptionsEnv`."""

import dataclasses

import numpy as np
import pytest

from benchmarks.options_conformance import compare_options
from hrl_escape.env.config import DynamicsConfig
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.geometry import compute_distance
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.primitives import Move
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.batched.cost_to_go import OTHER_PRESS_COST, compute_instance_fields
from tests.env.test_rectangular_base import NARROW, ROBOT, SMALL, change, make_corridor

ARM = get_preset("arm-two-button")
ARM = dataclasses.replace(ARM, robot=dataclasses.replace(ARM.robot, footprint="rectangle", body_length=1.2,
                                                         body_width=0.6))
DOOR = dataclasses.replace(SMALL, exit=dataclasses.replace(SMALL.exit, door=True))
KINDS = {"strafing": (SMALL, 0.05), "by half metres": (NARROW, 0.03),
         "quarter turns": (change(SMALL, turn_step_deg=90.0), 0.03),
         "whole moves": (dataclasses.replace(SMALL, dynamics=DynamicsConfig(blocked="stay")), 0.05),
         "turns of 30 degrees": (change(SMALL, moves=(Move("spin", turn=3), Move("unspin", turn=-3))), 0.05),
         "noise": (dataclasses.replace(SMALL, dynamics=DynamicsConfig(noise=0.05)), 0.08),
         "differential": (change(SMALL, drive="differential"), 0.12), "by hand": (ARM, 0.06), "door": (DOOR, 0.05)}
"""Room configuration, and the largest share of primitives that a batch may take more."""
UNREACHABLE = 10_000.0


@pytest.mark.nightly
@pytest.mark.nightly_for(
    "strafing", "by half metres", "whole moves", "turns of 30 degrees", "differential", "by hand", "door")
@pytest.mark.parametrize("kind", KINDS)
def test_options_reach_what_options_env_reaches_in_about_as_many_primitives(kind):
    config, more = KINDS[kind]
    found = compare_options([generate(config, seed) for seed in range(3)], 40)
    assert len(found.missed) <= (kind == "noise"), "noise leads to other poses, some of which no plan leaves"
    assert found.reached > 100
    assert found.more <= more
    assert found.side_presses <= 1


@pytest.mark.nightly
def test_a_corridor_in_which_it_cannot_turn_has_ways_at_one_heading_only():
    def list_headings(width):
        """Headings from which there is a way to the exit, in the middle of the corridor."""
        fields = compute_instance_fields(make_corridor(ROBOT, width))
        i, j = (int((at - low) / fields.size) for at, low in zip((-1.0, 0.0), fields.low, strict=True))
        return np.flatnonzero(fields.values[-1, i * fields.shape[1] + j] >= 0).tolist()

    assert list_headings(0.9) == [0, 1, 17], "10 degrees to either side of along and back"
    assert list_headings(1.6) == list(range(18))


@pytest.mark.nightly_for("differential")
@pytest.mark.parametrize("kind", ["strafing", "differential"])
def test_every_cost_is_one_more_than_the_best_that_a_primitive_leads_to(kind):
    """Bellman's equation by `Kinematics.step`, at cells whose representative place is their centre."""
    room = generate(KINDS[kind][0], 1)
    fields, rules, env = compute_instance_fields(room), Kinematics(room, is_still=True), EscapeRoomEnv(instance=room)
    env.reset(seed=0)
    costs = np.where(fields.values < 0, UNREACHABLE, fields.values * fields.scales[:, None, None])
    (columns, rows), classes = fields.shape, costs.shape[2]

    def is_out(x, y):
        return room.exit.x_min <= x <= room.exit.x_max and room.exit.y_min <= y <= room.exit.y_max

    def interpolate(field, state):
        u, v = ((at - low) / fields.size - 0.5 for at, low in zip((state.x, state.y), fields.low, strict=True))
        i, j = min(max(int(u + 1e-9), 0), columns - 2), min(max(int(v + 1e-9), 0), rows - 2)
        c = state.heading_steps % classes
        total = weight = 0.0
        for k in range(4):
            at = (i + k // 2) * rows + j + k % 2
            share = (u - i if k // 2 else 1 - u + i) * (v - j if k % 2 else 1 - v + j)
            if fields.values[field, at, c] >= 0 and share > 0.0:
                total, weight = total + share * costs[field, at, c], weight + share
        return total / weight if weight > 1e-6 else UNREACHABLE

    rng, errors = np.random.default_rng(0), []
    for n in rng.integers(columns * rows * classes, size=3_000):
        cell, c = divmod(int(n), classes)
        x, y = (np.array(divmod(cell, rows)) + 0.5) * fields.size + fields.low
        field = int(rng.integers(len(costs) - 1))
        away = min(compute_distance(x, y, solid.footprint) for solid in room.solids)
        if away < room.robot.base.outer_radius + 0.01 or costs[field, cell, c] > 1_000.0 or is_out(x, y):
            continue
        here = env.get_state()._replace(x=float(x), y=float(y), heading_steps=c)
        here = here._replace(touching=rules.compute_touching(*here[:6]))
        best = UNREACHABLE
        for primitive in rules.actions.base:
            after = rules.step(here, primitive).state
            has_turned, bit = after[:2] == here[:2], 1 << field // 2  # turns that press are left to the next look
            begun = 0 if has_turned else after.touching & ~here.touching
            if after[:3] == here[:3] or (field % 2 and is_out(after.x, after.y) and not begun & bit):
                continue
            cost = 1.0 if begun & bit else 1.0 + interpolate(field, after)
            best = min(best, cost + OTHER_PRESS_COST * bool(begun & ~bit))
        errors.append(costs[field, cell, c] - best)
    errors = np.abs(errors)
    assert len(errors) > 200
    assert np.mean(errors > 0.06) < 0.01
    assert errors.max() < 0.5
