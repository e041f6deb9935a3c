"""Plan to any goal from any state, run the plan, and draw it."""

from pathlib import Path

import tyro

import hrl_escape
from hrl_escape.planning.planner import RoomPlanner


def main(room: str = "clutter", draw: Path = Path("plan.svg")) -> None:
    """Plan to one button, then plan the whole escape, run it and draw it.

    Args:
        room: the room, such as clutter or ladder-1/chain/test#5.
        draw: file of the picture.
    """
    env = hrl_escape.make_env(room)
    env.reset(seed=0)
    planner = RoomPlanner(env.unwrapped.instance)
    goal = f"press-{env.unwrapped.instance.targets[0].name}"
    print(f"{goal}: {planner.plan(env.unwrapped.get_state(), goal).cost} primitives")
    plan = planner.solve(env.unwrapped.get_state())
    print(plan)
    execution = plan.execute(env)
    print(f"driven: escaped {execution.escaped}, return {sum(execution.rewards):g}, "
          f"every state as predicted: {execution.as_predicted}")
    plan.draw(draw)
    print(f"drawn: {draw}")


if __name__ == "__main__":
    tyro.cli(main)
