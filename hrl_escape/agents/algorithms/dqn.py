"""Deep Q-network over decisions of any duration, in one environment or in many: double, masked, n-step.

Mnih et al. (2015) with double estimation (van Hasselt, Guez and Silver 2016) on SMDP backups of n decisions (Sutton
1988; Hessel et al. 2018). A useless decision costs one reward and one discount, little beside the values' range, so
the greedy policy hangs on small differences: it holds what it found better where the target stands still long enough
to be fitted and n decisions carry values ahead of it (`benchmarks/README.md`).

It is composed of `components/networks.py`, `components/replay.py` and `components/exploration.py`.

One environment is not a batch of one stream: acting and storing in numpy takes about 44 us a decision on one CPU core,
the same through a stream of tensors 1,090 us.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from hrl_escape.agents.agent import GoalRule, SMDPTransition
from hrl_escape.agents.components.bonuses import NoveltySettings
from hrl_escape.agents.components.distillation import make_bonus, visit_streams
from hrl_escape.agents.components.exploration import (
    ExplorationSettings,
    choose_best,
    compute_exploration_entropy,
    make_rng,
    sample_action,
)
from hrl_escape.agents.components.hindsight import HindsightReplay
from hrl_escape.agents.components.networks import (
    Learner,
    ObservationEncoder,
    compute_td_loss,
    copy_network,
    make_action_network,
    make_generator,
)
from hrl_escape.agents.components.replay import (
    Experience,
    NStep,
    ReplaySettings,
    ReplayStreamAgent,
    make_experience,
)
from hrl_escape.agents.state import Kept
from hrl_escape.agents.streams import StreamTransitions
from hrl_escape.errors import AgentSettingsError
from hrl_escape.settings import Range


@dataclass(frozen=True)
class ValueSettings(ExplorationSettings, ReplaySettings):
    """Settings of `ActionValues`, and of how they are learned from replay."""

    network: Literal["mlp", "objects"] = "mlp"
    """`mlp`: a perceptron over the whole observation. `objects`: deep sets over its rows of objects, equivariant under
    permutation of the objects; for the observation `objects`."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 1.0
    """Share of the online network blended into the target network at each of its updates; 1 copies it."""
    target_every: Annotated[int, Range(1)] = 200
    """Updates of the online network to one of the target network."""
    average_rate: Annotated[float, Range(0, 1)] = 0.005
    """Share of the online network blended, at each update, into the averaged network that the greedy policy follows;
    0 keeps none."""


@dataclass(frozen=True)
class DQNSettings(NoveltySettings, ValueSettings):
    """Bonus, replay and backups of `dqn`, beside exploration and networks."""

    double: bool = True
    """The online network chooses the next action, the target network values it."""
    n_step: Annotated[int, Range(1)] = 3
    """Decisions joined into one backup; above 1 it is off-policy by the share of exploration."""
    replay_capacity: Annotated[int, Range(1)] = 50_000
    """Decisions kept for replay."""
    hindsight_goals: Annotated[int, Range(0)] = 0
    """Goals achieved later in its episode that are drawn for a decision; replay holds it once more under each
    (Andrychowicz et al. 2017, who take 4). 0 for none. For environments with goals, such as `GoalsEnv`."""


class ActionValues:
    """Q_theta, its target and its average: choices by them, and steps of Q_theta towards given targets.

    Args:
        settings: of networks, exploration and targets, as `DQNSettings` has them.
        network: a module of the user's own; None makes what the settings say.

    Attributes:
        online: Q_theta, from encoded observations to scaled values of all actions.
        target: Q_target, the same.
        average: of the online network's weights, which the greedy policy follows (Polyak and Juditsky 1992). It begins
            as a plain mean, so that it forgets the first weights. With `average_rate` 0 it is the online network.
        conduct: entropy of the latest exploring choice, and whether it was greedy, to log.
    """

    def __init__(self, name: str, encoder: ObservationEncoder, action_space: gymnasium.Space, seed: int, settings: Any,
                 network: nn.Module | None = None) -> None:
        self._settings, self._encoder = settings, encoder
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
        self.conduct: dict[str, float] = {}

    def compute(self, observation: Any) -> NDArray:
        """Q(s, .) behind the greedy policy at an observation, in units of return, float32 (actions,)."""
        return self.average.compute(self._encoder.encode(observation)) / self._settings.reward_scale

    def explore(self, encoded: NDArray, action_mask: NDArray[np.bool_], steps: int, rng: np.random.Generator) -> int:
        """Draw from the exploring policy at an encoded observation, `steps` on the clock; notes how, in `conduct`."""
        values = self.online.compute(encoded) / self._settings.reward_scale
        action = sample_action(values, action_mask, self._settings, steps, rng)
        self.conduct = {
            "entropy": compute_exploration_entropy(values, action_mask, self._settings, steps),
            "greedy": float(values[action] >= values[action_mask].max()),
        }
        return action

    def compute_loss(self, batch: Experience, targets: Tensor) -> tuple[Tensor, Tensor]:
        """The mean loss against targets (batch,), and Q_theta(s, o), (batch,), without gradient."""
        values = self.online(batch.observation).gather(1, batch.action.unsqueeze(1)).squeeze(1)
        return compute_td_loss(values, targets, self._settings.loss), values.detach()

    def update(self, batch: Experience, targets: Tensor) -> dict[str, float]:
        """One gradient step towards targets; see `descend`."""
        return self.descend(*self.compute_loss(batch, targets))

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


class ValueAgent(ReplayStreamAgent):
    """Base of agents that act by action values, and learn them towards targets from replay.

    Attributes:
        values: Q_theta, its target and its average.
    """

    STATE = (Kept("values.learner", "learner"),)
    values: ActionValues

    @abstractmethod
    def compute_targets(self, batch: Experience) -> Tensor:
        """Targets of Q_theta(s, o), (batch,); called without gradient."""

    def compute_values(self, observation: Any) -> NDArray:
        """Q(s, .) behind the greedy policy at an observation, in units of return, float32 (actions,)."""
        return self.values.compute(observation)

    def compute_scores(self, encoded: Tensor) -> Tensor:
        """Values of the online network, in units of return, (n, actions)."""
        return self.values.online(encoded) / self.settings.reward_scale

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The legal action of highest value."""
        return choose_best(self.compute_values(observation), action_mask)

    def update(self, batch: Experience, *known: Any) -> dict[str, float]:
        """One gradient step on a batch of arrays or tensors; `known` is for the targets. Returns numbers to log."""
        tensors = Experience(*map(torch.as_tensor, batch))
        with torch.no_grad():
            targets = self.compute_targets(tensors, *known)
        return self.values.update(tensors, targets)

    def move(self, device: torch.device) -> None:
        """Move networks and optimiser to a device."""
        self.values.learner.move(device)


class DQN(ValueAgent):
    """Minimise over theta the mean of loss(R + b Q_target(s', o*) - Q_theta(s, o)), o* = argmax of Q_theta(s', .).

    R = sum gamma^i r_i, b = gamma^k (1 - terminated), the argmax over actions legal at s'. With `n_step` n, R and b are
    those of n decisions joined. Without `double`, o* is the argmax of Q_target.

    Args:
        goal_rule: reward and termination as functions of goals, for `hindsight_goals`.
        network: a torch module of your own in place of the settings' network, from encoded observations to one number
            an action, with the weights to begin with; it is copied.

    Attributes:
        values: Q_theta, its target and its average, see `ActionValues`.

    Raises:
        AgentSettingsError: `hindsight_goals` in an environment without goals, or the module does not fit.
    """

    settings: DQNSettings
    STATE = ("_n_step", "_bonus", Kept("_hindsight", is_left_out=True))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: DQNSettings | None = None, goal_rule: GoalRule | None = None,
                 network: nn.Module | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        settings, encoder = self.settings, self._encoder
        self.values = ActionValues(self.name, encoder, action_space, seed, settings, network)
        self._n_step = NStep(settings.n_step)
        self._bonus = make_bonus(observation_space, seed, settings, self.name)
        self._hindsight = HindsightReplay(
            observation_space, goal_rule, settings.hindsight_goals, settings.n_step, encoder, settings,
            make_rng(seed, "goals")) if settings.hindsight_goals else None

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say, by the online network."""
        encoded = self._encoder.encode(observation)
        return self.values.explore(encoded, action_mask, self._schedule.steps, self._action_rng)

    # --- learning ------------------------------------------------------------------------

    def choose_next(self, batch: Experience, next_values: Tensor) -> Tensor:
        """o*, the legal argmax of Q_theta(s', .), or of Q_target without `double`; int64 (batch, 1)."""
        next_choice = self.values.online(batch.next_observation) if self.settings.double else next_values
        return next_choice.masked_fill(~batch.next_mask, -torch.inf).argmax(dim=1, keepdim=True)

    def compute_targets(self, batch: Experience) -> Tensor:
        """R + b Q_target(s', o*), o* = argmax over legal o of Q_theta(s', o), (batch,); called without gradient."""
        next_values = self.values.target(batch.next_observation)
        best = self.choose_next(batch, next_values)
        return batch.reward + batch.bootstrap * next_values.gather(1, best).squeeze(1)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Store the decision, then make the updates that are due."""
        bonus = self._bonus.visit(transition.next_observation)
        experience = make_experience(transition, self._encoder, self.settings, bonus)
        for joined in self._n_step.push(experience, transition.terminated or transition.truncated):
            self.replay.add(joined)
        if self._hindsight is not None:
            for relabelled in self._hindsight.push(transition, experience, bonus):
                self.replay.add(relabelled)
        return self.make_due_updates(transition) | self.values.conduct

    # --- streams -------------------------------------------------------------------------

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Begin episodes in all streams; raises `AgentSettingsError` with `hindsight_goals`."""
        if self._hindsight is not None:
            raise AgentSettingsError("hindsight_goals", self.settings.hindsight_goals, "0 in many environments at once")
        super().begin_streams(count, device)

    def compute_bonus(self, decisions: StreamTransitions) -> Tensor | None:
        """Pay for novelty, in units of return, (n,)."""
        return visit_streams(self._bonus, decisions.next_observation, self.settings)
