"""Deep Q-network from TorchRL's parts: `QValueActor`, `EGreedyModule`, `ReplayBuffer`, `DQNLoss` and `HardUpdate`.

The algorithm is `dqn` with one-step targets and without its averaged network; see `components/torchrl_agent.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import gymnasium
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.data import Categorical
from torchrl.modules import EGreedyModule, QValueActor
from torchrl.objectives import DQNLoss, HardUpdate, ValueEstimators

from hrl_escape.agents.agent import AgentSettings, SMDPTransition
from hrl_escape.agents.components.torchrl_agent import TorchRLReplayAgent
from hrl_escape.agents.state import Kept
from hrl_escape.settings import Range


@dataclass(frozen=True, kw_only=True)
class TorchRLDQNSettings(AgentSettings):
    """Settings of `torchrl-dqn`: exploration, targets and replay."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam. Too large a step diverges."""
    max_grad_norm: Annotated[float, Range(0, open_low=True)] = 10.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down."""
    batch_size: Annotated[int, Range(1)] = 64
    """Decisions in an update."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns. Logged values keep units of
    return."""
    replay_capacity: Annotated[int, Range(1)] = 50_000
    """Decisions kept for replay."""
    warmup: Annotated[int, Range(0)] = 500
    """Primitives before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each primitive. More learn more from the same experience and take longer."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    double: bool = True
    """The online network chooses the next action and the target network values it, which avoids overestimation."""
    target_every: Annotated[int, Range(1)] = 200
    """Updates between copies of the online network into the target network. Fewer follow faster and are less stable."""


class TorchRLDQN(TorchRLReplayAgent):
    """Minimise the Huber loss of R + gamma^k (1 - terminated) Q_target(s', o*) - Q_theta(s, o) over replay.

    o* is the legal argmax at s' of Q_theta, or of Q_target without `double`.
    """

    settings: TorchRLDQNSettings
    STATE = ("_exploration", Kept("_target.counter", "since_target"))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: TorchRLDQNSettings | None = None) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        settings = self.settings
        with self._own_chance():
            spec = Categorical(self._actions)
            actor = QValueActor(self._network, spec=spec, in_keys=["observation"],
                                action_space="categorical", action_mask_key="action_mask")
            loss = DQNLoss(actor, loss_function="smooth_l1", delay_value=True, double_dqn=settings.double,
                           action_space="categorical")
        loss.make_value_estimator(ValueEstimators.TD0, gamma=settings.gamma)
        self._begin(actor, loss)
        self._target = HardUpdate(loss, value_network_update_interval=settings.target_every)
        self._greed = EGreedyModule(spec, settings.epsilon_start, settings.epsilon_end, settings.epsilon_steps,
                                    action_mask_key="action_mask")

    @property
    def _exploration(self) -> dict[str, torch.Tensor]:
        """Current epsilon, and its schedule."""
        return dict(self._greed.named_buffers())

    def compute_values(self, observation: Any) -> NDArray:
        """Return Q(s, .) at an observation, in units of return, float32 (actions,)."""
        return self._compute(observation) / self.settings.reward_scale

    def _explore(self, seen: TensorDictBase) -> TensorDictBase:
        """Choose greedily, or uniformly with probability epsilon."""
        return self._greed(self._actor(seen))

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Decay epsilon, store the decision, then make the updates that are due."""
        self._greed.step(transition.duration)
        return super().observe(transition)
