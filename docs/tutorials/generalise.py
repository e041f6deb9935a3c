"""Generalise to unseen rooms.

An agent that escapes from one room may have learned that room. A rung of the ladder is a distribution over rooms, with
a set to train on and a set to be tested on; they share no room and no layout.
"""

import numpy as np

from hrl_escape import make_agent, train
from hrl_escape.benchmark import record_episode
from hrl_escape.options import DecisionMemory
from hrl_escape.sets import load_benchmark

rung = load_benchmark("ladder-1")["pair"]
print(len(rung.train), "rooms to train on,", len(rung.test), "to be tested in")
rung.test[:4]

# Rooms differ in where things are, so an agent must not see a fixed vector: `objects` gives a row an object, and a
# network that reads rows values an option by the row of its own object. `DecisionMemory` writes into the rows what the
# episode has tried. Every reset draws another room.


def make_env(rooms):
    """Options over a set of rooms, as rows of objects with what was tried."""
    return DecisionMemory(rooms.make_env(options={"include_primitives": False}, observation="objects"))


result = train("smdp-ppo+objects+memory", make_env(rung.train[:64]), primitives=6_000, seed=0, progress=False)
result

# Now the test: rooms that it has never seen, with frozen weights. Here is one of these episodes.

unseen = make_env(rung.test)
record_episode(result.agent, unseen, seed=1)

# Is that good? The random policy over the same options escapes too, and so does a search baseline: it tries what is
# unlit and untried, the nearest first. Compare a learner with both. (Twenty episodes are enough for a page, not for a
# claim: `hrl-escape ladder run` makes a report with ten seeds and intervals.)

plain = rung.test.make_env(options={"include_primitives": False})
chance = make_agent("random-options", plain.observation_space, plain.action_space, seed=0)
for name, player, env in (("learner", result.agent, unseen), ("random policy", chance, plain),
                          ("search baseline", "search-nearest", plain), ("oracle", "oracle", rung.test.make_env())):
    episodes = [record_episode(player, env, seed) for seed in range(20)]
    print(f"{name}: {sum(episode.success for episode in episodes)} of 20 escapes, "
          f"{np.mean([len(episode.states) - 1 for episode in episodes]):.0f} primitives an episode")
record_episode("search-nearest", plain, seed=1)
