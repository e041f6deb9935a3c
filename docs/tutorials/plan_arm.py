"""Plan with an arm.

The arm of a robot comes from a catalogue, from a number of joints, or from your own URDF. This tutorial finds postures
that reach a point, places for the base, a motion around a post, and an escape with presses by hand.
"""

from hrl_escape import RoomConfig, RoomPlanner, generate, get_preset
from hrl_escape.env.config import RobotConfig, ShapeConfig
from hrl_escape.env.geometry import Solid
from hrl_escape.planning import ArmPlanner, Scene

robot = RobotConfig(kind="franka-panda", joints=7, body_radius=0.4, body_height=0.5)
# your own: RobotConfig(kind="urdf", urdf=Path("arm.urdf").read_text(), joints=6, hand_link="flange")
room = generate(RoomConfig(room=ShapeConfig(width=8, depth=8), robot=robot), seed=0)
room

# Inverse kinematics returns every posture that it finds, the farthest from joint limits first.

arm = ArmPlanner(room)
state = arm.rules.make_state(room.starts[0])
x, y, z = arm.rules.get_hand(state)
target = (x - 0.1, y + 0.2, z - 0.2)
postures = arm.solve_ik(target, state)
print(f"{len(postures)} postures, joint margin {postures[0].margin:.2f} rad, "
      f"manipulability {postures[0].manipulability:.3f}")

# The map shows, for each place of the base, the share of headings that reach the same point.

arm.map_reach(target)

# Motion keeps clear of all solids, including a post that is added next to the robot.

scene = Scene.of(room, state).add("post", Solid("cylinder", state.x + 0.8, state.y, 0.05, 0.05, height=1.5))
cluttered = ArmPlanner(scene.instance)
free = [posture.angles for posture in postures if cluttered.is_free(state, posture.angles.tolist())]
path = cluttered.plan(state, free)
print(f"{len(free)} of the postures are free next to the post; {path.checks:,} places of the arm tested on the way")
scene.instance

# In a room whose buttons only the hand presses, base and arm are planned together, and the plan plays itself.

small = generate(get_preset("arm-two-button"), seed=1)
planner = RoomPlanner(small)
plan = planner.solve(planner.rules.make_state(small.starts[0]))
print(f"escape: {plan.cost} primitives, {sum(name.startswith('joint') for name in plan.instance.robot.actions.names)} "
      "of the primitives are turns of joints")
plan
