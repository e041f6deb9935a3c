"""Parts of policy gradients over decisions of any duration: advantages, masked policies, the clipped objective.

Schulman et al. (2016, 2017); masks follow Huang and Ontanon (2022). Decisions of many environments differ in number.
They are stored as rows with the index of their environment (`stream`) and their place in its sequence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.networks import BLOCK_ROWS
from hrl_escape.agents.state import Kept, Stateful


class Rollout(NamedTuple):
    """Decisions of one or more environments; tensors with leading dimension n, on one device."""

    observation: Tensor  # (n, *observation shape), encoded
    mask: Tensor  # bool (n, actions)
    action: Tensor  # int64 (n,), or float32 (n, size) of a Box
    log_probability: Tensor  # float32 (n,), of the action under the behaviour policy
    reward: Tensor  # float32 (n,), R, scaled
    bootstrap: Tensor  # float32 (n,), b
    duration: Tensor  # int64 (n,), k
    over: Tensor  # bool (n,), whether the episode ended, by termination or truncation
    next_observation: Tensor  # (n, *observation shape), the next state, also at the end of an episode
    memory: Tensor  # float32 (n, numbers), recurrent state before the decision; of width 0 without a memory
    stream: Tensor  # int64 (n,), index of the environment
    place: Tensor  # int64 (n,), index of the decision in its stream, from 0 without gaps


class RolloutBuffer(Stateful):
    """Decisions collected for the next updates, of one environment or many.

    Args:
        arrays: library of the decisions.
        num_envs: number of environments.
        size: components of a choice in a Box, 0 for an index.

    Attributes:
        choice: each environment's latest choice, (environments,) or (environments, size).
        log_probability: of these choices under the policy that made them, (environments,).
    """

    STATE = (Kept("_rows", "rows", unpack=dict), Kept("choice", is_left_out=True), "log_probability")

    def __init__(self, arrays: Arrays, num_envs: int, size: int = 0) -> None:
        self._arrays, self._num_envs = arrays, num_envs
        self.choice = arrays.zeros((num_envs, size)) if size else arrays.zeros((num_envs,), "int64")
        self.log_probability = arrays.zeros((num_envs,))
        self._parts: list[tuple[Any, ...]] = []
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, *fields: Any) -> None:
        """Add decisions: the fields of `Rollout` except the place, arrays or tensors (n, ...)."""
        self._parts.append(fields)
        self._count += len(fields[-1])

    def note_choice(self, env: Any, choice: Any, log_probability: Any) -> None:
        """Store choices, (n, ...), of some environments, int64 (n,), and their log probabilities, (n,)."""
        self.choice[env], self.log_probability[env] = choice, log_probability

    def gather(self) -> Rollout:
        """Return all collected decisions as tensors."""
        fields = [self._arrays.join(parts) for parts in zip(*self._parts, strict=True)]
        place = count_places(fields[-1])
        rollout = Rollout(*fields, place=place)
        return rollout._replace(**{name: getattr(rollout, name).float() for name in ("reward", "bootstrap")})

    def take(self) -> Rollout:
        """Return the collected decisions, and begin the next rollout."""
        rollout = self.gather()
        self._parts, self._count = [], 0
        return rollout

    def truncate(self) -> None:
        """End the episode of every environment at its latest decision."""
        if self._count:
            rollout = self.gather()
            last = torch.zeros(self._num_envs, dtype=torch.int64, device=rollout.place.device)
            last = last.scatter_reduce(0, rollout.stream, rollout.place, "amax")
            over = rollout.over | (rollout.place == last[rollout.stream])
            self._parts = [tuple(map(self._arrays.restore, (
                field.cpu().numpy() for field in rollout._replace(over=over)[:-1])))]

    @property
    def _rows(self) -> dict[str, Tensor] | None:
        """Fields of the collected decisions, or None if there are none."""
        return self.gather()._asdict() if self._count else None

    @_rows.setter
    def _rows(self, saved: Mapping[str, Any] | None) -> None:
        self._parts, self._count = [], 0
        if saved is not None:
            self.add(*(self._arrays.restore(saved[name]) for name in Rollout._fields[:-1]))


def count_places(stream: Tensor) -> Tensor:
    """Return the place of each row within its stream, in order, int64 (n,) from int64 (n,)."""
    order = torch.argsort(stream, stable=True)
    sizes = torch.bincount(stream)
    begins = (sizes.cumsum(0) - sizes)[stream[order]]
    place = torch.empty_like(order)
    place[order] = torch.arange(len(order), device=order.device) - begins
    return place


def compute_advantages(rollout: Rollout, values: Tensor, next_values: Tensor, settings: Any) -> Tensor:
    """Return generalised advantages of decisions of different duration, by environment, float32 (n,).

    delta_t = R_t + b_t V(s_{t+1}) - V(s_t), and A_t = delta_t + b_t L_t A_{t+1} unless the episode ended at t, with
    b_t = gamma^k_t (1 - terminated) and L_t = lambda, or lambda^k_t with `lambda_per="primitive"`; t + 1 is the next
    decision in the same environment.
    """
    delta = rollout.reward + rollout.bootstrap * next_values - values
    powers = rollout.duration if settings.lambda_per == "primitive" else torch.ones_like(rollout.duration)
    carry = rollout.bootstrap * settings.gae_lambda ** powers.to(torch.float64) * ~rollout.over
    at = rollout.place, rollout.stream
    shape = int(rollout.place.max()) + 1, int(rollout.stream.max()) + 1
    deltas, carries = (torch.zeros(shape, dtype=torch.float64, device=delta.device) for _ in range(2))
    deltas[at], carries[at] = delta.to(torch.float64), carry  # (places, streams), 0 after the end of a stream
    for place in range(shape[0] - 2, -1, -1):
        deltas[place] += carries[place] * deltas[place + 1]
    return deltas[at].to(torch.float32)


def find_next(rollout: Rollout) -> tuple[Tensor, Tensor]:
    """Return the row of the next decision in the same stream, int64 (n,), and whether it continues the episode."""
    place, stream = rollout.place, rollout.stream
    shape = int(place.max()) + 2, int(stream.max()) + 1
    rows = torch.full(shape, -1, dtype=torch.int64, device=place.device)
    rows[place, stream] = torch.arange(len(place), device=place.device)
    after = rows[place + 1, stream]
    return after.clamp(min=0), (after >= 0) & ~rollout.over


def compute_next_values(rollout: Rollout, values: Tensor, evaluate: Callable[[Tensor], Tensor]) -> Tensor:
    """Return V of the next states, float32 (n,): the value of the next decision, if it is in the rollout.

    Args:
        rollout: the decisions.
        values: V of the states of the decisions, (n,).
        evaluate: computes V of the next states of some rows, (k,) from int64 (k,); called for rows without a next
            decision.
    """
    after, goes_on = find_next(rollout)
    last = (~goes_on).nonzero().squeeze(1)
    return values[after].index_copy(0, last, evaluate(last))


def compute_log_policy(logits: Any, mask: Any) -> Any:
    """Return log probabilities of the softmax over legal actions, -inf elsewhere; arrays or tensors (n, actions)."""
    if isinstance(logits, np.ndarray):
        legal = np.where(mask, logits, -np.inf)
        legal = legal - legal.max(axis=1, keepdims=True)
        return legal - np.log(np.exp(legal).sum(axis=1, keepdims=True))
    legal = logits.masked_fill(~mask, -torch.inf)
    if len(legal) < BLOCK_ROWS:
        return functional.log_softmax(legal, dim=1)
    return functional.log_softmax(legal.t().contiguous(), dim=0).t()  # a sixth of the time of the row-wise form


def take_column(rows: Any, column: Any) -> Any:
    """Return one entry of each row, (n,) from (n, columns) and int64 (n,); arrays or tensors."""
    if isinstance(rows, np.ndarray):
        return rows[np.arange(len(rows)), column]
    return rows.gather(1, column[:, None]).squeeze(1)


def compute_clipped_loss(log_probability: Tensor, old_log_probability: Tensor, advantage: Tensor, clip: float,
                         normalise: bool = True) -> Tensor:
    """Return minus the mean of min(ratio A, clip(ratio, 1 - eps, 1 + eps) A), A normalised; () from (batch,)."""
    ratio = (log_probability - old_log_probability).exp()
    if normalise:
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    return -torch.minimum(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage).mean()


def compute_clipped_parts(log_probability: Tensor, entropy: Tensor, values: Tensor, old_log_probability: Tensor,
                          advantage: Tensor, target: Tensor, settings: Any) -> dict[str, Tensor]:
    """Return PPO's loss over a minibatch and its parts; the entropy is (), all others (n,)."""
    policy_loss = compute_clipped_loss(log_probability, old_log_probability, advantage, settings.clip,
                                       settings.normalise_advantages)
    value_loss = 0.5 * functional.mse_loss(values, target)
    loss = policy_loss + settings.value_weight * value_loss - settings.entropy_weight * entropy
    return {"loss": loss, "policy_loss": policy_loss, "value_loss": value_loss, "entropy": entropy}


def compute_entropy(log_policy: Tensor, mask: Tensor) -> Tensor:
    """Return the mean entropy of policies over legal actions, nats; () from (batch, actions)."""
    return -(log_policy.exp() * log_policy.masked_fill(~mask, 0.0)).sum(dim=1).mean()
