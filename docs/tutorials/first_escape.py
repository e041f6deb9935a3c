"""Your first escape.

A room is a Gymnasium environment. The robot is a disc that moves in steps of 1 m and turns by 10 degrees. Each
primitive costs 1, and an escape earns 100. The exit opens after both buttons are lit in the right order.
"""

import gymnasium

from hrl_escape import RoomPlanner
from hrl_escape.planning.best_known import best_known_return

env = gymnasium.make("hrl_escape/PaperTwoButton-v1")
observation, info = env.reset(seed=0)
room = env.unwrapped.instance
print(f"{env.action_space.n} primitives: {', '.join(env.unwrapped.rules.actions.names)}")
print(f"x {observation[0]:g}, y {observation[1]:g}, heading {observation[3]:g}, buttons {observation[6:8]}")
for target in room.targets:
    print(f"{target.name} at ({target.x:g}, {target.y:g})")
print(f"exit: x from {room.exit.x_min:g} to {room.exit.x_max:g}, y from {room.exit.y_min:g} to {room.exit.y_max:g}")
room  # in a notebook, a room draws itself

# At heading 0 the robot faces along +x, so +y is on its left. The robot is driven by hand: one primitive, repeated
# until something happens. A move stops at the first obstacle. A button is pressed when the robot begins to touch it.

FORWARD, BACK, LEFT, RIGHT = 0, 1, 2, 3
total, ended = 0.0, False


def drive(primitive, until):
    """Repeat a primitive until `until(observation, info)` holds, or the episode ends."""
    global total, ended
    count = 0
    while not ended:
        observation, reward, terminated, truncated, info = env.step(primitive)
        total, ended, count = total + reward, terminated or truncated, count + 1
        if until(observation, info):
            break
    return count


print("to button-1:", drive(LEFT, lambda seen, info: info["pressed"].any()), "primitives")
print("back beside button-2:", drive(RIGHT, lambda seen, info: seen[1] < 3), "primitives")
print("to button-2:", drive(BACK, lambda seen, info: info["pressed"].any()), "primitives")

# Both buttons are lit and the exit is open. The episode ends when the robot is in the exit.

print("to the exit, along:", drive(FORWARD, lambda seen, info: seen[0] > room.exit.x_min), "primitives")
print("to the exit, across:", drive(LEFT, lambda seen, info: False), "primitives")
print(f"escaped: {ended}, return {total:g}")

# The planner computes the best known return to compare with, and its plan plays itself.

print(f"best known return: {best_known_return(room):g}")
env.reset(seed=0)
RoomPlanner(room).solve(env.unwrapped.get_state())
