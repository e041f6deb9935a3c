"""Without pybullet, kinematic rooms run, plan and learn; physics and pictures say what to install."""

from __future__ import annotations

from tests.command_line import run_python

SCRIPT = """
import sys
sys.modules["pybullet"] = None  # an import of it then fails, as where it is not installed

import gymnasium
import hrl_escape
from hrl_escape import OptionsEnv, RoomPlanner, train
from hrl_escape.errors import MissingExtraError

env = OptionsEnv(gymnasium.make("hrl_escape/PaperOneButton-v1"))
env.reset(seed=0)
*_, info = env.step(env.action_names.index("press-button-1"))  # which is at the exit
print("escaped", info["is_success"])
room = env.unwrapped
print("planned", RoomPlanner(room.instance).solve(room.rules.make_state(room.instance.starts[0])).cost)
print("trained", train("smdp-q-learning+primitives", env, primitives=50, eval_episodes=0).primitives >= 50)
print("drawn", len(room.instance._repr_svg_()) > 1000)
for arguments in ({"id": "hrl_escape/PushBlock-v1"}, {"id": "hrl_escape/PaperOneButton-v1", "render_mode": "rgb_array"},
                  {"id": "hrl_escape/PaperOneButton-v1", "observation": "pixels"}):
    try:
        made = gymnasium.make(**arguments)
        made.reset(seed=0)
        made.render()
    except MissingExtraError as error:
        print("refused", arguments["id"], error)
"""


def test_kinematic_rooms_run_and_physics_and_pictures_name_the_extra():
    done = run_python(SCRIPT)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[:4] == ["escaped True", "planned 9", "trained True", "drawn True"]
    assert len(lines) == 7 and all("needs pybullet" in line and "[bullet]" in line for line in lines[4:])


def test_a_kinematic_room_does_not_load_pybullet():
    done = run_python("import gymnasium, sys, hrl_escape\n"
                      "env = gymnasium.make('hrl_escape/PaperOneButton-v1')\nenv.reset(seed=0)\nenv.step(0)\n"
                      "print('pybullet' in sys.modules)")
    assert done.stdout == "False\n", done.stderr
