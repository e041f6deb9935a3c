"""Play MiniGrid with options, and learn from it.

`record_play` records your own play in any environment with options. Without a second argument it asks for an action at
every decision. Here a script plays MiniGrid's DoorKey with three options. Minari keeps the episodes, and an agent
learns from them.
"""

import os
import tempfile
from collections import deque

import gymnasium
import minari
import numpy as np
from gymnasium.wrappers import FlattenObservation
from minigrid.core.constants import OBJECT_TO_IDX
from minigrid.wrappers import ImgObsWrapper

from hrl_escape import OptionsEnv, train
from hrl_escape.data import from_minari, record_play, to_minari
from hrl_escape.options import FunctionOption, OptionDomain

# Options read the whole grid through a domain: the codes of all cells, the pose of the agent, and whether it carries
# the key.

LEFT, RIGHT, FORWARD, PICK_UP, TOGGLE = 0, 1, 2, 3, 5
STEPS = [(1, 0), (0, 1), (-1, 0), (0, -1)]


class Grid(OptionDomain):
    """The grid, not the agent's view of it."""

    def get_state(self, observation):
        """Cells, position, direction, and whether the key is carried."""
        env = self.env.unwrapped
        return env.grid.encode(), tuple(map(int, env.agent_pos)), int(env.agent_dir), env.carrying is not None


def find(state, name):
    """The first cell with a thing."""
    return tuple(np.argwhere(state[0][..., 0] == OBJECT_TO_IDX[name])[0].tolist())


def is_open(state):
    """Whether the door is open."""
    return state[0][find(state, "door")][2] == 0


def turn_towards(state, goal):
    """First action of a shortest way to face a cell; None once the agent faces it."""
    cells, place, heading, _ = state
    waiting, seen = deque([(place, heading, None)]), {(place, heading)}
    while waiting:
        here, way, first = waiting.popleft()
        ahead = here[0] + STEPS[way][0], here[1] + STEPS[way][1]
        if ahead == goal:
            return first
        code, _, shut = cells[ahead]
        is_free = code in map(OBJECT_TO_IDX.get, ("empty", "goal")) or (code == OBJECT_TO_IDX["door"] and not shut)
        turns = [(LEFT, here, (way - 1) % 4), (RIGHT, here, (way + 1) % 4)]
        for action, there, heading in turns + [(FORWARD, ahead, way)] * bool(is_free):
            if (there, heading) not in seen:
                seen.add((there, heading))
                waiting.append((there, heading, action if first is None else first))
    return LEFT


def use(name, action):
    """Policy: face a thing, then act on it."""
    def choose(state):
        move = turn_towards(state, find(state, name))
        return action if move is None else move

    return choose


def make_options(env):
    """Take the key, open the door, go to the goal."""
    return [FunctionOption("take-key", use("key", PICK_UP), lambda s: s[3], lambda s: not s[3] and not is_open(s)),
            FunctionOption("open-door", use("door", TOGGLE), is_open, lambda s: s[3] and not is_open(s)),
            FunctionOption("reach-goal", use("goal", FORWARD), lambda s: False, is_open)]


env = OptionsEnv(FlattenObservation(ImgObsWrapper(gymnasium.make("MiniGrid-DoorKey-6x6-v0"))), make_options,
                 discount=0.95, domain=Grid)

# Twenty episodes, each clumsy in its own way. Leave out `play` to choose yourself.

rng = np.random.default_rng(0)


def play(observation, info):
    """A legal option, or now and then a turn on the spot."""
    legal = np.flatnonzero(info["action_mask"])
    return RIGHT if rng.random() < 0.3 else legal[-1]


played = record_play(env, play, episodes=20, name="door-key")
print(played)
print("decisions of each episode:", np.bincount(played.decisions.trajectory).tolist())

# Minari keeps two sets: the decisions, with durations, discounts and legal actions among the infos, and the primitives
# inside them. Each holds a description of its environment with its options.

os.environ["MINARI_DATASETS_PATH"] = tempfile.mkdtemp()  # leave this out for Minari's own folder
for dataset in to_minari(played, namespace="mine"):
    print(f"{dataset.spec.dataset_id}: {dataset.total_episodes} episodes, {dataset.total_steps} steps")
again = minari.load_dataset("mine/door-key-decisions-v1").recover_environment()
print("actions of the recovered environment:", ", ".join(again.get_wrapper_attr("action_names")[-3:]))

# `from_minari` reads a set for agents that learn offline. Fitted Q-iteration combines the best decisions of all
# episodes. `bins=256` keeps the codes of MiniGrid's cells apart. The tests begin in other grids than the episodes.

data = from_minari("mine/door-key-decisions-v1")
result = train("smdp-fitted-q+primitives", data=data, settings={"values": "table", "bins": 256, "gamma": 0.95},
               eval_episodes=20, seed=1)
chance = train("random-options+primitives", env, primitives=1, eval_episodes=20)
for name, each in (("agent", result), ("random choice", chance)):
    print(f"{name}: mean return {each.evaluations[-1].mean_return:.2f}, "
          f"{each.evaluations[-1].mean_length:.0f} primitives an episode")

# Minari's own `DataCollector(env, record_infos=True)` records the same set while any agent acts, and `from_minari`
# reads it in the same way.

result.plot()
