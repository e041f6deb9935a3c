"""Learn from many rooms at once.

A batch steps many rooms together, with options. Options have different durations, and each room takes its next decision
when the last one ends. The picture shows 24 primitives of eight rooms with blocks to grip. Each bar is a decision.
"""

import time

import torch

from hrl_escape import train
from hrl_escape.benchmark import record_episode
from hrl_escape.figures import get_figure_class
from hrl_escape.options import DecisionMemory, VectorDecisionMemory
from hrl_escape.sets import load_benchmark

freight = load_benchmark("ladder-1")["freight"].train[:8]
batch = freight.make_vec(8, options={"include_primitives": False}, compile=False)
batch.reset(0)
torch.manual_seed(0)
decisions, began = [], torch.zeros(8, dtype=torch.int64)
for step in range(1, 25):
    legal = batch.action_mask.float()
    done = batch.step(torch.multinomial(legal, 1).squeeze(1))  # read only where a room waits
    decisions += [(room, int(began[room]), step, batch.action_names[done.action[room]])
                  for room in done.where.nonzero().squeeze(1).tolist()]
    began[done.where] = step


def draw(bars):
    """One row a room, one bar a decision, named by its option."""
    figure = get_figure_class()(figsize=(8, 3), layout="constrained")
    axes = figure.subplots()
    for room, begin, end, name in bars:
        color = f"C{batch.action_names.index(name) % 10}"
        axes.barh(room, end - begin, left=begin, edgecolor="white", color=color)
        axes.text(begin + 0.2, room, name, va="center", fontsize=7)
    axes.set(xlabel="primitives", ylabel="room")
    return figure


draw(decisions)

# An agent reads the same values as in one room: observation, action, $R$, $k$, $\gamma^k$ and legal actions. `train`
# takes a batch instead of an environment. `VectorDecisionMemory` adds what each episode has tried to the rows of
# `objects`. The rooms are 16 of a rung's training set, and each episode draws one of them.

pair = load_benchmark("ladder-1")["pair"]
arguments = {"options": {"include_primitives": False}, "observation": "objects"}
rooms = pair.train[:16]
unseen = DecisionMemory(pair.test.make_env(**arguments))
rows = {"eval_env": unseen, "eval_every": 4_000, "progress": False}
start = time.perf_counter()
many = train("smdp-ppo+objects+memory", VectorDecisionMemory(rooms.make_vec(16, **arguments, compile=False)),
             primitives=12_000, **rows)
print(f"16 rooms at once: {many.primitives:,} primitives in {time.perf_counter() - start:.0f} s")
many

# The agent was evaluated in unseen rooms. This is one of the episodes:

episode = record_episode(many.agent, unseen, seed=1)
print(f"an unseen room: {'escaped' if episode.success else 'stuck'} after {len(episode.states) - 1} primitives")
episode

# With `compile=True`, the default, a step is one compiled kernel. Compiling takes half a minute once and pays off from
# a few hundred rooms on. On the command line: `hrl-escape train smdp-ppo+objects+memory --num-envs 256`.
# [Generalisation](../results/generalisation.md) has results for budgets of a million primitives and for transfer
# between rungs, and [budgets](../results/budgets.md) for the budgets of the ladder.
