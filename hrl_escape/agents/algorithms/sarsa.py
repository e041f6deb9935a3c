"""Deep SARSA over decisions of any duration: sampled or expected, online or with replay.

Zhao et al. (2016); expected SARSA is van Seijen et al. (2009).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents.agent import AgentSettings
from hrl_escape.agents.algorithms.dqn import ActionValues
from hrl_escape.agents.components.exploration import compute_epsilon, compute_exploration, measure_conduct
from hrl_escape.agents.components.policy import GreedyPolicy, Memory
from hrl_escape.agents.components.replay import Experience, ReplayAgent
from hrl_escape.agents.decisions import Decisions, Moments, Policy
from hrl_escape.agents.keras_rl_2019.keras_rl import LateTerminal
from hrl_escape.agents.state import Kept
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class SarsaSettings(AgentSettings):
    """Settings of `sarsa`. Without replay it makes one update per decision."""

    expected: bool = True
    """Value s' by its expectation over the policy. False values it by one action drawn from the policy, which is also
    the next action without replay."""
    late_terminal: bool = False
    """Repeat a mistake of keras-rl 0.4.2: the agent receives the flag of the end one decision early. The second to last
    decision is valued as terminal, and the last bootstraps even from a terminal state. Requires `replay_capacity=0`."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive. Higher values look further ahead and learn more slowly."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive` discounts k primitives by gamma^k. `decision` sums their rewards and discounts by gamma."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the last state of a truncated episode. False treats a truncation as a termination."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit of warm-up, updates and epsilon. With primitives an agent over options updates as often as a flat one."""

    exploration: Literal["epsilon-greedy", "boltzmann"] = "epsilon-greedy"
    """`epsilon-greedy` draws evenly with probability epsilon. `boltzmann` draws by exp(q / temperature)."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    temperature: Annotated[float, Range(0, open_low=True)] = 1.0
    """Temperature of `boltzmann`, in units of return. More explores more."""
    boltzmann_clip: Annotated[float, Range(0)] = 0.0
    """Bound on the size of q / temperature in `boltzmann`, as in keras-rl 0.4.2; 0 sets none."""

    network: Literal["mlp", "objects"] = "mlp"
    """`mlp`: a perceptron over the whole observation. `objects`: deep sets over its rows of objects, for the
    observation `objects`."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform, as in Keras; or orthogonal, with tanh units."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam. Too large a step diverges."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    max_grad_norm: Annotated[float, Range(0)] = 10.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    loss: Literal["huber", "squared"] = "huber"
    """Huber loss with threshold 1 in scaled rewards, or half the squared error, which follows outliers."""

    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Share of the online network blended into the target network at each of its updates; 1 copies it."""
    target_every: Annotated[int, Range(1)] = 1
    """Updates of the online network to one of the target network. Fewer follow faster and are less stable."""
    average_rate: Annotated[float, Range(0, 1)] = 0.0
    """Share of the online network blended at each update into the average that the greedy policy uses. 0 keeps no
    average."""

    replay_capacity: Annotated[int, Range(0)] = 50_000
    """Decisions kept for replay; 0 learns from each decision once, when it is made."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each step of the clock. More learn more from the same experience and take longer."""
    max_updates: Annotated[int, Range(1)] = 16
    """Most updates after a step of many environments. Where more are due, minibatches grow instead. Few large ones
    learn less, because the target network follows updates."""
    replay_per_env: Annotated[int, Range(1)] = 128
    """Smallest replay capacity per environment with many environments, in decisions."""

    def check(self) -> None:
        """Check that `late_terminal` is not combined with replay."""
        if self.late_terminal and self.replay_capacity:
            raise AgentSettingsError("SarsaSettings.late_terminal", True, "False, or replay_capacity = 0")


class Sarsa(ReplayAgent):
    """Minimise the mean of loss(R + b V(s') - Q_theta(s, o)), V(s') = sum over o' of pi(o' | s') Q_target(s', o').

    pi is the exploring policy of the online network at s', over legal actions. With `expected` off, V(s') is
    Q_target(s', o') of one o' drawn from pi. R = sum gamma^i r_i, b = gamma^k (1 - terminated).

    Attributes:
        values: Q_theta, its target and its average.
    """

    settings: SarsaSettings
    STATE = (Kept("values.learner", "learner"), "_next_action", "_late_terminal")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: SarsaSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self.values = ActionValues(self.name, self._encoder, action_space, seed, self.settings)
        self._next_action: int | None = None  # the action of the last bootstrap, to be taken next
        self._late_terminal = LateTerminal()
        self._conduct: dict[str, float] = {}

    def act(self, batch: Moments) -> Any:
        """Explore by the online network, or return the action of the last bootstrap, int64 (n,)."""
        taken, self._next_action = self._next_action, None
        if taken is not None:
            return np.array((taken,))
        return self._explore(self._encoder.encode_batch(batch.observation), batch.action_mask)

    def _explore(self, encoded: Any, mask: Any) -> Any:
        values = self.values.online.evaluate(encoded) / self.settings.reward_scale
        policy = compute_exploration(values, mask, **self._get_exploration())
        action = self._arrays.draw_choices(policy)
        self._conduct = measure_conduct(policy, values, mask, action)
        return action

    def _get_exploration(self) -> dict[str, float]:
        settings = self.settings
        return {"epsilon": compute_epsilon(settings, self._schedule.steps), "clip": settings.boltzmann_clip,
                "temperature": settings.temperature if settings.exploration == "boltzmann" else 0.0}

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        """Learn from replay, or from this decision."""
        experience, over = self.make_experience(batch), batch.terminated | batch.truncated
        if self.settings.replay_capacity:
            self.replay.add(experience, batch.env, over)
        conduct, due = self._conduct, self.make_due_updates(batch.duration)
        metrics = {"epsilon": self._get_exploration()["epsilon"], **due, **conduct}
        if self.settings.replay_capacity:
            return metrics
        if self.settings.late_terminal:
            for late, taken in self._late_terminal.push(experience, batch, self.settings):
                if self._schedule.is_warm:
                    metrics |= self._update_from(late, self._choose_next(late) if taken is None else taken)
            return metrics
        next_action = self._choose_next(experience)
        self._next_action = None if over[0] else next_action
        return metrics | (self._update_from(experience, next_action) if self._schedule.is_warm else {})

    def _choose_next(self, experience: Experience) -> int | None:
        """Action at s' to bootstrap from and to take next, or None if the expectation is used."""
        if self.settings.expected:
            return None
        return int(self._explore(experience.next_observation, experience.next_mask)[0])

    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin episodes. Raises `AgentSettingsError` for several environments without replay."""
        if device is not None and not self.settings.replay_capacity:
            raise AgentSettingsError("replay_capacity", 0, "at least 1 in many environments at once")
        super().begin_episodes(num_envs, device)
        self._next_action = None

    def update(self, batch: Experience) -> Mapping[str, float]:
        """Make one gradient step on a batch of tensors; return numbers to log."""
        return self._update_from(batch, None)

    def _update_from(self, batch: Experience, next_action: int | None) -> dict[str, float]:
        tensors = Experience(*map(torch.as_tensor, batch))
        with torch.no_grad():
            targets = self.compute_targets(tensors, next_action)
        return self.values.descend(*self.values.compute_loss(tensors, targets))

    def compute_targets(self, batch: Experience, next_action: int | None = None) -> torch.Tensor:
        """Return R + b V(s'), (batch,). `next_action` is the action at s', if known, for a batch of one."""
        next_online = self.values.online(batch.next_observation) / self.settings.reward_scale
        weights = compute_exploration(next_online, batch.next_mask, **self._get_exploration())
        if not self.settings.expected:
            drawn = self._draw_next(weights) if next_action is None else torch.tensor([next_action])
            weights = torch.nn.functional.one_hot(drawn, weights.shape[1])
        return batch.reward + batch.bootstrap * (weights * self.values.target(batch.next_observation)).sum(dim=1)

    def _draw_next(self, policy: torch.Tensor) -> torch.Tensor:
        if self._arrays.library is torch:
            return self._arrays.draw_choices(policy)
        return torch.from_numpy(self._arrays.draw_choices(policy.numpy()))

    def make_policy(self) -> Policy:
        """Make the greedy policy of the averaged network."""
        return GreedyPolicy(self._encoder, self.values.average, Memory())

    def compute_values(self, observation: Any) -> NDArray:
        """Return Q(s, .) behind the greedy policy at an observation, in units of return, float32 (actions,)."""
        return self.values.average.compute(self._encoder.encode(observation)) / self.settings.reward_scale

    def move(self, device: torch.device) -> None:
        """Move networks and optimiser to a device."""
        self.values.learner.move(device)
