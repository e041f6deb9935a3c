"""Proximal policy optimisation over decisions of any duration, with masked actions, in one environment or in many.

Schulman et al. (2017), advantages by Schulman et al. (2016), masks by Huang and Ontanon (2022). In the
advantage each decision discounts by its own gamma^k; lambda falls per decision or per primitive, as set.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.agent import LearningSettings, SMDPTransition, count_actions
from hrl_escape.agents.components.bonuses import NoveltySettings
from hrl_escape.agents.components.distillation import make_bonus, visit_streams
from hrl_escape.agents.components.exploration import choose_best, compute_softmax, make_rng, mask_values, sample_index
from hrl_escape.agents.components.memory import cut_stretches, make_memory
from hrl_escape.agents.components.networks import (
    Learner,
    ObservationEncoder,
    make_action_network,
    make_generator,
    make_state_network,
)
from hrl_escape.agents.components.policy_gradient import (
    ClippedSettings,
    Rollout,
    collect_decisions,
    compute_advantages,
    compute_clipped_parts,
    compute_log_policy,
    compute_next_values,
    draw_minibatches,
    keep_decision,
    sample_policy,
    stack_decisions,
    take_column,
)
from hrl_escape.agents.state import Kept, StateTree
from hrl_escape.agents.streams import OpenChoices, StreamAgent, StreamTransitions
from hrl_escape.settings import Range


@dataclass(frozen=True)
class PPOSettings(NoveltySettings, ClippedSettings, LearningSettings):
    """Network, rollouts, clipped objective and bonus of `ppo`."""

    network: Literal["mlp", "objects"] = "mlp"
    """`mlp`: a perceptron over the whole observation. `objects`: deep sets over its rows of objects, equivariant under
    permutation of the objects; for the observation `objects`."""
    memory: Literal["none", "gru"] = "none"
    """`gru`: a gated recurrent unit remembers the episode's observations, for tasks that the present one does not
    decide. It begins every episode empty."""
    memory_units: Annotated[int, Range(1)] = 32
    """Size of its state; with `network=objects`, of each object's."""
    memory_span: Annotated[int, Range(1)] = 32
    """Most decisions through which a gradient goes back."""


class PPO(StreamAgent):
    """Maximise the mean of min(ratio A, clip(ratio, 1 - eps, 1 + eps) A) + entropy, minimise (V - target)^2.

    ratio = pi(o | s) / pi_old(o | s) over legal actions. A is `compute_advantages`, normalised in each minibatch, and
    the value's target is A + V_old. There is no epsilon schedule: the policy itself is random. A decision that outlasts
    the rollout in which it was made counts in the next one, with the probability that it was made with.
    """

    settings: PPOSettings
    is_markov: bool = True
    STATE = ("_learner", Kept("_collected_rollout", "rollout", unpack=dict), Kept("_open", "streams"), "_recollection",
             "_bonus", "_action_rng", "_batch_rng", "_stream_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: PPOSettings | None = None) -> None:
        self.settings = settings = settings or PPOSettings()
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        self._actions = count_actions(action_space, self.name)
        generator = make_generator(make_rng(seed, "weights"))
        self._memory = make_memory(self._encoder, settings, settings.network == "objects", generator)
        size = 0 if self._memory is None else self._memory.size
        self.policy = make_action_network(self._encoder, action_space, settings, generator, 0.01, size)
        self.critic = make_state_network(self._encoder, settings, generator, size)
        networks = {"policy": self.policy, "critic": self.critic}
        self.is_markov = self._memory is None
        if self._memory is not None:
            networks["memory"] = self._memory.network
        self._learner = Learner(self.name, networks, networks, settings)
        self._action_rng, self._batch_rng = make_rng(seed, "actions"), make_rng(seed, "batches")
        self._stream_rng = make_rng(seed, "streams")
        self._bonus = make_bonus(observation_space, seed, settings, self.name)
        self._open: OpenChoices | None = None  # of streams; None while one environment is played
        self._recollection = self._before = np.zeros(size, np.float32)  # of the one environment: now, and before
        self._latest: NDArray | None = None
        self._forget()

    def _forget(self) -> None:
        self._chunks: list[Rollout] = []
        self._rows: list[tuple] = []  # of the one environment, after the chunks
        self._collected = 0

    def compute_preferences(self, observation: Any) -> NDArray:
        """Logits of the policy at an observation, before any mask, float32 (actions,).

        With a memory: of the latest choice, if this was its observation, else of an episode that begins here.
        """
        return self.policy.compute(self._see(observation))

    def compute_state_value(self, observation: Any) -> float:
        """V(s) at an observation, in units of return."""
        return float(self.critic.compute(self._see(observation))[0]) / self.settings.reward_scale

    def _see(self, observation: Any, recollection: NDArray | None = None) -> NDArray:
        """Input of the networks: the encoded observation, with what is remembered once it is seen."""
        encoded = self._encoder.encode(observation)
        if self._memory is None:
            return encoded
        if recollection is None:
            if self._latest is not None and np.array_equal(self._latest[: len(encoded)], encoded):
                return self._latest
            recollection = np.zeros_like(self._before)
        both = (torch.from_numpy(part)[None].to(self.policy.weights.device) for part in (encoded, recollection))
        with torch.no_grad():
            self._latest = seen = self._memory.read(*both)[0].cpu().numpy()
        return seen

    def _recall(self, seen: NDArray) -> NDArray:
        """Part of the networks' input that the memory holds; empty without one."""
        return self._before if self._memory is None else seen[len(seen) - len(self._before) :]

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Draw from the policy over legal actions."""
        seen = self._see(observation, self._recollection)
        self._before, self._recollection = self._recollection, self._recall(seen)
        policy = compute_softmax(mask_values(self.policy.compute(seen), action_mask))
        return sample_index(policy, self._action_rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The likeliest legal action."""
        (recollection,) = self.recall(rng) or (np.zeros_like(self._before),)
        seen = self._see(observation, recollection)
        self._evaluation = rng, self._recall(seen)
        return choose_best(self.policy.compute(seen), action_mask)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Keep the decision; update when the rollout is full. Streams are over with it, and what they collected."""
        if self._open is not None:
            self._open = None
            self._forget()
        bonus = self._bonus.visit(transition.next_observation)
        self._rows.append(keep_decision(transition, self._encoder, self.settings, self._before, bonus))
        if transition.terminated or transition.truncated:
            self._recollection = np.zeros_like(self._before)
        self._collected += 1
        return self._learn() if self._collected >= self.settings.rollout else {}

    # --- streams -------------------------------------------------------------------------

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Move networks and optimiser to a device; every stream begins an episode, and what was collected ends there.

        Where streams begin anew in the middle of a rollout, its decisions stay, and their episodes count as truncated.
        """
        if self._open is not None and self._open.has(count, device):
            if self._collected:
                rollout = self._gather()
                over = rollout.over | self._open.find_last(rollout.stream, rollout.place)
                self._chunks = [rollout._replace(over=over)]
            self._open.begin_episodes()
            return
        self._learner.move(device)
        self._open = OpenChoices(count, self._actions, device, self._stream_rng, len(self._before))
        self._forget()

    def act_streams(self, observation: Tensor, mask: Tensor, stream: Tensor) -> Tensor:
        """Draw from the policy over legal actions, for each row."""
        assert self._open is not None, "begin_streams comes first"
        seen = self._encoder.encode_many(observation)
        numbers = len(self._before)
        with torch.no_grad():
            if self._memory is not None:
                seen = self._memory.read(seen, self._open.memory[stream])
            log_policy = compute_log_policy(self.policy(seen), mask)
        action = sample_policy(log_policy, self._open.generator)
        self._open.choose(stream, mask, take_column(log_policy, action),
                          seen[:, seen.shape[1] - numbers :] if numbers else self._open.memory[stream])
        return action

    def observe_streams(self, decisions: StreamTransitions) -> Mapping[str, float]:
        """Keep the decisions; update when the rollout is full."""
        assert self._open is not None, "begin_streams comes first"
        bonus = visit_streams(self._bonus, decisions.next_observation, self.settings)
        self._chunks.append(collect_decisions(self._open, decisions, self._encoder, self.settings, bonus))
        self._collected += len(decisions.stream)
        least = max(self.settings.rollout, self.settings.stream_rollout * self._open.count)
        return self._learn() if self._collected >= least else {}

    # --- learning ------------------------------------------------------------------------

    def _gather(self) -> Rollout:
        first = sum(len(chunk.place) for chunk in self._chunks)
        chunks = self._chunks + ([stack_decisions(self._rows, first)] if self._rows else [])
        return Rollout(*map(torch.cat, zip(*chunks, strict=True)))

    def _learn(self) -> dict[str, float]:
        """The updates from the rollout, which then begins anew; returns means over them."""
        rollout = self._gather()
        self._forget()
        mask, action = rollout.mask, rollout.action
        seen = rollout.observation
        with torch.no_grad():
            if self._memory is None:
                values = self._value(seen)
                next_values = (self._value(rollout.next_observation) if self._open is None else
                               compute_next_values(rollout, values, self._value))
            else:
                seen = self._memory.read(seen, rollout.memory)
                reached = self._memory.read(rollout.next_observation, self._memory.get_state(seen))
                values, next_values = self._value(seen), self._value(reached)
            old_log_probability = rollout.log_probability
            if self._open is None:  # the policy is still the one that chose
                log_policy = compute_log_policy(self.policy(seen), mask)
                old_log_probability = take_column(log_policy, action)
            else:
                self._open.begin_rollout()
        advantages = compute_advantages(rollout, values, next_values, self.settings)
        targets = advantages + values
        totals = torch.zeros(4, device=action.device)
        count = 0
        for rows, batch in self._draw_batches(rollout):
            loss, parts = self.compute_loss(
                batch, mask[rows], action[rows], old_log_probability[rows], advantages[rows], targets[rows])
            self._learner.minimise(loss)
            totals += parts
            count += 1
        names = ("loss", "policy_loss", "value_loss", "entropy")
        mean_value = values.mean().item() / self.settings.reward_scale
        return dict(zip(names, (totals / count).tolist(), strict=True)) | {
            "gradient_norm": self._learner.gradient_norm, "value": mean_value}

    def _value(self, seen: Tensor) -> Tensor:
        return self.critic(seen).squeeze(1)

    def _draw_batches(self, rollout: Rollout) -> Iterator[tuple[Tensor, Tensor]]:
        """Rows of each minibatch, and the networks' input there; with a memory, lived through again in stretches."""
        settings, device = self.settings, rollout.action.device
        total, batch_size = len(rollout.action), settings.batch_size
        batch_size = max(batch_size, total * batch_size // settings.rollout)
        if self._memory is None:
            stretches, units = None, total
        else:
            stretches = cut_stretches(rollout.stream, rollout.place, settings.memory_span)
            units = stretches.grid.shape[1]
        for order in draw_minibatches(self._batch_rng, units, max(1, batch_size * units // total), settings.epochs):
            drawn = order.to(device)
            part = None if stretches is None else stretches.pick(drawn)
            rows = drawn if part is None else part.rows
            if len(rows) < 2:
                continue  # one advantage cannot be normalised
            if part is None or self._memory is None:
                yield rows, rollout.observation[rows]
            else:
                yield rows, self._memory.read_stretches(rollout.observation, rollout.memory, rollout.over, part)

    def compute_loss(self, observation: Tensor, mask: Tensor, action: Tensor, old_log_probability: Tensor,
                     advantage: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
        """The loss over a minibatch; and, without gradient, (4,): loss, policy loss, value loss, entropy."""
        log_policy = compute_log_policy(self.policy(observation), mask)
        parts = compute_clipped_parts(log_policy, mask, action, self.critic(observation).squeeze(1),
                                      old_log_probability, advantage, target, self.settings)
        return parts["loss"], torch.stack(tuple(parts.values())).detach()

    @property
    def _collected_rollout(self) -> dict[str, Tensor] | None:
        """Fields of the rollout so far; None where it is empty."""
        return self._gather()._asdict() if self._collected else None

    @_collected_rollout.setter
    def _collected_rollout(self, saved: Mapping[str, Any] | None) -> None:
        self._forget()
        if saved is not None:
            device = self.policy.weights.device
            self._chunks = [Rollout(**{name: torch.from_numpy(np.asarray(field)).to(device)
                                       for name, field in saved.items()})]
            self._collected = len(self._chunks[0].place)

    def load_state_dict(self, state: StateTree) -> None:
        """Restore the result of `state_dict`; streams go on if there are as many, on any device.

        A rollout of many streams is dropped where one environment is played, and the other way round.
        """
        is_other = (self._open is None) != (state["streams"] is None)
        super().load_state_dict({**state, "rollout": None} if is_other else state)
