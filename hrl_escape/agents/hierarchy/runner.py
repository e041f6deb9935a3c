"""Base of hierarchical agents: runs the calls of a hierarchy behind the interface of `Agent`.

It walks the stack and turns each primitive's outcome into returned decisions; subclasses choose and learn. Evaluation
has calls of its own, one stack per generator. `play_episode` makes a generator per episode, so a running call is
remembered within an episode only and is not part of the agent's state.

`StackAgent` has an ordinary `Agent` for each task. It receives the views and choices of its task, and
learns from SMDP transitions with its task's rewards.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, AgentSettings, OptionPolicy, RunningCall, SMDPTransition
from hrl_escape.agents.components.exploration import choose_best, compute_epsilon, make_rng, sample_action
from hrl_escape.agents.decisions import Decisions, Moments
from hrl_escape.agents.hierarchy.task import (
    BaseTask,
    Frame,
    Hierarchy,
    Return,
    Seen,
    Stack,
    Step,
    arrive,
    descend,
    load_stack,
    save_stack,
)
from hrl_escape.agents.single_env import MANY, SwitchingAgent, serve_many, serve_one
from hrl_escape.agents.state import Kept, StateTree
from hrl_escape.errors import AgentSettingsError, DiscountMismatchError, StepContractError, UnsupportedError
from hrl_escape.settings import Range

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True, kw_only=True)
class StackSettings(AgentSettings):
    """Settings of the execution of calls."""

    gamma: Annotated[float, Range(0, 1)] = 0.99
    """Discount per primitive: a reward k primitives later counts gamma^k. Higher values look further ahead."""
    polled: Literal["never", "evaluation", "always"] = "never"
    """Choose every running call again at each primitive, instead of running it to its end: never, in evaluation
    only (hierarchical greedy execution), or always."""


class CallRunner(SwitchingAgent):
    """Runs the calls of a hierarchy on a flat environment.

    Attributes:
        stack: the running calls, the root first, as shown by `watch`.
    """

    EPISODE = ("_stack", "_chosen")
    EPISODE_STATE = ("stack", "choice")
    STATE = (Kept("_rng", "calls_rng"), Kept("_running", "stack"), Kept("_kept_choice", "choice", is_left_out=True))
    _stack: Stack
    """Running calls at the next choice; the last one chooses."""
    _chosen: tuple[Stack, Seen, int] | None
    """After `act`: the stack down to the primitive, and the moment. The next `act` chooses again."""

    def __init__(self, hierarchy: Hierarchy, seed: int, settings: AgentSettings) -> None:
        self.hierarchy, self.privileges = hierarchy, hierarchy.privileges
        self.settings: Any = settings
        self._rng = make_rng(seed, "calls")
        self.begin_episode()
        self._latest: tuple[Stack, Seen] | None = None
        """Stack of the latest choice, in learning or evaluation."""

    def begin_episode(self) -> None:
        """End all running calls."""
        self._stack, self._chosen = (), None

    @property
    def stack(self) -> Stack:
        """Running calls, down to the call that chose the primitive."""
        return self._stack if self._chosen is None else self._chosen[0]

    @property
    def moment(self) -> Seen | None:
        """The moment of the choice of the primitive, or None before `act`."""
        return None if self._chosen is None else self._chosen[1]

    # --- methods of subclasses --------------------------------------------------------

    @abstractmethod
    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Choose for the last call, exploring."""

    @abstractmethod
    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Choose for the last call in evaluation, without any change of the agent."""

    @abstractmethod
    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Learn from one primitive and the decisions that it completed, the innermost first."""

    def get_gamma(self, task: BaseTask) -> float:
        """Discount of a task's sums over decisions."""
        return self.gamma

    # --- the agent --------------------------------------------------------------------

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        """Let the running calls choose down to a primitive."""
        seen = self.hierarchy.see(observation, action_mask)
        stack, action = descend(self._stack or self._begin(seen), seen, self.choose)
        self._chosen, self._latest = (stack, seen, action), (stack, seen)
        return action

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Let the calls of this evaluation, which belong to `rng`, choose down to a primitive."""
        seen = self.hierarchy.see(observation, action_mask)
        stack: Stack = ()
        known = self.recall(rng)  # running calls, and what the latest decision is held to have done before it is noted
        if known is not None and self.settings.polled == "never":
            running, step = known
            stack, returns = arrive(running, step._replace(next_seen=seen), self.get_gamma,
                                    lambda p: rng.random() < p, paid=False)
            self.note_returns(returns, rng)

        def choose(running: Stack, view: Any, legal: NDArray[np.bool_], moment: Seen) -> int:
            return self.choose_greedy(running, view, legal, moment, rng)

        stack, action = descend(stack or self._begin(seen), seen, choose)
        self._evaluation = rng, stack, Step(seen, action, 0.0, 0.0, 1, seen, False, False)
        self._latest = stack, seen
        return action

    def note_outcome(self, transition: SMDPTransition, rng: np.random.Generator) -> None:
        """Record the duration of a decision of evaluation, for calls with a limit of primitives."""
        if (known := self.recall(rng)) is not None:
            stack, step = known
            is_over = transition.terminated or transition.truncated
            self._evaluation = None if is_over else (rng, stack, step._replace(duration=transition.duration))

    def note_returns(self, returns: list[Return], rng: np.random.Generator) -> None:  # noqa: B027
        """Receive the returned decisions in evaluation, without rewards."""

    def list_calls(self) -> tuple[RunningCall, ...]:
        """Return the calls behind the latest choice, the root first."""
        stack, seen = self._latest or ((), None)
        return tuple(
            RunningCall(frame.task.name, frame.context, frame.primitives, frame.task.ends(frame, seen),
                        frame.task.find_place(frame.context))
            for frame in stack if seen is not None
        )

    def get_options(self) -> tuple[OptionPolicy, ...]:
        """Return every call of a task below the root, run to its end; without tasks below, the whole policy."""
        calls = [(name, task, context) for task in self.hierarchy.below for name, context in task.list_calls().items()]
        return tuple(self._export(*call) for call in calls) or super().get_options()

    def _export(self, name: str, task: BaseTask, context: Any) -> OptionPolicy:
        def can_start(observation: Any, action_mask: NDArray[np.bool_]) -> bool:
            return task.is_callable(self.hierarchy.see(observation, action_mask), context)

        return OptionPolicy(name, self, lambda: _CallRun(self, task, context), can_start)

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        """Reward the running calls, end calls that are over, and learn; refuse a primitive that they did not choose."""
        if self._chosen is None or self._chosen[2] != transition.action:
            raise StepContractError(
                f"action {transition.action} was not chosen by the calls that run; a hierarchical agent learns from "
                "its own decisions, each observed right after it was acted"
            )
        stack, seen, action = self._chosen
        after = self.hierarchy.see(transition.next_observation, transition.next_action_mask)
        step = Step(seen, action, transition.reward, transition.summed_reward, transition.duration, after,
                    transition.terminated, transition.truncated, cut=transition.cut)  # fmt: skip
        self._stack, returns = arrive(stack, step, self.get_gamma, lambda p: self._rng.random() < p,
                                      polled=self.settings.polled == "always")  # fmt: skip
        self._chosen = None
        return self.learn(step, returns)

    def _begin(self, seen: Seen) -> Stack:
        return (Frame(self.hierarchy.root, None, seen),)

    @property
    def _running(self) -> list[StateTree]:
        return save_stack(self._stack)

    @_running.setter
    def _running(self, saved: list[StateTree]) -> None:
        self._stack = load_stack(saved, self.hierarchy)
        self._chosen = None

    @property
    def _kept_choice(self) -> list[Any] | None:
        """Open choice in many environments; a single environment is saved between decisions."""
        if self._chosen is None or self._env is None:
            return None
        stack, seen, action = self._chosen
        return [save_stack(stack), seen.observation, seen.mask, action]

    @_kept_choice.setter
    def _kept_choice(self, saved: list[Any]) -> None:
        stack, observation, mask, action = saved
        self._chosen = (load_stack(stack, self.hierarchy),
                        self.hierarchy.see(observation, np.asarray(mask, np.bool_)), int(action))


class TabularRunner(CallRunner):
    """Base of runners with tables of values, and exploration by `TabularSettings`."""

    STATE = ("_steps", "_action_rng")

    def __init__(self, hierarchy: Hierarchy, seed: int, settings: AgentSettings) -> None:
        super().__init__(hierarchy, seed, settings)
        self._action_rng, self._steps = make_rng(seed, "actions"), 0

    @abstractmethod
    def weigh(self, stack: Stack, view: Any, seen: Seen) -> NDArray[np.float64] | None:
        """Return the values of the last call's choices, (choices,), or None with a given policy."""

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Explore by the call's values."""
        values = self.weigh(stack, view, seen)
        if values is None:
            return int(legal.argmax())
        return sample_action(values, legal, self.settings, self._steps, self._action_rng)

    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Choose the best choice of the call, uniformly among equals."""
        values = self.weigh(stack, view, seen)
        return int(legal.argmax()) if values is None else choose_best(values, legal, rng)

    def finish_step(self, step: Step, error: float) -> dict[str, float]:
        """Advance the clock of exploration; returns numbers to log."""
        self._steps += step.duration
        return {"td_error": error, "epsilon": compute_epsilon(self.settings, self._steps)}


class _CallRun:
    """A single call, as the root's only choice, run by the agent's greedy policy."""

    def __init__(self, runner: CallRunner, task: BaseTask, context: Any) -> None:
        self._runner, self._task, self._context = runner, task, context
        self._running: tuple[Stack, Seen, int] | None = None
        """The stack down to the latest primitive, the moment, and the primitive."""

    def act(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        runner = self._runner
        seen = runner.hierarchy.see(observation, action_mask)
        if self._running is None:
            stack: Stack = (Frame(runner.hierarchy.root, None, seen), Frame(self._task, self._context, seen))
        else:
            before, moment, action = self._running
            inner: Stack = ()
            if runner.settings.polled == "never" and len(before) > 2:
                step = Step(moment, action, 0.0, 0.0, 1, seen, False, False)
                inner, _ = arrive(before[2:], step, runner.get_gamma, lambda p: rng.random() < p, paid=False)
            stack = (*(frame._replace(primitives=frame.primitives + 1) for frame in before[:2]), *inner)

        def choose(running: Stack, view: Any, legal: NDArray[np.bool_], at: Seen) -> int:
            return runner.choose_greedy(running, view, legal, at, rng)

        stack, action = descend(stack, seen, choose)
        self._running = stack, seen, action
        return action

    def compute_termination(self, observation: Any, action_mask: NDArray[np.bool_]) -> float:
        seen = self._runner.hierarchy.see(observation, action_mask)
        assert self._running is not None
        called = self._running[0][1]
        if not self._task.legal(seen, self._context).any():
            return 1.0
        return self._task.ends(called._replace(primitives=called.primitives + 1), seen)


class StackAgent(CallRunner):
    """An agent at each task, which learns from its task's decisions.

    After a decision (s, c) of task i that lasted k primitives, the agent of i receives s, c, s', gamma^k and

        R = sum over t < k of gamma^t pay_i(t)    [+ gamma^k final_i(s') if i ended by itself]

    "terminated" is set if i ended by itself, had nothing left to choose, or the episode terminated. "truncated" is set
    if a caller or the time limit ended i, and the agent then bootstraps at the cut in its own view.

    Args:
        observation_space: the environment's, for tasks without a view space of their own.

    Attributes:
        learners: task name -> its agent; tasks that share an agent map to the same object.
    """

    Settings: ClassVar[type] = StackSettings
    STATE = (Kept("_owned", "learners"),)

    def __init__(self, hierarchy: Hierarchy, observation_space: gymnasium.Space, seed: int,
                 settings: StackSettings | None = None) -> None:
        super().__init__(hierarchy, seed, settings or StackSettings())
        self.made_for = None  # the second argument is not an action space
        tasks = hierarchy.tasks
        self._owned: dict[str, Agent] = {}
        for name, make in hierarchy.learners.items():
            # By name, not by place: renumbering tasks changes no learner's randomness.
            child_seed = int(np.random.SeedSequence([seed, *name.encode()]).generate_state(1)[0])
            self._owned[name] = make(tasks[name].view_space or observation_space, tasks[name].space, child_seed)
        self.learners = self._owned | {name: self._owned[owner] for name, owner in hierarchy.share.items()}

    def get_gamma(self, task: BaseTask) -> float:
        """Return the discount of the task's agent, or the agent's own without one."""
        learner = self.learners.get(task.name)
        return self.gamma if learner is None else learner.gamma

    def begin_episodes(self, num_envs: int, device: torch.device) -> None:
        """Begin an episode in every environment; a learner has as many environments for each of its tasks.

        Raises:
            AgentSettingsError: a learner cannot learn from many environments.
        """
        super().begin_episodes(num_envs, device)
        for name, learner in self._owned.items():
            if not isinstance(learner, MANY):
                raise AgentSettingsError(f"learner of task {name}", type(learner).__name__,
                                         "one that learns from many environments at once")
            serve_many(learner).begin_episodes(num_envs * len(self._list_tasks(learner)), device)

    def _list_tasks(self, learner: Agent) -> list[str]:
        return [name for name, each in self.learners.items() if each is learner]

    def _find_env(self, stack: Stack, learner: Agent) -> torch.Tensor:
        """Number of the environment for the agent of a running call, int64 (1,).

        Raises:
            UnsupportedError: two calls of one task run at once.
        """
        import torch

        tasks, task = self._list_tasks(learner), stack[-1].task.name
        if sum(frame.task.name == task for frame in stack) > 1:
            raise UnsupportedError(f"task {task!r} calls itself: give train an ordinary environment, not many at once")
        assert self._env is not None
        return torch.tensor([self._env * len(tasks) + tasks.index(task)])

    def choose(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen) -> int:
        """Return the exploring choice of the task's agent, or the task's own."""
        task, context = stack[-1].task, stack[-1].context
        learner = self.learners.get(task.name)
        if learner is None:
            return task.decide(seen, context, self._rng)
        if self._env is None:
            return serve_one(learner).act(view, legal)
        return int(serve_many(learner).act(Moments(self._find_env(stack, learner), _make_row(view),
                                                   _make_row(legal))))

    def choose_greedy(self, stack: Stack, view: Any, legal: NDArray[np.bool_], seen: Seen, rng: np.random.Generator
                      ) -> int:
        """Return the greedy choice of the task's agent, or the task's own."""
        task, context = stack[-1].task, stack[-1].context
        learner = self.learners.get(task.name)
        return task.decide(seen, context, rng) if learner is None else learner.act_greedy(view, legal, rng)

    def learn(self, step: Step, returns: list[Return]) -> Mapping[str, float]:
        """Pass every returned decision to its task's agent, unless it was summed at another discount."""
        metrics: dict[str, float] = {}
        for returned in returns:
            task = returned.frame.task
            learner = self.learners.get(task.name)
            if learner is None:
                continue
            if step.duration > 1 and learner.gamma != self.gamma:
                raise DiscountMismatchError(learner.gamma, self.gamma**step.duration, step.duration)
            told = self._teach(learner, returned)
            metrics |= {f"{task.name}/{name}": value for name, value in told.items()}
        return metrics

    def _teach(self, learner: Agent, returned: Return) -> Mapping[str, float]:
        one = make_task_transition(returned)
        if self._env is None:
            return serve_one(learner).observe(one)
        reward, summed, discount = map(np.float32, (one.reward, one.summed_reward, one.discount))
        rows = (one.observation, one.action_mask, one.action, reward, summed, one.duration, discount,
                one.next_observation, one.next_action_mask, one.terminated, one.truncated)
        fields: Any = map(_make_row, rows)
        return serve_many(learner).observe(Decisions(self._find_env(returned.stack, learner), *fields))

    def note_returns(self, returns: list[Return], rng: np.random.Generator) -> None:
        """Pass the returned decisions to the agents that made them."""
        for returned in returns:
            if (learner := self.learners.get(returned.frame.task.name)) is not None:
                learner.note_outcome(make_task_transition(returned), rng)


def _make_row(value: Any) -> torch.Tensor:
    import torch

    return torch.from_numpy(np.asarray(value)[None].copy())


def make_task_transition(returned: Return) -> SMDPTransition:
    """Return the SMDP transition of a running call's decision, as input of its task's agent."""
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
