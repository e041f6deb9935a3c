"""Plain loops over an environment, for tests that look at an agent between decisions."""

from __future__ import annotations

from collections.abc import Iterator

import gymnasium

from hrl_escape.agents.agent import Agent, SMDPTransition, make_transition, read_action_mask
from hrl_escape.agents.single_env import serve_one


def interact(agent: Agent, env: gymnasium.Env, decisions: int, seed: int = 0) -> Iterator[SMDPTransition]:
    """Let an agent act and learn for so many decisions; yields each transition after it was learned from."""
    actions = int(env.action_space.n)
    observation, info = env.reset(seed=seed)
    mask = read_action_mask(info, actions)
    served = serve_one(agent)
    for _ in range(decisions):
        action = served.act(observation, mask)
        transition = make_transition(observation, action, mask, env.step(action), agent.gamma)
        served.observe(transition)
        yield transition
        observation, mask = transition.next_observation, transition.next_action_mask
        if transition.terminated or transition.truncated:
            observation, info = env.reset()
            mask = read_action_mask(info, actions)


def learn(agent: Agent, env: gymnasium.Env, decisions: int, seed: int = 0) -> None:
    """Let an agent act and learn for so many decisions."""
    for _ in interact(agent, env, decisions, seed):
        pass
