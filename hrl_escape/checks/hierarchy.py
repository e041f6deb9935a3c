"""Check of hierarchies: time and reward add up, ends unwind from the innermost call, evaluation has no side effects.

The hierarchy runs in an environment with recorders in place of its learners. A recorder takes random legal choices and
records its transitions, and requirements are checked on these records.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition, make_transition, read_action_mask, set_option_discount
from hrl_escape.agents.hierarchy.runner import CallRunner, StackAgent, StackSettings
from hrl_escape.agents.hierarchy.task import BaseTask, Call, Frame, Hierarchy, Seen, Stack, Step
from hrl_escape.checks.claims import Claims, dump_state
from hrl_escape.errors import ContractError, StepContractError

GAMMA = 0.9


def check_hierarchy(hierarchy: Hierarchy, env: gymnasium.Env, primitives: int = 1_000, seed: int = 0,
                    agent_class: type[StackAgent] = StackAgent) -> None:
    """Check a hierarchy by running it in an environment.

    The root task must earn the environment's reward. Episodes are truncated at random lengths, which truncates calls at
    every depth.

    Args:
        hierarchy: to check; its learners are replaced.
        env: where it runs.
        primitives: length of the run.
        seed: of choices and episodes.
        agent_class: agent that runs it.

    Raises:
        ContractError: a requirement is violated.
    """
    _HierarchyCheck(hierarchy, env, primitives, seed, agent_class).run()


class _Note(NamedTuple):
    """Record of one decision.

    `begun` and `order` are time and number of the choice, `clock` is the time of its return.
    """

    task: str
    transition: SMDPTransition
    begun: int
    order: int
    clock: int


class _Book:
    """Time of the environment and all records, shared by recorders and observed tasks."""

    def __init__(self) -> None:
        self.clock = self.choices = 0
        self.notes: list[_Note] = []
        self.pays: dict[tuple[str, int], float] = {}
        """(task, clock before the primitive) -> pay."""
        self.ends: dict[tuple[str, int], float] = {}
        """(task, clock) -> probability that it is over."""
        self.finals: dict[tuple[str, int], float] = {}
        """(task, clock) -> pseudo-reward that was asked for."""


class _Watched(BaseTask):
    """Task that records its results; `order` renumbers its choices."""

    def __init__(self, task: BaseTask, book: _Book, order: NDArray[np.int64]) -> None:
        super().__init__(task.name, int(task.space.n), task.view_space)
        self.task, self._book, self.order = task, book, order
        self.others: dict[str, _Watched] = {}

    def view(self, seen: Seen, stack: Stack) -> Any:
        return self.task.view(seen, stack)

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        return self.task.legal(seen, context)[self.order]

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        call = self.task.decode(int(self.order[choice]), seen, context)
        return call if isinstance(call.child, int) else call._replace(child=self.others[call.child.name])

    def ends(self, frame: Frame, seen: Seen) -> float:
        answer = self.task.ends(frame, seen)
        key = self.name, self._book.clock
        self._book.ends[key] = max(answer, self._book.ends.get(key, 0.0))  # a new call may begin at the same moment
        return answer

    def pay(self, step: Step, frame: Frame) -> float:
        pay = self.task.pay(step, frame)
        self._book.pays.setdefault((self.name, self._book.clock - step.duration), pay)
        return pay

    def final(self, frame: Frame, seen: Seen) -> float:
        reward = self.task.final(frame, seen)
        self._book.finals[self.name, self._book.clock] = reward
        return reward

    def decide(self, seen: Seen, context: Any, rng: np.random.Generator) -> int:
        return int(np.argsort(self.order)[self.task.decide(seen, context, rng)])


class _Recorder(Agent):
    """Learner that records transitions and chooses at random, independently of the numbering of choices."""

    Settings = StackSettings

    def __init__(self, name: str, seed: int, order: NDArray[np.int64], book: _Book) -> None:
        self._task, self.settings = name, StackSettings(gamma=GAMMA)
        self.order, self._book = order, book
        self._rng = np.random.default_rng([seed, *name.encode()])
        self._open: list[tuple[int, int]] = []

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        self._open.append((self._book.clock, self._book.choices))
        self._book.choices += 1
        return self._draw(action_mask, self._rng)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        return self._draw(action_mask, rng)

    def _draw(self, mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        """Return a random legal choice, drawn by its number before renumbering."""
        legal = sorted(int(self.order[choice]) for choice in mask.nonzero()[0])
        drawn = legal[rng.integers(len(legal))]
        return int(np.argsort(self.order)[drawn])

    def observe(self, transition: SMDPTransition) -> dict[str, float]:
        begun, order = self._open.pop()
        self._book.notes.append(_Note(self._task, transition, begun, order, self._book.clock))
        return {}

    def state_dict(self) -> dict[str, Any]:
        return {"rng": self._rng.bit_generator.state, "told": len(self._book.notes)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self._rng.bit_generator.state = state["rng"]


class _Chain(BaseTask):
    """Task whose only choice is a call of another task."""

    def __init__(self, below: BaseTask) -> None:
        super().__init__(f"{below.name} (called by a chain)", 1, below.view_space)
        self._below = below

    def legal(self, seen: Seen, context: Any) -> NDArray[np.bool_]:
        return np.ones(1, np.bool_)

    def decode(self, choice: int, seen: Seen, context: Any) -> Call:
        return Call(self._below)


class _Played(NamedTuple):
    """Records of one run."""

    book: _Book
    primitives: list[int]
    returns: list[tuple[int, int, float]]
    """Episodes: clock at their beginning and end, and the environment's discounted return."""
    ends: dict[int, tuple[bool, bool]]
    """Clock -> whether the episode terminated there, was truncated there."""


class _HierarchyCheck(Claims):
    """Requirements of a hierarchy, checked on a run."""

    def __init__(self, hierarchy: Hierarchy, env: gymnasium.Env, primitives: int, seed: int,
                 agent_class: type[StackAgent]) -> None:
        super().__init__(f"hierarchy {hierarchy.root.name!r}")
        self._hierarchy, self._env, self._budget, self._seed = hierarchy, env, primitives, seed
        self._agent_class = agent_class

    def run(self) -> None:
        played = self._play()
        self._check_time(played)
        self._check_rewards(played)
        self._check_ends(played)
        self._check_legal(played)
        self._check_replays(played)

    # --- running ----------------------------------------------------------------------

    def _make(self, book: _Book, reverse: bool = False, chain: bool = False) -> StackAgent:
        """Make an agent of observed tasks and recorders; `reverse` reverses choices, `chain` adds callers."""
        watched: dict[str, _Watched] = {}
        for name, task in self._hierarchy.tasks.items():
            order = np.arange(int(task.space.n))
            watched[name] = _Watched(task, book, order[::-1].copy() if reverse else order)
        for each in watched.values():
            each.others = watched
        root, *below = watched.values()
        learners = {name: self._make_recorder(name, each, book) for name, each in watched.items()}
        top: BaseTask = root
        if chain:
            top, below = _Chain(root), [root, *below]
        hierarchy = dataclasses.replace(self._hierarchy, root=top, below=tuple(below), learners=learners, share={})
        return self._agent_class(hierarchy, self._env.observation_space, self._seed, StackSettings(gamma=GAMMA))

    def _make_recorder(self, name: str, task: _Watched, book: _Book) -> Any:
        def make(space: gymnasium.Space, choices: gymnasium.spaces.Discrete, seed: int) -> Agent:
            return _Recorder(name, self._seed, task.order, book)

        return make

    def _play(self, reverse: bool = False, chain: bool = False) -> _Played:
        book, env = _Book(), self._env
        set_option_discount(env, GAMMA)
        agent = self._make(book, reverse, chain)
        lengths, greedy = np.random.default_rng(self._seed), np.random.default_rng(self._seed)
        played = _Played(book, [], [], {})
        actions, episode = int(env.action_space.n), 0  # pyright: ignore[reportAttributeAccessIssue]
        while book.clock < self._budget:
            observation, info = env.reset(seed=self._seed + episode)
            mask = read_action_mask(info, actions)
            cut, begun, gained, is_over = book.clock + int(lengths.integers(1, 200)), book.clock, 0.0, False
            while not is_over:
                try:
                    action = agent.act(observation, mask)
                except StepContractError as error:
                    raise ContractError(self.name, "every call has a legal choice to make", str(error)) from error
                if not chain and not reverse:
                    self._check_calls(agent)
                    self._check_greedy(agent, observation, mask, greedy)
                played.primitives.append(action)
                transition = make_transition(observation, action, mask, env.step(action), GAMMA)
                gained += GAMMA ** (book.clock - begun) * transition.reward
                book.clock += transition.duration
                if book.clock >= cut and not transition.terminated:
                    transition = transition._replace(truncated=True)
                agent.observe(transition)
                observation, mask = transition.next_observation, transition.next_action_mask
                is_over = transition.terminated or transition.truncated
                played.ends[book.clock] = transition.terminated, transition.truncated
            played.returns.append((begun, book.clock, gained))
            episode += 1
        return played

    # --- claims -----------------------------------------------------------------------

    def _check_calls(self, agent: CallRunner) -> None:
        """Invariant 9: no legal choice calls a task that is over."""
        seen = agent.moment
        assert seen is not None
        for frame in agent.stack:
            for choice in frame.task.legal(seen, frame.context).nonzero()[0]:
                call = frame.task.decode(int(choice), seen, frame.context)
                if not isinstance(call.child, int):
                    called = getattr(call.child, "task", call.child)
                    over = called.ends(Frame(called, call.context, seen), seen)
                    self.require(over < 1.0, "a task that would be over at once is not among the legal choices",
                                 (frame.task.name, called.name))

    def _check_greedy(self, agent: CallRunner, observation: Any, mask: NDArray[np.bool_], rng: np.random.Generator
                      ) -> None:
        """Invariant 6: evaluation during learning has no side effects."""
        before = dump_state(agent)
        agent.act_greedy(observation, mask, rng)
        self.require(dump_state(agent) == before, "evaluation changes nothing in the agent", "state_dict changed")

    def _check_time(self, played: _Played) -> None:
        """Invariant 1: k is the time since the choice, gamma^k its discount; calls add up to their caller's time."""
        for note in played.book.notes:
            told = note.transition
            self.require(told.duration == note.clock - note.begun, "a decision lasts as long as its primitives",
                         (note.task, told.duration, note.clock - note.begun))
            self.require(math.isclose(told.discount, GAMMA**told.duration), "a decision's discount is gamma^k",
                         (note.task, told.discount, told.duration))

    def _check_rewards(self, played: _Played) -> None:
        """Invariants 2 and 5: the root earns the environment's reward; others their pay, and `final` at the end."""
        book, root = played.book, self._hierarchy.root.name
        for note in book.notes:
            paid = sum(GAMMA ** (clock - note.begun) * book.pays[note.task, clock]
                       for clock in range(note.begun, note.clock) if (note.task, clock) in book.pays)
            final = book.finals.get((note.task, note.clock), 0.0) if note.transition.terminated else 0.0
            expected = paid + note.transition.discount * final
            self.require(math.isclose(note.transition.reward, expected, abs_tol=1e-9),
                         "a decision's reward is the discounted sum of its task's pay, and `final` where it ended",
                         (note.task, note.transition.reward, expected))
        for begun, end, gained in played.returns:
            earned = sum(GAMMA ** (note.begun - begun) * note.transition.reward for note in book.notes
                         if note.task == root and begun < note.clock <= end)
            earned -= sum(GAMMA ** (clock - begun) * reward for (task, clock), reward in book.finals.items()
                          if task == root and begun < clock <= end)
            self.require(math.isclose(earned, gained, abs_tol=1e-6), "the root's return is the environment's",
                         (earned, gained))

    def _check_ends(self, played: _Played) -> None:
        """Invariants 4 and 5: inner calls return first; truncation bootstraps; only ended calls get their `final`."""
        book = played.book
        for earlier, later in zip(book.notes, book.notes[1:], strict=False):
            if earlier.clock == later.clock:
                self.require(earlier.order > later.order, "ends unwind from the innermost call", (earlier, later))
        for note in book.notes:
            terminated, truncated = played.ends[note.clock]
            has_ended = (note.task, note.clock) in book.finals
            self.require(not has_ended or book.ends[note.task, note.clock] > 0.0,
                         "`final` is asked only of a task that ended by itself", note)
            if truncated and not has_ended:
                self.require(not note.transition.terminated, "a truncated call does not receive termination", note)
                self.require(note.transition.truncated, "a truncated call receives truncation", note)
            if terminated:
                self.require(note.transition.terminated, "a terminated episode terminates every call", note)

    def _check_legal(self, played: _Played) -> None:
        """Invariant 7: learners receive only legal choices."""
        for note in played.book.notes:
            told = note.transition
            self.require(bool(told.action_mask[told.action]), "a learner hears of legal choices only", note)
            self.require(bool(told.next_action_mask.any()), "a next mask has a legal choice", note)

    def _check_replays(self, played: _Played) -> None:
        """Invariants 3 and 8: chains of one-child tasks and renumbered choices change nothing else."""
        for words, reverse in (("renumbering choices changes nothing else", True),
                               ("calling the hierarchy through a chain of one-child tasks changes nothing", False)):
            again = self._play(reverse=reverse, chain=not reverse)
            self.require(again.primitives == played.primitives, words, "the primitives differ")
            notes = [each for each in again.book.notes if each.task in self._hierarchy.tasks]
            for ours, theirs in zip(played.book.notes, notes, strict=True):
                same = (ours.task == theirs.task and ours.transition.reward == theirs.transition.reward
                        and ours.transition.duration == theirs.transition.duration)
                self.require(same, words, (ours, theirs))
