"""Generalise to unseen rooms.

An agent that escapes from one room can have memorised that room. A rung of the ladder is a distribution over rooms,
with one set for training and one for testing. The two sets share no room and no layout.
"""

import numpy as np

from hrl_escape import make_agent, train
from hrl_escape.benchmark import record_episode
from hrl_escape.options import DecisionMemory
from hrl_escape.sets import load_benchmark

rung = load_benchmark("ladder-1")["pair"]
print(len(rung.train), "rooms to train on,", len(rung.test), "to be tested in")
rung.test[:4]

# Rooms differ in the places of their objects, so a fixed vector does not fit. The observation `objects` has one row per
# object, and the network values an option by the row of its object. `DecisionMemory` adds what the episode has tried to
# the rows. Every reset draws another room.


def make_env(rooms):
    """Options over a set of rooms, as rows of objects with what was tried."""
    return DecisionMemory(rooms.make_env(options={"include_primitives": False}, observation="objects"))


result = train("smdp-ppo+objects+memory", make_env(rung.train[:64]), primitives=6_000, seed=0, progress=False)
result

# Now the test, with frozen weights in unseen rooms. This is one of the episodes.

unseen = make_env(rung.test)
record_episode(result.agent, unseen, seed=1)

# The random policy over the same options escapes too. So does the search baseline, which tries the nearest button that
# is unlit and untried. Compare the trained agent with both. Twenty episodes suffice for a tutorial; for a claim,
# `hrl-escape ladder run` writes a report with ten seeds and intervals.

plain = rung.test.make_env(options={"include_primitives": False})
random_policy = make_agent("random-options", plain.observation_space, plain.action_space, seed=0)
for name, player, env in (("learner", result.agent, unseen), ("random policy", random_policy, plain),
                          ("search baseline", "search-nearest", plain), ("oracle", "oracle", rung.test.make_env())):
    episodes = [record_episode(player, env, seed) for seed in range(20)]
    print(f"{name}: {sum(episode.success for episode in episodes)} of 20 escapes, "
          f"{np.mean([len(episode.states) - 1 for episode in episodes]):.0f} primitives an episode")
record_episode("search-nearest", plain, seed=1)
