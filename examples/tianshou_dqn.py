"""Tianshou's DQN on options, with masks and with the right discount of decisions that take k primitives.

Tianshou 2 multiplies the next value by a constant gamma. `OptionsDQN` below multiplies it by gamma^k. Install Tianshou
into an environment of its own with `pip install tianshou`. Without it, the script prints this and ends.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import gymnasium
import numpy as np
import torch
import tyro

from hrl_escape.options import MaskedObservation

KEPT = ("duration", "discount", "action_mask", "is_success")
"""Entries of `info` in the replay buffer, which needs entries of fixed shape."""


class KeepInfo(gymnasium.Wrapper):
    """Keeps the entries of `info` that the buffer stores."""

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        observation, info = self.env.reset(**arguments)
        return observation, {key: info[key] for key in KEPT}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Run one decision."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated, truncated, {key: info[key] for key in KEPT}


def make_room(room: str, gamma: float) -> gymnasium.Env:
    """Make a room with options, with the mask where Tianshou reads it."""
    env = gymnasium.make(room, observation="features", include_primitives=False, discount=gamma,
                         discounted_reward=True)
    return MaskedObservation(KeepInfo(env), key="obs", mask_key="mask")


def main(room: str = "hrl_escape/PaperTwoButtonOptions-v1", decisions: int = 1_000, gamma: float = 0.99,
         seed: int = 0) -> None:
    """Train, and print returns of the greedy policy.

    Args:
        room: id of rooms with options.
        decisions: training budget.
        gamma: discount per primitive.
        seed: seed of weights, draws and rooms.
    """
    if importlib.util.find_spec("tianshou") is None:
        print("Tianshou is not installed: pip install tianshou, in an environment of its own")
        return
    from tianshou.algorithm import DQN
    from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
    from tianshou.algorithm.optim import AdamOptimizerFactory
    from tianshou.data import Collector, VectorReplayBuffer
    from tianshou.env import DummyVectorEnv
    from tianshou.utils.net.common import Net
    from tianshou.utils.torch_utils import policy_within_training_step

    class OptionsDQN(DQN):
        """DQN whose targets discount a decision of k primitives by gamma^k."""

        def _target_q(self, buffer: Any, indices: np.ndarray) -> torch.Tensor:
            ratio = torch.as_tensor(buffer[indices].info.discount / gamma, dtype=torch.float32)
            return super()._target_q(buffer, indices) * ratio  # which Tianshou multiplies by gamma

    np.random.seed(seed)  # noqa: NPY002  # Tianshou explores with it
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    rooms = DummyVectorEnv([lambda: make_room(room, gamma)] * 4)
    env = make_room(room, gamma)
    space: Any = env.observation_space
    actions = int(env.action_space.n)  # type: ignore[attr-defined]  # options are discrete
    network = Net(state_shape=space["obs"].shape, action_shape=actions, hidden_sizes=[64, 64])
    policy = DiscreteQLearningPolicy(model=network, action_space=env.action_space, eps_training=1.0, eps_inference=0.0)
    algorithm = OptionsDQN(policy=policy, optim=AdamOptimizerFactory(lr=1e-3), gamma=gamma, target_update_freq=100)
    buffer = VectorReplayBuffer(20_000, 4)
    collector = Collector(algorithm, rooms, buffer, exploration_noise=True)
    tests = Collector(algorithm, DummyVectorEnv([lambda: make_room(room, gamma)]))
    collector.reset(gym_reset_kwargs={"seed": seed})
    trained = 0
    for part in range(1, 5):
        policy.set_eps_training(1.25 - part / 4)
        while trained < decisions * part // 4:
            with policy_within_training_step(policy):
                trained += collector.collect(n_step=20).n_collected_steps
                for _ in range(10):
                    algorithm.update(buffer, sample_size=64)
        tests.reset(gym_reset_kwargs={"seed": seed})
        found = tests.collect(n_episode=5)
        print(f"{trained:,} decisions: return {found.returns.mean():.1f} discounted within decisions, "
              f"{found.lens.mean():.1f} decisions an episode")


if __name__ == "__main__":
    tyro.cli(main)
