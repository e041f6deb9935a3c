"""Why flat RL gets stuck.

With one button, an agent that chooses primitives finds the exit by chance and learns from it. With two, the reward does
not show progress. This tutorial measures the difference.
"""

import gymnasium

import hrl_escape
from hrl_escape.agents import train

# First, random primitives: how often do 5,000 of them press a button, and how often do they escape?

for config in ("paper-one-button", "paper-two-button"):
    env = gymnasium.make("hrl_escape/EscapeRoom-v1", config=config)
    env.action_space.seed(0)
    env.reset(seed=0)
    presses, escapes = 0, 0
    for _ in range(5_000):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        presses += info["pressed"].sum()
        escapes += terminated
        if terminated or truncated:
            env.reset()
    print(f"{config}: random, 5,000 primitives: {escapes} escapes, {presses} presses")
env.unwrapped.instance

# The reward is -1 until the agent escapes. An agent that never escapes observes a constant reward, so all actions look
# equally bad. This is tabular Q-learning in the second room.


def learn(agent, env):
    """Train, and print the greedy returns before, during and after."""
    result = train(agent, env, primitives=8_000, seed=0, eval_every=2_000, eval_episodes=1, progress=False)
    print(f"{agent}: returns {[round(e.mean_return) for e in result.evaluations]}")
    return result


env = gymnasium.make("hrl_escape/EscapeRoom-v1", config="paper-two-button", observation="features")
flat = learn("q-learning", env)

# A return of -1000 is a truncated episode. Now the same algorithm trains in the same room, with the same budget of
# primitives. A decision can also be an option that goes to a button and presses it:

env = hrl_escape.OptionsEnv(env)
with_options = learn("smdp-q-learning+primitives", env)

# The options contain knowledge of the room's geometry. A random policy over the same options measures how much.

random_policy = learn("random-options+primitives", env)

# The random policy over options escapes too. (Its five numbers are the same fixed episode, since it does not learn.)
# Learning adds the difference between the last two lines. Read every comparison in this project in this way.

with_options.plot(beside=[random_policy, flat])
