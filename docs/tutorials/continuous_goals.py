"""Goals for velocities.

A manager sets goals on the floor, and a worker drives towards them (HAC, HIRO, HRAC). The picture shows the four rooms
and the starts and goals of 200 episodes. Actions are velocities, and a step lasts a tenth of a second.
"""

import gymnasium
import numpy as np

from hrl_escape.agents import train
from hrl_escape.env.mazes import Maze
from hrl_escape.figures import get_figure_class

maze = Maze("four-rooms")
starts, goals = maze.place(np.random.default_rng(0).random((200, 6)))


def draw(paths, points=()):
    """The map, with paths and points."""
    figure = get_figure_class()(figsize=(4, 4), layout="constrained")
    axes = figure.subplots()
    width, depth = 2 * maze.half
    axes.imshow(~maze.is_free.T, origin="lower", extent=(-width / 2, width / 2, -depth / 2, depth / 2), cmap="Greys")
    for path in paths:
        axes.plot(*np.array(path).T)
    for place, label in points:
        axes.plot(*np.array(place).T, "o", markersize=3, label=label)
    axes.set(xlabel="x, m", ylabel="y, m")
    axes.legend()
    return figure


draw([], [(starts, "start"), (goals, "goal")])

# 64 mazes step at once as tensors. HAC learns at two levels: the upper level sets a point as goal for up to ten steps,
# the lower level chooses velocities. Both learn in hindsight. The budget here is small: the measured runs
# on the page of HAC have eight times as much.

many = gymnasium.make_vec("hrl_escape/PointMaze-v1", num_envs=64, maze="u", max_steps=60)
settings = {"hidden": [32, 32], "max_updates": 2, "warmup": 500}
result = train("hac", many, primitives=6_000, settings=settings, eval_episodes=2, eval_every=6_000, progress=False)
print(f"{result.primitives:,} primitives, {len(result.evaluations)} evaluations")

# A policy shows its goals while it drives: `list_calls` lists the goals of all levels, with their places on the floor.
# In a room, `hrl-escape watch` draws them as ghosts.

env = many.unwrapped.make_single_env()
policy = result.agent.make_policy()
policy.begin_episode(np.random.default_rng(0))
seen, _ = env.reset(seed=1)
path, subgoals, is_over = [seen["observation"]], [], False
while not is_over:
    action = policy.choose(seen, np.ones(0, bool))
    subgoals.append(result.agent.list_calls()[-1].place)
    seen, _, terminated, truncated, _ = env.step(action)
    path.append(seen["observation"])
    is_over = terminated or truncated
maze = Maze("u")
draw([path], [(subgoals, "goals of the lower level"), ([seen["desired_goal"]], "goal of the episode")])
