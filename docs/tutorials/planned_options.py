"""Planned options.

Options written by hand suit one room. Without any, `OptionsEnv` has the room's planner make them. Each is named by a
verb and its target, such as `press-button-1`, and `go-to-exit` leaves. The action mask marks those that can start.
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

# An agent has to discover which button comes first. Here we read the room's graph instead.

print("order:", ", ".join(f"{room.puzzle.target_names[a]} before {room.puzzle.target_names[b]}"
                          for a, b in room.puzzle.edges))

# The planner solves the room as a whole. Its plan has one part per option. The room's own kinematics predict every
# state, so executing the plan meets exactly those states.

plan = RoomPlanner(room).solve(env.unwrapped.get_state())
for part in plan.parts:
    print(f"  {part.name}: {part.stop - part.start} primitives")
print(f"plan: {plan.cost} primitives, return {plan.compute_return():g}")
plan

# The same escape by options, one decision each, in the plan's order. Each option takes the shortest way to its own
# goal, so together they may take a few primitives more than a plan that looks ahead.

total = 0.0
for part in plan.parts:
    _, reward, terminated, _, info = env.step(env.action_names.index(part.name))
    total += reward
    print(f"  {part.name}: {info['duration']} primitives, {info['option']['ended']}")
print(f"by options: escaped {terminated}, return {total:g}")

# Under noise the robot soon leaves the planned path. A planned option observes the state and plans again.

noisy = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", config={
    **hrl_escape.get_preset("paper-two-button").to_dict(), "dynamics": {"noise": 0.2, "slip": 0.1}}))
noisy.reset(seed=0)
replans = 0
for name in ("press-button-1", "press-button-2", "go-to-exit"):
    _, _, terminated, _, info = noisy.step(noisy.action_names.index(name))
    replans += noisy.planning_report.replans
print(f"with noise 0.2 and slip 0.1: escaped {terminated}, planned again: {replans > 0}")

# Such an episode, recorded: the reference `sweep` presses 1, then 2, and leaves.

record_episode("sweep", noisy)
