"""A room as a plain Gymnasium environment.

A robot must press two buttons in the right order and go to the exit. A primitive costs 1, and an escape earns 100.
"""

import gymnasium
import tyro

import hrl_escape  # noqa: F401  # registers the environments


def main(primitives: int = 2_000) -> None:
    """Act at random and count presses and escapes.

    Args:
        primitives: number of random primitives.
    """
    env = gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button", observation="features")
    print(f"observation {env.observation_space.shape}, {env.action_space.n} primitives: "
          f"{', '.join(env.unwrapped.rules.actions.names)}")
    observation, info = env.reset(seed=0)
    env.action_space.seed(0)
    pressed, escapes, episodes = 0, 0, 0
    for _ in range(primitives):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        pressed += int(info["pressed"].sum())
        escapes += terminated
        if terminated or truncated:
            episodes += 1
            observation, info = env.reset()
    print(f"{primitives:,} random primitives: {pressed} presses, {escapes} escapes in {episodes} finished episodes")


if __name__ == "__main__":
    tyro.cli(main)
