"""Proximal policy optimisation over decisions of any duration, with masked actions, in one environment or in many.

    maximise the mean of min(ratio A, clip(ratio, 1 - eps, 1 + eps) A) + entropy,    minimise (V(s) - (A + V_old(s)))^2

ratio = pi(o | s) / pi_old(o | s) over legal actions. A is the generalised advantage: delta = R + b V(s') - V(s),
A = delta + b lambda A', with b = gamma^k (1 - terminated) of each decision. Schulman et al. (2017), advantages by
Schulman et al. (2016), masks by Huang and Ontanon (2022). In a Box pi is Gaussian, and its entropy is exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.agent import AgentSettings, compute_backup, count_choices
from hrl_escape.agents.batch_agent import BatchAgent
from hrl_escape.agents.components.arrays import Arrays
from hrl_escape.agents.components.box_actions import BoxActions
from hrl_escape.agents.components.distillation import make_bonus
from hrl_escape.agents.components.distributions import CategoricalHead, GaussianHead
from hrl_escape.agents.components.exploration import make_rng
from hrl_escape.agents.components.memory import Recollections, make_memory
from hrl_escape.agents.components.networks import (
    Learner,
    ObservationEncoder,
    make_action_network,
    make_generator,
    make_state_network,
)
from hrl_escape.agents.components.policy import GreedyPolicy
from hrl_escape.agents.components.policy_gradient import (
    Rollout,
    RolloutBuffer,
    compute_advantages,
    compute_clipped_parts,
    compute_next_values,
)
from hrl_escape.agents.decisions import Decisions, Moments, Policy
from hrl_escape.agents.state import Stateful
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class PPOSettings(AgentSettings):
    """Settings of `ppo`."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive. Higher values look further ahead and have more variance."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination."""
    gae_lambda: Annotated[float, Range(0, 1)] = 0.95
    """Lambda of generalised advantage estimation. 1 has the most variance, and no bias from the critic."""
    lambda_per: Literal["decision", "primitive"] = "decision"
    """Unit of lambda: a decision of k primitives weighs later errors by lambda, or by lambda^k."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Ignored: rollouts count decisions."""

    rollout: Annotated[int, Range(2)] = 256
    """Decisions collected before each round of updates, of all environments together. More make steadier updates, and
    fewer of them."""
    rollout_per_env: Annotated[int, Range(1)] = 32
    """Least decisions of each of many environments, on average, in a rollout. A rollout above `rollout` is cut into as
    many minibatches, so into larger ones."""
    epochs: Annotated[int, Range(1)] = 10
    """Passes over a rollout. More learn more from it and move further from the policy that collected it."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in a minibatch of a rollout of `rollout` decisions."""
    clip: Annotated[float, Range(0, open_low=True)] = 0.2
    """Bound on how far the probability ratio may move to any advantage. Smaller is slower and steadier."""
    normalise_advantages: bool = True
    """Shift and scale the advantages of each minibatch to mean 0 and deviation 1. Before the first success that blows
    noise up to full-sized steps."""
    entropy_weight: Annotated[float, Range(0)] = 0.01
    """Weight of the policy's entropy. More explores for longer."""
    value_weight: Annotated[float, Range(0)] = 0.5
    """Weight of half the squared value error."""
    log_std: float = 0.0
    """Initial logarithm of the Gaussian's standard deviation, for actions in a Box scaled to [-1, 1]. Higher values
    explore more."""

    network: Literal["mlp", "objects"] = "mlp"
    """`mlp`: a perceptron over the whole observation. `objects`: deep sets over its rows of objects, for the
    observation `objects`."""
    memory: Literal["none", "gru"] = "none"
    """`gru`: a gated recurrent unit remembers the episode's observations, for tasks that the present one does not
    decide."""
    memory_units: Annotated[int, Range(1)] = 32
    """Size of its state; with `network=objects`, of each object's."""
    memory_span: Annotated[int, Range(1)] = 32
    """Most decisions through which a gradient goes back. More learn longer dependencies and take longer."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "orthogonal"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform, as in Keras; or orthogonal, with tanh units and a small
    last layer of the policy."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that the critic learns. Smaller values suit larger returns."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam. Too large a step diverges."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    max_grad_norm: Annotated[float, Range(0)] = 0.5
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""

    bonus: Literal["counts", "distillation"] = "counts"
    """Novelty for `bonus_weight`: visits of a cell, or the error of a network that predicts a random one (Burda et al.
    2018)."""
    bonus_weight: Annotated[float, Range(0)] = 0.0
    """Largest cost of reaching known states, in units of return. More explores more; 0 turns novelty off."""
    bonus_bins: Annotated[int, Range(2)] = 5
    """Points to round a bounded component to for counting. More make finer cells with fewer visits each."""


class PPO(BatchAgent):
    """Proximal policy optimisation; the equation is in the module's text.

    The policy is stochastic and needs no schedule of exploration. A decision that outlasts the rollout of its choice
    counts in the next one, with its probability at the choice.

    Attributes:
        policy: logits of the actions; means in a Box.
        critic: V in scaled rewards.
        rollout: decisions since the last round of updates.
    """

    settings: PPOSettings
    acts_in = ("discrete", "box")
    is_markov: bool = True
    STATE = ("_learner", "_bonus", "_batch_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: PPOSettings | None = None) -> None:
        self.settings = settings = settings or PPOSettings()
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        self._seed, self._actions = seed, count_choices(action_space, self.name)
        self._box = None if self._actions else BoxActions(action_space, self.name)
        generator = make_generator(make_rng(seed, "weights"))
        self._memory = make_memory(self._encoder, settings.memory, settings.memory_units, settings.memory_span,
                                   settings.network == "objects", generator)
        self.policy = make_action_network(self._encoder, action_space, settings, generator, 0.01, self._memory.size)
        self.critic = make_state_network(self._encoder, settings, generator, self._memory.size)
        self._head = CategoricalHead() if self._box is None else GaussianHead(self._box, settings.log_std)
        networks = {"policy": self.policy, "critic": self.critic, **self._memory.networks, **self._head.networks}
        self._learner = Learner(self.name, networks, networks, settings)
        self._bonus = make_bonus(observation_space, seed, settings, self.name)
        self._batch_rng = make_rng(seed, "batches")
        self.is_markov = self._memory.size == 0
        self._prepare(1, None)

    def _prepare(self, num_envs: int, device: torch.device | None) -> None:
        self.place = num_envs, device
        self._arrays = Arrays(make_rng(self._seed, "actions" if device is None else "streams"), device)
        self._recollections = Recollections(self._memory, num_envs, self._arrays)
        self._least = max(self.settings.rollout, 0 if device is None else self.settings.rollout_per_env * num_envs)
        self.rollout = RolloutBuffer(self._arrays, num_envs, 0 if self._box is None else self._box.size)

    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin episodes; with as many environments as before, episodes of the present rollout count as truncated."""
        if self.place == (num_envs, device):
            self.rollout.truncate()
            self._recollections.begin_episodes()
        else:
            self._learner.move(device or torch.device("cpu"))
            self._prepare(num_envs, device)

    def act(self, batch: Moments) -> Any:
        """Draw from the policy: legal actions, int64 (n,), or actions in the Box, float32 (n, ...)."""
        seen = self._recollections.see(batch.env, self._encoder.encode_batch(batch.observation))
        action, choice, log_probability = self._head.draw(self.policy.evaluate(seen), batch.action_mask, self._arrays)
        self.rollout.note_choice(batch.env, choice, log_probability)
        return action

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        """Keep the decisions; improve the policy when the rollout is full."""
        reward, bootstrap = compute_backup(batch, self.settings)
        reward = (reward + self._bonus.visit_batch(batch.next_observation)) * self.settings.reward_scale
        over = batch.terminated | batch.truncated
        self.rollout.add(
            self._encoder.encode_batch(batch.observation), batch.action_mask, self.rollout.choice[batch.env],
            self.rollout.log_probability[batch.env], reward, bootstrap, batch.duration, over,
            self._encoder.encode_batch(batch.next_observation), self._recollections.end(batch.env, over), batch.env)
        return self.improve(self.rollout.take()) if len(self.rollout) >= self._least else {}

    def improve(self, rollout: Rollout) -> Mapping[str, float]:
        """Make a round of updates from a rollout; returns means over them to log."""
        settings, memory = self.settings, self._memory
        with torch.no_grad():
            seen = memory.read(rollout.observation, rollout.memory)
            values = self.critic(seen).squeeze(1)
            next_values = compute_next_values(rollout, values, lambda rows: self.critic(memory.read(
                rollout.next_observation[rows], memory.get_state(seen[rows]))).squeeze(1))
            advantages = compute_advantages(rollout, values, next_values, settings)
            targets = advantages + values
        size = max(settings.batch_size, len(values) * settings.batch_size // settings.rollout)
        metrics = self._learner.minimise_each(
            self.compute_loss(seen, *(field.index_select(0, rows) for field in (
                rollout.mask, rollout.action, rollout.log_probability, advantages, targets)))
            for rows, seen in memory.draw_batches(rollout, size, self._batch_rng, settings.epochs)
            if len(rows) > 1)  # one advantage cannot be normalised
        return metrics | {"gradient_norm": self._learner.gradient_norm,
                          "value": values.mean().item() / settings.reward_scale}

    def compute_loss(self, seen: Tensor, mask: Tensor, action: Tensor, old_log_probability: Tensor, advantage: Tensor,
                     target: Tensor) -> dict[str, Tensor]:
        """The loss over a minibatch, and after it its parts; `seen` are the inputs of the networks."""
        return compute_clipped_parts(*self._head.measure(self.policy(seen), mask, action), self.critic(seen).squeeze(1),
                                     old_log_probability, advantage, target, self.settings)

    def make_policy(self) -> Policy:
        """Make the policy that takes the likeliest legal action, or the mean."""
        return GreedyPolicy(self._encoder, self.policy, self._memory, self._box)

    def compute_preferences(self, observation: Any) -> NDArray:
        """Logits of the policy, or means, at an observation, before any mask, float32 (actions,).

        With a memory: of the latest choice, if this was its observation, else of an episode that begins here.
        """
        return self.policy.compute(self._memory.recall(self._encoder.encode(observation)))

    def compute_state_value(self, observation: Any) -> float:
        """V(s) at an observation, in units of return."""
        value = self.critic.compute(self._memory.recall(self._encoder.encode(observation)))
        return float(value[0]) / self.settings.reward_scale

    def list_running(self) -> dict[str, Stateful]:
        """Parts of the state that belong to the present environments, by their names in a checkpoint."""
        return {"rollout": self.rollout, "memory": self._recollections, "draws": self._arrays}
