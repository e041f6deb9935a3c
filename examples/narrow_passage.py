"""Drive a rectangular base through a doorway that is narrower than the base is long.

Run it:

    python examples/narrow_passage.py
    python examples/narrow_passage.py --drive strafing --draw passage.svg

The robot must point through the doorway. The planner computes the headings where the base fits and the places where it
can turn. The environment executes every plan as predicted.
"""

import argparse

from hrl_escape import RoomConfig, RoomPlanner, generate
from hrl_escape.env import EscapeRoomEnv
from hrl_escape.env.config import RobotConfig, ShapeConfig
from hrl_escape.env.pictures.maps import Trajectory, save_map
from hrl_escape.env.puzzles.base import Panels
from hrl_escape.env.puzzles.buttons import ButtonsConfig


def main() -> None:
    """Plan and drive an escape through the doorway."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drive", choices=["strafing", "differential"], default="differential")
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--draw", help="file for a map of the escape")
    chosen = parser.parse_args()
    robot = RobotConfig(footprint="rectangle", body_length=1.2, body_width=0.6, drive=chosen.drive, move_step=0.5)
    room = generate(RoomConfig(
        name="narrow-passage", room=ShapeConfig(width=10, depth=8, rooms=2, doorway_width=1.2), robot=robot,
        puzzle=ButtonsConfig(count=2, buttons=Panels(width=1.0))), chosen.seed)
    planner = RoomPlanner(room)
    rules = planner.rules
    plan = planner.solve(rules.make_state(room.starts[0]))
    turns = [[rules.can_turn(state, rules.get_rotation((state.heading_steps + side) % rules.headings, 0.0),
                             side * rules.turn_step) for side in (1, -1)] for state in plan.states]
    print(f"base {robot.body_length:g} x {robot.body_width:g} m, {2 * robot.outer_radius:.2f} m across its corners; "
          "doorway 1.2 m")
    print(f"escape in {plan.cost} primitives; at {sum(not all(pair) for pair in turns)} of {len(turns)} states a turn "
          f"is blocked, at {sum(not any(pair) for pair in turns)} both are")
    env = EscapeRoomEnv(instance=room)
    env.reset(options={"state": plan.states[0]})
    run = plan.execute(env)
    env.close()
    print(f"driven: escaped {run.escaped}, every state as predicted: {run.as_predicted}")
    if chosen.draw:
        save_map(chosen.draw, room, plan.states[len(plan.states) // 2], [Trajectory(plan.path, "escape")])


if __name__ == "__main__":
    main()
