"""What keys mean."""

from __future__ import annotations

import pytest

from hrl_escape.env.primitives import make_action_table
from hrl_escape.viewer.play.commands import Controls


def name(controls: Controls, keys: str | list[str], joints: int, options: int = 3) -> str:
    """The last command of some keys, in words."""
    command = None
    for key in keys:
        command = controls.press(key)
    if command is None or command.verb != "act":
        return "" if command is None else command.verb
    names = make_action_table(joints).names
    names += tuple(f"option {n}" for n in range(options))
    return names[command.action]


@pytest.mark.parametrize(("key", "meaning"), [
    ("w", "forward"), ("s", "back"), ("a", "strafe-left"), ("d", "strafe-right"), ("up", "forward"), ("down", "back"),
    ("left", "turn-left"), ("right", "turn-right"), ("u", "joint-1-increment"), ("j", "joint-1-decrement"),
    ("z", "undo"), ("r", "reset"), ("n", "next"), ("f", "save"), ("q", "quit"),
])
def test_every_key_means_what_the_help_says(key: str, meaning: str):
    assert name(Controls(make_action_table(2), 3), [key], joints=2) == meaning


def test_digits_choose_the_joint_that_u_and_j_move():
    assert name(Controls(make_action_table(3), 3), "2u", joints=3) == "joint-2-increment"
    assert name(Controls(make_action_table(3), 3), "3j", joints=3) == "joint-3-decrement"
    assert name(Controls(make_action_table(3), 3), "34u", joints=3) == "joint-3-increment", "there is no joint 4"
    assert name(Controls(make_action_table(3), 3), "301u", joints=3) == "joint-1-increment", "nor 0, and 1 is one"
    assert Controls(make_action_table(3), 3).press("0") is None


def test_m_and_a_digit_run_a_meta_action_and_zero_is_the_exit():
    assert name(Controls(make_action_table(1), 3), "m1", joints=1) == "option 0"
    assert name(Controls(make_action_table(1), 3), "m2", joints=1) == "option 1"
    assert name(Controls(make_action_table(1), 3), "m0", joints=1) == "option 2"
    assert name(Controls(make_action_table(1), 3), "m3", joints=1) == "note"


def test_more_than_nine_meta_actions_take_two_digits():
    controls = Controls(make_action_table(0), 21)
    assert controls.press("m") is not None and name(controls, "1", 0, 21) == "note"
    assert name(controls, "2", 0, 21) == "option 11"
    assert name(controls, "m00", 0, 21) == "option 20"


def test_a_meta_action_that_is_given_up_leaves_the_next_key_its_meaning():
    assert name(Controls(make_action_table(1), 3), "mw", joints=1) == "forward"


def test_a_robot_without_an_arm_has_no_joint_to_move():
    assert name(Controls(make_action_table(0), 3), "u", joints=0) == "note"
