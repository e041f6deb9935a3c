"""Data that agents learn from without an environment: arrays of decisions or primitives, and the base of such agents.

Where the data shows few states, values stand in a table over the empirical MDP and a pass is a sweep of exact backups;
elsewhere, and over rows of objects, they are networks, and a pass is as many minibatches as hold the data once. An
algorithm says how a state's value follows from its actions' (`improve`), or gives a loss.
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
"""Decisions of the data below which networks are warned of."""
FEW_STATES = 0.1
"""States for each decision of the data up to which `values=auto` is a table."""


class RecordedDecisions(NamedTuple):
    """Decisions of recorded trajectories, in order; the fields of `SMDPTransition`, one row a decision."""

    observation: Any  # at each decision, (n, ...)
    action: NDArray[np.int64]  # int64 (n,)
    mask: NDArray[np.bool_]  # actions legal there, bool (n, actions)
    reward: NDArray[np.float64]  # R = sum gamma^i r_i, float64 (n,)
    summed_reward: NDArray[np.float64]  # sum r_i, float64 (n,)
    duration: NDArray[np.int64]  # k, int64 (n,)
    discount: NDArray[np.float64]  # gamma^k, float64 (n,)
    next_observation: Any  # at the state reached, (n, ...)
    next_mask: NDArray[np.bool_]  # actions legal there, bool (n, actions)
    terminated: NDArray[np.bool_]  # the task ended, so that nothing follows, bool (n,)
    last: NDArray[np.bool_]  # the trajectory ends here, by its end, the horizon or a cut, bool (n,)
    trajectory: NDArray[np.int64]  # number of the trajectory, int64 (n,)
    ended: NDArray[np.int64]  # how the option ended, an index into `step_info.ENDINGS`, int64 (n,)


class Primitives(NamedTuple):
    """Primitives of recorded trajectories, in order, each with the option that chose it."""

    observation: Any  # before each primitive, (n, ...)
    action: NDArray[np.int64]  # int64 (n,)
    reward: NDArray[np.float64]  # float64 (n,)
    next_observation: Any  # after it, (n, ...)
    terminated: NDArray[np.bool_]  # as in `RecordedDecisions`
    last: NDArray[np.bool_]  # likewise
    trajectory: NDArray[np.int64]  # likewise
    option: NDArray[np.int64]  # action of the decision that it belongs to, int64 (n,)
    begins: NDArray[np.bool_]  # it is the decision's first, bool (n,)

    def as_decisions(self, gamma: float, actions: int) -> RecordedDecisions:
        """The same as decisions of one primitive each."""
        ones, legal = np.ones_like(self.action), np.ones((len(self.action), actions), np.bool_)
        return RecordedDecisions(self.observation, self.action, legal, self.reward, self.reward, ones,
                         np.full(len(ones), gamma, np.float64),
                         self.next_observation, legal, self.terminated, self.last, self.trajectory, 0 * ones)


class OfflineData(Protocol):
    """Data set that `train` takes; `hrl_escape.data.load_data` gives one.

    Attributes:
        level: `decisions` or `primitives`, for agents that are given as objects; a name's prefix says which.
    """

    level: str

    @property
    def identity(self) -> Mapping[str, Any]:
        """Name, content hash and observation, part of a run's identity."""
        ...

    def read_decisions(self, gamma: float) -> RecordedDecisions:
        """All decisions, in memory."""
        ...

    def read_primitives(self) -> Primitives:
        """All primitives, in memory."""
        ...

    def make_env(self, options: bool, gamma: float) -> gymnasium.Env:
        """The environment to be tested in; with options its actions are those of the decisions."""
        ...


@dataclass(frozen=True, kw_only=True)
class OfflineSettings(AgentSettings):
    """Settings that agents have in common that learn from a data set."""

    bins: Annotated[int, Range(2)] = 11
    """A component with bounds low, high is rounded to the nearest of this many evenly spaced points, both ends
    included: 11 over a 20 m room is 2 m; a bit stays a bit."""
    resolution: Annotated[float, Range(0, open_low=True)] = 1.0
    """A component without bounds is rounded to multiples of this, in its own unit."""
    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive; per decision if `discounting` is `decision`."""
    discounting: Literal["primitive", "decision"] = "primitive"
    """`primitive`: an action of k primitives is worth sum gamma^i r_i and discounts by gamma^k. `decision`: it is
    worth the plain sum and discounts by gamma, as if it were one step, as the paper's agents did."""
    bootstrap_on_truncation: bool = True
    """Bootstrap from the state in which an episode was truncated; otherwise truncation counts as termination, as in
    the paper's agents."""
    clock: Literal["primitive", "decision"] = "primitive"
    """Unit in which warm-up, update and exploration schedules count. With primitives, flat and option-level agents do
    the same work on the same experience."""
    hidden: tuple[Annotated[int, Range(1)], ...] = (64, 64)
    """Units of each hidden layer."""
    initialisation: Literal["torch", "glorot", "orthogonal"] = "torch"
    """Initial weights: `torch` U(+-1/sqrt(fan in)); `glorot` Xavier uniform with zero bias, as Keras; `orthogonal`
    with zero bias, usual for PPO."""
    learning_rate: Annotated[float, Range(0, open_low=True)] = 3e-4
    """Step size of Adam."""
    max_grad_norm: Annotated[float, Range(0)] = 10.0
    """Gradients are scaled down to this Euclidean norm; 0 leaves them."""
    adam_epsilon: Annotated[float, Range(0, open_low=True)] = 1e-8
    """Term in Adam's denominator; Keras has 1e-7."""
    scale_observations: bool = True
    """Map components with finite bounds in the observation space to [-1, 1]."""
    reward_scale: Annotated[float, Range(0, open_low=True)] = 0.1
    """Networks learn rewards times this; temperatures and logged values stay in units of return."""
    epsilon_start: Annotated[float, Range(0, 1)] = 1.0
    """Epsilon at the beginning."""
    epsilon_end: Annotated[float, Range(0, 1)] = 0.05
    """Epsilon from `epsilon_steps` on."""
    epsilon_steps: Annotated[int, Range(1)] = 5_000
    """Steps of the clock over which epsilon falls linearly."""
    loss: Literal["huber", "squared"] = "huber"
    """Loss of action values: Huber with threshold 1 (in scaled rewards), or half the squared error."""
    batch_size: Annotated[int, Range(1)] = 256
    """Decisions in an update."""
    warmup: Annotated[int, Range(0)] = 500
    """Steps of the clock before the first update."""
    updates_per_step: Annotated[float, Range(0)] = 0.25
    """Updates from replay for each step of the clock; an option of 16 primitives is followed by 16 times as many."""
    stream_updates: Annotated[int, Range(1)] = 16
    """Most updates after a step of many streams. Where more are due, minibatches grow, so that every decision is
    learned from as often; much fewer and larger ones learn less, as the target network follows updates."""
    stream_replay: Annotated[int, Range(1)] = 128
    """Decisions of each stream, on average, for which replay has room at least."""
    passes: Annotated[int, Range(1)] = 50
    """Passes over the data, where `train` is given no budget."""
    values: Literal["auto", "table", "network"] = "auto"
    """`table`: exact backups over the states that the data shows. `auto`: a table where the data shows each state ten
    times or more, on average, and the observation has no rows of objects, which networks carry to other rooms."""
    network: Literal["mlp", "objects"] = "objects"
    """`objects`: deep sets over rows of objects; `mlp`: a perceptron, also where the observation has no rows."""
    target_rate: Annotated[float, Range(0, 1, open_low=True)] = 0.01
    """Share of a network blended into its target at each update."""


class DecisionTable:
    """The empirical MDP of decisions whose observations are rounded to states.

    Args:
        state: number of the state of each decision, int64 (n,).
        next_state: of the state reached; those at which the data shows no decision have numbers too.
        discounts: gamma^k, or what is to stand for it; 0 where nothing follows.
        rewards: R, likewise.

    Attributes:
        counts: how often the data shows each, float64 (states, actions).
        shown: the data shows it, bool (states, actions).
        worst: value of a state at which the data shows no decision: least reward a primitive, for ever.
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
        """Mean of R + b V(s') over the decisions of each state and action; `worst` where there is none."""
        follow = np.where(self.shown.any(axis=1), values, self.worst)[self._next]
        targets = self._rewards + self._discounts * follow
        sums = np.bincount(self._pair, targets, self.counts.size).reshape(self.shape)
        return np.where(self.shown, sums / np.maximum(self.counts, 1.0), self.worst)


def list_best(data: RecordedDecisions, share: float) -> NDArray[np.bool_]:
    """Decisions of the best share of trajectories by plain return, bool (n,); of those not cut, if there are any."""
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
    """Base of agents that learn from a data set: `begin` takes it, each `update` is one sweep or one minibatch.

    A subclass gives `improve` for tables, `heads` and `compute_loss` for networks. Its policy takes the argmax of the
    table's `scores`, or of the network named `acting`.

    Attributes:
        is_fitted: a further sweep would change nothing.
        is_table: values stand in a table.
        networks: by name; none with `values=table`.
        scores: with a table, what the policy takes the argmax of, float64 (states, actions).
        q: with a table, Q of what the data shows, float64 (states, actions).
    """

    heads: ClassVar[Mapping[str, str]]
    """Name of a network -> what it gives a number for: each `action`, or the `state`; `target_NAME` follows NAME."""
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
        """Take the data, and for agents of both the primitives in it; `AgentSettingsError` where it holds nothing."""
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
                          f"often learn nothing. {advice}", stacklevel=2)
        scale = settings.reward_scale
        self._data = Experience(
            encode_all(self._encoder, data.observation), torch.from_numpy(data.mask), torch.from_numpy(data.action),
            torch.from_numpy((rewards * scale).astype(np.float32)), torch.from_numpy(discounts.astype(np.float32)),
            encode_all(self._encoder, data.next_observation), torch.from_numpy(data.next_mask))
        self._durations = data.duration

    def update(self) -> tuple[dict[str, float], int, int]:
        """One sweep or one minibatch; returns numbers to log, and the decisions and primitives learned from."""
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
        """Make the next Q and the scores of the policy from the present Q, each (states, actions), for tables."""
        raise NotImplementedError

    def make_networks(self, encoder: ObservationEncoder, action_space: gymnasium.Space, settings: Any,
                      generator: torch.Generator) -> dict[str, Network]:
        """Make the networks by name, those of `heads` by default."""
        return {name: make_action_network(encoder, action_space, settings, generator) if about == "action" else
                make_state_network(encoder, settings, generator) for name, about in self.heads.items()}

    @abstractmethod
    def compute_loss(self, batch: Experience, rows: NDArray[np.int64]) -> tuple[Tensor, dict[str, float]]:
        """The loss of a minibatch of tensors, which are these rows of the data, and numbers to log."""

    # --- acting --------------------------------------------------------------------------

    def find_state(self, observation: Any) -> int | None:
        """Number of an observation's state in the table; None for one that the data does not show."""
        assert self._find_cell is not None
        return self._numbers.get(np.ascontiguousarray(self._find_cell(observation)).tobytes())

    def compute_preferences(self, observation: Any) -> NDArray:
        """Scores that the policy takes the argmax of, (actions,); equal in states that a table does not know."""
        if not self.is_table:
            return self.networks[self.acting].compute(self._encoder.encode(observation))
        state = self.find_state(observation)
        return np.zeros(self._actions) if state is None else self.scores[state]

    def compute_values(self, observation: Any) -> NDArray | None:
        """Q(s, .) in units of return, (actions,); None where none is learned, or the table does not know the state."""
        if self.is_table:
            state = self.find_state(observation)
            return None if state is None else self.q[state]
        if "q" not in self.networks:
            return None
        with torch.no_grad():
            encoded = torch.from_numpy(self._encoder.encode(observation))[None]
            return self.networks["q"](encoded)[0].numpy() / self.settings.reward_scale

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """The greedy choice: nothing is explored."""
        return self.act_greedy(observation, action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """The legal action of highest score; a table draws among equals."""
        return choose_best(self.compute_preferences(observation), action_mask, rng if self.is_table else None)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Refuse with `UnsupportedError`: such an agent learns from a data set."""
        raise UnsupportedError(f"{self.name} learns from a data set, not from an environment: train(agent="
                               f"'{self.name}', data='lattice-play-v1')")


def encode_all(encoder: ObservationEncoder, observation: NDArray) -> Tensor:
    """Encode observations in blocks, (n, *shape)."""
    blocks = np.array_split(observation, max(1, len(observation) // 65_536))
    return torch.cat([encoder.encode_many(torch.from_numpy(np.ascontiguousarray(block))) for block in blocks])
