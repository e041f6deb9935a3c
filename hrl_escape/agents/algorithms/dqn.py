"""Deep Q-network over decisions of any duration, in one environment or in many.

    minimise over theta the mean of loss(R + b Q_target(s', o*) - Q_theta(s, o)),    o* = argmax of Q_theta(s', .)

R = sum over i < k of gamma^i r_i and b = gamma^k (1 - terminated), joined over `n_step` decisions. The argmax is over
the actions that are legal at s'. Mnih et al. (2015), with double estimation (van Hasselt, Guez and Silver 2016) and
backups of n decisions (Sutton 1988; Hessel et al. 2018).

A useless decision costs one reward and one discount, which is little compared with the range of values, so the greedy
policy depends on small differences. Learning is steadier where the target stands still long enough to be fitted, and
where n decisions carry values ahead of it (`benchmarks/README.md`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from hrl_escape.agents.agent import AgentSettings, GoalRule
from hrl_escape.agents.components.distillation import make_bonus
from hrl_escape.agents.components.exploration import compute_epsilon, compute_exploration, make_rng, measure_conduct
from hrl_escape.agents.components.hindsight import Hindsight, HindsightReplay
from hrl_escape.agents.components.networks import (
    Learner,
    ObservationEncoder,
    compute_td_loss,
    copy_network,
    make_action_network,
    make_generator,
)
from hrl_escape.agents.components.policy import GreedyPolicy, Memory
from hrl_escape.agents.components.replay import Experience, ReplayAgent
from hrl_escape.agents.decisions import Decisions, Moments, Policy
from hrl_escape.agents.state import Kept
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class DQNSettings(AgentSettings):
    """Settings of `dqn`. A step of the clock is one primitive, or one decision with `clock="decision"`."""

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
    bonus: Literal["counts", "distillation"] = "counts"
    """Novelty for `bonus_weight`: visits of a cell, or the error of a network that predicts a random one (Burda et al.
    2018)."""
    bonus_weight: Annotated[float, Range(0)] = 0.0
    """Largest cost of reaching known states, in units of return. More explores more; 0 turns novelty off."""
    bonus_bins: Annotated[int, Range(2)] = 5
    """Points to round a bounded component to for counting. More make finer cells with fewer visits each."""

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

    double: bool = True
    """The online network chooses o* and the target network values it, which avoids overestimation. False takes the
    argmax of the target network."""
    n_step: Annotated[int, Range(1)] = 3
    """Decisions joined into one backup. More carry rewards back faster, and are off-policy by the share of
    exploration."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 1.0
    """Share of the online network blended into the target network at each of its updates; 1 copies it."""
    target_every: Annotated[int, Range(1)] = 200
    """Updates of the online network to one of the target network. Fewer follow faster and are less stable."""
    average_rate: Annotated[float, Range(0, 1)] = 0.005
    """Share of the online network blended at each update into the average that the greedy policy uses. 0 keeps no
    average."""

    replay_capacity: Annotated[int, Range(1)] = 50_000
    """Decisions kept for replay."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each step of the clock. More learn more from the same experience and take longer."""
    max_updates: Annotated[int, Range(1)] = 16
    """Most updates after a step of many environments. Where more are due, minibatches grow instead. Few large ones
    learn less, because the target network follows updates."""
    max_batch_size: Annotated[int, Range(1)] = 65_536
    """Largest minibatch with many environments. Smaller ones learn from each decision less often and take less time."""
    replay_per_env: Annotated[int, Range(1)] = 128
    """Smallest replay capacity per environment with many environments, in decisions."""
    hindsight_goals: Annotated[int, Range(0)] = 0
    """Number of goals achieved later in its episode that each decision is stored with again (4 in Andrychowicz et al.
    2017). For environments with goals; 0 for none."""


class DQN(ReplayAgent):
    """Deep Q-network; the equation is in the module's text.

    Args:
        goal_rule: reward and termination as functions of goals, for `hindsight_goals`.
        network: a torch module of your own in place of the settings' network, from encoded observations to one number
            an action, with the weights to begin with; it is copied.

    Attributes:
        values: Q_theta, its target and its average.

    Raises:
        AgentSettingsError: `hindsight_goals` in an environment without goals, or the module does not fit.
    """

    settings: DQNSettings
    STATE = (Kept("values.learner", "learner"), "_bonus", Kept("_hindsight", is_left_out=True))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: DQNSettings | None = None, goal_rule: GoalRule | None = None,
                 network: nn.Module | None = None) -> None:
        made: Any = settings or self.Settings()
        super().__init__(observation_space, action_space, seed, made, made.n_step)
        settings = self.settings
        self.values = ActionValues(self.name, self._encoder, action_space, seed, settings, network)
        self._bonus = make_bonus(observation_space, seed, settings, self.name)
        self._hindsight = Hindsight() if not settings.hindsight_goals else HindsightReplay(
            observation_space, goal_rule, settings.hindsight_goals, settings.n_step, self._encoder, settings,
            make_rng(seed, "goals"))
        self._conduct: dict[str, float] = {}

    def act(self, batch: Moments) -> Any:
        """Explore by the online network, int64 (n,)."""
        values = self.values.online.evaluate(self._encoder.encode_batch(batch.observation)) / self.settings.reward_scale
        policy = compute_exploration(values, batch.action_mask, **self.get_exploration())
        action = self._arrays.draw_choices(policy)
        self._conduct = measure_conduct(policy, values, batch.action_mask, action)
        return action

    def observe(self, batch: Decisions) -> Mapping[str, float]:
        """Store the decisions, then make the updates that are due."""
        bonus = self._bonus.visit_batch(batch.next_observation)
        experience = self.make_experience(batch, bonus)
        self.replay.add(experience, batch.env, batch.terminated | batch.truncated)
        for relabelled in self._hindsight.push(batch, experience, bonus):
            self.replay.add(relabelled)
        return self.make_due_updates(batch.duration) | self._conduct | {"epsilon": self.get_exploration()["epsilon"]}

    def update(self, batch: Experience) -> Mapping[str, float]:
        """Make one step of the online network towards the targets; returns numbers to log."""
        tensors = Experience(*map(torch.as_tensor, batch))
        with torch.no_grad():
            targets = self.compute_targets(tensors)
        return self.values.descend(*self.values.compute_loss(tensors, targets))

    def compute_targets(self, batch: Experience) -> Tensor:
        """R + b Q_target(s', o*), (batch,); called without gradient."""
        next_values = self.values.target(batch.next_observation)
        best = self.choose_next(batch, next_values)
        return batch.reward + batch.bootstrap * next_values.gather(1, best).squeeze(1)

    def choose_next(self, batch: Experience, next_values: Tensor) -> Tensor:
        """o*, the legal argmax of Q_theta(s', .), or of Q_target without `double`; int64 (batch, 1)."""
        next_choice = self.values.online(batch.next_observation) if self.settings.double else next_values
        return next_choice.masked_fill(~batch.next_mask, -torch.inf).argmax(dim=1, keepdim=True)

    def make_policy(self) -> Policy:
        """Make the greedy policy of the averaged network."""
        return GreedyPolicy(self._encoder, self.values.average, Memory())

    def compute_values(self, observation: Any) -> NDArray:
        """Q(s, .) behind the greedy policy at an observation, in units of return, float32 (actions,)."""
        return self.values.average.compute(self._encoder.encode(observation)) / self.settings.reward_scale

    def get_exploration(self) -> dict[str, float]:
        """Parameters of `compute_exploration` now."""
        settings = self.settings
        return {"epsilon": compute_epsilon(settings, self._schedule.steps), "clip": settings.boltzmann_clip,
                "temperature": settings.temperature if settings.exploration == "boltzmann" else 0.0}

    def begin_episodes(self, num_envs: int = 1, device: torch.device | None = None) -> None:
        """Begin episodes; raises `AgentSettingsError` for many environments with `hindsight_goals`."""
        if device is not None and self.settings.hindsight_goals:
            raise AgentSettingsError("hindsight_goals", self.settings.hindsight_goals, "0 in many environments at once")
        super().begin_episodes(num_envs, device)

    def move(self, device: torch.device) -> None:
        """Move networks and optimiser to a device."""
        self.values.learner.move(device)


class ActionValues:
    """Q_theta, its target and its average, and steps of Q_theta.

    Args:
        settings: of networks and targets, as `DQNSettings` has them.
        network: a module of the user's own, or None for the network of the settings.

    Attributes:
        online: Q_theta, from encoded observations to scaled values of all actions.
        target: Q_target, the same.
        average: of the online network's weights, which the greedy policy follows (Polyak and Juditsky 1992). It begins
            as a plain mean, so that it forgets the first weights. With `average_rate` 0 it is the online network.
    """

    def __init__(self, name: str, encoder: ObservationEncoder, action_space: gymnasium.Space, seed: int, settings: Any,
                 network: nn.Module | None = None) -> None:
        self._settings = settings
        generator = make_generator(make_rng(seed, "weights"))
        networks = {
            key: make_action_network(encoder, action_space, settings, generator) if network is None else
            copy_network(network, encoder, action_space)
            for key in ("online", "target", "average")[: 3 if settings.average_rate else 2]}
        self.online, self.target, self.average = (networks.get(key, networks["online"])
                                                  for key in ("online", "target", "average"))
        for copy in (self.target, self.average):
            if copy is not self.online:
                copy.requires_grad_(False).blend(self.online, 1.0)
        self.learner = Learner(name, networks, ["online"], settings)

    def compute_loss(self, batch: Experience, targets: Tensor) -> tuple[Tensor, Tensor]:
        """The mean loss against targets (batch,), and Q_theta(s, o), (batch,), without gradient."""
        values = self.online(batch.observation).gather(1, batch.action.unsqueeze(1)).squeeze(1)
        return compute_td_loss(values, targets, self._settings.loss), values.detach()

    def descend(self, loss: Tensor, values: Tensor) -> dict[str, float]:
        """One step down a loss, then, if they are due, one of the target and of the average; returns numbers to log."""
        settings, learner = self._settings, self.learner
        value = learner.minimise(loss)
        if learner.updates % settings.target_every == 0:
            self.target.blend(self.online, settings.target_rate)
        if settings.average_rate:
            self.average.blend(self.online, max(settings.average_rate, 1 / learner.updates))
        return {"loss": value, "gradient_norm": learner.gradient_norm,
                "value": values.mean().item() / settings.reward_scale}
