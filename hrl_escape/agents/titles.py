"""Display names of agents, for prose, tables and legends."""

from __future__ import annotations

from hrl_escape.agents.registry import split_name

_TITLES = {
    "random": "random policy",
    "sweep": "sweep in index order",
    "sweep-random": "sweep in random order",
    "search-random": "search baseline, random order",
    "search-nearest": "search baseline, nearest first",
    "search-backtrack": "search baseline, with backtracking",
    "search-memory": "search baseline, with memory",
    "count-cues": "counting baseline",
    "bayes": "Bayes planner",
    "oracle": "oracle",
    "text-agent": "text agent",
    "q-learning": "Q-learning",
    "r-max": "R-MAX",
    "factored-r-max": "factored R-MAX",
    "met-r-max": "Met-R-MAX",
    "r-maxq": "R-MAXQ",
    "maxq-q": "MAXQ-Q",
    "sarsa": "SARSA",
    "hrc": "HRC",
    "hrac": "HRAC",
    "hiro": "HIRO",
    "hac": "HAC",
    "hdg": "HDG",
    "hamq": "HAMQ",
    "h-dqn": "h-DQN",
    "h-uct": "H-UCT",
    "hq-learning": "HQ-learning",
    "macro-q": "macro Q-learning",
    "intra-option-q": "intra-option Q-learning",
    "feudal-rl": "feudal RL",
    "fun": "FuN",
    "sol": "SOL",
    "hiql": "HIQL",
    "iql": "IQL",
    "cql": "CQL",
    "sharsa": "SHARSA",
    "fitted-q": "fitted Q-iteration",
    "behaviour-cloning": "behaviour cloning",
    "decision-transformer": "Decision Transformer",
    "monte-carlo-model": "Monte Carlo model",
    "deep-abstract-q": "deep abstract Q",
    "vigorito-barto": "Vigorito and Barto",
    "option-critic": "option-critic",
    "option-keyboard": "option keyboard",
    "skill-chaining": "skill chaining",
    "covering-options": "covering options",
    "eigenoptions": "eigenoptions",
    "rainbow": "Rainbow",
    "dqn": "DQN",
    "ddpg": "DDPG",
    "ppo": "PPO",
    "ppoc": "PPOC",
    "dac": "DAC",
    "a2oc": "A2OC",
    "diayn": "DIAYN",
    "torchrl-dqn": "TorchRL DQN",
    "torchrl-ppo": "TorchRL PPO",
    "torchrl-sac": "TorchRL SAC",
}


def find_title(name: str) -> str:
    """Display name of an agent without its options; an agent of a third party has its name."""
    algorithm = split_name(name)[0]
    return _TITLES.get(algorithm, algorithm)
