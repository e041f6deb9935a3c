"""Rollouts of one environment as rows, which are stacked as tensors before an update."""

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
    """A decision of one environment as `stack_decisions` takes it, with what was remembered before it.

    Rewards are scaled; the bonus is in units of return.
    """
    reward, bootstrap = compute_backup(transition, settings)
    return (encoder.encode(transition.observation), transition.action_mask, transition.action,
            (reward + bonus) * settings.reward_scale, bootstrap, transition.duration,
            transition.terminated or transition.truncated, encoder.encode(transition.next_observation), memory)


def stack_decisions(rows: Sequence[tuple], first: int) -> Rollout:
    """Decisions of one environment in order, from `keep_decision`, as a rollout, the first at the place `first`."""
    dtypes = (None, np.bool_, np.int64, np.float32, np.float32, np.int64, np.bool_, None, np.float32)
    fields = [torch.from_numpy(np.array(field, dtype))
              for field, dtype in zip(zip(*rows, strict=True), dtypes, strict=True)]
    observation, mask, action, *rest = fields
    return Rollout(observation, mask, action, torch.zeros(len(rows)), *rest,
                   stream=torch.zeros(len(rows), dtype=torch.int64),
                   place=torch.arange(first, first + len(rows)))


def unstack_decisions(fields: Mapping[str, Any]) -> list[tuple]:
    """The rows that `stack_decisions` took, of the fields of its result by name."""
    names = ("observation", "mask", "action", "reward", "bootstrap", "duration", "over", "next_observation", "memory")
    return list(zip(*(np.asarray(fields[name]) for name in names), strict=True))
