r"""MAXQ on Taxi.

A taxi fetches a passenger and drives him to his destination. MAXQ (Dietterich 2000) splits this into tasks that call
each other. `drive` calls `get` and `put`, which call four ways to `navigate`, which call moves. The value of a call is
what the child earns, plus what is still earned to complete the parent:

$$
Q(i,s,a) = V(a,s) + C(i,s,a), \qquad V(i,s) = \max_a Q(i,s,a)
$$

Both `get` and `put` therefore use what `navigate` learns about a depot.
"""

import gymnasium

from benchmarks.optima import compute_price, read_model
from hrl_escape import generate, get_preset, make_agent, train
from hrl_escape.agents import maxq

env = gymnasium.make("Taxi-v4")
generate(get_preset("taxi"), 0)  # the same world as a room of this package

# The task graph lists the children of each task and when it ends. A passenger with number 4 sits in the taxi.

PICK_UP, PUT_DOWN, MOVES = 4, 5, range(4)
DEPOTS = {f"navigate {number}": place for number, place in enumerate([(0, 0), (0, 4), (4, 0), (4, 3)])}


def read(number):
    """Row, column, passenger, destination."""
    return tuple(map(int, env.unwrapped.decode(int(number))))


def is_riding(seen):
    """The passenger sits in the taxi."""
    return seen.state[2] == 4


graph = {"drive": ["get", "put"], "get": [PICK_UP, *DEPOTS], "put": [PUT_DOWN, *DEPOTS]} | {
    walk: [*MOVES] for walk in DEPOTS}
until = {"get": is_riding, "put": lambda seen: not is_riding(seen)} | {
    walk: lambda seen, place=place: seen.state[:2] == place for walk, place in DEPOTS.items()}

# The state abstraction says what each value depends on: `navigate` reads the cell, `get` the passenger, `put` the
# destination. Without it, MAXQ has more values to learn than Q-learning.

depot_of = {place: number for number, place in enumerate(DEPOTS.values())}
see = {("drive", "get"): lambda seen: seen.state[2:], ("drive", "put"): lambda seen: 0}
see |= {("get", walk): lambda seen: seen.state[2] for walk in DEPOTS}
see |= {("put", walk): lambda seen: seen.state[3] for walk in DEPOTS}
see |= {walk: lambda seen: seen.state[:2] for walk in DEPOTS} | {move: lambda seen: 0 for move in MOVES}
for pick, key, place in (("get", PICK_UP, 2), ("put", PUT_DOWN, 3)):  # legal where the depot is the one asked for
    see[key] = see[pick, key] = lambda seen, place=place: (
        is_riding(seen) == (place == 3) and depot_of.get(seen.state[:2]) == seen.state[place])
tasks = maxq(graph, until, see, read=read)

# The best policy of this graph and the best policy of all are computed exactly. The graph costs nothing here.

price = compute_price(read_model(env), tasks)
print(f"optimum of the graph {price.recursive:.2f}, of all policies {price.flat:.2f}")

# MAXQ-Q and Q-learning train with the same primitives, learning rates and evaluation episodes.

settings = {"gamma": 1.0, "learning_rate": 0.25, "epsilon_start": 0.3, "epsilon_end": 0.1}
results = []
for name, structure in (("maxq-q", {"hierarchy": tasks}), ("q-learning", {})):
    agent = make_agent(name, env.observation_space, env.action_space, 0, structure=structure, **settings)
    results.append(train(agent, env, primitives=40_000, seed=0, eval_every=8_000, eval_episodes=50, progress=False))
    print(f"{name}: mean return {results[-1].evaluations[-1].mean_return:.2f} after 40,000 primitives")
learned, flat = results
learned.plot(beside=[flat])
