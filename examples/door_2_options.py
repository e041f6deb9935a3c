"""The same room with options: one step is one decision, which can run many primitives.

The planned options `press-button-1` and `press-button-2` press a button each, and `go-to-exit` leaves the room. `info`
holds the duration k, the discount gamma^k, the discounted reward sum of gamma^i r_i, and the legal actions.
"""

import gymnasium
import tyro

import hrl_escape  # noqa: F401  # registers the environments
from hrl_escape.options.options_env import OptionsEnv


def main(seed: int = 0) -> None:
    """Press the buttons in order, then leave.

    Args:
        seed: seed of the episode.
    """
    env = OptionsEnv(gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button"), discount=0.99)
    observation, info = env.reset(seed=seed)
    print(f"{len(env.action_names)} actions: {', '.join(env.action_names)}")
    total = 0.0
    for name in ("press-button-1", "press-button-2", "go-to-exit"):
        action = env.action_names.index(name)
        assert info["action_mask"][action], f"{name} cannot start here"
        observation, reward, terminated, truncated, info = env.step(action)
        total += reward
        targets = env.unwrapped.instance.targets
        pressed = [target.name for target, hit in zip(targets, info["pressed"], strict=True) if hit]
        print(f"{name}: {info['duration']} primitives, {info['option']['ended']}, reward {reward:g}, "
              f"discounted {info['discounted_reward']:.2f}, then discount by {info['discount']:.3f}, "
              f"pressed {pressed}")
    print(f"escaped: {terminated}, return {total:g}")


if __name__ == "__main__":
    tyro.cli(main)
