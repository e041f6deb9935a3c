"""The words of a hierarchy: what a task sees, what it calls, what a running call is, and the base of tasks.

A hierarchical method is a stack of running calls. At each primitive the top call chooses, the world
advances once, and every running call is rewarded and can end. Methods differ in the six methods of a task:
`view`, `legal`, `decode`, `ends`, `pay` and `final`. The module does not learn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent
from hrl_escape.agents.state import StateTree
from hrl_escape.errors import AgentSettingsError, StepContractError, UnknownNameError


class Seen(NamedTuple):
    """A moment as tasks may look at it."""

    observation: Any  # as the environment gave it
    mask: NDArray[np.bool_]  # bool (primitives,), the primitives legal there
    state: Any = None  # what `Hierarchy.read` made of the observation, or None without it


def allow_only(choice: int | None, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask of one choice alone, all false if it is illegal or None; bool (choices,)."""
    return mask & (np.arange(len(mask)) == (-1 if choice is None else choice))


class Call(NamedTuple):
    """A choice of a task.

    Attributes:
        child: a task, or the number of a primitive.
        context: argument of the child: a goal, a command, a length.
    """

    child: BaseTask | int
    context: Any = None


class Decision(NamedTuple):
    """A choice of a running call, and its outcome so far."""

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
    context: Any  # argument from its caller
    start: Seen  # the moment of the call
    primitives: int = 0  # primitives that ran since
    reward: float = 0.0  # undiscounted sum of its pay since
    decision: Decision | None = None  # its latest choice, or None before the first


Stack = tuple[Frame, ...]
"""Running calls, the root first."""


class Step(NamedTuple):
    """Outcome of one primitive."""

    seen: Seen  # moment of its choice
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
    """A kind of call: by default it sees the observation, gets the environment's reward, and never ends by itself.

    Views and contexts are numbers, arrays, or None, so that a checkpoint can hold a running call.

    Args:
        name: unique in its hierarchy.
        view_space: of its views, or None for the environment's observation space.
        child: the task that every choice calls with the choice's number, or None if choices are primitives.
    """

    def __init__(self, name: str, choices: int, view_space: gymnasium.Space | None = None,
                 child: BaseTask | None = None) -> None:
        self.name, self.view_space, self.child = name, view_space, child
        self.space = gymnasium.spaces.Discrete(choices)

    def view(self, seen: Seen, stack: Stack) -> Any:
        """Return the input of its agent, by default the observation; `stack` holds the running calls, its own last."""
        return seen.observation

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        """Return its legal choices, bool (choices,): by default legal primitives, and children not over at once."""
        return seen.mask

    def find_place(self, context: Any) -> tuple[float, float] | None:
        """Return the place (x, y) of the goal of a call on the floor, m, for drawings, or None."""
        return None

    def is_callable(self, seen: Seen, context: Any) -> bool:
        """Return whether a call can begin here: it is not over at once, and has a legal choice."""
        return self.ends(Frame(self, context, seen), seen) < 1.0 and bool(self.legal(seen, context).any())

    def list_calls(self) -> Mapping[str, Any]:
        """Return calls to use as options: name -> argument; by default one without an argument."""
        return {self.name: None}

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        """Return the call of a choice, by default the primitive of this number, or the child with this number."""
        return Call(int(choice)) if self.child is None else Call(self.child, int(choice))

    def ends(self, frame: Frame, seen: Seen) -> float:
        """Return the probability that the call is over here; with 0.0 only a caller or the episode ends it."""
        return 0.0

    def pay(self, step: Step, frame: Frame) -> float:
        """Return its reward for one primitive, by default the environment's; `step.arrival` discounts the arrival."""
        return step.reward

    def final(self, frame: Frame, seen: Seen) -> float:
        """Return the pseudo-reward at its own end, for its own agent and not for its caller's."""
        return 0.0

    def decide(self, seen: Seen, context: Any, rng: np.random.Generator) -> int:
        """Choose without an agent, by default uniformly among legal choices."""
        legal = self.legal(seen, context).nonzero()[0]
        return int(legal[rng.integers(len(legal))])


LearnerSpec = Callable[[gymnasium.Space, gymnasium.spaces.Discrete, int], Agent]
"""Makes the agent of a task from view space, choices and seed: an agent's class, or
`functools.partial(make_agent, "dqn")`."""


@dataclass(frozen=True)
class Hierarchy:
    """Tasks below a root, the agent of each, and their information beyond a flat agent's."""

    root: BaseTask  #: the call that runs for the whole episode
    below: tuple[BaseTask, ...] = ()  #: all other tasks
    learners: Mapping[str, LearnerSpec] = field(default_factory=dict)
    """Task name -> constructor of its agent; a task without one chooses by `decide`."""
    share: Mapping[str, str] = field(default_factory=dict)  #: task name -> name of the task whose agent it uses
    source: Literal["given", "synthesised", "learned"] = "given"  #: where the structure comes from
    privileges: tuple[str, ...] = ()
    """Knowledge that is not in the observation, such as `task graph` or `state`; printed in tables."""
    read: Callable[[Any], Any] | None = None  #: makes `Seen.state` of an observation

    MOST_DEPTH: ClassVar[int] = 64
    """Bound on running calls, against unlimited recursion."""

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


# --- descent to a primitive, and return of its outcome: pure functions of stacks ---

Chooser = Callable[[Stack, Any, NDArray[np.bool_], Seen], int]
"""Chooses for the last frame of a stack: (stack, view, legal choices, moment) -> choice."""


class Return(NamedTuple):
    """A decision of a running call that is complete, or was cut."""

    stack: Stack  # the running calls up to this one, paid, as they were before any was ended
    seen: Seen  # the moment reached
    ended: bool  # the call ended by itself, its `ends` said so
    is_over: bool  # the call is over, by itself or because a caller, the episode or the lack of choices ended it
    cut: bool  # the child that was called neither ended by itself nor got stuck
    terminated: bool  # the episode ended in the task's sense
    truncated: bool  # the episode was cut off

    @property
    def frame(self) -> Frame:
        """The call whose decision this is."""
        return self.stack[-1]

    @property
    def stuck(self) -> bool:
        """True if the call did not end by itself, but has no legal choice left."""
        return not (self.ended or self.terminated) and not self.frame.task.legal(self.seen, self.frame.context).any()

    @property
    def decision(self) -> Decision:
        """The decision, paid up to the moment reached."""
        decision = self.stack[-1].decision
        assert decision is not None
        return decision


def descend(stack: Stack, seen: Seen, choose: Chooser) -> tuple[Stack, int]:
    """Let the top call and its callees choose; return the stack down to a primitive, and the primitive.

    Raises:
        StepContractError: a task has no legal choice, calls a child that is illegal or over, or recurses without end.
    """
    while True:
        frame = stack[-1]
        task = frame.task
        legal = task.legal(seen, frame.context)
        if not legal.any():
            raise StepContractError(f"task {task.name!r} runs without a legal choice")
        view = task.view(seen, stack)
        choice = int(choose(stack, view, legal, seen))
        if not legal[choice]:
            raise StepContractError(f"task {task.name!r} chose {choice}, which is illegal for it here")
        call = task.decode(choice, seen, frame.context)
        stack = (*stack[:-1], frame._replace(decision=Decision(view, legal, choice)))
        if isinstance(call.child, (int, np.integer)):
            if not seen.mask[call.child]:
                raise StepContractError(f"task {task.name!r} calls primitive {call.child}, which is illegal here")
            return stack, int(call.child)
        called = Frame(call.child, call.context, seen)
        if call.child.ends(called, seen) >= 1.0:
            raise StepContractError(
                f"task {task.name!r} calls {call.child.name!r} where that is over already; `legal` must exclude it"
            )
        stack = (*stack, called)
        if len(stack) > Hierarchy.MOST_DEPTH:
            raise StepContractError(f"more than {Hierarchy.MOST_DEPTH} calls run at once: {task.name!r} calls for ever")


def arrive(stack: Stack, step: Step, get_gamma: Callable[[BaseTask], float], draw: Callable[[float], bool],
           polled: bool = False, paid: bool = True) -> tuple[Stack, list[Return]]:
    """Pay every running call for a primitive, and end those that are over.

    A call that ends also ends all calls below it. The last call of the remaining stack chooses next; the stack is
    empty where the root is over.

    Args:
        stack: from `descend`.
        step: outcome of the primitive.
        get_gamma: the discount of a task, per step of the environment.
        draw: samples a termination of this probability, above 0 and below 1.
        polled: end every call but the root, and choose each again at every primitive.
        paid: compute rewards; otherwise they stay 0, as in evaluation.

    Returns:
        The remaining stack, and the decisions that are complete, the innermost first.
    """
    seen = step.next_seen
    stack = tuple(_pay(frame, step, get_gamma(frame.task), paid) for frame in stack)
    ended = [_is_ended(frame, seen, draw) for frame in stack]
    episode_over = step.terminated or step.truncated
    if episode_over:
        keep = 0
    else:
        keep = ended.index(True) if True in ended else len(stack)
        keep = min(keep, 1) if polled else keep
    while not episode_over and keep > 0 and not stack[keep - 1].task.legal(seen, stack[keep - 1].context).any():
        keep -= 1
    returns = []
    for index in range(len(stack) - 1, max(keep - 2, -1), -1):
        child_cut = index + 1 < len(stack) and not ended[index + 1] and bool(
            stack[index + 1].task.legal(seen, stack[index + 1].context).any())
        returns.append(Return(stack[: index + 1], seen, ended[index], index >= keep, child_cut, step.terminated,
                              step.truncated))  # fmt: skip
    return stack[:keep], returns


def _pay(frame: Frame, step: Step, gamma: float, paid: bool) -> Frame:
    decision = frame.decision
    assert decision is not None
    pay = frame.task.pay(step._replace(arrival=gamma ** (step.duration - 1)), frame) if paid else 0.0
    several = paid and step.duration > 1
    summed = frame.task.pay(step._replace(reward=step.summed), frame) if several else pay
    decision = decision._replace(reward=decision.reward + decision.discount * pay, summed=decision.summed + summed,
                                 duration=decision.duration + step.duration,
                                 discount=decision.discount * gamma**step.duration)
    return frame._replace(primitives=frame.primitives + step.duration, reward=frame.reward + summed, decision=decision)


def _is_ended(frame: Frame, seen: Seen, draw: Callable[[float], bool]) -> bool:
    probability = frame.task.ends(frame, seen)
    return probability >= 1.0 or (probability > 0.0 and draw(probability))


def save_stack(stack: Stack) -> list[StateTree]:
    """Return running calls as a state tree."""
    return [
        {
            "task": frame.task.name,
            "context": frame.context,
            "start": [frame.start.observation, frame.start.mask],
            "primitives": frame.primitives,
            "reward": frame.reward,
            "decision": None if frame.decision is None else list(frame.decision),
        }
        for frame in stack
    ]


def load_stack(state: list[StateTree], hierarchy: Hierarchy) -> Stack:
    """Return running calls from the result of `save_stack`."""
    starts = [hierarchy.see(each["start"][0], np.asarray(each["start"][1], np.bool_)) for each in state]
    tasks = hierarchy.tasks
    return tuple(
        Frame(tasks[each["task"]], each["context"], start, int(each["primitives"]), float(each["reward"]),
              None if each["decision"] is None else Decision(*each["decision"]))
        for each, start in zip(state, starts, strict=True)
    )
