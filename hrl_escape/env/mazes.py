"""Point mazes with goals: a kinematic point with velocities as actions, one maze or thousands.

Maps are those of PointMaze in Gymnasium-Robotics (U, Medium and Large), and the four rooms of Sutton, Precup and Singh
(1999). `PointMazeEnv` is one maze in NumPy; `env.maze_vector_env` steps thousands as tensors with the same functions.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from hrl_escape.env.presets import FOUR_ROOMS
from hrl_escape.errors import ConfigError, ResetNeededError, UnknownNameError

MAPS: dict[str, tuple[str, ...]] = {
    "u": ("   ", "## ", "   "),
    "medium": ("  ##  ", "  #   ", "#   ##", "  #   ", " #  # ", "   #  "),
    "large": ("    #     ", " ## # # # ", "      #   ", " #### ### ", "  # #     ", "# # # # ##", "  #   #   "),
    "four-rooms": FOUR_ROOMS,
}
"""Name -> rows of a map from the top, without its outer walls; # is wall, a cell is 1 m wide."""
STEPS = {"u": 150, "medium": 300, "large": 400, "four-rooms": 300}
"""Name -> time limit in steps."""
HALF_WIDTH = 0.1
"""Half the width of the point's square outline, m."""
REACH = 0.45
"""Largest distance from a goal that counts as reached, m, as in PointMaze."""
JITTER = 0.25
"""Start and goal are up to this far from the centre of their cell along each axis, m."""


class Maze:
    """Walls, motion, goals and rewards of a map; all functions take arrays or tensors (n, 2) of one library.

    The origin is the middle of the map, x points right and y up.

    Args:
        name: one of `MAPS`.
        reward: `sparse`, -1 until the goal is reached and 0 then; or `dense`, minus the distance, m.
        time_step: duration of a step, s.
        speed: largest speed along each axis, m/s; a step must be shorter than a cell.
    """

    def __init__(self, name: str, reward: str = "sparse", time_step: float = 0.1, speed: float = 2.0) -> None:
        if name not in MAPS:
            raise UnknownNameError("maze", name, list(MAPS))
        if reward not in ("sparse", "dense"):
            raise ConfigError("reward", reward, "'sparse' or 'dense'")
        if not (time_step > 0 and speed > 0 and time_step * speed < 1):
            raise ConfigError("speed", speed, "above 0, and below 1 m in a step")
        self.name, self.reward, self._step = name, reward, time_step * speed
        rows = MAPS[name]
        self.is_free = np.array([[cell != "#" for cell in row] for row in reversed(rows)]).T  # [x, y]
        self._is_wall = np.pad(~self.is_free, 1, constant_values=True)
        self._wall_tensor: Any = None  # made at first use
        self.half = np.array(self.is_free.shape) / 2
        self.centres = np.argwhere(self.is_free) + 0.5 - self.half

    def hits_wall(self, point: Any) -> Any:
        """Return whether the outline at points (n, 2) overlaps a wall, bool (n,)."""
        walls = self._is_wall if isinstance(point, np.ndarray) else self._give_walls(point)
        low, high = (self._find_cells(point + side * (HALF_WIDTH - 1e-4)) for side in (-1, 1))
        west, east, south, north = low[:, 0], high[:, 0], low[:, 1], high[:, 1]
        return walls[west, south] | walls[west, north] | walls[east, south] | walls[east, north]

    def _give_walls(self, point: Any) -> Any:
        """Return the padded map as a tensor on the device of points."""
        if self._wall_tensor is None or self._wall_tensor.device != point.device:
            self._wall_tensor = point.new_tensor(self._is_wall).bool()
        return self._wall_tensor

    def _find_cells(self, point: Any) -> Any:
        """Return the indices of points' cells in the padded map, int64 (n, 2)."""
        top = np.array(self._is_wall.shape) - 1
        if isinstance(point, np.ndarray):
            return np.clip(np.floor(point + self.half) + 1, 0, top).astype(np.int64)
        cell = (point + point.new_tensor(self.half)).floor() + 1
        return cell.clamp(point.new_zeros(2), point.new_tensor(top)).long()

    def move(self, point: Any, action: Any) -> Any:
        """Return points after a step of velocities in [-1, 1] (n, 2): first along x, then along y, up to a wall."""
        moved = point
        for axis in range(2):
            shift = action[:, axis] * self._step
            ahead = moved.copy() if isinstance(moved, np.ndarray) else moved.clone()
            ahead[:, axis] = ahead[:, axis] + shift
            blocked = self.hits_wall(ahead)
            sign = (shift > 0) * 2 - 1
            edge = ahead[:, axis] + sign * HALF_WIDTH + self.half[axis]  # front, from the map's corner
            line = (np.floor(edge) if isinstance(edge, np.ndarray) else edge.floor()) + (sign < 0)
            stop = line - self.half[axis] - sign * HALF_WIDTH
            ahead[:, axis] = ahead[:, axis] * ~blocked + stop * blocked
            moved = ahead
        return moved

    def place(self, draws: Any) -> tuple[Any, Any]:
        """Return starts and goals in different cells, (n, 2) each, from uniform draws (n, 6) in [0, 1)."""
        is_array = isinstance(draws, np.ndarray)
        centres = self.centres if is_array else draws.new_tensor(self.centres)
        count = len(centres)
        first, other = ((draws[:, column] * size).astype(np.int64) if is_array else (draws[:, column] * size).long()
                        for column, size in ((0, count), (1, count - 1)))
        goal = (first + 1 + other) % count
        return (centres[first] + (2 * draws[:, 2:4] - 1) * JITTER, centres[goal] + (2 * draws[:, 4:6] - 1) * JITTER)

    @staticmethod
    def measure(achieved: Any, desired: Any) -> Any:
        """Return distances between points (..., 2), m."""
        return ((achieved - desired) ** 2).sum(-1) ** 0.5

    def judge(self, achieved: Any, desired: Any) -> tuple[Any, Any]:
        """Return rewards and whether the goals are reached, (...) each."""
        distance = self.measure(achieved, desired)
        reached = distance <= REACH
        return (-distance if self.reward == "dense" else reached * 1.0 - 1.0), reached

    def make_spaces(self) -> tuple[spaces.Dict, spaces.Box]:
        """Make the spaces of observations, a Dict with goals, and of actions."""
        point = spaces.Box(-self.half.astype(np.float32), self.half.astype(np.float32))
        return (spaces.Dict({"observation": point, "achieved_goal": point, "desired_goal": point}),
                spaces.Box(-1.0, 1.0, (2,), np.float32))


class PointMazeEnv(gymnasium.Env, EzPickle):
    """Reach a goal in a maze, with velocities as actions.

    ## Action space
    `Box(-1, 1, (2,))`: velocities along x and y over `speed`. Motion stops at walls, axis by axis.

    ## Observation space
    A Dict as in Gymnasium-Robotics, float32: `observation` and `achieved_goal` are the position, m, `desired_goal` is
    the goal. Unlike PointMaze, velocities are not a part of the state.

    ## Rewards
    `sparse`: -1, and 0 when the goal is reached. `dense`: minus the distance to the goal, m.

    ## Episode end
    `terminated` within 0.45 m of the goal, `truncated` after `max_steps`. Start and goal are drawn for each episode, in
    different cells.

    ## Information
    `is_success`.

    ## Arguments
    Args:
        maze: `u`, `medium`, `large` or `four-rooms`.
        reward: `sparse` or `dense`.
        time_step: duration of a step, s.
        speed: largest speed along each axis, m/s.
        max_steps: time limit in steps; by default 150, 300, 400 and 300.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(self, maze: str = "u", reward: str = "sparse", time_step: float = 0.1, speed: float = 2.0,
                 max_steps: int | None = None) -> None:
        EzPickle.__init__(self, maze, reward, time_step, speed, max_steps)
        self._maze, self._most_steps = Maze(maze, reward, time_step, speed), check_steps(max_steps, maze)
        self._arguments = {"maze": maze, "reward": reward, "time_step": time_step, "speed": speed,
                           "max_steps": self._most_steps}
        self.observation_space, self.action_space = self._maze.make_spaces()
        self._point = self._goal = np.full((1, 2), np.nan)
        self._steps = -1

    def describe(self) -> dict[str, Any]:
        """Return the arguments that determine its numbers."""
        return dict(self._arguments)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None
              ) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
        """Begin an episode with a new start and goal."""
        super().reset(seed=seed)
        self._point, self._goal = self._maze.place(self.np_random.random((1, 6)))
        self._steps = 0
        return self._observe(), {"is_success": False}

    def step(self, action: NDArray[np.float32]
             ) -> tuple[dict[str, NDArray[np.float32]], float, bool, bool, dict[str, Any]]:
        """Move for one time step.

        Raises:
            ConfigError: the action has another shape, or a number that is not finite.
            ResetNeededError: no episode has begun.
        """
        if self._steps < 0:
            raise ResetNeededError("call reset() first: no episode has begun")
        rates = np.asarray(action, np.float64)
        if rates.shape != (2,) or not np.isfinite(rates).all():
            raise ConfigError("action", action, "2 finite numbers")
        self._point = self._maze.move(self._point, rates.clip(-1, 1)[None])
        self._steps += 1
        reward, reached = self._maze.judge(self._point, self._goal)
        is_success = bool(reached[0])
        return (self._observe(), float(reward[0]), is_success, self._steps >= self._most_steps and not is_success,
                {"is_success": is_success})

    def compute_reward(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Any) -> NDArray[np.float64]:
        """Compute the reward of goals (..., 2)."""
        return self._maze.judge(np.asarray(achieved_goal), np.asarray(desired_goal))[0]

    def compute_terminated(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Any
                           ) -> NDArray[np.bool_]:
        """Compute the termination of goals (..., 2)."""
        return self._maze.judge(np.asarray(achieved_goal), np.asarray(desired_goal))[1]

    def _observe(self) -> dict[str, NDArray[np.float32]]:
        point, goal = self._point[0].astype(np.float32), self._goal[0].astype(np.float32)
        return {"observation": point, "achieved_goal": point.copy(), "desired_goal": goal}


def check_steps(max_steps: int | None, maze: str) -> int:
    """Return the time limit in steps, by default the maze's own. Raises `ConfigError` if it is below 1."""
    if max_steps is None:
        return STEPS[maze]
    if isinstance(max_steps, bool) or not isinstance(max_steps, (int, np.integer)) or max_steps < 1:
        raise ConfigError("max_steps", max_steps, "a whole number of at least 1, or None")
    return int(max_steps)
