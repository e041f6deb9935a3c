"""The map in letters."""

from hrl_escape.env.kinematics import Kinematics
from hrl_escape.viewer.play.text_map import draw_map


def test_the_map_shows_robot_walls_buttons_exit_and_trail(clutter):
    rules = Kinematics(clutter)
    states = [rules.make_state(clutter.starts[0])]
    for action in (0, 0, 4):
        states.append(rules.step(states[-1], action).state)
    lines = draw_map(clutter, states, rules, 120, 36).plain.splitlines()
    assert len({len(line) for line in lines}) == 1 and len(lines) <= 36 and len(lines[0]) <= 120
    text = "".join(lines)
    assert all(mark in text for mark in ("1", "2", "3", "4", "E", "\N{MIDDLE DOT}", "\N{FULL BLOCK}"))
    assert sum("\N{LEFTWARDS ARROW}" <= mark <= "\N{SOUTH WEST ARROW}" for mark in text) == 1
