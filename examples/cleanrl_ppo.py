"""PPO in one file, in the style of CleanRL, on many rooms that step together.

Only the rooms come from this package. They reset in the step that ends an episode (`SameStep`), as CleanRL's loop
expects. At the time limit, the value of the state reached (`final_obs`) is added to the reward.
"""

import time

import gymnasium
import numpy as np
import torch
import tyro
from torch import nn

import hrl_escape  # noqa: F401  # registers the rooms


def make_layer(inputs: int, outputs: int, gain: float = 2**0.5) -> nn.Linear:
    """A linear layer with orthogonal weights."""
    layer = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class Agent(nn.Module):
    """An actor and a critic."""

    def __init__(self, numbers: int, actions: int, width: int = 64) -> None:
        super().__init__()
        self.critic, self.actor = (
            nn.Sequential(make_layer(numbers, width), nn.Tanh(), make_layer(width, width), nn.Tanh(),
                          make_layer(width, outputs, gain)) for outputs, gain in ((1, 1.0), (actions, 0.01)))

    def value(self, seen: torch.Tensor) -> torch.Tensor:
        """V(s), (n,)."""
        return self.critic(seen).squeeze(-1)

    def policy(self, seen: torch.Tensor) -> torch.distributions.Categorical:
        """pi(. | s)."""
        return torch.distributions.Categorical(logits=self.actor(seen))


def main(room: str = "hrl_escape/PaperOneButton-v1", primitives: int = 200_000, envs: int = 32, steps: int = 64,
         epochs: int = 4, minibatches: int = 8, learning_rate: float = 1e-3, gamma: float = 0.99,
         gae_lambda: float = 0.95, clip: float = 0.2, entropy: float = 0.01, reward_scale: float = 0.01,
         seed: int = 1) -> None:
    """Train, and print the mean return and success rate of each tenth of the budget.

    Args:
        room: environment id.
        primitives: training budget of all rooms together.
        envs: number of rooms.
        steps: steps per room in a rollout.
        epochs: passes over a rollout.
        minibatches: minibatches per epoch.
        learning_rate: step size of Adam.
        gamma: discount per primitive.
        gae_lambda: lambda of generalised advantage estimation.
        clip: bound on the probability ratio.
        entropy: weight of the entropy bonus.
        reward_scale: factor on rewards.
        seed: seed of weights, draws and rooms.
    """
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    many = gymnasium.make_vec(room, num_envs=envs, observation="features", autoreset_mode="SameStep")
    agent = Agent(many.single_observation_space.shape[0], int(many.single_action_space.n))
    optimiser = torch.optim.Adam(agent.parameters(), lr=learning_rate, eps=1e-5)
    shape = (steps, envs)
    seen = torch.zeros((*shape, *many.single_observation_space.shape))
    actions, log_probabilities, rewards, overs, values = (torch.zeros(shape) for _ in range(5))
    now, begun = torch.from_numpy(many.reset(seed=seed)[0]), time.process_time()
    returns, ended, printed = np.zeros(envs), [], 0
    for done in range(0, primitives, steps * envs):
        for step in range(steps):
            with torch.no_grad():
                policy = agent.policy(now)
                action = policy.sample()
                seen[step], actions[step], values[step] = now, action, agent.value(now)
                log_probabilities[step] = policy.log_prob(action)
            found, reward, terminated, truncated, infos = many.step(action.numpy())
            returns += reward
            rewards[step] = torch.from_numpy(reward * reward_scale)
            over = terminated | truncated
            overs[step] = torch.from_numpy(over)
            if truncated.any():
                with torch.no_grad():
                    left = agent.value(torch.from_numpy(infos["final_obs"][truncated]))
                rewards[step, truncated] += gamma * left
            ended += [(returns[i], bool(terminated[i])) for i in over.nonzero()[0]]
            returns[over] = 0.0
            now = torch.from_numpy(found)
        with torch.no_grad():
            following, carried = agent.value(now), torch.zeros(envs)
            advantages = torch.zeros(shape)
            for step in reversed(range(steps)):
                goes_on = 1.0 - overs[step]
                error = rewards[step] + gamma * goes_on * following - values[step]
                carried = error + gamma * gae_lambda * goes_on * carried
                advantages[step], following = carried, values[step]
        batch = [part.flatten(0, 1) for part in (seen, actions, log_probabilities, advantages, advantages + values)]
        for _ in range(epochs):
            for rows in torch.randperm(steps * envs).chunk(minibatches):
                observation, action, before, advantage, target = (part[rows] for part in batch)
                policy = agent.policy(observation)
                ratio = (policy.log_prob(action) - before).exp()
                advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
                gained = torch.min(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage).mean()
                loss = 0.5 * (agent.value(observation) - target).square().mean() - gained
                optimiser.zero_grad()
                (loss - entropy * policy.entropy().mean()).backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimiser.step()
        learned = done + steps * envs
        if learned * 10 // primitives > printed and ended:
            printed = learned * 10 // primitives
            total, escaped = np.mean(ended, axis=0)
            print(f"{learned:,} primitives: return {total:.0f}, {escaped:.0%} of {len(ended)} episodes escape")
            ended = []
    print(f"{primitives / (time.process_time() - begun):,.0f} primitives a second of CPU")


if __name__ == "__main__":
    tyro.cli(main)
