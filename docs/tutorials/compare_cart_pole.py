"""Compare agents in any Gymnasium environment.

A comparison needs no room and no options. Here agents of this package, an agent of our own, PPO of Stable-Baselines3
and a fixed rule balance CartPole, all with the same seeds and evaluations.
"""

import numpy as np
from stable_baselines3 import PPO

from hrl_escape import compare
from hrl_escape.agents import Agent, AgentSettings, FrozenAgent, SB3Agent

# An agent of our own is a class. This one draws weights of a linear policy at random after every episode and keeps the
# best, as a first baseline.


class RandomSearch(Agent):
    """Keep the linear policy with the best episode so far."""

    Settings, STATE = AgentSettings, ("best", "tried", "record", "total", "rng")
    gamma = 0.99

    def __init__(self, observation_space, action_space, seed, settings=None):
        """Begin with no weights."""
        self.settings, self.rng = settings or AgentSettings(), np.random.default_rng(seed)
        self.best = self.tried = np.zeros(observation_space.shape[0])
        self.record, self.total = -1.0, 0.0

    def act(self, observation, action_mask):
        """Follow the weights on trial."""
        return int(observation @ self.tried > 0)

    def act_greedy(self, observation, action_mask, rng):
        """Follow the best weights."""
        return int(observation @ self.best > 0)

    def observe(self, transition):
        """At the end of an episode, keep the weights if they are the best, and draw others."""
        self.total += transition.summed_reward
        if transition.terminated or transition.truncated:
            if self.total > self.record:
                self.best, self.record = self.tried, self.total
            self.tried, self.total = self.rng.normal(size=self.best.shape), 0.0
        return {}


# A function or a trained model takes part as a `FrozenAgent`, which is evaluated without training.

lean = FrozenAgent(lambda observation: int(observation[2] + observation[3] > 0), name="lean-with-the-pole")
result = compare(["dqn", "ppo", SB3Agent(PPO, n_steps=256), RandomSearch, lean], env="CartPole-v1", seeds=10,
                 primitives=1_000, eval_every=500, eval_episodes=2, reference=475, progress=False)
result

# Ten seeds give a verdict by paired tests, corrected for all pairs of agents. With fewer there are estimates and
# intervals. The budget of 1,000 primitives is small, so that the page builds quickly. The numbers say nothing about
# trained agents: take 50,000 primitives before you judge a learner. With a folder as `out=`, a stopped call continues.

for agent in result.summary.agents:
    print(f"{agent.label}: return {agent.returns:.0f}, {agent.length.value:.0f} primitives an episode")
print(result.report("cart-pole"))
result.plot()
