"""Velocities as actions: Stable-Baselines3's SAC, unmodified, compared with a plan driven as a trajectory."""

import argparse

import gymnasium
from stable_baselines3 import SAC

import hrl_escape
from hrl_escape.planning import RoomPlanner, make_trajectory, track


def main() -> None:
    """Track the plan, train SAC, and run its policy once."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--room", default="paper-one-button")
    parser.add_argument("--steps", type=int, default=3000, help="training steps of 0.1 s")
    chosen = parser.parse_args()
    env = gymnasium.make("hrl_escape/EscapeRoomContinuous-v1", instance=hrl_escape.make_room(chosen.room),
                         observation="features", time_limit=100.0)
    env.reset(seed=0)
    room = env.unwrapped
    tracking = track(make_trajectory(RoomPlanner(room.instance).solve(room.get_state())), env)
    print(f"plan: {tracking.end.words} in {tracking.seconds:.1f} s of motion, {len(tracking.pressed)} presses")

    model = SAC("MlpPolicy", env, learning_starts=100, train_freq=8, seed=0)
    model.learn(chosen.steps)
    observation, _ = env.reset(seed=0)
    total, is_over, info = 0.0, False, {"seconds": 0.0}
    while not is_over:
        action, _ = model.predict(observation, deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        total, is_over = total + reward, terminated or truncated
    print(f"SAC, {chosen.steps} steps: return {total:.1f} in {info['seconds']:.1f} s")


if __name__ == "__main__":
    main()
