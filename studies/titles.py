"""Display names of learners whose labels in the studies are not agent specs."""

from __future__ import annotations

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.errors import EscapeError

__all__ = ["find_title"]

_TITLES = {
    "options, dqn": "DQN over options",
    "options, ppo": "PPO over options",
    "options, q-learning": "Q-learning over options",
    "dqn": "DQN, long exploration",
    "dqn, patient": "DQN, long exploration",
    "dqn, defaults": "DQN, default settings",
    "dqn, distillation": "DQN with random network distillation",
    "dqn, hindsight": "DQN with hindsight",
    "q-learning, counts": "Q-learning with a count bonus",
    "ppo, long": "PPO, ten million primitives",
    "ppo, novelty": "PPO with a novelty bonus",
    "ppo, commitment": "PPO, actions repeated 8 times",
    "ppo, commitment and novelty": "PPO, repeats and novelty bonus",
    "ppo, advantages as they are": "PPO, advantages not normalised",
    "ppo, recurrent": "PPO with a GRU",
    "archive, moves": "archive exploration",
    "archive, privileged": "archive exploration with resets",
    "chance": "untrained policy",
    "chance, commitment": "untrained policy, actions repeated 8 times",
    "options explore": "options explore",
    "repeats explore": "repeated primitives explore",
    "long credit": "15-step targets",
    "options explore, long credit": "options explore, 15-step targets",
    "options ahead": "imagined options",
    "random ways ahead": "imagined random primitives",
    "primitives ahead": "imagined random primitives, 3-step targets",
}


def find_title(label: str) -> str:
    """Display name of a learner: by its label in a study, or by its agent spec."""
    if label in _TITLES:
        return _TITLES[label]
    try:
        return AgentSpec.parse(label).title
    except EscapeError:
        return label
