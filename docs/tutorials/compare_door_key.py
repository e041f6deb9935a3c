"""Compare agents in MiniGrid with options of your own.

MiniGrid's DoorKey hides a goal behind a locked door. Three options of our own fetch the key, open the door and walk to
the goal. One call trains a flat DQN, DQN over the options, and the random policy over the options, with ten seeds each.
"""

import gymnasium
import numpy as np
from gymnasium.wrappers import FlattenObservation
from minigrid.wrappers import FullyObsWrapper, ImgObsWrapper

from hrl_escape import compare
from hrl_escape.options import FunctionOption

# `compare` takes a function that makes the environment, because every run needs its own. The observation is the grid,
# three numbers a cell: what is there, its colour and its state.

LEFT, RIGHT, AHEAD, PICK_UP, TOGGLE = 0, 1, 2, 3, 5
EMPTY, DOOR, KEY, GOAL, AGENT = 1, 4, 5, 8, 10


def make_env():
    """The grid of 6 x 6 cells, as 108 numbers."""
    return FlattenObservation(ImgObsWrapper(FullyObsWrapper(gymnasium.make("MiniGrid-DoorKey-6x6-v0"))))


# An option is made of three functions of the observation: policy, termination and initiation. Here all three ask for
# the shortest way to a cell that faces an object, by breadth-first search over places and headings. Where there is no
# way, the option ends and cannot start. The door can be tried without the key, and then never opens.


def walk_to(name, kind, condition, last):
    """Make the option that walks to an object in some state and then acts on it."""
    def plan(state):
        grid = np.reshape(state, (6, 6, 3))
        place = np.argwhere(grid[..., 0] == AGENT)[0].tolist()
        ways = {(*place, int(grid[(*place, 2)])): []}
        waiting = list(ways)
        for x, y, heading in waiting:
            ahead = x + (1, 0, -1, 0)[heading], y + (0, 1, 0, -1)[heading]
            if (grid[ahead][0], grid[ahead][2]) == (kind, condition):
                return [*ways[x, y, heading], last]
            moves = {LEFT: (x, y, (heading - 1) % 4), RIGHT: (x, y, (heading + 1) % 4)}
            if grid[ahead][0] == EMPTY or (grid[ahead][0], grid[ahead][2]) == (DOOR, 0):
                moves[AHEAD] = (*ahead, heading)
            for action, reached in moves.items():
                if reached not in ways:
                    ways[reached] = [*ways[x, y, heading], action]
                    waiting.append(reached)
        return []

    return FunctionOption(name, lambda s: plan(s)[0], lambda s: float(not plan(s)), lambda s: bool(plan(s)))


def make_options(env):
    """Fetch the key, open the locked door, walk to the goal."""
    return [walk_to("fetch-key", KEY, 0, PICK_UP), walk_to("open-door", DOOR, 2, TOGGLE),
            walk_to("go-to-goal", GOAL, 0, AHEAD)]


# `options` goes to the agents that choose among options. The flat DQN gets the environment without them.

result = compare(["dqn", "smdp-dqn", "random-options"], env=make_env, options=make_options, seeds=10,
                 primitives=1_000, eval_every=500, eval_episodes=2, progress=False)
result

# The score is the return, because MiniGrid states no best return of a layout. With ten seeds the verdict rests on
# paired tests, corrected for all pairs of agents. `report` writes the page with curves, tables and tests, and the raw
# numbers with it. Curves against decisions show what an option saves. The budget of 1,000 primitives is small, so that
# the page builds quickly. The numbers say nothing about trained flat agents, which need far more: take 100,000 before
# you judge them.

print(result.verdict[0].text)
print(result.report("door-key"))
result.plot(against="decisions")
