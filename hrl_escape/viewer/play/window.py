"""Manual mode in Bullet's own window: the simulated world itself, with the keys of manual mode. Needs a display."""

from __future__ import annotations

import time

from rich.console import Console

from hrl_escape.env.episode_end import EpisodeEnd
from hrl_escape.env.escape_room import EscapeRoomEnv
from hrl_escape.env.instance import RoomInstance
from hrl_escape.viewer.play.controls import Command, Controls

__all__ = ["play_in_window"]

KEY_RATE = 30.0


def play_in_window(instance: RoomInstance, seed: int = 0) -> None:
    """Play until the window is closed or `q` is pressed.

    Raises:
        UnsupportedError: there is no display.
    """
    console = Console()
    env = EscapeRoomEnv(instance=instance, render_mode="human")
    try:
        assert env.room is not None
        controls = Controls(instance.robot.actions, 1)
        env.reset(seed=seed)
        past, rewards, over = [env.get_state()], [0.0], False
        while env.room.is_open:
            for key in env.room.read_keys():
                command = controls.press(key)
                if command is None:
                    continue
                if command.verb == "quit":
                    return
                if command.verb == "reset" or (command.verb == "undo" and len(past) > 1):
                    env.set_state(past[0] if command.verb == "reset" else past[-2])
                    left = 1 if command.verb == "reset" else len(past) - 1
                    past, rewards, over = past[:left], rewards[:left], False
                elif _is_primitive(command, len(env.rules.actions)) and not over:
                    _, reward, terminated, truncated, info = env.step(command.action)
                    past.append(env.get_state())
                    rewards.append(float(reward))
                    end = EpisodeEnd.of_step(bool(info["success"]), terminated, truncated)
                    over = end.is_over
                    console.print(f"{len(past) - 1} primitives, return {sum(rewards):g}: {end.words}")
            time.sleep(1 / KEY_RATE)
    finally:
        env.close()


def _is_primitive(command: Command, primitives: int) -> bool:
    return command.verb == "act" and command.action < primitives
