"""Deep SARSA over decisions of any duration: sampled or expected, online or with replay.

Zhao et al. (2016); expected SARSA is van Seijen et al. (2009). The recipe `paper` is keras-rl 0.4.2's SARSAAgent as
the published program configured it, with that agent's mistake about the end of an episode.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition, StateTree, compute_backup, count_actions, count_steps
from hrl_escape.agents.exploration import (
    ExplorationSettings,
    choose_best,
    compute_epsilon,
    compute_policy,
    make_rng,
    sample_action,
    sample_index,
)
from hrl_escape.agents.networks import (
    Learner,
    NetworkSettings,
    ObservationEncoder,
    compute_td_loss,
    make_forward,
    make_generator,
    make_network,
)
from hrl_escape.agents.replay import Experience, ReplayBuffer
from hrl_escape.agents.settings import LearningSettings, Range
from hrl_escape.agents.stacking import JointLearner, NetworkStack, finish_updates
from hrl_escape.agents.updates import Metrics, Updates, run_alone
from hrl_escape.errors import AgentSettingsError, DivergenceError

__all__ = ["Sarsa", "SarsaSettings", "SarsaTogether"]


@dataclass(frozen=True)
class SarsaSettings(NetworkSettings, ExplorationSettings, LearningSettings):
    """Settings of `sarsa`."""

    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam."""
    expected: bool = True
    """Value s' by its expectation over the policy; otherwise by one action drawn from the policy, the very one
    taken next where there is no replay."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Share of the online network blended into the target network at each update; 1 does without a target network."""
    replay_capacity: Annotated[int, Range(0)] = 50_000
    """Decisions kept for replay; 0 learns from each decision once, as it comes."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update from replay."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates from replay for each step of the clock; without replay there is one a decision."""
    loss: Literal["huber", "squared"] = "huber"
    """Huber loss with threshold 1 (in scaled rewards), or half the squared error."""
    late_terminal: bool = False
    """Repeat keras-rl 0.4.2: the flag that the episode ended reaches the learner one decision early. The last decision
    but one is valued as if nothing followed, the last bootstraps even from a terminal state. Only without replay."""

    def __post_init__(self) -> None:
        """Refuse impossible values and combinations."""
        super().__post_init__()
        if self.late_terminal and self.replay_capacity:
            raise AgentSettingsError("SarsaSettings.late_terminal", True, "it goes with replay_capacity 0 only")


PAPER = SarsaSettings(
    discounting="decision",
    bootstrap_on_truncation=False,
    clock="decision",
    exploration="boltzmann",
    hidden=(16, 16, 16),
    initialisation="glorot",
    learning_rate=1e-3,
    adam_epsilon=1e-7,
    max_grad_norm=0.0,
    scale_observations=False,
    reward_scale=1.0,
    expected=False,
    target_rate=1.0,
    replay_capacity=0,
    warmup=10,
    loss="squared",
    late_terminal=True,
)


class Request(NamedTuple):
    """What an update is made from.

    Attributes:
        source: rows of the replay, int64 (batch,), or the decision itself as a batch of one.
        next_action: the action at s' to bootstrap from, in a batch of one; None as `expected` says.
    """

    source: NDArray[np.int64] | Experience
    next_action: int | None = None


class Sarsa:
    """Minimise the mean of loss(R + b V(s') - Q_theta(s, o)), V(s') = sum over o' of pi(o' | s') Q_target(s', o').

    pi is the exploring policy of the online network at s', over legal actions. With `expected` off, V(s') is
    Q_target(s', o') of one o' drawn from pi. R = sum gamma^i r_i, b = gamma^k (1 - terminated).
    """

    Settings: ClassVar[type] = SarsaSettings
    recipes: ClassVar[Mapping[str, SarsaSettings]] = {
        "corrected": SarsaSettings(),
        "paper": PAPER,
        "smdp-paper": replace(PAPER, hidden=(32, 32, 32)),  # the program's width with meta-actions on
    }

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.Space,
        seed: int,
        settings: SarsaSettings | None = None,
    ) -> None:
        self.settings = settings = settings or SarsaSettings()
        actions = count_actions(action_space, "sarsa")
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        generator = make_generator(make_rng(seed, "weights"))
        self.online = make_network(self._encoder, actions, settings, generator)
        self.target = make_network(self._encoder, actions, settings, generator).requires_grad_(False)
        self.target.blend(self.online, 1.0)
        self._forward = make_forward(self.online)
        self._learner = Learner("sarsa", {"online": self.online, "target": self.target}, ["online"], settings)
        self.replay = (
            ReplayBuffer(settings.replay_capacity, self._encoder.shape, self._encoder.dtype, actions)
            if settings.replay_capacity
            else None
        )
        self._action_rng, self._replay_rng = make_rng(seed, "actions"), make_rng(seed, "replay")
        self._steps, self._updates_due = 0, 0.0
        self._next_action: int | None = None  # drawn for the last target, to be taken next
        self._waiting: Experience | None = None  # with `late_terminal`: the decision whose update waits

    @property
    def gamma(self) -> float:
        """Discount per primitive."""
        return self.settings.gamma

    def compute_values(self, observation: Any) -> NDArray:
        """Q(s, .) at an observation, in units of return, float32 (actions,)."""
        return self._forward(self._encoder.encode(observation)) / self.settings.reward_scale

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore as the settings say, or take the action that the last target was computed with."""
        if self._next_action is not None:
            action, self._next_action = self._next_action, None
            return action
        return self._sample(self.compute_values(observation), action_mask)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The legal action of highest value."""
        return choose_best(self.compute_values(observation), action_mask)

    def _sample(self, values: NDArray, mask: NDArray[np.bool_]) -> int:
        return sample_action(values, mask, self.settings, self._steps, self._action_rng)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Learn from this decision (or, with `late_terminal`, from the one before), or from replay."""
        return run_alone(self.learn(transition), self._update)

    def learn(self, transition: SMDPTransition) -> Updates:
        """As `observe`; hands out each update as a `Request`."""
        self._steps += (steps := count_steps(transition, self.settings))
        learns = self._steps > self.settings.warmup
        metrics: Metrics = {"epsilon": compute_epsilon(self.settings, self._steps)}
        if self.replay is not None:
            self.replay.add(self._make_experience(transition))
            if learns:
                self._updates_due += steps * self.settings.updates_per_step
                while self._updates_due >= 1:
                    self._updates_due -= 1
                    metrics |= yield Request(self.replay.draw(self.settings.batch_size, self._replay_rng))
        elif self.settings.late_terminal:
            metrics |= yield from self._learn_late(transition, learns)
        else:
            metrics |= yield from self._learn_online(transition, learns)
        return metrics

    def _make_experience(self, transition: SMDPTransition) -> Experience:
        reward, bootstrap = compute_backup(transition, self.settings)
        return Experience(
            self._encoder.encode(transition.observation),
            transition.action_mask,
            transition.action,
            np.float32(reward * self.settings.reward_scale),
            np.float32(bootstrap),
            self._encoder.encode(transition.next_observation),
            transition.next_action_mask,
        )

    def _learn_online(self, transition: SMDPTransition, learns: bool) -> Updates:
        """One update from this decision; the action it bootstraps from is the one taken next."""
        experience = self._make_experience(transition)
        next_action = self._draw_next(experience)
        self._next_action = None if transition.terminated or transition.truncated else next_action
        return dict((yield Request(_as_batch(experience), next_action)) if learns else {})

    def _draw_next(self, experience: Experience) -> int | None:
        """An action at s' to bootstrap from, or None where the expectation over all is taken."""
        if self.settings.expected:
            return None
        return self._sample(
            self._forward(experience.next_observation) / self.settings.reward_scale, experience.next_mask
        )

    def _learn_late(self, transition: SMDPTransition, learns: bool) -> Updates:
        """As keras-rl 0.4.2: update the decision before with this one's end, then at an end this one without."""
        metrics: Metrics = {}
        over = transition.terminated or transition.truncated
        flagged = self._make_experience(transition)
        unflagged = self._make_experience(transition._replace(terminated=False, truncated=False))
        if learns and self._waiting is not None:
            ended = over and flagged.bootstrap == 0
            waiting = self._waiting._replace(bootstrap=np.float32(0)) if ended else self._waiting
            metrics |= yield Request(_as_batch(waiting), None if self.settings.expected else transition.action)
        if learns and over:
            metrics |= yield Request(_as_batch(unflagged), self._draw_next(unflagged))
        self._waiting = None if over else unflagged
        return metrics

    def _update(self, request: Request) -> Metrics:
        loss, values = self.compute_loss(self._get_batch(request), request.next_action)
        value = self._learner.minimise(loss)
        self._blend()
        return {"loss": value, "value": values.mean().item() / self.settings.reward_scale}

    def _get_batch(self, request: Request) -> Experience:
        if isinstance(request.source, Experience):
            return request.source
        assert self.replay is not None, "rows are drawn from a replay"
        return self.replay.take(request.source)

    def _blend(self) -> None:
        if self.settings.target_rate < 1:
            self.target.blend(self.online, self.settings.target_rate)

    def compute_loss(self, batch: Experience, next_action: int | None = None) -> tuple[torch.Tensor, torch.Tensor]:
        """The loss over a batch of numpy arrays, and Q_theta(s, o), (batch,), without gradient.

        Args:
            batch: leading dimension batch.
            next_action: the action at s' to bootstrap from, in a batch of one; without it, as `expected` says.
        """
        return compute_sarsa_loss(
            self.online, self.target, batch, self.settings,
            lambda next_online: self._compute_weights(next_online, batch.next_mask, next_action),
        )

    @staticmethod
    def make_together(agents: Sequence[Sarsa]) -> SarsaTogether:
        """What makes the updates of several such agents at once."""
        return SarsaTogether(agents)

    def _compute_weights(
        self, next_online: NDArray, next_mask: NDArray[np.bool_], next_action: int | None
    ) -> NDArray[np.float32]:
        """Weight of each next action in V(s'), float32 (batch, actions)."""
        if next_action is not None:
            return np.eye(next_online.shape[1], dtype=np.float32)[[next_action]]
        policy = compute_policy(next_online / self.settings.reward_scale, next_mask, self.settings, self._steps)
        if self.settings.expected:
            return policy.astype(np.float32)
        drawn = [sample_index(row, self._replay_rng) for row in policy]
        return np.eye(policy.shape[1], dtype=np.float32)[drawn]

    def state_dict(self) -> StateTree:
        """Networks, optimiser, replay, counters, generators, and what waits for the next decision."""
        return {
            "learner": self._learner.state_dict(),
            "replay": None if self.replay is None else self.replay.state_dict(),
            "steps": self._steps,
            "updates_due": self._updates_due,
            "next_action": self._next_action,
            "waiting": None
            if self._waiting is None
            else {name: np.asarray(field) for name, field in self._waiting._asdict().items()},
            "action_rng": self._action_rng.bit_generator.state,
            "replay_rng": self._replay_rng.bit_generator.state,
        }

    def load_state_dict(self, state: StateTree) -> None:
        """Restore what `state_dict` gave."""
        self._learner.load_state_dict(state["learner"])
        if self.replay is not None:
            self.replay.load_state_dict(state["replay"])
        self._steps, self._updates_due = int(state["steps"]), float(state["updates_due"])
        self._next_action = state["next_action"]
        self._waiting = None if state["waiting"] is None else Experience(**state["waiting"])
        self._action_rng.bit_generator.state = state["action_rng"]
        self._replay_rng.bit_generator.state = state["replay_rng"]


class SarsaTogether:
    """The updates of several SARSA agents, of the same settings, as one; see `updates.Together`."""

    def __init__(self, agents: Sequence[Sarsa]) -> None:
        self._agents = agents
        self._learner = JointLearner([agent._learner for agent in agents])

    def update(self, requests: Sequence[Request]) -> list[Metrics | DivergenceError]:
        """One update of each."""
        agents, settings = self._agents, self._agents[0].settings
        online = NetworkStack([agent.online for agent in agents], with_gradient=True)
        target = NetworkStack([agent.target for agent in agents])
        batches = [agent._get_batch(request) for agent, request in zip(agents, requests, strict=True)]
        batch = Experience(*map(np.stack, zip(*batches, strict=True)))

        def compute_weights(next_online: NDArray) -> NDArray[np.float32]:
            rows = zip(agents, next_online, batch.next_mask, requests, strict=True)
            return np.stack([agent._compute_weights(q, mask, request.next_action) for agent, q, mask, request in rows])

        losses, values = compute_sarsa_loss(online, target, batch, settings, compute_weights)
        outcomes = self._learner.minimise(losses, online)
        return finish_updates(outcomes, values, settings.reward_scale, [agent._blend for agent in agents])


def compute_sarsa_loss(
    online: Callable[[torch.Tensor], torch.Tensor],
    target: Callable[[torch.Tensor], torch.Tensor],
    batch: Experience,
    settings: SarsaSettings,
    compute_weights: Callable[[NDArray], NDArray[np.float32]],
) -> tuple[torch.Tensor, torch.Tensor]:
    """The mean loss over a batch, and Q_theta(s, o) without gradient.

    Args:
        online: Q_theta of observations.
        target: Q_target of observations; not asked where `target_rate` is 1.
        batch: numpy arrays (batch, ...), or (trials, batch, ...) for stacked networks.
        settings: kind of loss.
        compute_weights: weight of each next action in V(s'), from Q_theta(s', .), (..., batch, actions).

    Returns:
        (), (batch,), or (trials,), (trials, batch).
    """
    observation, _, action, reward, bootstrap, next_observation, _ = map(torch.from_numpy, batch)
    with torch.no_grad():
        next_online = online(next_observation)
        next_values = next_online if settings.target_rate == 1 else target(next_observation)
        weights = torch.from_numpy(compute_weights(next_online.numpy()))
        targets = reward + bootstrap * (weights * next_values).sum(dim=-1)
    values = online(observation).gather(-1, action.unsqueeze(-1)).squeeze(-1)
    return compute_td_loss(values, targets, settings.loss), values.detach()


def _as_batch(experience: Experience) -> Experience:
    """The same experience with a leading dimension of one."""
    return Experience(*(np.asarray(field)[None] for field in experience))
