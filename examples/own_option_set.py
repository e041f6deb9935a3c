"""Your own option set: a function of a room's planner, registered under a name for `option_set=`."""

from collections.abc import Sequence

import tyro

from hrl_escape import OptionsEnv, RoomPlanner
from hrl_escape.agents import AgentSpec
from hrl_escape.agents.spec import OptionsView
from hrl_escape.env import EscapeRoomEnv
from hrl_escape.options import Option, make_go_to, make_meta_options, register_option_set


def make_press_or_go_home(planner: RoomPlanner) -> Sequence[Option]:
    """Press one button, leave, or go to the middle of the room."""
    home = make_go_to(planner, "0,0", "go-home")
    return [*make_meta_options(planner.instance, "press", planner), home]


def main(config: str = "paper-two-button") -> None:
    """Register the set, run its options in a room, and name it in the specification of an agent.

    Args:
        config: preset of the room.
    """
    register_option_set("press-or-go-home", make_press_or_go_home)
    env = OptionsEnv(EscapeRoomEnv(config), option_set="press-or-go-home", include_primitives=False)
    env.reset(seed=0)
    for name in ("press-button-1", "go-home"):
        info = env.step(env.action_names.index(name))[4]
        print(f"{name}: {info['duration']} primitives, {info['option']['ended']}")
    agent = AgentSpec("smdp-q-learning", options=OptionsView(option_set="press-or-go-home"))
    print(f"{agent.label} chooses among {agent.options.option_set}")


if __name__ == "__main__":
    tyro.cli(main)
