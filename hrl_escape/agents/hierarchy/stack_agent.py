"""Any agents at the tasks of any hierarchy: an agent of the flat environment that is made of agents.

Each task's learner is an ordinary `Agent`. It sees its task's views and choices, and learns from SMDP
transitions whose reward is its task's pay, over as many levels as the hierarchy has.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition
from hrl_escape.agents.hierarchy.call_stack import Return
from hrl_escape.agents.hierarchy.runner import CallRunner, StackSettings
from hrl_escape.agents.hierarchy.task import BaseTask, Hierarchy, Seen, Stack, Step
from hrl_escape.agents.state import Kept
from hrl_escape.errors import DiscountMismatchError


class StackAgent(CallRunner):
    """An agent at each task, told of its task's decisions.

    Of a decision (s, c) of task i that lasted k primitives, the learner of i is told s, c, s', gamma^k and

        R = sum over t < k of gamma^t pay_i(t)    [+ gamma^k final_i(s') if i ended by itself]

    It is told "terminated" where i ended by itself, where i had nothing left to choose, and where the episode
    terminated; "truncated" where a caller or the time limit took i along, so that it bootstraps at the cut in its
    own view.

    Args:
        hierarchy: tasks, and who learns at each.
        observation_space: the environment's, for tasks that name no view space of their own.
        seed: fixes everything, the learners' seeds included.
        settings: discount of the root, polling.

    Attributes:
        learners: task name -> its learner; tasks that share one map to the same object.
    """

    Settings: ClassVar[type] = StackSettings
    STATE = (Kept("_owned", "learners"),)

    def __init__(
        self,
        hierarchy: Hierarchy,
        observation_space: gymnasium.Space,
        seed: int,
        settings: StackSettings | None = None,
    ) -> None:
        super().__init__(hierarchy, seed, settings or StackSettings())
        tasks = hierarchy.tasks
        self._owned: dict[str, Agent] = {}
        for name, make in hierarchy.learners.items():
            # By name, not by place: renumbering tasks changes no learner's randomness.
            child_seed = int(np.random.SeedSequence([seed, *name.encode()]).generate_state(1)[0])
            self._owned[name] = make(tasks[name].view_space or observation_space, tasks[name].space, child_seed)
        self.learners = self._owned | {name: self._owned[owner] for name, owner in hierarchy.share.items()}

    def get_gamma(self, task: BaseTask) -> float:
        """The discount of the task's learner; the agent's own where nobody learns."""
        learner = self.learners.get(task.name)
        return self.gamma if learner is None else learner.gamma

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """The learner's exploring choice, or the task's own."""
        task, context = stack[-1].task, stack[-1].context
        learner = self.learners.get(task.name)
        return task.decide(seen, context, self._rng) if learner is None else learner.act(view, legal)

    def choose_greedy(
        self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
    ) -> int:
        """The learner's greedy choice, or the task's own."""
        task, context = stack[-1].task, stack[-1].context
        learner = self.learners.get(task.name)
        return task.decide(seen, context, rng) if learner is None else learner.act_greedy(view, legal, rng)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Hand every returned decision to its task's learner.

        Raises:
            DiscountMismatchError: a primitive lasted several steps, summed at a discount that is not the learner's.
        """
        metrics: dict[str, float] = {}
        for returned in returns:
            task = returned.frame.task
            learner = self.learners.get(task.name)
            if learner is None:
                continue
            if step.duration > 1 and learner.gamma != self.gamma:
                raise DiscountMismatchError(learner.gamma, self.gamma**step.duration, step.duration)
            told = learner.observe(make_task_transition(returned))
            metrics |= {f"{task.name}/{name}": value for name, value in told.items()}
        return metrics

    def note_returns(self, returns: list[Return], rng: np.random.Generator) -> None:
        """Learners hear of the decisions that they made."""
        for returned in returns:
            if (learner := self.learners.get(returned.frame.task.name)) is not None:
                learner.note_outcome(make_task_transition(returned), rng)


def make_task_transition(returned: Return) -> SMDPTransition:
    """The SMDP transition of one decision of a running call, as the learner of its task is told it."""
    frame, decision = returned.frame, returned.decision
    task, seen = frame.task, returned.seen
    final = task.final(frame, seen) if returned.ended else 0.0
    terminated = returned.ended or returned.stuck or returned.terminated
    truncated = (returned.is_over or returned.truncated) and not terminated
    legal = task.legal(seen, frame.context)
    return SMDPTransition(
        decision.view,
        decision.choice,
        decision.legal,
        decision.reward + decision.discount * final,
        decision.summed + final,
        decision.duration,
        decision.discount,
        task.view(seen, returned.stack),
        legal if legal.any() else np.ones_like(legal),  # nothing is bootstrapped there
        terminated,
        truncated,
        cut=truncated and (returned.cut or decision.duration > 1),
    )
