"""Streams: many copies of an environment that step together as tensors on one device, each at its own pace.

A step runs one primitive in every stream, or one decision where all take equally long, and returns the decisions that
ended with it. A stream takes its next decision as soon as the last one ended, whatever the others do. Learners see
SMDP transitions, those of `agent.py` with a leading dimension, so that what they learn from is the same.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, LearningSettings, SMDPTransition
from hrl_escape.agents.decisions import Decisions
from hrl_escape.agents.state import Kept, Stateful, StateTree, list_kept
from hrl_escape.errors import DiscountMismatchError

if TYPE_CHECKING:
    import torch
    from torch import Tensor


class EndedDecisions(NamedTuple):
    """Result of a step of streams: tensors (streams, ...), of which the rows in `where` count."""

    where: Tensor  # streams whose decision ended, bool (streams,)
    observation: Tensor  # at the decision
    action: Tensor  # chosen there, int64
    reward: Tensor  # sum of the primitive rewards, float32
    discounted_reward: Tensor  # R = sum over i < k of gamma^i r_i at the streams' gamma, float32
    duration: Tensor  # k >= 1, the primitives that ran
    next_observation: Tensor  # state reached, never the first of a new episode
    next_action_mask: Tensor  # actions legal there, bool (streams, actions)
    terminated: Tensor  # the task ended, which a cut does not do, bool
    truncated: Tensor  # the episode was cut off, bool
    success: Tensor  # the episode ended in success, bool; or int8, with -1 where the environment reports none


class Streams(Protocol):
    """Many copies of an environment; `observation_space` and `action_space` are those of one.

    A vector environment may have streams behind its steps in common, which its method `get_streams` gives. One that
    can make an ordinary environment of the same task, spaces and action numbers has the method `make_single_env`, and
    one whose running episodes can be written down has `state_dict` and `load_state_dict`.
    """

    count: int  # environments that step together
    observation_space: Any  # Gymnasium space of one stream's observations
    action_space: Any  # and of its actions

    @property
    def gamma(self) -> float:
        """Discount per primitive in `discounted_reward`."""
        ...

    @property
    def device(self) -> torch.device:
        """Device of all tensors; known after `reset`."""
        ...

    @property
    def observation(self) -> Tensor:
        """Observations now, after any automatic reset, (streams, ...)."""
        ...

    @property
    def action_mask(self) -> Tensor:
        """Actions legal now, bool (streams, actions)."""
        ...

    @property
    def is_waiting(self) -> Tensor:
        """Streams that take an action at the next step, bool (streams,)."""
        ...

    def reset(self, seeds: int) -> Any:
        """Begin all episodes anew; stream i draws from seed + i."""
        ...

    def step(self, action: Tensor) -> Any:
        """Give waiting streams their actions, int64 (streams,), and step; the next episodes begin by themselves.

        Returns `EndedDecisions`, or what has its attributes.
        """
        ...

    def state_dict(self) -> StateTree | None:
        """Everything that the coming steps depend on; None if it cannot be written down."""
        ...

    def load_state_dict(self, state: StateTree) -> None:
        """Go on where `state_dict` was taken."""


class StreamTransitions(NamedTuple):
    """Decisions of several streams and their outcomes, one a row; see `SMDPTransition`."""

    stream: Tensor  # int64 (n,), stream of each row; no stream has two rows
    observation: Tensor  # (n, ...), at the decision
    action: Tensor  # int64 (n,)
    reward: Tensor  # float32 (n,), R at the agent's gamma
    summed_reward: Tensor  # float32 (n,)
    duration: Tensor  # int64 (n,), k
    next_observation: Tensor  # (n, ...), the state reached
    next_action_mask: Tensor  # bool (n, actions)
    terminated: Tensor  # bool (n,)
    truncated: Tensor  # bool (n,)


class StreamAgent(Agent):
    """An agent that learns from many streams as it does from one environment.

    All of its tensors lie on the device of the streams. `act` and `observe` go on to serve a single environment.
    """

    @abstractmethod
    def begin_streams(self, count: int, device: torch.device) -> None:
        """Move to a device and forget all decisions in progress: every stream begins an episode."""

    @abstractmethod
    def act_streams(self, observation: Tensor, mask: Tensor, stream: Tensor) -> Tensor:
        """Choose actions for learning, int64 (n,).

        Observations (n, ...) are as the streams gave them, the mask, bool (n, actions), holds the actions legal there;
        `stream`, int64 (n,), are the streams that ask.
        """

    @abstractmethod
    def observe_streams(self, decisions: StreamTransitions) -> Mapping[str, float]:
        """Learn from decisions that ended together; returns numbers to log, or nothing."""


class RowStreamAgent(StreamAgent):
    """An agent that chooses and learns for one stream after another.

    What is learned in one room counts in all, so many rooms share tables, models and replay. Choices and updates are
    those of `act` and `observe`, which get arrays on the CPU. What an agent remembers of a running episode stands in
    attributes that `EPISODE` names: every stream has its own, put in their place while the agent serves it.
    """

    EPISODE: ClassVar[tuple[str, ...]] = ()
    """Attributes of a running episode."""
    EPISODE_STATE: ClassVar[tuple[str, ...]] = ()
    """Keys that hold them in a state."""
    STATE = (Kept("_open_masks", is_left_out=True), Kept("_kept_episodes", "episodes", is_left_out=True))
    _open_masks: NDArray[np.bool_] | None = None  # legal at each stream's present decision, (streams, actions)
    _episodes: list[tuple[Any, ...]] | None = None  # of each stream, and last that of a single environment
    _stream: int | None = None  # that is served now

    def begin_episode(self) -> None:  # noqa: B027
        """Forget the running episode."""

    def begin_streams(self, count: int, device: torch.device) -> None:
        """Forget all decisions in progress."""
        del device
        self._open_masks, self._episodes = np.zeros((count, 0), np.bool_), [()] * (count + 1)
        for place in range(count + 1):
            self.begin_episode()
            self._leave(place)

    def act_streams(self, observation: Tensor, mask: Tensor, stream: Tensor) -> Tensor:
        """Choose for each row."""
        assert self._open_masks is not None, "begin_streams comes first"
        masks, rows = mask.cpu().numpy(), stream.tolist()
        if self._open_masks.shape[1] != masks.shape[1]:
            self._open_masks = np.ones((len(self._open_masks), masks.shape[1]), np.bool_)
        self._open_masks[rows] = masks
        chosen = []
        for row, seen, legal in zip(rows, observation.cpu().numpy(), masks, strict=True):
            with self._serving(row):
                chosen.append(self.act(seen, legal))
        return stream.new_tensor(chosen)

    def observe_streams(self, decisions: StreamTransitions) -> Mapping[str, float]:
        """Learn from each row; returns the means of what rows log."""
        assert self._open_masks is not None, "begin_streams comes first"
        logged: dict[str, list[float]] = {}
        for stream, seen, action, reward, summed, k, reached, mask, terminated, truncated in zip(
                *(field.cpu().numpy() for field in decisions), strict=True):
            with self._serving(stream):
                metrics = self.observe(SMDPTransition(
                    seen, int(action), self._open_masks[stream].copy(), float(reward), float(summed), int(k),
                    self.gamma ** int(k), reached, mask, bool(terminated), bool(truncated),
                    cut=bool(truncated and not terminated and k > 1)))
            for name, value in metrics.items():
                logged.setdefault(name, []).append(value)
        return {name: sum(values) / len(values) for name, values in logged.items()}

    @contextmanager
    def _serving(self, stream: int) -> Iterator[None]:
        """Put a stream's episode in place, and afterwards that of a single environment."""
        self._stream = stream
        self._place(stream)
        yield
        self._leave(stream)

    def _leave(self, stream: int) -> None:
        """Put a stream's episode away, and that of a single environment in its place."""
        assert self._episodes is not None, "begin_streams comes first"
        self._episodes[stream] = tuple(getattr(self, name) for name in self.EPISODE)
        self._stream = None
        self._place(-1)

    def _place(self, index: int) -> None:
        assert self._episodes is not None, "begin_streams comes first"
        for name, value in zip(self.EPISODE, self._episodes[index], strict=False):
            setattr(self, name, value)

    @property
    def _kept_episodes(self) -> list[StateTree] | None:
        """Running episodes of all streams; None without any."""
        if not self.EPISODE or not self._episodes:
            return None
        trees: list[StateTree] = [{} for _ in self._episodes[1:]]
        for stream, tree in enumerate(trees):
            with self._serving(stream):
                for kept in self._list_episode():
                    kept.write(self, tree)
        return trees

    @_kept_episodes.setter
    def _kept_episodes(self, saved: list[StateTree] | None) -> None:
        """Streams go on if there are as many."""
        for stream, tree in enumerate(saved if saved and len(saved) + 1 == len(self._episodes or ()) else ()):
            with self._serving(stream):
                for kept in self._list_episode():
                    kept.read(self, tree)

    def _list_episode(self) -> list[Kept]:
        return [kept for kept in list_kept(type(self)) if isinstance(kept, Kept) and kept.key in self.EPISODE_STATE]


class OpenChoices(Stateful):
    """The masks and probabilities that streams' present decisions were chosen with, and their generator.

    Attributes:
        generator: on the device, for the draws of all streams.
        memory: (count, numbers), what each stream remembers now; 0 before an episode's first decision.
    """

    STATE = ("_mask", "_log_probability", "_place", "memory", "_before", "generator")

    def __init__(self, count: int, actions: int, device: torch.device, rng: np.random.Generator,
                 memory: int = 0) -> None:
        import torch  # which no other part of this module needs

        self.count = count
        self.generator = torch.Generator(device).manual_seed(int(rng.integers(2**63)))
        self._mask = torch.ones((count, actions), dtype=torch.bool, device=device)
        self._log_probability = torch.zeros(count, device=device)
        self._place = torch.zeros(count, dtype=torch.int64, device=device)
        self.memory, self._before = (torch.zeros((count, memory), device=device) for _ in range(2))

    def choose(self, stream: Tensor, mask: Tensor, log_probability: Tensor, memory: Tensor) -> None:
        """Keep with what some streams, int64 (n,), have just chosen, and what they remember since."""
        rows = self._find_rows(stream)
        self._mask[rows], self._log_probability[rows] = mask, log_probability
        if self.memory.shape[1]:
            self._before[rows] = self.memory[rows]
            self.memory[rows] = memory

    def end(self, stream: Tensor, over: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Mask (n, actions), log probability (n,), place (n,) and memory before the choice of decisions that ended.

        Where the episode is `over` too, bool (n,), the stream forgets.
        """
        rows = self._find_rows(stream)
        place = self._place[rows].clone()
        self._place[rows] += 1
        if self.memory.shape[1]:
            self.memory[rows] = self.memory[rows].masked_fill(over[:, None], 0.0)
        return self._mask[rows].clone(), self._log_probability[rows].clone(), place, self._before[rows].clone()

    def _find_rows(self, stream: Tensor) -> Tensor | slice:
        """Index of some streams, each named once and in order; that of all of them copies nothing."""
        return slice(None) if len(stream) == self.count else stream

    def has(self, count: int, device: torch.device) -> bool:
        """True if these are the choices of that many streams on that device."""
        return (self.count, self._place.device) == (count, device)

    def find_last(self, stream: Tensor, place: Tensor) -> Tensor:
        """True at each stream's last decision among those at some places of its rollout, bool (n,)."""
        return place == self._place[stream] - 1

    def begin_episodes(self) -> None:
        """Let every stream forget what it remembers; its present decision is dropped."""
        self.memory.zero_()

    def begin_rollout(self) -> None:
        """Count places from 0 again."""
        self._place.zero_()


def gather_decisions(ended: EndedDecisions, masks: Tensor, gamma: float, agent_gamma: float) -> Decisions:
    """Rows of the decisions that ended, of streams discounted by `gamma`, for an agent that discounts by its own.

    `masks`, bool (streams, actions), are the legal actions at each stream's present decision.

    Raises:
        DiscountMismatchError: a decision of several primitives, discounted by another gamma than the agent's.
    """
    stream = ended.where.nonzero().squeeze(1)
    duration = ended.duration.long()
    if gamma != agent_gamma and len(stream) and (longest := int(duration[stream].max())) > 1:
        raise DiscountMismatchError(agent_gamma, gamma**longest, longest)
    discount = (agent_gamma ** duration.double()).float()
    fields = (ended.observation, masks, ended.action, ended.discounted_reward, ended.reward, duration, discount,
              ended.next_observation, ended.next_action_mask, ended.terminated, ended.truncated)
    return Decisions._make((stream, *(field[stream] for field in fields), ()))


def compute_backups(decisions: StreamTransitions, settings: LearningSettings) -> tuple[Tensor, Tensor]:
    """R and b of the backups R + b V(s'), float32 (n,) each; see `compute_backup`."""
    if settings.discounting == "primitive":
        reward, factor = decisions.reward, settings.gamma ** decisions.duration.double()
    else:
        reward, factor = decisions.summed_reward, settings.gamma ** (0 * decisions.duration + 1).double()
    ended = decisions.terminated
    if not settings.bootstrap_on_truncation:
        ended = ended | decisions.truncated
    return reward, factor.masked_fill(ended, 0.0).float()
