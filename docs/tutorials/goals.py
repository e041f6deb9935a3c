"""Goals of a room.

A learner with two levels needs words for them to talk in: the upper level names a goal, the lower one gets there. A
goal space says which goals there are, when one is reached, and what is left of it on the way. A room has two of them
ready made. Here they are followed along a plan, given to a learner of single moves, and drawn.
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

# Events are absolute: the same goal wherever the robot is. Here is when each comes about for the first time on the
# planner's way out, in the order that the puzzle asks for. That order is what a learner has to find: its goals tell it
# what can happen here, not when.

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

# Displacements are relative, so a goal is told anew at each step, as h(s, g, s') = s + g - s' (Nachum et al. 2018). One
# that stayed as it was when it was named would run away from the robot.

env = HierarchyEnv(flat_room, kind="displacements", low_level="learned")
before, _ = env.reset(seed=0)
goal = displacements.goals[0]
for _ in range(2):
    after, *_ = env.step(0)
    goal, before = displacements.advance(goal, before, after), after
    print(f"left to go: {goal}")

# Either space goes to a learner with its environment. The option keyboard learns a skill for each event and combines
# them; beside it a flat learner, in a room with one button.

easy = gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-one-button", observation="features")
for agent, env in (("option-keyboard", HierarchyEnv(easy, kind="events", low_level="learned")), ("q-learning", easy)):
    result = train(agent, env, primitives=15_000, seed=0, eval_every=3_000, eval_episodes=1, progress=False)
    returns = [round(evaluation.mean_return) for evaluation in result.evaluations]
    print(f"{agent}: first escape after {result.first_escape} primitives, greedy returns {returns}")

# One seed shows how it is done, not which agent is better: [all algorithms](../results/all-algorithms.md) compares
# learners of goals with flat learners and search baselines. Last, both spaces in one picture.

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
