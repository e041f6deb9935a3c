"""Thousands of point mazes as one Gymnasium `VectorEnv` of tensors; `env.mazes` describes the task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from torch import Tensor

from hrl_escape.env.mazes import Maze, PointMazeEnv, check_steps
from hrl_escape.errors import BatchError, ConfigError


class PointMazeVectorEnv(VectorEnv):
    """Many mazes of `PointMazeEnv` that step together.

    Observations, rewards and ends are float32 and bool tensors on the device, or arrays. Episodes reset in the same
    step: `infos` then has `final_obs` and `final_info`. All mazes draw from one generator.

    ## Arguments
    Args:
        num_envs: number of mazes.
        maze: `u`, `medium`, `large` or `four-rooms`.
        reward: `sparse` or `dense`.
        time_step: duration of a step, s.
        speed: largest speed along each axis, m/s.
        max_steps: time limit in steps.
        output: `torch` tensors on the device, or `numpy` arrays.
        device: of the tensors.
    """

    metadata: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}

    def __init__(self, num_envs: int = 1, maze: str = "u", reward: str = "sparse", time_step: float = 0.1,
                 speed: float = 2.0, max_steps: int | None = None, output: str = "torch", device: str = "cpu") -> None:
        super().__init__()
        if output not in ("numpy", "torch"):
            raise ConfigError("output", output, "'numpy' or 'torch'")
        self._maze, self._most_steps = Maze(maze, reward, time_step, speed), check_steps(max_steps, maze)
        self._arguments = {"maze": maze, "reward": reward, "time_step": time_step, "speed": speed,
                           "max_steps": self._most_steps}
        self.num_envs, self._is_numpy, self._device = num_envs, output == "numpy", torch.device(device)
        self.single_observation_space, self.single_action_space = self._maze.make_spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generator = torch.Generator(self._device)
        self._point, self._goal = torch.zeros((2, num_envs, 2), device=self._device)
        self._steps = torch.zeros(num_envs, dtype=torch.int64, device=self._device)

    def describe(self) -> dict[str, Any]:
        """Return the arguments that determine its numbers."""
        return dict(self._arguments)

    def make_single_env(self) -> gymnasium.Env:
        """Make a `PointMazeEnv` of the same task."""
        return PointMazeEnv(**self._arguments)

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
              ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every maze; a seed fixes all of them."""
        if isinstance(seed, Sequence):
            raise ConfigError("seed", seed, "one whole number: all mazes draw from one generator")
        super().reset(seed=seed)
        self._generator.manual_seed(int(self.np_random.integers(2**62)))
        self._begin(torch.ones(self.num_envs, dtype=torch.bool, device=self._device))
        return self._observe(), self._inform()

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Move every point for one time step; actions are finite floats (num_envs, 2), else it raises `BatchError`."""
        rates = torch.as_tensor(actions, dtype=torch.float32, device=self._device)
        if rates.shape != (self.num_envs, 2) or not bool(torch.isfinite(rates).all()):
            raise BatchError("action", actions, f"finite numbers of shape ({self.num_envs}, 2)")
        self._point = self._maze.move(self._point, rates.clamp(-1, 1))
        self._steps = self._steps + 1
        reward, terminated = self._maze.judge(self._point, self._goal)
        truncated = (self._steps >= self._most_steps) & ~terminated
        over, infos = terminated | truncated, self._inform()  # a maze whose goal was reached has a new episode
        if bool(over.any()):
            infos |= {"final_obs": self._observe(), "final_info": self._inform(terminated),
                      "_final_obs": self._give(over), "_final_info": self._give(over)}
            self._begin(over)
        return self._observe(), self._give(reward.float()), self._give(terminated), self._give(truncated), infos

    def _begin(self, which: Tensor) -> None:
        """Draw starts and goals of some mazes, bool (num_envs,)."""
        draws = torch.rand((self.num_envs, 6), generator=self._generator, device=self._device)
        start, goal = self._maze.place(draws)
        self._point = torch.where(which[:, None], start, self._point)
        self._goal = torch.where(which[:, None], goal, self._goal)
        self._steps = torch.where(which, 0, self._steps)

    def _inform(self, is_success: Tensor | None = None) -> dict[str, Any]:
        """Return the information of all mazes, without success by default."""
        success = torch.zeros_like(self._steps, dtype=torch.bool) if is_success is None else is_success
        return {"is_success": self._give(success), "_is_success": self._give(torch.ones_like(success))}

    def _observe(self) -> dict[str, Any]:
        parts = {"observation": self._point, "achieved_goal": self._point, "desired_goal": self._goal}
        return {name: self._give(parts[name].float().clone()) for name in sorted(parts)}

    def _give(self, tensor: Tensor) -> Any:
        return tensor.cpu().numpy() if self._is_numpy else tensor

    def state_dict(self) -> dict[str, Any]:
        """Return the running episodes and the generator."""
        return {"point": self._point.cpu().numpy(), "goal": self._goal.cpu().numpy(),
                "steps": self._steps.cpu().numpy(), "generator": self._generator.get_state().numpy()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the result of `state_dict`."""
        self._point, self._goal, self._steps = (
            torch.from_numpy(np.array(state[name])).to(self._device) for name in ("point", "goal", "steps"))
        self._generator.set_state(torch.from_numpy(np.array(state["generator"])))
