"""Goal spaces of a room.

An agent with two levels needs a goal space: the upper level chooses a goal, and the lower level reaches it. A goal
space lists the goals, tests whether one is reached, and computes what remains of it. Every room has two goal spaces.
This tutorial follows them along a plan, trains an agent on one, and draws both.
"""

import gymnasium
import numpy as np

from hrl_escape import RoomPlanner, train
from hrl_escape.env.pictures.maps import Trajectory, draw_room
from hrl_escape.figures import LINES, get_figure_class
from hrl_escape.hierarchies import HierarchyEnv, synthesise

flat_room = gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button")
flat_room.reset(seed=0)
room, here = flat_room.unwrapped.instance, flat_room.unwrapped.get_state()
events, displacements = synthesise(room, "events", "learned"), synthesise(room, "displacements", "learned")
print("events:", *events.names, sep="\n  ")
print("displacements:", *displacements.names, sep="\n  ")

# Events are absolute: a goal is the same wherever the robot is. This prints when each event first happens on the
# planner's way out. Their order is what an agent has to learn, because the goals do not contain it.

plan = RoomPlanner(room).solve(here)
env = HierarchyEnv(flat_room, kind="events", low_level="learned")
observation, _ = env.reset(seed=0)
known, way = np.zeros(len(events.goals), bool), [(here.x, here.y)]
for step, primitive in enumerate(plan.primitives, 1):
    observation, *_ = env.step(primitive)
    way.append((flat_room.unwrapped.get_state().x, flat_room.unwrapped.get_state().y))
    for goal in np.flatnonzero(events.list_reached(observation) & ~known):
        print(f"primitive {step}: {events.names[goal]}")
    known |= events.list_reached(observation)

# Displacements are relative, so a goal is updated at each step by h(s, g, s') = s + g - s' (Nachum et al. 2018). A goal
# without this update would move with the robot.

env = HierarchyEnv(flat_room, kind="displacements", low_level="learned")
before, _ = env.reset(seed=0)
goal = displacements.goals[0]
for _ in range(2):
    after, *_ = env.step(0)
    goal, before = displacements.advance(goal, before, after), after
    print(f"left to go: {goal}")

# Each space comes with an environment to train in. The option keyboard learns a skill for each event and combines them.
# A flat agent trains in the same room, which has one button.

easy = gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-one-button", observation="features")
for agent, env in (("option-keyboard", HierarchyEnv(easy, kind="events", low_level="learned")), ("q-learning", easy)):
    result = train(agent, env, primitives=15_000, seed=0, eval_every=3_000, eval_episodes=1, progress=False)
    returns = [round(evaluation.mean_return) for evaluation in result.evaluations]
    print(f"{agent}: first escape after {result.first_escape} primitives, greedy returns {returns}")

# One seed shows how to run this, not which agent is better. [All algorithms](../results/all-algorithms.md) are compared
# in many rooms. Last, both spaces in one picture.

figure = get_figure_class()(figsize=(7.6, 3.9), layout="constrained")
panels = figure.subplots(1, 2)
for axes, title, shown in zip(panels, ("events", "displacements"), (way, way[:1]), strict=True):
    draw_room(axes, room, here, [Trajectory(shown)], names=False)
    axes.set_title(title)
for target in room.targets:
    panels[0].annotate(f"touch, on\n{target.name}", (0.72 * target.x, 0.82 * target.y), fontsize=8, ha="left")
for x, y in displacements.goals:
    panels[1].annotate("", (here.x + x, here.y + y), (here.x, here.y),
                       arrowprops={"arrowstyle": "->", "color": LINES[0]})
figure
