"""Data for agents that learn without an environment: arrays of decisions or primitives, and the base of such agents.

If the data has few states, values are a table over the empirical MDP, and a pass is one sweep of exact backups.
Otherwise, and for rows of objects, they are networks, and a pass is as many minibatches as contain the data once. An
algorithm defines how a state's value follows from its actions' values (`improve`), or a loss.
"""

from __future__ import annotations

import dataclasses
import warnings
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Protocol

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.agent import Agent, AgentSettings, SMDPTransition, count_actions
from hrl_escape.agents.components.exploration import choose_best, make_rng
from hrl_escape.agents.components.networks import (
    Learner,
    Network,
    ObservationEncoder,
    make_action_network,
    make_generator,
    make_state_network,
)
from hrl_escape.agents.components.replay import Experience
from hrl_escape.agents.components.tables import make_cell_finder
from hrl_escape.agents.state import Kept, pack_keys, unpack_keys
from hrl_escape.errors import AgentSettingsError, UnsupportedError
from hrl_escape.settings import Range
from hrl_escape.spaces import ObjectsBox

FEW_DECISIONS = 2_000
"""Number of decisions below which training networks causes a warning."""
FEW_STATES = 0.1
"""Largest number of states per decision of the data for a table with `values=auto`."""


class RecordedDecisions(NamedTuple):
    """Decisions of recorded trajectories, in order; the fields of `SMDPTransition`, one row per decision."""

    observation: Any  # observation of each decision, (n, ...)
    action: NDArray[np.int64]  # int64 (n,)
    mask: NDArray[np.bool_]  # legal actions, bool (n, actions)
    reward: NDArray[np.float64]  # R = sum gamma^i r_i, float64 (n,)
    summed_reward: NDArray[np.float64]  # sum r_i, float64 (n,)
    duration: NDArray[np.int64]  # k, int64 (n,)
    discount: NDArray[np.float64]  # gamma^k, float64 (n,)
    next_observation: Any  # observation after the decision, (n, ...)
    next_mask: NDArray[np.bool_]  # legal actions after the decision, bool (n, actions)
    terminated: NDArray[np.bool_]  # the task ended and the next value is 0, bool (n,)
    last: NDArray[np.bool_]  # the trajectory ends here, by its end, the horizon or a cut, bool (n,)
    trajectory: NDArray[np.int64]  # index of the trajectory, int64 (n,)
    ended: NDArray[np.int64]  # how the option ended, an index into `step_info.ENDINGS`, int64 (n,)


class Primitives(NamedTuple):
    """Primitives of recorded trajectories, in order, each with the option that chose it."""

    observation: Any  # observation before each primitive, (n, ...)
    action: NDArray[np.int64]  # int64 (n,)
    reward: NDArray[np.float64]  # float64 (n,)
    next_observation: Any  # observation after it, (n, ...)
    terminated: NDArray[np.bool_]  # as in `RecordedDecisions`
    last: NDArray[np.bool_]  # as in `RecordedDecisions`
    trajectory: NDArray[np.int64]  # as in `RecordedDecisions`
    option: NDArray[np.int64]  # action of its decision, int64 (n,)
    begins: NDArray[np.bool_]  # whether it is the first of its decision, bool (n,)

    def as_decisions(self, gamma: float, actions: int) -> RecordedDecisions:
        """Return the same data as decisions of one primitive each."""
        ones, legal = np.ones_like(self.action), np.ones((len(self.action), actions), np.bool_)
        return RecordedDecisions(self.observation, self.action, legal, self.reward, self.reward, ones,
                         np.full(len(ones), gamma, np.float64),
                         self.next_observation, legal, self.terminated, self.last, self.trajectory, 0 * ones)


class OfflineData(Protocol):
    """Data set for `train`; `hrl_escape.data.load_data` returns one.

    Attributes:
        level: `decisions` or `primitives`, for agents given as objects; the prefix of a name decides otherwise.
    """

    level: str

    @property
    def identity(self) -> Mapping[str, Any]:
        """Name, content hash and observation, which are part of a run's identity."""
        ...

    def read_decisions(self, gamma: float) -> RecordedDecisions:
        """Return all decisions, in memory."""
        ...

    def read_primitives(self) -> Primitives:
        """Return all primitives, in memory."""
        ...

    def make_env(self, options: bool, gamma: float) -> gymnasium.Env:
        """Make the environment for tests; with `options` its actions are the data's decisions."""
        ...


@dataclass(frozen=True, kw_only=True)
class OfflineSettings(AgentSettings):
    """Common settings of agents that learn from a data set."""

    bins: Annotated[int, Range(2)] = 11
    """Number of evenly spaced points, both bounds included, to round bounded components to: 11 over a 20 m room is 2 m.
    More points make more, finer states. Binary components are unchanged."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """Unit to round unbounded components to multiples of. Smaller values make more, finer states."""
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
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: U(+-1/sqrt(fan in)); Xavier uniform with zero bias, as in Keras; or orthogonal with zero bias,
    usual for PPO."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam. Too large a step diverges."""
    max_grad_norm: Annotated[float, Range(0)] = 10.0
    """Largest Euclidean norm of a gradient; larger ones are scaled down. 0 sets no limit."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; 1e-7 in Keras."""
    scale_observations: bool = True
    """Map components with finite bounds to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Factor on the rewards that networks learn. Smaller values suit larger returns. Temperatures and logged values
    keep units of return."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning; 1 acts at random."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on. More explores for longer and lowers the return of training episodes."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Number of clock steps of the linear decrease of epsilon. More explores for longer."""
    loss: Literal["huber", "squared"] = "huber"
    """Huber loss with threshold 1 in scaled rewards, or half the squared error, which follows outliers."""
    batch_size: Annotated[int, Range(1)] = 256
    """Decisions in an update."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates for each step of the clock. More learn more from the same experience and take longer."""
    max_updates: Annotated[int, Range(1)] = 16
    """Most updates after a step of many environments. Where more are due, minibatches grow instead. Few large ones
    learn less, because the target network follows updates."""
    replay_per_env: Annotated[int, Range(1)] = 128
    """Smallest replay capacity per environment with many environments, in decisions."""
    passes: Annotated[int, Range(1)] = 50
    """Passes over the data, if `train` has no budget."""
    values: Literal["auto", "table", "network"] = "auto"
    """`table`: exact backups over the states of the data. `auto`: a table if each state occurs at least ten times on
    average and the observation has no rows of objects, which let networks generalise to other rooms."""
    network: Literal["mlp", "objects"] = "objects"
    """`objects`: deep sets over the observation's rows of objects. `mlp`: a perceptron over the whole observation."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Share of a network blended into its target at each update. Smaller rates are slower and more stable."""


class DecisionTable:
    """The empirical MDP of decisions whose observations are rounded to states.

    Args:
        state: index of the state of each decision, int64 (n,).
        next_state: index of the next state. States without a decision in the data have indices too.
        discounts: gamma^k, or a replacement for it; 0 if the task ended.
        rewards: R, or a replacement for it.

    Attributes:
        counts: number of decisions of each state and action, float64 (states, actions).
        shown: whether the data has such a decision, bool (states, actions).
        worst: value of a state without decisions: the lowest reward per primitive, forever.
    """

    def __init__(self, state: NDArray, next_state: NDArray, data: RecordedDecisions, states: int, actions: int,
                 rewards: NDArray, discounts: NDArray) -> None:
        self.shape = states, actions
        self._pair, self._next = state * actions + data.action, next_state
        self._rewards, self._discounts = rewards, discounts
        self.counts = np.bincount(self._pair, minlength=states * actions).reshape(self.shape).astype(np.float64)
        self.shown = self.counts > 0
        share = 1.0 - data.discount
        self.worst = float(np.min(rewards / np.where(share > 0, share, 1.0))) if share.any() else float(
            np.bincount(data.trajectory, data.summed_reward).min())

    def back_up(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mean of R + b V(s') over the decisions of each state and action; `worst` if there are none."""
        follow = np.where(self.shown.any(axis=1), values, self.worst)[self._next]
        targets = self._rewards + self._discounts * follow
        sums = np.bincount(self._pair, targets, self.counts.size).reshape(self.shape)
        return np.where(self.shown, sums / np.maximum(self.counts, 1.0), self.worst)


def list_best(data: RecordedDecisions, share: float) -> NDArray[np.bool_]:
    """Return the decisions of the best fraction of trajectories by plain return, bool (n,), uncut ones if possible."""
    if share >= 1.0:
        return np.ones(len(data.action), np.bool_)
    returns = np.bincount(data.trajectory, data.summed_reward)
    ended = np.zeros(len(returns), np.bool_)
    ended[data.trajectory[data.terminated]] = True
    candidates = np.flatnonzero(ended) if ended.any() else np.arange(len(returns))
    kept = max(1, round(share * len(returns)))
    best = candidates[np.argsort(-returns[candidates], kind="stable")[:kept]]
    return np.isin(data.trajectory, best)


class OfflineAgent(Agent):
    """Base class of agents that learn from a data set: `begin` takes it, each `update` is one sweep or one minibatch.

    A subclass defines `improve` for tables, `heads` and `compute_loss` for networks. Its policy takes the argmax of the
    table's `scores`, or of the network named `acting`.

    Attributes:
        is_fitted: whether a further sweep would have no effect.
        is_table: whether values are a table.
        networks: networks by name; empty with `values=table`.
        scores: argument of the policy's argmax with a table, float64 (states, actions).
        q: Q of the state-action pairs in the data with a table, float64 (states, actions).
    """

    heads: ClassVar[Mapping[str, str]]
    """Name of a network -> what its outputs belong to: each `action`, or the `state`; `target_NAME` follows NAME."""
    acting: ClassVar[str] = "q"
    has_table: ClassVar[bool] = True
    reads_both: ClassVar[bool] = False
    settings: Any
    is_markov = True
    STATE = ("_rng", Kept("_learner", "learner", is_left_out=True), "is_fitted", "is_table", Kept(
        "_numbers", "keys", pack_keys, lambda saved: {key: n for n, key in enumerate(unpack_keys(saved))}),
        Kept("scores", unpack=np.array), Kept("q", unpack=np.array))

    def __init__(self, observation_space: gymnasium.Space, action_space: gymnasium.Space, seed: int,
                 settings: Any = None) -> None:
        self.settings = settings = settings or self.Settings()
        self._actions, self._rng = count_actions(action_space, self.name), make_rng(seed, "batches")
        self.is_fitted, self.is_table = False, self.has_table and settings.values == "table"
        self._has_rows = isinstance(observation_space, ObjectsBox)
        self._numbers: dict[bytes, int] = {}
        self.scores = self.q = np.zeros((0, self._actions))
        self._find_cell = make_cell_finder(observation_space, settings, self.name) if self.has_table else None
        self.networks: dict[str, Network] = {}
        self._learner: Learner | None = None
        self._data: Any = None
        if self.is_table:
            return
        self._encoder = ObservationEncoder(observation_space, settings.scale_observations)
        kind = settings.network if self._has_rows else "mlp"
        drawn = dataclasses.replace(settings, network=kind), make_generator(make_rng(seed, "weights"))
        self.networks = self.make_networks(self._encoder, action_space, *drawn)
        trained = [name for name in self.networks if not name.startswith("target")]
        for target in self.networks.keys() - trained:
            self.networks[target].requires_grad_(False).blend(self.networks[target.removeprefix("target_")], 1.0)
        self._learner = Learner(self.name, self.networks, trained, settings)

    # --- learning ------------------------------------------------------------------------

    def begin(self, data: RecordedDecisions, primitives: Primitives | None = None) -> None:
        """Load the data, with its primitives for agents of both. Raises `AgentSettingsError` for empty data."""
        del primitives
        if not len(data.action):
            raise AgentSettingsError("data", "no decision", "a data set with at least one")
        settings, self._counts = self.settings, (len(data.action), int(data.duration.sum()))
        by_primitive = settings.discounting == "primitive"
        rewards, discounts = (data.reward, data.discount) if by_primitive else (
            data.summed_reward, np.full(len(data.action), settings.gamma))
        over = data.terminated if settings.bootstrap_on_truncation else data.last
        discounts = np.where(over, 0.0, discounts)
        may_be_table = settings.values == "table" or (settings.values == "auto" and not self._has_rows)
        if self._find_cell is not None and may_be_table:
            cells = self._find_cell(np.concatenate([data.observation, data.next_observation]))
            rows = np.ascontiguousarray(cells.reshape(len(cells), -1))
            found, number = np.unique(rows.view(np.dtype((np.void, rows.shape[1] * 4))).ravel(), return_inverse=True)
            self.is_table = settings.values == "table" or len(found) <= FEW_STATES * len(data.action)
            if self.is_table:
                self._numbers = {key.tobytes(): n for n, key in enumerate(found)}
                half = len(data.action)
                self._data = DecisionTable(number[:half], number[half:], data, len(found), self._actions, rewards,
                                           discounts)
                if len(self.q) != len(found):
                    self.q = self.scores = np.full(self._data.shape, self._data.worst)
                return
        if len(data.action) < FEW_DECISIONS:
            advice = ("Use settings={'values': 'table'} for exact backups over the states in the data"
                      if self._find_cell is not None else "Give it more data")
            warnings.warn(f"{self.name} fits networks to {len(data.action):,} decisions. Below {FEW_DECISIONS:,} they "
                          f"often fail to learn. {advice}", stacklevel=2)
        scale = settings.reward_scale
        self._data = Experience(
            encode_all(self._encoder, data.observation), torch.from_numpy(data.mask), torch.from_numpy(data.action),
            torch.from_numpy((rewards * scale).astype(np.float32)), torch.from_numpy(discounts.astype(np.float32)),
            encode_all(self._encoder, data.next_observation), torch.from_numpy(data.next_mask))
        self._durations = data.duration

    def update(self) -> tuple[dict[str, float], int, int]:
        """Make one sweep or minibatch; return numbers to log, and the numbers of decisions and primitives used."""
        if self.is_table:
            before = self.q
            self.q, self.scores = self.improve(self._data, before)
            change = float(np.abs(self.q - before).max())
            self.is_fitted = change == 0.0
            return {"td_error": change, "states": float(len(self.q))}, *self._counts
        assert self._learner is not None
        rows = self._rng.integers(len(self._durations), size=self.settings.batch_size)
        index = torch.from_numpy(rows)
        loss, metrics = self.compute_loss(Experience(*(field[index] for field in self._data)), rows)
        value = self._learner.minimise(loss)
        for name, network in self.networks.items():
            if name.startswith("target_"):
                network.blend(self.networks[name.removeprefix("target_")], self.settings.target_rate)
        logged = {"loss": value, "gradient_norm": self._learner.gradient_norm, **metrics}
        return logged, len(rows), int(self._durations[rows].sum())

    def improve(self, table: DecisionTable, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the next Q and the scores of the policy from the current Q, each (states, actions), for tables."""
        raise NotImplementedError

    def make_networks(self, encoder: ObservationEncoder, action_space: gymnasium.Space, settings: Any,
                      generator: torch.Generator) -> dict[str, Network]:
        """Make the networks by name, by default those in `heads`."""
        return {name: make_action_network(encoder, action_space, settings, generator) if about == "action" else
                make_state_network(encoder, settings, generator) for name, about in self.heads.items()}

    @abstractmethod
    def compute_loss(self, batch: Experience, rows: NDArray[np.int64]) -> tuple[Tensor, dict[str, float]]:
        """Return the loss of a minibatch of tensors, which are `rows` of the data, and numbers to log."""

    # --- acting --------------------------------------------------------------------------

    def find_state(self, observation: Any) -> int | None:
        """Return the index of an observation's state in the table, or None if the data lacks it."""
        assert self._find_cell is not None
        return self._numbers.get(np.ascontiguousarray(self._find_cell(observation)).tobytes())

    def compute_preferences(self, observation: Any) -> NDArray:
        """Return the scores for the policy's argmax, (actions,); equal in states that the table lacks."""
        if not self.is_table:
            return self.networks[self.acting].compute(self._encoder.encode(observation))
        state = self.find_state(observation)
        return np.zeros(self._actions) if state is None else self.scores[state]

    def compute_values(self, observation: Any) -> NDArray | None:
        """Return Q(s, .) in units of return, (actions,), or None without values or for states that the table lacks."""
        if self.is_table:
            state = self.find_state(observation)
            return None if state is None else self.q[state]
        if "q" not in self.networks:
            return None
        with torch.no_grad():
            encoded = torch.from_numpy(self._encoder.encode(observation))[None]
            return self.networks["q"](encoded)[0].numpy() / self.settings.reward_scale

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Return the greedy choice; such an agent does not explore."""
        return self.act_greedy(observation, action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return the legal action of highest score; a table draws among equal scores."""
        return choose_best(self.compute_preferences(observation), action_mask, rng if self.is_table else None)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Raise `UnsupportedError`: such an agent learns from a data set."""
        raise UnsupportedError(f"{self.name} learns from a data set, not from an environment: train(agent="
                               f"'{self.name}', data='lattice-play-v1')")


def encode_all(encoder: ObservationEncoder, observation: NDArray) -> Tensor:
    """Encode observations in blocks, (n, *shape)."""
    blocks = np.array_split(observation, max(1, len(observation) // 65_536))
    return torch.cat([encoder.encode_many(torch.from_numpy(np.ascontiguousarray(block))) for block in blocks])
