"""Stable-Baselines3 and sb3-contrib, unmodified, on primitives and on options, and a trained model as an option.

These algorithms count and discount an option as one step, while an SMDP agent discounts by its duration. Only
MaskablePPO uses the action mask. Requires the extra `bench`: pip install -c constraints.txt '.[bench]' in a checkout.
"""

import gymnasium
import torch
import tyro
from sb3_contrib import MaskablePPO
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.options import LearnedOption, OptionsEnv


def make_flat() -> gymnasium.Env:
    """Make a room with primitives."""
    return Monitor(gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button", observation="features"))


def make_options() -> gymnasium.Env:
    """Make the same room with options."""
    flat = gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button", observation="features")
    return Monitor(OptionsEnv(flat))


def main(steps: int = 4_000, seed: int = 0) -> None:
    """Train each algorithm briefly and evaluate it.

    Args:
        steps: environment steps, which are primitives or decisions.
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
    show_model_as_option(steps, seed)


def show_model_as_option(steps: int, seed: int) -> None:
    """Run a trained model as an option next to the primitives. It balances until the cart has left the middle."""
    model = PPO("MlpPolicy", "CartPole-v1", seed=seed, device="cpu", n_steps=256).learn(steps)
    balance = LearnedOption("balance", model, termination=lambda state: float(abs(state[0]) > 0.5))
    env = OptionsEnv(gymnasium.make("CartPole-v1"), [balance])
    env.reset(seed=seed)
    _, reward, _, _, info = env.step(env.action_names.index("balance"))
    print(f"PPO as the option {info['option']['name']}: {info['duration']} primitives, reward {reward:.0f}, "
          f"ended by {info['option']['ended']}")


if __name__ == "__main__":
    tyro.cli(main)
