"""SOL, scalable option learning: one network for the controller and all options, with their index as input.

Henaff et al. (2025), from the paper's description, in one environment. An option is a reward function. The controller
chooses one and its length, and V-trace (Espeholt et al. 2018) chains each policy's return over its own steps alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from hrl_escape.agents.agent import AgentSettings, count_actions
from hrl_escape.agents.components.exploration import choose_best, compute_softmax, make_rng, mask_values, sample_index
from hrl_escape.agents.components.networks import Learner, ObservationEncoder, make_generator, make_network
from hrl_escape.agents.components.policy_gradient import (
    compute_entropy,
    compute_log_policy,
    take_column,
)
from hrl_escape.agents.hierarchy.goal_space import GoalSpace, make_goal_space
from hrl_escape.agents.hierarchy.runner import CallRunner
from hrl_escape.agents.hierarchy.task import BaseTask, Call, Frame, Hierarchy, Return, Seen, Stack, Step
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class SolSettings(AgentSettings):
    """Settings of `sol`."""

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
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "never"
    """Choose every running call again at each primitive, instead of running it to its end: never, in evaluation
    only (hierarchical greedy execution), or always."""
    longest: Annotated[int, Range(1)] = 32
    """Most primitives of an option; the controller chooses among the powers of 2 up to it."""
    rollout: Annotated[int, Range(2)] = 128
    """Choices of controller and options, together, collected before each round of updates. More make steadier
    updates."""
    epochs: Annotated[int, Range(1)] = 2
    """Updates from a rollout. From the second on, V-trace weighs choices by the change of their probability."""
    ratio_clip: Annotated[float, Range(0, open_low=True)] = 1.0
    """Bound on these weights, rho and c of V-trace. Smaller bounds have less variance and more bias."""


class Choices(NamedTuple):
    """Choices of all policies, in the order of their ends; one column per field, with leading dimension n."""

    observation: Any  # (n, numbers), encoded
    policy: Any  # int64 (n,), 0 for the controller, 1 + option
    mask: Any  # bool (n, most choices)
    choice: Any  # int64 (n,)
    log_probability: Any  # float32 (n,), at the time of the choice
    reward: Any  # float32 (n,), sum of gamma^i times the policy's own reward
    bootstrap: Any  # float32 (n,), gamma^k, 0 if the episode terminated
    over: Any  # bool (n,), whether the episode ended
    next_observation: Any  # (n, numbers)


def compute_vtrace(choices: Choices, values: Tensor, next_values: Tensor, ratio: Tensor, clip: float
                   ) -> tuple[Tensor, Tensor]:
    """Return targets of values and advantages, chained from each choice to the next of the same policy and episode.

    `values`, and `next_values` of the next states, belong to the same policies, (n,). `ratio` is the current pi divided
    by pi at the time of the choice, (n,), and `clip` bounds rho and c.

        v_t = V_t + rho_t (r_t + b_t V' - V_t) + b_t c_t (v' - V'),    A_t = rho_t (r_t + b_t v' - V_t)

    V' and v' belong to that next choice, independent of what ran in between. Without one, both are V of the next state
    for the same policy.
    """
    weight, targets, advantages = ratio.clamp(max=clip), values.clone(), torch.zeros_like(values)
    following: dict[int, tuple[Tensor, Tensor]] = {}
    for row in range(len(values) - 1, -1, -1):
        policy = int(choices.policy[row])
        if choices.over[row] and not policy:  # the controller's choice ends last; an end of the episode ends all
            following = {}
        value_after, target_after = following.get(policy, (next_values[row], next_values[row]))
        reward, bootstrap = choices.reward[row], choices.bootstrap[row]
        targets[row] = values[row] + weight[row] * (reward + bootstrap * value_after - values[row]) + (
            bootstrap * weight[row] * (target_after - value_after))
        advantages[row] = weight[row] * (reward + bootstrap * target_after - values[row])
        following[policy] = values[row], targets[row]
    return targets, advantages


class _Option(BaseTask):
    """Runs for the number of primitives that the controller chose; its reward is its reward function."""

    def __init__(self, space: GoalSpace, primitives: int, longest: int) -> None:
        super().__init__("option", primitives)
        self._space, self._longest = space, longest

    def list_calls(self) -> Mapping[str, Any]:
        return {f"option {number}": np.array([number, self._longest]) for number in range(len(self._space.goals) + 1)}

    def ends(self, frame: Frame, seen: Seen) -> float:
        return float(frame.primitives >= frame.context[1])

    def pay(self, step: Step, frame: Frame) -> float:
        """Return 1 if the option's goal becomes reached; for the last option, the environment's reward."""
        if frame.context[0] == len(self._space.goals):
            return step.reward
        before, after = (self._space.list_reached(each.observation)[frame.context[0]]
                         for each in (step.seen, step.next_seen))
        return step.arrival * float(after and not before)


class _Controller(BaseTask):
    """Chooses an option and its length, at no cost of its own; its reward is the environment's."""

    def __init__(self, option: _Option, options: int, lengths: list[int]) -> None:
        super().__init__("controller", options * len(lengths))
        self._option, self._lengths = option, lengths

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        return np.ones(int(self.space.n), np.bool_)

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        option, length = divmod(choice, len(self._lengths))
        return Call(self._option, np.array([option, self._lengths[length]]))


class Sol(CallRunner):
    """One step on this loss for all policies together, `epochs` times per rollout.

        - A log pi(c | s, i) + value weight x half of (v - V(s, i))^2 - entropy weight x entropy

    v and A come from `compute_vtrace`. i is the policy: the controller, an option for each goal, or one for the task
    itself, which makes flat behaviour possible. A choice of the controller takes no primitives and no discount: its
    reward and gamma^k belong to the option that it starts.

    Args:
        goal_space: its goals, each when it becomes reached, are the rewards of options; by default the result of
            `make_goal_space`.
    """

    Settings = SolSettings
    EPISODE = (*CallRunner.EPISODE, "_rows")
    EPISODE_STATE = (*CallRunner.EPISODE_STATE, "rollout")
    STATE = ("_learner", Kept("_kept", "rollout", unpack=dict), "_action_rng")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: SolSettings | None = None, goal_space: GoalSpace | None = None) -> None:
        settings = settings or SolSettings()
        self._actions = count_actions(action_space, "sol")
        space = goal_space or make_goal_space(observation_space, "sol")
        lengths = [2**power for power in range(settings.longest.bit_length())]
        self.options = len(space.goals) + 1
        option = _Option(space, self._actions, settings.longest)
        controller = _Controller(option, self.options, lengths)
        hierarchy = Hierarchy(controller, (option,), source="learned", privileges=space.privileges)
        super().__init__(hierarchy, seed, settings)
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        self._numbers = self._actions, self.options * len(lengths)
        self.network = make_network(self._encoder, sum(self._numbers) + 1, settings, make_generator(
            make_rng(seed, "weights")), extra_inputs=self.options + 1, output_gain=0.1)
        self._learner = Learner("sol", {"network": self.network}, ["network"], settings)
        self._action_rng = make_rng(seed, "actions")

    def begin_episode(self) -> None:
        """Begin an empty rollout. Every environment has its own."""
        super().begin_episode()
        self._rows: list[Choices] = []

    # --- acting --------------------------------------------------------------------------

    def _see(self, observation: Any, policy: int) -> NDArray[np.float32]:
        told = np.zeros(self.options + 1, np.float32)
        told[policy] = 1.0
        return np.concatenate([self._encoder.encode(observation), told])

    def compute_policy(self, frame: Frame, observation: Any, legal: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return probabilities of the choices of a running call, (choices,)."""
        policy = 0 if frame.context is None else 1 + int(frame.context[0])
        output = self.network.compute(self._see(observation, policy))
        logits = output[: self._actions] if policy else output[self._actions : -1]
        return compute_softmax(mask_values(logits, legal))

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Draw from the policy of the call."""
        return sample_index(self.compute_policy(stack[-1], view, legal), self._action_rng)

    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Return the likeliest choice."""
        return choose_best(self.compute_policy(stack[-1], view, legal), legal)

    # --- learning ------------------------------------------------------------------------

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Store finished choices; update when the rollout is full."""
        for returned in returns:
            decision, frame = returned.decision, returned.frame
            policy = 0 if frame.context is None else 1 + int(frame.context[0])
            is_task = policy in (0, self.options)
            mask = np.zeros(max(self._numbers), np.bool_)
            mask[: len(decision.legal)] = decision.legal
            probability = self.compute_policy(frame, decision.view, decision.legal)[decision.choice]
            self._rows.append(Choices(
                self._see(decision.view, policy), policy, mask, decision.choice, np.log(probability),
                decision.reward * (self.settings.reward_scale if is_task else 1.0),
                0.0 if returned.terminated else decision.discount, returned.terminated or returned.truncated,
                self._see(returned.seen.observation, policy)))
        if len(self._rows) < self.settings.rollout:
            return {}
        choices, self._rows = self._stack_rows(), []
        return self._learner.minimise_each(self.compute_losses(choices) for _ in range(self.settings.epochs))

    def compute_outputs(self, choices: Choices) -> tuple[Tensor, Tensor]:
        """Return log probabilities of choices, (n, most choices), and V(s, policy), (n,)."""
        output, most = self.network(choices.observation), max(self._numbers)
        low, high = (functional.pad(part, (0, most - part.shape[1]))
                     for part in (output[:, : self._actions], output[:, self._actions : -1]))
        logits = torch.where(choices.policy[:, None] > 0, low, high)
        return compute_log_policy(logits, choices.mask), output[:, -1]

    def compute_losses(self, choices: Choices) -> dict[str, Tensor]:
        """Return the loss over a rollout, and its parts."""
        settings = self.settings
        log_policy, values = self.compute_outputs(choices)
        log_probability = take_column(log_policy, choices.choice)
        with torch.no_grad():
            ratio = (log_probability - choices.log_probability).exp()
            targets, advantages = compute_vtrace(choices, values, self.network(choices.next_observation)[:, -1], ratio,
                                                 settings.ratio_clip)
        policy_loss = -(log_probability * advantages).mean()
        value_loss = 0.5 * functional.mse_loss(values, targets)
        entropy = compute_entropy(log_policy, choices.mask)
        loss = policy_loss + settings.value_weight * value_loss - settings.entropy_weight * entropy
        return {"loss": loss, "policy_loss": policy_loss, "value_loss": value_loss, "entropy": entropy}

    def _stack_rows(self) -> Choices:
        dtypes = (np.float32, np.int64, np.bool_, np.int64, np.float32, np.float32, np.float32, np.bool_, np.float32)
        return Choices(*(torch.from_numpy(np.array(field, dtype))
                         for field, dtype in zip(zip(*self._rows, strict=True), dtypes, strict=True)))

    @property
    def _kept(self) -> dict[str, Tensor] | None:
        """Choices so far by field, or None without any."""
        return self._stack_rows()._asdict() if self._rows else None

    @_kept.setter
    def _kept(self, saved: Mapping[str, Any] | None) -> None:
        self._rows = [] if saved is None else list(map(Choices._make, zip(
            *(np.asarray(saved[name]) for name in Choices._fields), strict=True)))
