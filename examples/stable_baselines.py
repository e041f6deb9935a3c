"""Stable-Baselines3 and sb3-contrib, unmodified, on primitives and on options.

They count and discount an option as one step, where an SMDP agent discounts by its duration, and only MaskablePPO
knows which options are legal. Needs the extra `bench`: pip install 'hrl-escape[bench]'.
"""

import gymnasium
import torch
import tyro
from sb3_contrib import MaskablePPO
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.options.options_env import OptionsEnv


def make_flat() -> gymnasium.Env:
    """A room of primitives."""
    return Monitor(gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button", observation="features"))


def make_options() -> gymnasium.Env:
    """The same room with options."""
    flat = gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button", observation="features")
    return Monitor(OptionsEnv(flat))


def main(steps: int = 4_000, seed: int = 0) -> None:
    """Train each algorithm briefly and evaluate it.

    Args:
        steps: number of environment steps: primitives or decisions.
        seed: seed of the training runs.
    """
    torch.set_num_threads(1)
    runs = [
        ("DQN on primitives", DQN, make_flat, {"learning_starts": 200, "exploration_fraction": 0.5}),
        ("PPO on primitives", PPO, make_flat, {"n_steps": 256}),
        ("DQN on options", DQN, make_options, {"learning_starts": 200, "exploration_fraction": 0.5}),
        ("PPO on options", PPO, make_options, {"n_steps": 256}),
        ("MaskablePPO on options", MaskablePPO, make_options, {"n_steps": 256}),
    ]
    for name, algorithm, make, settings in runs:
        model = algorithm("MlpPolicy", make(), seed=seed, device="cpu", **settings)
        model.learn(steps)
        mean, _ = evaluate_policy(model, make(), n_eval_episodes=2, deterministic=False)
        print(f"{name}: {steps:,} steps, then return {mean:.1f}")


if __name__ == "__main__":
    tyro.cli(main)
