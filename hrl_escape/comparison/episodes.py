"""Recorded episodes of an agent, primitive by primitive, as JSON that a page can play, and progress in a room.

Recording changes nothing in the environment and adds `progress` to its `info`. The report plays the episodes
(`reporting/templates/replay.js`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium

from hrl_escape.agents.agent import Agent, read_success
from hrl_escape.agents.training.evaluation import play_episode
from hrl_escape.env.kinematics import RoomState, Rules
from hrl_escape.errors import UnsupportedError

__all__ = ["StateRecorder", "find_recorder", "record_episode"]


class StateRecorder(gymnasium.Wrapper):
    """Record of the room's states in the present episode; goes between a room and its `OptionsEnv`.

    `info["progress"]` is the largest `compute_progress` of the puzzle so far in the episode; 1 once the robot has
    escaped.

    Attributes:
        states: the first one, and one a primitive.
        starts: first states of this episode and of those before it, back to the last reset with a seed.
    """

    is_passive = True  # runs with and without it are the same

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.states: list[RoomState] = []
        self.starts: list[RoomState] = []
        self._progress = 0.0

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Reset, and begin a new record."""
        observation, info = self.env.reset(**arguments)
        self.states = [self._get_state()]
        self.starts = [*([] if arguments.get("seed") is not None else self.starts), self.states[0]]
        self._progress = self._measure_progress()
        return observation, {**info, "progress": self._progress}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step, and record the state reached."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.states.append(self._get_state())
        if self.states[-1].puzzle != self.states[-2].puzzle:
            self._progress = max(self._progress, self._measure_progress())
        self._progress = 1.0 if read_success(info, terminated) else self._progress
        return observation, reward, terminated, truncated, {**info, "progress": self._progress}

    def _measure_progress(self) -> float:
        room: Any = self.env.unwrapped
        return room.instance.puzzle.compute_progress(self.states[-1].puzzle)

    def _get_state(self) -> RoomState:
        room: Any = self.env.unwrapped
        return room.get_state()


def find_recorder(env: gymnasium.Env) -> StateRecorder:
    """The recorder among the wrappers of a room.

    Raises:
        UnsupportedError: there is none.
    """
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, StateRecorder):
            return env
        env = env.env
    raise UnsupportedError(f"nothing records the states of {env}")


def record_episode(agent: Agent, env: gymnasium.Env, recorder: StateRecorder, seed: int) -> dict[str, Any]:
    """Play one greedy episode and return it as a JSON value.

    Args:
        agent: acts with frozen weights.
        env: the recorder itself, or what wraps it.
        recorder: around the flat room.
        seed: the episode's.

    Returns:
        `return`, `primitives`, `success`; `decisions`: [name, duration, how it ended] each; `frames`, see
        `make_frames`.
    """
    room: Any = env.unwrapped
    names = room.instance.robot.actions.names
    total, success = 0.0, False
    decisions: list[list[Any]] = []
    for transition, info in play_episode(agent, env, seed):
        total += transition.summed_reward
        option = info.get("option") or {"name": names[transition.action], "ended": "reached"}
        decisions.append([option["name"], transition.duration, option["ended"]])
        success = read_success(info, transition.terminated)
    return {
        "return": total,
        "primitives": len(recorder.states) - 1,
        "success": success,
        "decisions": decisions,
        "frames": make_frames(room.rules, recorder.states),
    }


def make_frames(rules: Rules, states: Sequence[RoomState]) -> dict[str, Any]:
    """Turn states into compact numbers for drawing.

    Returns:
        `x`, `y` (m) and `heading` (rad) a state; `arm`: per state where the arm's joints and hand are, [x, y] in the
        room, empty without an arm; `lit` and `open`: [frame, value] where the lit targets (indices) or the exit
        (true if it is open) change; `props`: per state [x, y, yaw] a prop, empty where none can move.
    """
    puzzle, find_arm = rules.instance.puzzle, _make_arm_finder(rules)
    lit: list[list[Any]] = []
    is_open: list[list[Any]] = []
    for number, state in enumerate(states):
        now = [index for index, on in enumerate(puzzle.get_lit(state.puzzle)) if on]
        if not lit or lit[-1][1] != now:
            lit.append([number, now])
        solved = puzzle.is_solved(state.puzzle)
        if not is_open or is_open[-1][1] != solved:
            is_open.append([number, solved])
    return {
        "x": [round(state.x, 3) for state in states],
        "y": [round(state.y, 3) for state in states],
        "heading": [round(rules.get_heading(state), 4) for state in states],
        "arm": [find_arm(state) for state in states] if rules.instance.robot.joints else [],
        "lit": lit,
        "open": is_open,
        "props": [[_find_planar_pose(prop) for prop in state.physics.props] for state in states if state.physics],
    }


def _make_arm_finder(rules: Rules) -> Callable[[RoomState], list[list[float]]]:
    """A function from a state to where each joint of the arm and the hand are, [x, y] in the room."""
    robot = rules.robot
    # the chain cut after each joint ends where the next link begins
    cuts = [dataclasses.replace(robot, chain=robot.chain[: n + 1]) for n in range(len(robot.chain))]

    def find(state: RoomState) -> list[list[float]]:
        angles, heading = rules.get_angles(state), rules.get_heading(state)
        cos, sin = math.cos(heading), math.sin(heading)
        points = [cut.compute_hand(angles) for cut in cuts]
        return [[round(float(state.x + cos * x - sin * y), 3), round(float(state.y + sin * x + cos * y), 3)]
                for x, y, _ in points]

    return find


def _find_planar_pose(prop: Sequence[float]) -> list[float]:
    x, y, _, qx, qy, qz, qw = prop[:7]
    return [round(x, 3), round(y, 3), round(math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)), 4)]
