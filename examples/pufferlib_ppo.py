"""PufferLib's trainer, unmodified, on rooms that step together in shared buffers.

PufferLib 3 requires older versions of Gymnasium and NumPy than this package. Install it with
`pip install --no-deps pufferlib`, and the packages it then misses. Without it, the script prints this and ends. The
trainer clips rewards to [-1, 1], so rewards are divided by 100. It treats a truncated episode as continuing.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
import tyro
from numpy.typing import NDArray

import hrl_escape  # noqa: F401  # registers the rooms


def make_rooms(room: str, count: int) -> Any:
    """Make a native environment of PufferLib with one agent per room; imports PufferLib."""
    import pufferlib

    class Rooms(pufferlib.PufferEnv):
        """Rooms that reset in the step that ends an episode, as the trainer expects."""

        def __init__(self, buf: Any = None) -> None:
            self._many = gymnasium.make_vec(room, num_envs=count, observation="features", autoreset_mode="SameStep")
            self.single_observation_space = self._many.single_observation_space
            self.single_action_space = self._many.single_action_space
            self.num_agents, self._returns = count, np.zeros(count)
            super().__init__(buf)

        def reset(self, seed: int | None = None) -> tuple[NDArray[Any], list[dict[str, float]]]:
            """Reset all rooms."""
            self.observations[:], self._returns = self._many.reset(seed=seed)[0], np.zeros(self.num_agents)
            return self.observations, []

        def step(self, actions: NDArray[Any]) -> tuple[Any, Any, Any, Any, list[dict[str, float]]]:
            """Step every room, and return statistics of the episodes that ended."""
            self.observations[:], reward, self.terminals[:], self.truncations[:], _ = self._many.step(actions)
            self.rewards[:] = reward / 100
            self._returns += reward
            over = self.terminals | self.truncations
            ended = [{"return": float(self._returns[k]), "escaped": float(self.terminals[k])}
                     for k in over.nonzero()[0]]
            self._returns[over] = 0.0
            return self.observations, self.rewards, self.terminals, self.truncations, ended

        def close(self) -> None:
            """Release the rooms."""
            self._many.close()

    return Rooms()


def main(room: str = "hrl_escape/PaperOneButton-v1", primitives: int = 200_000, envs: int = 32, steps: int = 64,
         out: Path = Path("pufferlib"), seed: int = 1) -> None:
    """Train, and print the mean return and success rate of each tenth of the budget.

    Args:
        room: environment id.
        primitives: training budget of all rooms together.
        envs: number of rooms.
        steps: steps per room in a rollout.
        out: folder of the trainer's checkpoints.
        seed: seed of weights, draws and rooms.
    """
    if importlib.util.find_spec("pufferlib") is None:
        print("PufferLib is not installed: pip install --no-deps pufferlib, and what it then misses")
        return
    import pufferlib.models
    from pufferlib.pufferl import PuffeRL

    torch.set_num_threads(1)
    torch.manual_seed(seed)
    rooms = make_rooms(room, envs)
    config = {
        "env": room, "seed": seed, "torch_deterministic": True, "cpu_offload": False, "device": "cpu",
        "optimizer": "adam", "anneal_lr": False, "precision": "float32", "total_timesteps": primitives,
        "learning_rate": 1e-3, "gamma": 0.99, "gae_lambda": 0.95, "update_epochs": 4, "clip_coef": 0.2,
        "vf_coef": 0.5, "vf_clip_coef": 10.0, "max_grad_norm": 0.5, "ent_coef": 0.01, "adam_beta1": 0.9,
        "adam_beta2": 0.999, "adam_eps": 1e-5, "data_dir": str(out), "checkpoint_interval": 10**9,
        "batch_size": envs * steps, "bptt_horizon": steps, "minibatch_size": envs * steps // 8,
        "max_minibatch_size": envs * steps // 8, "compile": False, "use_rnn": False, "vtrace_rho_clip": 1.0,
        "vtrace_c_clip": 1.0, "prio_alpha": 0.0, "prio_beta0": 1.0, "tag": None,
    }
    with contextlib.redirect_stdout(io.StringIO()):  # hides its dashboard
        trainer = PuffeRL(config, rooms, pufferlib.models.Default(rooms, hidden_size=64))
    ended: dict[str, list[float]] = {}
    for part in range(1, 11):
        while trainer.global_step < primitives * part // 10:
            with contextlib.redirect_stdout(io.StringIO()):
                for name, values in trainer.evaluate().items():
                    ended.setdefault(name, []).extend(np.atleast_1d(values).tolist())
                trainer.stats.clear()
                trainer.train()
        if ended.get("return"):
            print(f"{trainer.global_step:,} primitives: return {np.mean(ended['return']):.0f}, "
                  f"{np.mean(ended['escaped']):.0%} of {len(ended['return'])} episodes escape")
            ended.clear()
    trainer.utilization.stop()


if __name__ == "__main__":
    tyro.cli(main)
