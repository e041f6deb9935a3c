"""FeUdal Networks: a manager sets directions in a learned latent space, and a worker is rewarded for following them.

Vezhnevets et al. (2017), with perceptrons instead of the convolutional front and both recurrent networks. With
`horizon` 1 a direction applies to one decision, without a hierarchy: the ablation to compare results with.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from hrl_escape.agents.agent import Agent, AgentSettings, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import choose_best, compute_softmax, make_rng, mask_values, sample_index
from hrl_escape.agents.components.networks import (
    Learner,
    Network,
    ObservationEncoder,
    make_generator,
    make_linear,
    make_network,
)
from hrl_escape.agents.components.policy_gradient import (
    Rollout,
    compute_advantages,
    compute_entropy,
    compute_log_policy,
    take_column,
)
from hrl_escape.agents.components.rollout_rows import keep_decision, stack_decisions, unstack_decisions
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class FunSettings(AgentSettings):
    """Settings of `fun`."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive, or per decision if `discounting` is `decision`. Higher values look further ahead and
    learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma, as the
    paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination, as in the
    paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "orthogonal"
    """Initial weights; `orthogonal` goes with tanh units and a small last layer of the policy."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 1e-3
    """Step size of Adam. Too large a step diverges."""
    max_grad_norm: Annotated[float, Range(0)] = 0.5
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns. Temperatures and logged values
    keep units of return."""
    entropy_weight: Annotated[float, Range(0)] = 0.01
    """Weight of the policy's entropy in the loss. More explores for longer."""
    value_weight: Annotated[float, Range(0)] = 0.5
    """Weight of half the squared value error in the loss."""
    gae_lambda: Annotated[float, Range(0, 1)] = 1.0
    """Lambda of generalised advantage estimation. 1 has the most variance, and no bias from the critic."""
    lambda_per: Literal["decision", "primitive"] = "decision"
    """Unit of lambda: a decision of k primitives weighs later errors by lambda, or by lambda^k."""
    horizon: Annotated[int, Range(1)] = 10
    """c, number of decisions under one direction. Longer horizons make the manager more abstract; 1 removes the
    hierarchy."""
    direction_units: Annotated[int, Range(1)] = 16
    """Size of the manager's latent state, and of a direction."""
    embedding_units: Annotated[int, Range(1)] = 8
    """k, size of the embedding of directions that the worker receives."""
    intrinsic_weight: Annotated[float, Range(0)] = 0.5
    """alpha, weight of the reward for following directions, relative to the environment's scaled reward."""
    random_directions: Annotated[float, Range(0, 1)] = 0.05
    """Fraction of random directions. More explores more."""
    rollout: Annotated[int, Range(2)] = 40
    """Decisions collected before each update."""


class FunLayers(nn.Module):
    """Percept z, the manager's latent state s and direction g, the worker's U, both critics."""

    def __init__(self, encoder: ObservationEncoder, actions: int, settings: FunSettings, generator: torch.Generator
                 ) -> None:
        super().__init__()
        self._shape, units = (actions, settings.embedding_units), settings.direction_units
        width = (settings.hidden or (64,))[-1]
        self.percept = nn.Sequential(*make_network(encoder, width, settings, generator), nn.Tanh())

        def make(inputs: int, outputs: int, gain: float = 1.0) -> Any:
            return make_linear(inputs, outputs, settings.initialisation, generator, gain)

        self.state, self.direct = make(width, units), make(units, units)
        self.embed: Any = nn.utils.skip_init(nn.Linear, units, settings.embedding_units, bias=False)
        nn.init.orthogonal_(self.embed.weight, generator=generator)
        self.act = make(width, actions * settings.embedding_units, 0.01)
        self.manager_value, self.worker_value = make(width, 1), make(width, 1)

    def see(self, observation: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return percept z (n, units), latent state s and direction g of length 1, (n, direction units)."""
        percept = self.percept(observation)
        state = functional.relu(self.state(percept))
        return percept, state, functional.normalize(self.direct(state), dim=1)

    def compute_logits(self, percept: Tensor, followed: Tensor) -> Tensor:
        """Return U w, w = phi(sum of directions), (n, actions)."""
        table = self.act(percept).unflatten(1, self._shape)
        return (table @ self.embed(followed)[:, :, None]).squeeze(2)


def sum_directions(directions: Tensor, is_fresh: Tensor, horizon: int) -> Tensor:
    """Return the sum of a decision's direction and the `horizon` before it in its episode, (n, units)."""
    episode, total = is_fresh.cumsum(0), directions.clone()
    for lag in range(1, min(horizon, len(directions) - 1) + 1):
        same = (episode[lag:] == episode[:-lag])[:, None]
        total[lag:] += directions[:-lag] * same
    return total


def pay_for_following(states: Tensor, reached: Tensor, directions: Tensor, is_fresh: Tensor, horizon: int) -> Tensor:
    """R^I = 1/c sum over i = 1..c of cos(s_(t+1) - s_(t+1-i), g_(t+1-i)), within the episode, (n,).

    States s_t and `reached` s_(t+1), also at the end of an episode, and directions g_t are (n, units); `is_fresh`, bool
    (n,), marks decisions that begin an episode.
    """
    episode, pay = is_fresh.cumsum(0), torch.zeros(len(states))
    for lag in range(min(horizon, len(states))):
        end = len(states) - lag
        same = episode[lag:] == episode[:end]
        pay[lag:] += same * functional.cosine_similarity(reached[lag:] - states[:end], directions[:end], dim=1)
    return pay / horizon


class Fun(Agent):
    """Makes one step on the sum of these losses per rollout.

        manager  - A^M_t cos(s_(t+c) - s_t, g_t), no gradient into s;  A^M of the environment's rewards
        worker   - A^W_t log pi(a_t | s_t) - weight x entropy;         A^W of R + alpha R^I, no gradient into g
        critics  half the squared errors of V^M and V^W, functions of the percept

    pi is the softmax of U(z) w over legal actions, w = phi(the sum of the directions of this decision and the last c).
    Both levels discount by gamma^k. Sums end at the beginning of the episode. The manager learns from a decision once
    the c after it are available, if the episode is long enough.
    """

    Settings: ClassVar[type] = FunSettings
    STATE = ("_learner", Kept("_kept", "rollout", unpack=dict), "_new", "_followed", "_action_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: FunSettings | None = None) -> None:
        self.settings = settings = settings or FunSettings()
        actions = count_actions(action_space, self.name)
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        self.layers = FunLayers(self._encoder, actions, settings, make_generator(make_rng(seed, "weights")))
        network = Network(self.layers)
        self._learner = Learner(self.name, {"layers": network}, ["layers"], settings)
        self._rows: list[tuple] = []
        """Collected decisions, preceded by the last c of the previous rollout. Their memory is the followed direction,
        and 1 at the beginning of an episode."""
        self._new = 0
        self._followed: list[NDArray] = []
        """Directions of this episode's last c + 1 decisions."""
        self._asked: list[NDArray] = []  # the same with the direction of the latest choice
        self._action_rng = make_rng(seed, "actions")

    # --- acting --------------------------------------------------------------------------

    def _choose(self, observation: Any, mask: NDArray[np.bool_], followed: list[NDArray], replaced: NDArray | None
                ) -> NDArray[np.float64]:
        """Probabilities of actions; appends the direction to those followed."""
        with torch.no_grad():
            percept, _, direction = self.layers.see(torch.from_numpy(self._encoder.encode(observation))[None])
            followed.append(direction[0].numpy() if replaced is None else replaced)
            del followed[: -self.settings.horizon - 1]
            logits = self.layers.compute_logits(percept, torch.from_numpy(np.sum(followed, axis=0))[None])
        return compute_softmax(mask_values(logits[0].numpy(), mask))

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Draw from the worker's policy. A repeated call draws the direction again."""
        replaced = None
        if self._action_rng.random() < self.settings.random_directions:
            drawn = self._action_rng.standard_normal(self.settings.direction_units).astype(np.float32)
            replaced = drawn / np.linalg.norm(drawn)
        self._asked = list(self._followed)
        return sample_index(self._choose(observation, action_mask, self._asked, replaced), self._action_rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the likeliest action, under the directions of this evaluation, which `rng` identifies."""
        (followed,) = self.recall(rng) or ([],)
        followed = list(followed)
        policy = self._choose(observation, action_mask, followed, None)
        self._evaluation = rng, followed
        return choose_best(policy, action_mask)

    def compute_state_value(self, observation: Any) -> float:
        """Return V^M(s) at an observation, in units of return."""
        with torch.no_grad():
            percept, *_ = self.layers.see(torch.from_numpy(self._encoder.encode(observation))[None])
            return float(self.layers.manager_value(percept)) / self.settings.reward_scale

    # --- learning ------------------------------------------------------------------------

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Store the decision; update when the rollout is full."""
        over = transition.terminated or transition.truncated
        memory = np.append(self._asked[-1], float(not self._followed)).astype(np.float32)
        self._rows.append(keep_decision(transition, self._encoder, self.settings, memory))
        self._followed, self._new = [] if over else self._asked, self._new + 1
        if self._new < self.settings.rollout:
            return {}
        parts = self.compute_loss(stack_decisions(self._rows, 0), len(self._rows) - self._new)
        self._learner.minimise(parts["loss"])
        self._rows, self._new = self._rows[-self.settings.horizon :], 0
        return {name: part.item() for name, part in parts.items()} | {"gradient_norm": self._learner.gradient_norm}

    def compute_loss(self, rollout: Rollout, first: int) -> dict[str, Tensor]:
        """Return the loss over the decisions from `first`, c decisions earlier for the manager, and its parts."""
        settings, layers, c = self.settings, self.layers, self.settings.horizon
        directions, is_fresh = rollout.memory[:, :-1], rollout.memory[:, -1] > 0
        percept, states, aimed = layers.see(rollout.observation)
        with torch.no_grad():
            after, reached, _ = layers.see(rollout.next_observation)
            intrinsic = pay_for_following(states, reached, directions, is_fresh, c)
        losses, advantages = [], {}
        for name, critic, pay in (("manager", layers.manager_value, 0.0), ("worker", layers.worker_value, intrinsic)):
            values = critic(percept).squeeze(1)
            paid = rollout._replace(reward=rollout.reward + settings.intrinsic_weight * pay)
            with torch.no_grad():
                advantages[name] = compute_advantages(paid, values, critic(after).squeeze(1), settings)
            losses.append(0.5 * functional.mse_loss(values[first:], (advantages[name] + values.detach())[first:]))
        log_policy = compute_log_policy(
            layers.compute_logits(percept, sum_directions(directions, is_fresh, c))[first:], rollout.mask[first:])
        worker = -(take_column(log_policy, rollout.action[first:]) * advantages["worker"][first:]).mean()
        entropy = compute_entropy(log_policy, rollout.mask[first:])
        start, end, episode = max(first - c, 0), max(len(aimed) - c, 0), is_fresh.cumsum(0)
        is_there = episode[start:end] == episode[start + c : end + c]
        shift = (states[start + c : end + c] - states[start:end]).detach()
        aligned = functional.cosine_similarity(shift, aimed[start:end], dim=1)
        manager = -(is_there * advantages["manager"][start:end] * aligned).sum() / settings.rollout
        loss = manager + worker - settings.entropy_weight * entropy + settings.value_weight * sum(losses)
        return {"loss": loss, "manager_loss": manager, "policy_loss": worker, "entropy": entropy,
                "intrinsic": intrinsic[first:].mean()}

    @property
    def _kept(self) -> dict[str, Tensor] | None:
        """Fields of the stored decisions, or None without any."""
        return stack_decisions(self._rows, 0)._asdict() if self._rows else None

    @_kept.setter
    def _kept(self, saved: Mapping[str, Any] | None) -> None:
        self._rows = [] if saved is None else unstack_decisions(saved)
