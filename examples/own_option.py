"""Your own option: it moves in one direction until something stops it.

The option is checked against the contract and then offered next to the planned options, in every instance of the room.
"""

import gymnasium
import tyro

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.checks import check_option
from hrl_escape.env.kinematics import RoomState
from hrl_escape.options.meta_actions import make_meta_options
from hrl_escape.options.option import Option
from hrl_escape.options.options_env import OptionsEnv


class Slide(Option):
    """Repeats one primitive until it no longer moves the robot."""

    def __init__(self, name: str, primitive: int) -> None:
        super().__init__(name)
        self.primitive = primitive
        self._last: RoomState | None = None

    def policy(self, state: RoomState) -> int:
        """Return the same primitive in every state."""
        self._last = state
        return self.primitive

    def termination(self, state: RoomState) -> float:
        """Return 1 if the last primitive did not move the robot."""
        moved = self._last is None or abs(state.x - self._last.x) + abs(state.y - self._last.y) > 0.5
        return 0.0 if moved else 1.0


def main(config: str = "clutter", decisions: int = 12) -> None:
    """Check a slide, make a room with planned options and slides, and choose among them at random.

    Args:
        config: preset of the room.
        decisions: number of random decisions.
    """
    flat = gymnasium.make("hrl_escape/EscapeRoom-v1", config=config)
    check_option(Slide("slide-forward", 0), flat)
    slides = {"slide-forward": 0, "slide-back": 1, "slide-left": 2, "slide-right": 3}
    env = OptionsEnv(flat, include_primitives=False, options=lambda room: [
        *make_meta_options(room), *(Slide(name, primitive) for name, primitive in slides.items())])
    _, info = env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(decisions):
        _, _, terminated, truncated, info = env.step(env.action_space.sample(info["action_mask"]))
        print(f"{info['option']['name']}: {info['duration']} primitives, {info['option']['ended']}")
        if terminated or truncated:
            break


if __name__ == "__main__":
    tyro.cli(main)
