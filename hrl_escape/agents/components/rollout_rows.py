"""Rollouts of one environment as rows, to stack as tensors before an update."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition, compute_backup
from hrl_escape.agents.components.networks import ObservationEncoder
from hrl_escape.agents.components.policy_gradient import Rollout


def keep_decision(transition: SMDPTransition, encoder: ObservationEncoder, settings: Any, memory: NDArray[np.float32],
                  bonus: float = 0.0) -> tuple:
    """Convert a decision of one environment to a row for `stack_decisions`, with the memory before it.

    Rewards are scaled; the bonus is in units of return.
    """
    reward, bootstrap = compute_backup(transition, settings)
    return (encoder.encode(transition.observation), transition.action_mask, transition.action,
            (reward + bonus) * settings.reward_scale, bootstrap, transition.duration,
            transition.terminated or transition.truncated, encoder.encode(transition.next_observation), memory)


def stack_decisions(rows: Sequence[tuple], first: int) -> Rollout:
    """Stack rows of `keep_decision`, in order, as a rollout of one environment, the first at the place `first`."""
    dtypes = (None, np.bool_, np.int64, np.float32, np.float32, np.int64, np.bool_, None, np.float32)
    fields = [torch.from_numpy(np.array(field, dtype))
              for field, dtype in zip(zip(*rows, strict=True), dtypes, strict=True)]
    observation, mask, action, *rest = fields
    return Rollout(observation, mask, action, torch.zeros(len(rows)), *rest,
                   stream=torch.zeros(len(rows), dtype=torch.int64),
                   place=torch.arange(first, first + len(rows)))


def unstack_decisions(fields: Mapping[str, Any]) -> list[tuple]:
    """Return the rows of a result of `stack_decisions`, from its fields by name."""
    names = ("observation", "mask", "action", "reward", "bootstrap", "duration", "over", "next_observation", "memory")
    return list(zip(*(np.asarray(fields[name]) for name in names), strict=True))
