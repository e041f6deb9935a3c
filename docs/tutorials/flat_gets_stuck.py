"""Why flat RL gets stuck.

With one button, an agent that chooses primitives finds the exit by luck and learns from it. With two, nothing that it
can stumble over tells it that it is on the way. This page measures that.
"""

import gymnasium

import hrl_escape
from hrl_escape.agents import train

# First luck alone: how often does a random walk press buttons, and how often does it escape? 5,000 primitives each.

for config in ("paper-one-button", "paper-two-button"):
    env = gymnasium.make("hrl_escape/EscapeRoom-v0", config=config)
    env.action_space.seed(0)
    env.reset(seed=0)
    presses, escapes = 0, 0
    for _ in range(5_000):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        presses += len(info["pressed"])
        escapes += terminated
        if terminated or truncated:
            env.reset()
    print(f"{config}: random, 5,000 primitives: {escapes} escapes, {presses} presses")

# The reward is -1 whatever the agent does until it escapes. An agent that never escapes sees one constant, and a
# constant teaches nothing: each action is as bad as the next. Here is tabular Q-learning in the second room.


def curve(agent, env, primitives):
    """Greedy returns before, during and after training."""
    result = train(agent, env, primitives=primitives, seed=0, eval_every=primitives // 4, eval_episodes=1)
    return [round(e.mean_return) for e in result.evaluations]


env = gymnasium.make("hrl_escape/EscapeRoom-v0", config="paper-two-button", observation="features")
print(f"q-learning on primitives: returns {curve('q-learning', env, 8_000)}")

# A return of -1000 is an episode that was cut off. The same algorithm, the same room, the same budget of primitives,
# but every decision may be an option that goes to a button and presses it:

env = hrl_escape.OptionsEnv(env)
print(f"q-learning on options:    returns {curve('smdp-q-learning', env, 8_000)}")

# Is that fair? Not by itself: the options know the room's walls. So look at what chance does with the same options.

print(f"chance on options:        returns {curve('smdp-random', env, 8_000)}")

# Chance with options escapes. (Its five numbers are one and the same fixed episode: chance learns nothing.) What
# learning adds is the difference between the last two lines, and that is how every comparison here is read.
