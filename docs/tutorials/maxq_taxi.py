r"""MAXQ on Taxi in 80 lines.

A taxi fetches a passenger and brings him to his destination. MAXQ (Dietterich 2000) splits that into tasks that call
each other: `drive` calls `get` and `put`, which call `navigate`, which calls moves. The value of a call is what the
child earns, plus what is still earned to complete the parent:

$$
Q(i,s,a) = V(a,s) + C(i,s,a), \qquad V(i,s) = \max_a Q(i,s,a)
$$

So what `navigate` learns about a depot serves `get` and `put` alike.
"""

import gymnasium
import numpy as np

from hrl_escape import generate, get_preset
from hrl_escape.agents.hierarchy.price import compute_price
from hrl_escape.agents.hierarchy.tabular_model import read_model
from hrl_escape.agents.hierarchy.task_graph import maxq

ALPHA, EPSILON, PICK_UP, PUT_DOWN = 0.25, 0.1, 4, 5
DEPOTS = [(0, 0), (0, 4), (4, 0), (4, 3)]
env = gymnasium.make("Taxi-v4")
rng = np.random.default_rng(0)
states = [tuple(map(int, env.unwrapped.decode(number))) for number in range(500)]  # row, column, passenger, destination


generate(get_preset("taxi"), 0)  # the same world as a room of this package


# The task graph: the children of each task, and where it is over. A passenger with number 4 sits in the taxi.
def at(depot):
    """The taxi stands at a depot."""
    return lambda state: state[:2] == DEPOTS[depot]


WALKS = [f"navigate {depot}" for depot in range(4)]
GRAPH = {"drive": ["get", "put"], "get": [PICK_UP, *WALKS], "put": [PUT_DOWN, *WALKS]}
GRAPH |= {walk: [0, 1, 2, 3] for walk in WALKS}
OVER = {"drive": lambda state: False, "get": lambda state: state[2] == 4, "put": lambda state: state[2] != 4}
OVER |= {walk: at(depot) for depot, walk in enumerate(WALKS)}


# What each completion depends on. Without this abstraction MAXQ has more values to learn than Q-learning.
def see(task, child, state):
    """The part of a state that matters to completing a task after a child."""
    row, column, passenger, destination = state
    if task.startswith("navigate"):
        return row, column
    if task == "drive":
        return (passenger, destination) if child == "get" else ()
    return (passenger,) if task == "get" else (destination,)


def see_primitive(action, state):
    """The part of a state that matters to what a primitive earns: nothing for moves, else if it is allowed."""
    depot = DEPOTS.index(state[:2]) if state[:2] in DEPOTS else None
    return {PICK_UP: depot == state[2], PUT_DOWN: state[2] == 4 and depot == state[3]}.get(action)


earned, completion = {}, {}


def value(task, state):
    """V: of a primitive from the table, of a task by the graph below it."""
    if isinstance(task, int):
        return earned.get((task, see_primitive(task, state)), 0.0)
    return max(value(child, state) + completion.get((task, child, see(task, child, state)), 0.0)
               for child in list_legal(task, state))


def list_legal(task, state):
    """Primitives, and the tasks that are not over; a call of zero length would loop for ever."""
    return [child for child in GRAPH[task] if isinstance(child, int) or not OVER[child](state)]


def choose(task, state, epsilon):
    """Epsilon-greedy by V + C."""
    legal = list_legal(task, state)
    if rng.random() < epsilon:
        return legal[rng.integers(len(legal))]
    return max(legal, key=lambda a: value(a, state) + completion.get((task, a, see(task, a, state)), 0.0))


def learn(table, key, target):
    """One step of the running average."""
    table[key] = table.get(key, 0.0) + ALPHA * (target - table.get(key, 0.0))


def run(task, state, epsilon):
    """Run a call to its end; returns states on the way, the state reached, the sum of rewards, and how it ended."""
    if isinstance(task, int):
        number, reward, terminated, truncated, _ = env.step(task)
        if epsilon:
            learn(earned, (task, see_primitive(task, state)), float(reward))
        return [state], states[number], reward, terminated, truncated
    way, total, terminated, truncated = [], 0.0, False, False
    while not (OVER[task](state) or terminated or truncated):
        child = choose(task, state, epsilon)
        inner, state, reward, terminated, truncated = run(child, state, epsilon)
        way, total = way + inner, total + reward
        if epsilon and not truncated:  # a call that was cut short never ended, so there is nothing to learn from it
            # Over means over for this task, not for the episode: what comes then is its caller's to complete.
            after = 0.0 if terminated or OVER[task](state) else value(task, state)
            for seen in inner:  # from every state on the child's way (undiscounted, so its length does not matter)
                learn(completion, (task, child, see(task, child, seen)), after)
    return way, state, total, terminated, truncated


def drive(seed, epsilon):
    """One episode; returns its return."""
    return run("drive", states[env.reset(seed=seed)[0]], epsilon)[2]


checks = (0, 100, 300, 1_000, 3_000)
for done, target in zip((0, *checks), checks, strict=False):
    for seed in range(done, target):
        drive(seed, EPSILON)
    greedy = np.mean([drive(seed, 0.0) for seed in range(10_000, 10_300)])
    print(f"after {target:5,} episodes: greedy return {greedy:7.2f} over 300 starts, {len(completion)} completions")

# The exact optimum of the graph, and that of all policies: this graph costs nothing.
until = {name: lambda seen, over=over: over(states[seen.observation]) for name, over in OVER.items()}
price = compute_price(read_model(env), maxq(GRAPH, until))
print(f"optimum of the graph {price.recursive:.2f}, of all policies {price.flat:.2f}")
