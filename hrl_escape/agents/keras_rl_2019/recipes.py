"""The named settings `keras-rl-2019`: each agent as keras-rl 0.4.2 and the published 2019 program ran it.

An entry lists the changes to the agent's recommended settings. Names with the prefix `smdp-` have their own entry if
the code used other layer widths with meta-actions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_DECISIONS: dict[str, Any] = {"discounting": "decision", "bootstrap_on_truncation": False}
"""One gamma per decision, the plain sum of rewards, and truncation treated as termination."""

_KERAS: dict[str, Any] = {
    **_DECISIONS,
    "clock": "decision",
    "hidden": (16, 16, 16),
    "initialisation": "glorot",
    "learning_rate": 1e-3,
    "adam_epsilon": 1e-7,
    "scale_observations": False,
    "reward_scale": 1.0,
    "loss": "squared",
}

_BOLTZMANN: dict[str, Any] = {"exploration": "boltzmann", "boltzmann_clip": 500.0}

_DQN: dict[str, Any] = {
    **_KERAS,
    **_BOLTZMANN,
    "max_grad_norm": 0.0,
    "n_step": 1,
    "target_rate": 0.01,
    "target_every": 1,
    "average_rate": 0.0,
    "batch_size": 32,
    "warmup": 1_000,
    "updates_per_step": 1.0,
}

_SARSA: dict[str, Any] = {
    **_KERAS,
    **_BOLTZMANN,
    "max_grad_norm": 0.0,
    "expected": False,
    "target_rate": 1.0,
    "replay_capacity": 0,
    "warmup": 10,
    "late_terminal": True,
}

_DDPG: dict[str, Any] = {
    **_KERAS,
    "exploration": "ornstein-uhlenbeck",
    "max_grad_norm": 1.0,
    "relaxation": "linear",
    "entropy_weight": 0.0,
    "target_rate": 0.001,
    "average_actor": False,
    "batch_size": 32,
    "warmup": 1_000,
    "actor_warmup": 100,
    "updates_per_step": 1.0,
}

CHANGES: Mapping[str, Mapping[str, Any]] = {
    "random": {},
    "q-learning": {**_DECISIONS, "clock": "decision"},
    "dqn": _DQN,
    "smdp-dqn": {**_DQN, "hidden": (3, 3, 3)},
    "sarsa": _SARSA,
    "smdp-sarsa": {**_SARSA, "hidden": (32, 32, 32)},
    "ddpg": _DDPG,
    "smdp-ddpg": {**_DDPG, "hidden": (4, 4, 4)},
    "ppo": _DECISIONS,
}
"""Agent -> changes to its recommended settings; other agents have no such recipe."""
