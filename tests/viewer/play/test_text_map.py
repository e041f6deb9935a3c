"""The map in letters."""

from hrl_escape.env.kinematics import Kinematics
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.viewer.play.terminal import draw_map


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


def test_the_map_shows_things_in_their_cells_and_inner_doors_until_they_are_open():
    room = generate(get_preset("door-key"), 0)
    rules = Kinematics(room)
    state = rules.make_state(room.starts[0])
    shut, opened = (draw_map(room, [state._replace(puzzle=puzzle)], rules, 120, 36).plain
                    for puzzle in (state.puzzle, state.puzzle | 3))
    marks = "\N{DARK SHADE}", "\N{BLACK SQUARE}"
    assert [[text.count(mark) for mark in marks] for text in (shut, opened)] == [[1, 1], [0, 1]]
