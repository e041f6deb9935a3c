"""Base class of agents made of TorchRL's parts: decisions as TensorDicts, random numbers, updates and checkpoints.

TorchRL (Bou et al. 2023) provides the networks, losses, value estimators, replay and target updates. The training loop
of this project runs the environment, and run folders, evaluations and reports are the same as for every other agent.
TorchRL's estimators discount by gamma to the power of the root key `steps_to_next_obs`, here the duration of a
decision.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import MLP, MaskedCategorical, ProbabilisticActor
from torchrl.objectives import LossModule
from torchrl.objectives.utils import TargetNetUpdater

from hrl_escape.agents.agent import Agent, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import choose_best, make_rng
from hrl_escape.agents.components.networks import ObservationEncoder, make_generator
from hrl_escape.agents.components.replay import UpdateSchedule
from hrl_escape.agents.state import Kept
from hrl_escape.errors import DivergenceError

ILLEGAL = -1e6
"""Logit of an illegal action. Its probability is exactly 0, and 0 times its logarithm is 0; minus infinity would make
`DiscreteSACLoss` NaN."""
PARAMETERS: Any = {"logits": "logits", "mask": "action_mask"}
"""Keys of a distribution's parameters: a mapping, which TorchRL accepts without declaring it."""
logging.getLogger("torchrl").setLevel(logging.WARNING)  # silences a message for every replay buffer


class TorchRLAgent(Agent):
    """Base class: the policy is an actor over TensorDicts, and learning minimises a TorchRL loss.

    A subclass makes the actor and the loss and passes them to `_begin`. The agent runs on the CPU.
    """

    settings: Any
    is_markov = True
    STATE = ("_weights", Kept("_moments", "moments", unpack=dict), "_chance")

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int, settings: Any
                 ) -> None:
        self.settings = settings or self.Settings()
        self._actions = count_actions(action_space, self.name)
        self._encoder = ObservationEncoder(observation_space, self.settings.scale_observations)
        self._chance = make_generator(make_rng(seed, "torchrl"))
        with self._own_chance():
            self._network = self._make_mlp(self._actions)

    def _begin(self, actor: TensorDictModule, loss: LossModule) -> None:
        """Set the policy and the loss, whose parameters Adam updates."""
        self._actor, self._loss = actor, loss
        self._trained = [parameter for parameter in loss.parameters() if parameter.requires_grad]
        self._adam = torch.optim.Adam(self._trained, lr=self.settings.learning_rate)
        self._updates = 0

    def _make_mlp(self, outputs: int) -> MLP:
        return MLP(in_features=math.prod(self._encoder.shape), out_features=outputs, num_cells=self.settings.hidden,
                   activation_class=nn.Tanh)

    def _make_policy(self) -> ProbabilisticActor:
        """Policy with the network's outputs as logits of a distribution over legal actions."""
        return ProbabilisticActor(
            TensorDictModule(self._network, ["observation"], ["logits"]),
            in_keys=PARAMETERS, distribution_class=MaskedCategorical,
            distribution_kwargs={"neg_inf": ILLEGAL}, return_log_prob=True)

    @contextmanager
    def _own_chance(self) -> Iterator[None]:
        """Run TorchRL, which draws from torch's global generator, with the agent's own random state."""
        with torch.random.fork_rng(devices=()):
            torch.set_rng_state(self._chance.get_state())
            yield
            self._chance.set_state(torch.get_rng_state())

    # --- acting --------------------------------------------------------------------------

    def _see(self, observation: Any, action_mask: NDArray[np.bool_]) -> TensorDict:
        encoded = torch.from_numpy(self._encoder.encode(observation).reshape(-1))
        return TensorDict({"observation": encoded, "action_mask": torch.from_numpy(np.array(action_mask, np.bool_))})

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Explore with the actor, among legal actions."""
        with torch.no_grad(), self._own_chance(), set_exploration_type(ExplorationType.RANDOM):
            return int(self._explore(self._see(observation, action_mask))["action"])

    def _explore(self, seen: TensorDictBase) -> TensorDictBase:
        return self._actor(seen)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the legal action of highest value, or of highest probability."""
        return choose_best(self._compute(observation), action_mask)

    def _compute(self, observation: Any) -> NDArray:
        """Return the outputs of the actor's network, float32 (actions,): scaled values, or logits."""
        with torch.no_grad():  # calling the whole actor takes ten times as long
            return self._network(torch.from_numpy(self._encoder.encode(observation).reshape(-1))).numpy()

    # --- learning ------------------------------------------------------------------------

    def _make_decision(self, transition: SMDPTransition) -> TensorDict:
        """A decision under the keys of TorchRL's losses; `reward` is R, scaled."""
        seen = self._see(transition.observation, transition.action_mask)
        reached = self._see(transition.next_observation, transition.next_action_mask)
        ended = transition.terminated or transition.truncated
        reached.update({"reward": torch.tensor([transition.reward * self.settings.reward_scale]),
                        "terminated": torch.tensor([transition.terminated]), "done": torch.tensor([ended])})
        return seen.update({"action": torch.tensor(transition.action), "next": reached,
                            "steps_to_next_obs": torch.tensor([transition.duration])})

    def _descend(self, batch: TensorDictBase) -> dict[str, float]:
        """Make one step of Adam on the sum of the losses of a batch. Raises `DivergenceError` if it is not finite."""
        parts = self._loss(batch)
        loss = sum(value for key, value in parts.items() if key.startswith("loss"))
        assert isinstance(loss, Tensor)
        self._adam.zero_grad()
        loss.backward()
        norm = float(nn.utils.clip_grad_norm_(self._trained, self.settings.max_grad_norm))
        if not math.isfinite(norm) or not math.isfinite(loss.item()):
            raise DivergenceError(self.name, self._updates, loss=loss.item(), gradient_norm=norm)
        self._adam.step()
        self._updates += 1
        return {"loss": loss.item(), "gradient_norm": norm}

    # --- checkpoints ---------------------------------------------------------------------

    @property
    def _weights(self) -> dict[str, Tensor]:
        """Parameters and buffers of the loss, with target networks."""
        named = (*self._loss.named_parameters(), *self._loss.named_buffers())
        return {name: tensor.detach() for name, tensor in named}

    @property
    def _moments(self) -> dict[str, Any]:
        """Adam's state by parameter and name, and the number of updates."""
        state = self._adam.state_dict()["state"]
        return {"updates": self._updates,
                **{f"{index} {name}": np.asarray(value) for index, own in state.items() for name, value in own.items()}}

    @_moments.setter
    def _moments(self, saved: Mapping[str, Any]) -> None:
        state: dict[int, dict[str, Tensor]] = {}
        for key, value in saved.items():
            index, _, name = key.partition(" ")
            if name:
                state.setdefault(int(index), {})[name] = torch.from_numpy(np.array(value))
        self._adam.load_state_dict({**self._adam.state_dict(), "state": state})
        self._updates = int(saved["updates"])


class TorchRLReplayAgent(TorchRLAgent):
    """Base class of agents with replay; `_target` updates the target networks after each update."""

    STATE = ("replay", Kept("_schedule.steps", "steps"), Kept("_schedule._due", "updates_due"))
    _target: TargetNetUpdater

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int, settings: Any
                 ) -> None:
        super().__init__(observation_space, action_space, seed, settings)
        self._schedule = UpdateSchedule(self.settings.warmup, self.settings.updates_per_step)
        self.replay = TorchRLReplay(self.settings.replay_capacity, self.settings.batch_size)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Store the decision, then make the updates that are due."""
        self.replay.add(self._make_decision(transition))
        told: dict[str, float] = {}
        for _ in range(self._schedule.advance(transition.duration, len(self.replay))):
            with self._own_chance():
                told = self._descend(self.replay.sample())
            self._target.step()
        return told


class TorchRLReplay:
    """TorchRL's replay buffer with a checkpoint of arrays."""

    def __init__(self, capacity: int, batch_size: int) -> None:
        self._buffer = ReplayBuffer(storage=LazyTensorStorage(capacity), batch_size=batch_size)

    def __len__(self) -> int:
        return len(self._buffer)

    def add(self, decision: TensorDict) -> None:
        """Store a decision, replacing the oldest if the buffer is full."""
        self._buffer.add(decision)

    def sample(self) -> TensorDictBase:
        """Draw a batch uniformly, with repetition, from torch's generator."""
        return self._buffer.sample()

    def state_dict(self) -> dict[str, Any]:
        """Return decisions by key, and the next position."""
        if not len(self):
            return {}
        kept = self._buffer[:].flatten_keys(" ")
        return {"writer": dict(self._buffer.writer.state_dict()),
                "decisions": {key: value.numpy().copy() for key, value in sorted(kept.items())}}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from the state of `state_dict`."""
        self._buffer.empty()
        if state:
            decisions = {key: torch.from_numpy(np.array(value)) for key, value in state["decisions"].items()}
            self._buffer.extend(TensorDict(decisions, [len(decisions["action"])]).unflatten_keys(" "))
            self._buffer.writer.load_state_dict(state["writer"])
