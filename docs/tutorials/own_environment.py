"""Add options to your own environment.

Options do not need a room. This tutorial writes a small Gymnasium environment, gives it three options and checks them.
It then trains an agent over options and a flat agent with the same budget.
"""

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit

from hrl_escape import OptionsEnv, train
from hrl_escape.checks import check_option
from hrl_escape.options import FunctionOption

# The environment is a courier on a 12 x 12 floor, who fetches a parcel in one corner and brings it to the door in
# another. Each move costs 1, and the delivery earns 50. The observation is row, column, and whether the courier has the
# parcel. Options read this observation.

SIZE, PARCEL, DOOR = 12, (1, 10), (10, 2)
MOVES = NORTH, SOUTH, WEST, EAST = range(4)
STEPS = [(-1, 0), (1, 0), (0, -1), (0, 1)]


class Courier(gymnasium.Env):
    """Fetch the parcel, bring it to the door."""

    observation_space = spaces.MultiDiscrete([SIZE, SIZE, 2])
    action_space = spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        """Begin anywhere, without the parcel."""
        super().reset(seed=seed)
        self.place, self.carries = tuple(self.np_random.integers(SIZE, size=2).tolist()), False
        return self.observe(), {}

    def step(self, action):
        """Move one cell; walls hold."""
        (row, column), (down, right) = self.place, STEPS[action]
        self.place = min(max(row + down, 0), SIZE - 1), min(max(column + right, 0), SIZE - 1)
        self.carries |= self.place == PARCEL
        delivered = self.carries and self.place == DOOR
        return self.observe(), 49.0 if delivered else -1.0, delivered, False, {}

    def observe(self):
        """Row, column, 1 with the parcel."""
        return np.array([*self.place, self.carries])


# An option is three functions: initiation, policy and termination. Two options walk to a place. The third walks at
# random. It draws from the generator in its arguments, so runs with the same seed are equal.


def walk_to(goal):
    """Make the policy of the shortest way to a place."""
    def choose(state):
        row, column, _ = state
        if row != goal[0]:
            return SOUTH if row < goal[0] else NORTH
        return EAST if column < goal[1] else WEST

    return choose


def is_at(goal):
    """Make the test of having arrived."""
    return lambda state: float(tuple(state[:2]) == goal)


fetch = FunctionOption("fetch", walk_to(PARCEL), is_at(PARCEL), initiation=lambda state: state[2] == 0)
to_the_door = FunctionOption("to-the-door", walk_to(DOOR), is_at(DOOR), lambda state: not is_at(DOOR)(state))
stroll = FunctionOption("stroll", lambda state, rng: rng.choice(MOVES), lambda state: 0.2, is_stochastic=True)

# `check_option` tests the contract. It plays at random, starts the option in the states reached, and runs it twice.

for option in (fetch, to_the_door, stroll):
    check_option(option, Courier())

# `OptionsEnv` makes the SMDP. One `step` runs a primitive, or an option to its end. `info` has the transition.


def make_env():
    """The courier with its options; 200 primitives an episode at most."""
    return OptionsEnv(TimeLimit(Courier(), 200), [fetch, to_the_door, stroll], discount=0.99)


env = make_env()
_, info = env.reset(seed=0)
print(f"actions: {', '.join(env.action_names)}")
for name in ("stroll", "fetch", "to-the-door"):
    _, reward, _, _, info = env.step(env.action_names.index(name))
    print(f"{name}: {info['duration']} primitives, {info['option']['ended']}, reward {reward:g}, "
          f"gamma^k {info['discount']:.3f}")

# Any agent trains on it. The same tabular Q-learning chooses options in one run and primitives in the other. Both have
# 8,000 primitives, and both are evaluated on the same five starts.

settings = {"learning_rate": 1.0, "epsilon_steps": 4_000}
results = []
for agent, learned_on in (("smdp-q-learning+primitives", make_env()), ("q-learning", TimeLimit(Courier(), 200))):
    result = train(agent, learned_on, primitives=8_000, seed=0, settings=settings, progress=False)
    print(f"{agent}: mean return {result.evaluations[-1].mean_return:.1f} after {result.decisions:,} decisions")
    results.append(result)
results[0].plot(beside=results[1:])

# The options contain knowledge of the floor. Always run the random policy over the same options as well
# (`random-options+primitives`), to see what learning adds.

random_policy = train("random-options+primitives", make_env(), primitives=8_000, seed=0, progress=False)
print(f"random-options+primitives: mean return {random_policy.evaluations[-1].mean_return:.1f}")
results[0].plot(beside=[random_policy, results[1]])
