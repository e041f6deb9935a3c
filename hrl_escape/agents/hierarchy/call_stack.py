"""The stack of running calls: how choices go down to a primitive, how its outcome comes back up.

Pure functions of stacks; whoever chooses and learns passes its own functions and keeps the result.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.hierarchy.task import BaseTask, Decision, Frame, Hierarchy, Seen, Stack, Step
from hrl_escape.agents.state import StateTree
from hrl_escape.errors import StepContractError

Chooser = Callable[[Stack, Any, NDArray[np.bool_], Seen], int]
"""Chooses for the last frame of a stack: (stack, view, legal choices, moment) -> choice."""


class Return(NamedTuple):
    """One decision of one running call that is complete, or was cut."""

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
        """The call did not end by itself, but has nothing left to choose, so that nothing follows in its own view."""
        return not (self.ended or self.terminated) and not self.frame.task.legal(self.seen, self.frame.context).any()

    @property
    def decision(self) -> Decision:
        """The decision, paid up to the moment reached."""
        decision = self.stack[-1].decision
        assert decision is not None
        return decision


def descend(stack: Stack, seen: Seen, choose: Chooser) -> tuple[Stack, int]:
    """Let the top call choose, and every call it makes, down to a primitive.

    Returns:
        The stack with the new calls and decisions, and the primitive.

    Raises:
        StepContractError: a task has nothing to choose, calls what is illegal or over already, or calls for ever.
    """
    while True:
        frame = stack[-1]
        task = frame.task
        legal = task.legal(seen, frame.context)
        if not legal.any():
            raise StepContractError(f"task {task.name!r} runs where it has nothing to choose")
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
                f"task {task.name!r} calls {call.child.name!r} where that is over already; `legal` must leave it out"
            )
        stack = (*stack, called)
        if len(stack) > Hierarchy.MOST_DEPTH:
            raise StepContractError(f"more than {Hierarchy.MOST_DEPTH} calls run at once: {task.name!r} calls for ever")


def arrive(stack: Stack, step: Step, get_gamma: Callable[[BaseTask], float], draw: Callable[[float], bool],
           polled: bool = False, paid: bool = True) -> tuple[Stack, list[Return]]:
    """Pay every running call for a primitive, and end those that are over.

    A call that ends takes all calls below it along. What is left is a stack whose last call must choose next; it is
    empty where the root is over.

    Args:
        stack: from `descend`.
        step: what the world did.
        get_gamma: the discount of a task, per step of the environment.
        draw: whether a termination of this probability, above 0 and below 1, happens.
        polled: end every call but the root, so that each is chosen anew at every primitive.
        paid: compute pay; without it rewards stay 0, for evaluation, where none is known.

    Returns:
        The stack left, and the decisions that are complete, the innermost first.
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
    """Running calls as a state tree."""
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
    """Running calls from what `save_stack` gave."""
    starts = [hierarchy.see(each["start"][0], np.asarray(each["start"][1], np.bool_)) for each in state]
    tasks = hierarchy.tasks
    return tuple(
        Frame(tasks[each["task"]], each["context"], start, int(each["primitives"]), float(each["reward"]),
              None if each["decision"] is None else Decision(*each["decision"]))
        for each, start in zip(state, starts, strict=True)
    )

