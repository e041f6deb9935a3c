"""Planned options.

Options written by hand suit one room. By default, `OptionsEnv` takes the options of the room's planner. Each is named
by a verb and its target, such as `press-button-1`, and `go-to-exit` leaves the room. The action mask marks the options
that can start.
"""

import gymnasium

import hrl_escape
from hrl_escape import OptionsEnv, RoomPlanner
from hrl_escape.benchmark import record_episode

env = OptionsEnv(gymnasium.make("hrl_escape/Clutter-v1", instance_seed=3))
_, info = env.reset(seed=0)
room = env.unwrapped.instance
print(f"{len(room.targets)} buttons, {sum(s.role == 'obstacle' for s in room.solids)} obstacles; "
      f"options: {', '.join(option.name for option in env.options)}")

# An agent has to discover which button comes first. This tutorial reads the graph of the room instead.

print("order:", ", ".join(f"{room.puzzle.target_names[a]} before {room.puzzle.target_names[b]}"
                          for a, b in room.puzzle.edges))

# The planner solves the room as a whole. Its plan has one part per option. The kinematics of the room predict every
# state, and execution visits exactly these states.

plan = RoomPlanner(room).solve(env.unwrapped.get_state())
for part in plan.parts:
    print(f"  {part.name}: {part.stop - part.start} primitives")
print(f"plan: {plan.cost} primitives, return {plan.compute_return():g}")
plan

# The same escape by options takes one decision per part, in the order of the plan. Each option takes the shortest way
# to its own goal. Together they can take a few primitives more than a plan that looks ahead.

total = 0.0
for part in plan.parts:
    _, reward, terminated, _, info = env.step(env.action_names.index(part.name))
    total += reward
    print(f"  {part.name}: {info['duration']} primitives, {info['option']['ended']}")
print(f"by options: escaped {terminated}, return {total:g}")

# Noise pushes the robot off its path. A planned option observes the state and plans again.

noisy = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", config={
    **hrl_escape.get_preset("paper-two-button").to_dict(), "dynamics": {"noise": 0.2, "slip": 0.1}}))
noisy.reset(seed=0)
replans = 0
for name in ("press-button-1", "press-button-2", "go-to-exit"):
    _, _, terminated, _, info = noisy.step(noisy.action_names.index(name))
    replans += noisy.planning_report.replans
print(f"with noise 0.2 and slip 0.1: escaped {terminated}, planned again: {replans > 0}")

# A recorded episode of the reference `sweep`, which presses 1, then 2, and leaves:

record_episode("sweep", noisy)
