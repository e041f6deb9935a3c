import dataclasses

import numpy as np
import pytest

from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.primitives import make_action_table
from hrl_escape.env.sampling.generation import generate

PAPER = ("forward", "back", "strafe-left", "strafe-right", "turn-left", "turn-right")  # table 3


def test_the_base_has_the_papers_primitives_in_its_order():
    table = make_action_table(0)
    assert table.names == PAPER and not table.joints


@pytest.mark.parametrize("joints", [0, 1, 7])
def test_groups_divide_the_table_and_name_what_its_primitives_do(joints):
    table = make_action_table(joints)
    assert [*table.translations, *table.turns, *(action for pair in table.joints for action in pair)] == list(
        range(len(table)))
    assert [*table.translations, *table.turns] == list(table.base) and table.names[: len(PAPER)] == PAPER
    assert all(table.primitives[action].turn == 0 and table.primitives[action].joint == -1
               for action in table.translations)
    assert all(table.primitives[action].turn for action in table.turns)
    for joint, pair in enumerate(table.joints):
        steps = [(table.primitives[action].joint, table.primitives[action].joint_change) for action in pair]
        assert steps == [(joint, 1), (joint, -1)]
        assert table.find(f"joint-{joint + 1}-decrement") == pair.decrement


def test_displacements_of_translations_are_those_of_the_kinematics():
    rules = Kinematics(generate(get_preset("paper-two-button"), 0))
    state = rules.make_state(rules.instance.starts[0])
    angles = rules.turn_step * np.arange(rules.headings)
    moves = rules.actions.compute_moves(np.cos(angles), np.sin(angles))
    assert moves.shape == (rules.headings, len(rules.actions.translations), 2) and moves.flags.c_contiguous
    for heading in (0, 3, 20):
        turned = state._replace(x=0.0, y=0.0, heading_steps=heading)
        for action in rules.actions.translations:
            after = rules.step(turned, action).state
            assert (after.x, after.y) == pytest.approx(moves[heading, action], abs=1e-12)


@pytest.mark.parametrize("press_with", ["body", "hand"])
def test_waiting_is_possible_anywhere_and_leaves_position_arm_and_puzzle_alone(press_with):
    config = get_preset("arm-two-button")
    dynamics = dataclasses.replace(config.dynamics, press_with=press_with)
    rules = Kinematics(generate(dataclasses.replace(config, dynamics=dynamics), 0))
    rng, state = np.random.default_rng(0), rules.make_state(rules.instance.starts[0])
    for action in rng.integers(len(rules.actions), size=200).tolist():
        state = rules.step(state, action).state
        after = rules.step(state, rules.actions.wait).state
        assert after.pose != state.pose
        assert after.pose == state._replace(heading_steps=after.heading_steps).pose
