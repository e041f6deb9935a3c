"""The words of a hierarchy: what a task sees, what it calls, what a running call is, and the base of tasks.

A hierarchical method is a stack of running calls. At each primitive the top call chooses, the world
moves once, and every running call is paid and asked whether it is over. Methods differ in the answers
that a task gives to six questions: `view`, `legal`, `decode`, `ends`, `pay`, `final`. Nothing here learns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent
from hrl_escape.errors import AgentSettingsError, UnknownNameError


class Seen(NamedTuple):
    """A moment as tasks may look at it."""

    observation: Any  # as the environment gave it
    mask: NDArray[np.bool_]  # bool (primitives,), the primitives legal there
    state: Any = None  # what `Hierarchy.read` made of the observation; None without it


def allow_only(choice: int | None, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask of one choice alone, all false where it is illegal or None; bool (choices,)."""
    return mask & (np.arange(len(mask)) == (-1 if choice is None else choice))


class Call(NamedTuple):
    """A choice of a task.

    Attributes:
        child: a task, or the number of a primitive.
        context: what the child is told: a goal, a command, a length.
    """

    child: BaseTask | int
    context: Any = None


class Decision(NamedTuple):
    """A choice that a running call has made, and what came of it so far."""

    view: Any  # what the task saw when it chose
    legal: NDArray[np.bool_]  # bool (choices,), what it could choose
    choice: int  # what it chose
    reward: float = 0.0  # sum of gamma^i times its pay since
    summed: float = 0.0  # undiscounted sum of its pay since
    duration: int = 0  # primitives since
    discount: float = 1.0  # gamma^duration


class Frame(NamedTuple):
    """One running call."""

    task: BaseTask  # which task runs
    context: Any  # what its caller told it
    start: Seen  # the moment of the call
    primitives: int = 0  # primitives that ran since
    reward: float = 0.0  # undiscounted sum of its pay since
    decision: Decision | None = None  # its latest choice; None before the first


Stack = tuple[Frame, ...]
"""Running calls, the root first."""


class Step(NamedTuple):
    """One primitive: what the world did."""

    seen: Seen  # where it was done
    action: int  # which primitive
    reward: float
    """Reward of the environment, discounted within the primitive where it lasts several steps (an option of the
    environment)."""
    summed: float  # the same without discount
    duration: int  # steps of the environment, 1 for a true primitive
    next_seen: Seen  # the moment reached
    terminated: bool  # the episode ended in the task's sense
    truncated: bool  # the episode was cut off
    arrival: float = 1.0
    """Discount of what is paid at `next_seen`, gamma^(duration - 1); 1 where a sum without discount is asked."""
    cut: bool = False  # truncated inside an option of the environment


class BaseTask:
    """A kind of call: by default it sees the observation, is paid by the environment, and calls primitives until told.

    Views and contexts are numbers, arrays, or None, so that a checkpoint can hold a running call.

    Args:
        name: unique in its hierarchy.
        view_space: of its views; None is the environment's observation space.
    """

    def __init__(self, name: str, choices: int, view_space: gymnasium.Space | None = None) -> None:
        self.name, self.view_space = name, view_space
        self.space = gymnasium.spaces.Discrete(choices)

    def view(self, seen: Seen, stack: Stack) -> Any:
        """View that its learner has, the observation by default; `stack` holds the running calls, its own last."""
        return seen.observation

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Choices it has here, bool (choices,): legal primitives by default; no child that would be over at once."""
        return seen.mask

    def find_place(self, context: Any) -> tuple[float, float] | None:
        """Place (x, y) of the goal of a call on the floor, m, for drawings; None where it has no place."""
        return None

    def is_callable(self, seen: Seen, context: Any) -> bool:
        """A call may begin here: it would not be over at once, and has something to choose."""
        return self.ends(Frame(self, context, seen), seen) < 1.0 and bool(self.legal(seen, context).any())

    def list_calls(self) -> Mapping[str, Any]:
        """Calls that stand on their own, as options: name -> what the caller says, by default one, told nothing."""
        return {self.name: None}

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        """The call that a choice stands for, by default the primitive of this number."""
        return Call(int(choice))

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Probability that the call is over here; 1.0 is certain, and by 0.0 only a caller or the episode ends it."""
        return 0.0

    def pay(self, step: Step, frame: Frame) -> float:
        """Its reward for one primitive, the environment's by default; for what it reached, times `step.arrival`."""
        return step.reward

    def final(self, frame: Frame, seen: Seen) -> float:
        """Pseudo-reward where it ended by itself: for its own learner, never for its caller's."""
        return 0.0

    def decide(self, seen: Seen, context: Any, rng: np.random.Generator) -> int:
        """Its choice where no learner makes it, by default any legal one, uniformly."""
        legal = self.legal(seen, context).nonzero()[0]
        return int(legal[rng.integers(len(legal))])


LearnerSpec = Callable[[gymnasium.Space, gymnasium.spaces.Discrete, int], Agent]
"""Makes the learner of a task from view space, choices and seed: an agent's class, or
`functools.partial(make_agent, "dqn")`."""


@dataclass(frozen=True)
class Hierarchy:
    """Tasks below a root, the learner of each, and what they are told that a flat agent is not.

    Attributes:
        root: the call that runs for the whole episode.
        below: all other tasks.
        learners: task name -> how its learner is made; a task without one decides for itself.
        share: task name -> name of the task whose learner it shares.
        privileges: what it reads that is not in the observation, such as `task graph` or `state`; printed in tables.
        read: makes `Seen.state` of an observation.
    """

    root: BaseTask
    below: tuple[BaseTask, ...] = ()
    learners: Mapping[str, LearnerSpec] = field(default_factory=dict)
    share: Mapping[str, str] = field(default_factory=dict)
    source: Literal["given", "synthesised", "learned"] = "given"
    privileges: tuple[str, ...] = ()
    read: Callable[[Any], Any] | None = None

    MOST_DEPTH: ClassVar[int] = 64
    """Bound on running calls; more is a task that calls itself for ever."""

    def see(self, observation: Any, mask: NDArray[np.bool_]) -> Seen:
        """The moment of an observation."""
        return Seen(observation, mask, None if self.read is None else self.read(observation))

    @property
    def tasks(self) -> dict[str, BaseTask]:
        """All tasks by name, the root first."""
        return {task.name: task for task in (self.root, *self.below)}

    def __post_init__(self) -> None:
        names = [task.name for task in (self.root, *self.below)]
        if len(set(names)) < len(names):
            raise AgentSettingsError("Hierarchy.below", names, "tasks of different names")
        for where, mentioned in (("learners", self.learners), ("share", [*self.share, *self.share.values()])):
            if unknown := set(mentioned) - set(names):
                raise UnknownNameError(f"task in Hierarchy.{where}", min(unknown), names)
