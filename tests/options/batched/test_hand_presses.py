"""Presses by hand in a batch: beside `OptionsEnv`, the exact rules of the room, and themselves interrupted."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from benchmarks.options_conformance import compare_options
from hrl_escape.env.config import CONTACT_SKIN, ObstaclesConfig
from hrl_escape.env.geometry import compute_distance, compute_first_contact
from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.options.batched.cost_to_go import compute_instance_fields
from hrl_escape.options.batched.env import ENDINGS, BatchedOptionsEnv
from hrl_escape.options.batched.hand_policy import CHOSEN
from hrl_escape.options.degraded import OptionDegradation
from hrl_escape.planning.goals import PressGoal
from hrl_escape.planning.planner import get_planner
from tests.env.rooms import all_configs
from tests.options.batched.test_batched_env import begin, decide, play

ARM = get_preset("arm-two-button")
NOISY = dataclasses.replace(ARM, dynamics=dataclasses.replace(ARM.dynamics, noise=0.05, slip=0.1))
CLUTTERED = dataclasses.replace(ARM, obstacles=ObstaclesConfig(count=8))
SEVEN = all_configs()["seven-joints"]


def make_env(count=1, config=ARM, seed=0, **more):
    return begin(BatchedOptionsEnv(count, instance=generate(config, seed), include_primitives=False, **more))


@pytest.mark.nightly
@pytest.mark.nightly_for("noise")
@pytest.mark.parametrize(("config", "decisions", "most"), [
    (ARM, 20, 0.06), pytest.param(CLUTTERED, 10, 0.08, marks=pytest.mark.slow),
    pytest.param(SEVEN, 10, 0.12, marks=pytest.mark.slow), (NOISY, 10, 0.08)], ids=["arm", "clutter", "seven", "noise"])
def test_what_options_env_presses_by_hand_is_pressed_in_about_as_many_primitives(config, decisions, most):
    found = compare_options([generate(config, seed) for seed in range(2)], decisions)
    assert found.reached == found.decisions == 2 * decisions and found.missed == []
    assert found.side_presses == 0, "other targets are not touched on the way"
    assert found.planned > 100 and -0.02 < found.more < most


@pytest.mark.nightly
def test_rooms_pressed_by_hand_go_on_without_the_planner():
    env = make_env(16)
    generator, pressed = torch.Generator().manual_seed(0), 0
    for _ in range(60):
        done = env.step(torch.multinomial(env.action_mask.float(), 1, generator=generator).squeeze(1))
        pressed += int((done.where & (done.pressed != 0)).sum())
    assert pressed > 30
    assert env._host_planner._planners == {}, "no planner was ever asked"


@pytest.mark.nightly_for("arm", "seven")
@pytest.mark.parametrize(("config", "least"), [(ARM, 5), (SEVEN, 1)], ids=["arm", "seven"])
def test_every_press_by_hand_is_one_that_the_exact_rules_of_the_room_make(config, least):
    """Each state is reached from the one before by one primitive of the scalar rules, with the same presses."""
    env = make_env(4, config)
    rules, targets = Kinematics(env.room.instances[0]), len(env.room.instances[0].targets)
    generator, presses, joint_steps = torch.Generator().manual_seed(1), 0, 0
    for _ in range(50):
        before = [env.room.get_room_state(room) for room in range(4)]
        done = env.step(torch.multinomial(env.action_mask.float(), 1, generator=generator).squeeze(1))
        for room, state in enumerate(before):
            after = env.room.get_room_state(room)
            if after.primitives != state.primitives + 1:
                continue  # another episode
            steps = [rules.step(state, action) for action in range(len(rules.actions))]
            same = [step for step in steps if step.state.heading_steps == after.heading_steps
                    and step.state.joint_steps == after.joint_steps
                    and math.hypot(step.state.x - after.x, step.state.y - after.y) < 1e-6]
            assert same and same[0].state.touching == after.touching and same[0].state.puzzle == after.puzzle
            joint_steps += after.joint_steps != state.joint_steps
            if done.where[room] and ENDINGS[done.ended[room]] == "reached" and int(done.action[room]) < targets:
                assert after.touching & ~state.touching == 1 << int(done.action[room]), "this press, and no other"
                presses += 1
    assert presses >= 10 and joint_steps >= least


@pytest.mark.nightly
def test_a_hand_presses_from_any_posture_and_any_pose():
    env = make_env(12, dataclasses.replace(ARM, start=dataclasses.replace(ARM.start, choices=8)), seed=3)
    rng, rules = np.random.default_rng(0), Kinematics(env.room.instances[0])
    for room in range(env.count):
        state = env.room.get_room_state(room)
        posture = tuple(int(n) for n in rng.integers(rules.robot.step_low, np.array(rules.robot.step_high) + 1))
        state = state._replace(joint_steps=posture, heading_steps=int(rng.integers(36)))
        env.room.set_room_state(room, state._replace(touching=rules.compute_touching(*state.pose)))
    lasted = []
    for _ in range(60):
        done = env.step(torch.arange(12) % 2)
        for room in done.where.nonzero().squeeze(1).tolist():
            assert ENDINGS[done.ended[room]] == "reached" and int(done.pressed[room]) == 1 << int(done.action[room])
            lasted.append(int(done.duration[room]))
    assert len(lasted) >= 24 and max(lasted) <= 45


@pytest.mark.nightly
def test_a_press_that_is_held_is_let_go_and_made_again():
    env = make_env()
    decide(env, 0)
    before = env.room.get_room_state(0)
    done = decide(env, 0)
    assert before.touching & 1 and int(done.pressed) == 1 and int(done.duration) == 2, "away and back"


@pytest.mark.nightly
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_target_that_no_hand_reaches_costs_one_primitive(noise):
    room = generate(dataclasses.replace(ARM, dynamics=dataclasses.replace(ARM.dynamics, noise=noise)), 0)
    high = (dataclasses.replace(room.targets[0], z=9.0), *room.targets[1:])
    env = begin(BatchedOptionsEnv(2, instance=dataclasses.replace(room, targets=high), include_primitives=False))
    before = env.room.get_room_state(0)
    done = env.step(torch.tensor([0, 1]))
    assert done.where.tolist() == [True, False]
    assert (ENDINGS[done.ended[0]], int(done.duration[0]), int(done.pressed[0])) == ("planning-failed", 1, 0)
    after = env.room.get_room_state(0)
    assert (after.x, after.y) == (before.x, before.y) and after.heading_steps != before.heading_steps


@pytest.mark.nightly
def test_a_hand_sets_out_for_the_postures_from_which_least_is_left_and_keeps_them_while_it_gets_nearer():
    """The four least over all postures, by the arrays of the fields, cell by cell."""
    env = make_env(6, CLUTTERED)
    fields, instance, checked = compute_instance_fields(env.room.instances[0]), env.room.instances[0], 0
    assert fields.postures is not None
    before = None
    for number in range(30):
        states, waits = [env.room.get_room_state(room) for room in range(6)], env.is_waiting
        env.step(torch.tensor([number % 2, 1 - number % 2] * 3))
        running = env._get_begun()[1]
        for room, state in enumerate(states):
            chosen = running.postures[:, room].tolist()
            if waits[room]:
                left = [compute_left(fields, instance, state, int(running.goal[room]), n) for n in range(64)]
                assert len(set(chosen)) == CHOSEN
                assert [left[n] for n in chosen] == pytest.approx(sorted(left)[:CHOSEN], abs=0.01)
                checked += 1
            elif before is not None and before.stalled[room] == 0 and before.age[room] > 0:
                assert chosen == before.postures[:, room].tolist()
        before = running
    assert checked >= 12


def compute_left(fields, instance, state, target, number):
    """Joint steps to a posture, and the interpolated way of the base to where it presses."""
    library, angle = fields.postures, math.tau * state.heading_steps / fields.values.shape[2] + state.heading_offset
    field = library.fields[target, number]
    ahead, left = library.hands[target, number, :2] - library.approaches[field, 1:3]
    x = state.x + math.cos(angle) * ahead - math.sin(angle) * left
    y = state.y + math.sin(angle) * ahead + math.cos(angle) * left
    u, v = (np.maximum((x, y) - np.array(fields.low), 0.0) / fields.size - 0.5).clip(min=0.0)
    i, j = min(int(u), fields.shape[0] - 2), min(int(v), fields.shape[1] - 2)
    total = weight = 0.0
    for k in range(4):
        share = abs(1 - k // 2 - min(u - i, 1.0)) * abs(1 - k % 2 - min(v - j, 1.0))
        value = fields.values[field, (i + k // 2) * fields.shape[1] + j + k % 2, state.heading_steps]
        total, weight = total + (value >= 0) * share * value * fields.scales[field], weight + (value >= 0) * share
    steps = int(np.abs(library.steps[target, number] - np.array(state.joint_steps)).sum())
    return max(total / weight if weight > 1e-6 else 10_000.0, 1.0) + steps


# --- kinds of options ------------------------------------------------------------------------


@pytest.mark.nightly
def test_an_interrupted_press_by_hand_takes_the_primitives_of_one_that_is_not():
    whole, cut = make_env(), make_env(interruptible=True)
    for choice in (1, 0, 1):
        expected, primitives = int(decide(whole, choice).duration), 0
        while True:
            done = decide(cut, choice)
            primitives += int(done.duration)
            if ENDINGS[done.ended] != "interrupted":
                break
        assert ENDINGS[done.ended] == "reached" and primitives == expected > 1
        assert cut.room.get_room_state(0) == whole.room.get_room_state(0)


@pytest.mark.nightly
def test_ancestors_by_hand_are_pressed_first():
    env = make_env(option_set="press-with-ancestors")
    orders, state = get_planner(env.room.instances[0]).orders, env.room.get_room_state(0)
    order = max((orders.find_ancestors(state, PressGoal(n)) for n in range(2)), key=len)
    done = decide(env, order[-1].target)
    assert len(order) == 2 and int(done.pressed) == sum(1 << goal.target for goal in order)
    assert ENDINGS[done.ended] == "reached"


@pytest.mark.nightly
def test_options_by_hand_fail_and_dawdle_where_asked():
    env = make_env(8, options=OptionDegradation(failure=0.5, detour=2, seed=3))
    endings = [ENDINGS[done] for _ in range(40) for found in [env.step(torch.zeros(8, dtype=torch.int64))]
               for done in found.ended[found.where]]
    assert {"reached", "planning-failed"} == set(endings)


# --- rooms do not know of each other, and go on from a checkpoint -----------------------------


@pytest.mark.nightly
def test_a_room_pressed_by_hand_meets_the_same_fate_alone_and_in_any_batch():
    instance = generate(NOISY, 1)
    together = play(BatchedOptionsEnv(6, instance=instance), list(range(6)), 40)
    again = play(BatchedOptionsEnv(2, instance=instance), [4, 1], 40)
    assert torch.equal(again, together[[4, 1]])


@pytest.mark.slow
def test_compiled_presses_by_hand_do_what_eager_ones_do():
    """From the same states, but for primitives of equal cost, which the last bits of costs tell apart."""
    instance = generate(NOISY, 0)
    eager, compiled = (BatchedOptionsEnv(8, instance=instance, compile=compile) for compile in (False, True))
    for env in (eager, compiled):
        env.reset(torch.arange(8))
    generator, apart = torch.Generator().manual_seed(0), 0
    for _ in range(60):
        compiled.load_state_dict(eager.state_dict())
        action = torch.randint(eager.actions, (8,), generator=generator)
        for env in (eager, compiled):
            env.step(action)
        apart += int(((eager.observation - compiled.observation).abs() > 1e-5).any(1).sum())
    assert apart <= 5, f"{apart} of 480 steps"


@pytest.mark.nightly
def test_rooms_pressed_by_hand_go_on_where_they_were_written_down():
    env, other = make_env(4, NOISY), make_env(4, NOISY)
    for number in range(12):
        env.step(torch.full((4,), number % 2))
    other.load_state_dict(env.state_dict())
    for number in range(20):
        found, again = (one.step(torch.full((4,), number % 2)) for one in (env, other))
        assert all(torch.equal(a, b) for a, b in zip(found, again, strict=True))


# --- fields -----------------------------------------------------------------------------------


@pytest.mark.nightly
def test_fields_of_postures_are_zero_in_touch_and_else_one_more_than_the_best_that_a_primitive_leads_to():
    """Bellman's equation by the scalar rules, in a field of each target; touches by the hand's own kinematics."""
    instance = generate(ARM, 2)
    fields, rules = compute_instance_fields(instance), Kinematics(instance, is_still=True)
    costs = np.where(fields.values < 0, 10_000.0, fields.values * fields.scales[:, None, None])
    (columns, rows), headings = fields.shape, fields.values.shape[2]
    library, radius, rng = fields.postures, instance.robot.body_radius + CONTACT_SKIN, np.random.default_rng(0)
    assert library is not None
    solids = [solid.footprint for solid in instance.solids]
    errors, touches = [], 0
    for number, (target, *hand) in enumerate(library.approaches):
        posture = next(tuple(row.tolist()) for row, place in zip(
            library.steps[int(target)], library.hands[int(target)], strict=True) if np.allclose(place, hand))
        assert np.allclose(rules.get_hand_in_base(posture, ()), hand, atol=1e-6)
        near = np.flatnonzero((costs[number] < 3.0).ravel())
        for n in [*rng.choice(near, 60), *rng.integers(costs[number].size, size=60)]:
            cell, h = divmod(int(n), headings)
            x, y = (np.array(divmod(cell, rows)) + 0.5) * fields.size + fields.low
            if any(compute_distance(x + dx, y + dy, solid) < radius
                   for solid in solids for dx in (-0.2, 0.0, 0.2) for dy in (-0.2, 0.0, 0.2)):
                continue
            touching = rules.compute_touching(x, y, h, 0.0, posture, ()) >> int(target) & 1
            assert (costs[number, cell, h] < 0.01) == bool(touching)
            touches += touching
            exit_ = instance.exit
            is_by_exit = exit_.x_min - 1 <= x <= exit_.x_max + 1 and exit_.y_min - 1 <= y <= exit_.y_max + 1
            if touching or is_by_exit or costs[number, cell, h] > 1_000.0:
                continue
            best = 1.0 + min(costs[number, cell, (h + 1) % headings], costs[number, cell, h - 1])
            angle = h * rules.turn_step
            moves = rules.actions.compute_moves(np.array([math.cos(angle)]), np.array([math.sin(angle)]))[0]
            for dx, dy in instance.robot.move_step * moves:
                free = min(1.0, *(compute_first_contact(x, y, dx, dy, radius, solid) for solid in solids))
                if free * instance.robot.move_step < 0.01:
                    continue
                u, v = ((x + free * dx, y + free * dy) - np.array(fields.low)) / fields.size - 0.5
                i, j = min(max(math.floor(u + 1e-9), 0), columns - 2), min(max(math.floor(v + 1e-9), 0), rows - 2)
                shares = {(i + k // 2) * rows + j + k % 2: (u - i if k // 2 else 1 - u + i) * (
                    v - j if k % 2 else 1 - v + j) for k in range(4)}
                shares = {at: max(share, 0.0) for at, share in shares.items() if fields.values[number, at, h] >= 0}
                if sum(shares.values()) > 1e-6:
                    best = min(best, 1.0 + sum(share * costs[number, at, h] for at, share in shares.items())
                               / sum(shares.values()))
            errors.append(abs(costs[number, cell, h] - best))
    assert touches >= 30 and len(errors) > 300
    assert np.mean(np.array(errors) > 0.06) < 0.01
