r"""Your own agent and network.

Three ways to extend, from small to large: your own network in an agent of the package, a variant of an agent, and a new
agent. All three train in the same room and choose among the same options. They share training, evaluation and
checkpoints.
"""

from dataclasses import dataclass

import gymnasium
import numpy as np
import torch
from torch import nn

from hrl_escape import OptionsEnv, make_agent, train
from hrl_escape.agents import Agent, AgentSettings
from hrl_escape.agents.algorithms.dqn import DQN

env = OptionsEnv(gymnasium.make("hrl_escape/PaperTwoButton-v1", observation="features"), include_primitives=False)
env.unwrapped.instance

# **A network.** Any torch module from observations to one number per action can replace an agent's own.

inputs, actions = env.observation_space.shape[0], int(env.action_space.n)
torch.manual_seed(0)
network = nn.Sequential(nn.Linear(inputs, 64), nn.LayerNorm(64), nn.SiLU(), nn.Linear(64, actions))
with_network = make_agent("smdp-dqn", env.observation_space, env.action_space, 0, structure={"network": network})

# **A variant.** A subclass implements what it changes and inherits replay, n-step backups and checkpoints. This one
# backs up the mellowmax of Asadi and Littman (2017), a soft maximum, where DQN takes the maximum.


class MellowDQN(DQN):
    """R + b log(mean over legal o of exp(5 Q_target(s', o))) / 5."""

    name = "mellow-dqn"

    def compute_targets(self, batch):
        """Targets of a batch, float32 (batch,)."""
        scores = 5.0 * self.values.target(batch.next_observation)
        total = scores.masked_fill(~batch.next_mask, -torch.inf).logsumexp(dim=1)
        return batch.reward + batch.bootstrap * (total - batch.next_mask.sum(dim=1).log()) / 5.0


variant = MellowDQN(env.observation_space, env.action_space, seed=0)

# **A new agent.** The contract is three methods and the names of its state. This agent is Monte Carlo control: the
# value of an option is the mean of the returns that followed it.


@dataclass(frozen=True)
class MonteCarloSettings(AgentSettings):
    """What can be set."""

    gamma: float = 0.99
    epsilon: float = 0.2


class MonteCarlo(Agent):
    """Q(s, o) is the mean return after o in s."""

    name, Settings, STATE = "monte-carlo", MonteCarloSettings, ("table", "rng")

    def __init__(self, actions, seed):
        """Begin with an empty table."""
        self.settings, self.actions, self.rng = MonteCarloSettings(), actions, np.random.default_rng(seed)
        self.table, self.episode = {}, []

    def read(self, observation):
        """Sums and counts of returns, (2, actions)."""
        return self.table.setdefault(str(np.round(observation * 4)), np.zeros((2, self.actions)))

    def act(self, observation, action_mask):
        """Explore a little."""
        explores = self.rng.random() < self.settings.epsilon
        return int(self.rng.choice(np.flatnonzero(action_mask))) if explores else self.act_greedy(
            observation, action_mask, self.rng)

    def act_greedy(self, observation, action_mask, rng):
        """The best mean; what was never tried comes first."""
        total, visits = self.read(observation)
        means = np.where(visits > 0, total / np.maximum(visits, 1), 1e3)
        return int(np.argmax(np.where(action_mask, means, -np.inf)))

    def observe(self, transition):
        """At the episode's end, add up R + gamma^k G backwards."""
        self.episode.append((self.read(transition.observation), transition))
        if transition.terminated or transition.truncated:
            future = 0.0
            for row, step in reversed(self.episode):
                future = step.reward + step.discount * future
                row[:, step.action] += future, 1
            self.episode = []
        return {}


own = MonteCarlo(actions, seed=0)

# Train all three and plot them together. Each point evaluates frozen weights on the same fixed episodes.

runs = [train(agent, env, primitives=6_000, seed=0, eval_every=500, progress=False)
        for agent in (with_network, variant, own)]
for name, run in zip(("own network", "variant", "own agent"), runs, strict=True):
    first, last = run.evaluations[0], run.evaluations[-1]
    print(f"{name}: return {first.mean_return:g} untrained, {last.mean_return:g} at the end")
runs[0].plot(beside=runs[1:])
