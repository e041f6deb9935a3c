"""A watched driver: its last choice and plan, completed decisions, and a log of events.

`Watch` wraps an agent and its environment and records their steps without changing them. Everything runs in the
driver's thread; other threads only operate the gate and read.
"""

from __future__ import annotations

import dataclasses
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, RunningCall, SMDPTransition, make_transition, set_option_discount
from hrl_escape.agents.decisions import Moments, Policy, name_action, to_plain_action
from hrl_escape.agents.single_env import serve_one
from hrl_escape.agents.training.evaluation import compute_episode_seed, play_episode
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.episodes import PrimitiveStep
from hrl_escape.benchmark.references.search import SearchBaseline
from hrl_escape.env.instance import RoomInstance
from hrl_escape.env.kinematics import EpisodeEnd, RoomState
from hrl_escape.env.noise import check_seed
from hrl_escape.env.puzzles.graphs import find_target_edges
from hrl_escape.errors import EscapeError
from hrl_escape.options.execution import OptionExecution
from hrl_escape.options.option import Option
from hrl_escape.planning.planner import get_planner
from hrl_escape.viewer.watch.drivers import Driver

MOST = 400
"""Most primitives in a preview."""


class Preview(NamedTuple):
    """Predicted course of an option."""

    name: str  # name of the option
    states: tuple[RoomState, ...]  # all states, with the initial one
    pressed: tuple[str, ...] = ()  # names of the targets pressed on the way
    escapes: bool = False  # whether the episode would end in the exit
    problem: str = ""  # reason why the option fails, otherwise empty


class Previewer:
    """Predicts meta-actions of a room without noise, with its own options, which leaves running options undisturbed."""

    def __init__(self, instance: RoomInstance, options: Iterable[Option]) -> None:
        self._planner = get_planner(instance)
        self.options = {option.name: option for option in options}
        self._instance = instance

    def preview(self, name: str, state: RoomState) -> Preview:
        """Predict an option from a state to its end, or until it fails."""
        option, rules = self.options[name], self._planner.rules
        if self._instance.dynamics.kind == "physics":
            state = state._replace(physics=None)
        if not option.initiation(state):
            return Preview(name, (state,), problem="it cannot start here")
        states, pressed, rng = [state], [], np.random.default_rng(0)
        try:
            run = OptionExecution(0, option, rng)
            run.start(state)
            while len(states) <= MOST:
                step = rules.step(states[-1], run.choose(states[-1]))
                states.append(step.state)
                pressed += [self._instance.targets[i].name for i in step.pressed]
                if step.terminated or run.ends_at(step.state):
                    escapes = rules.has_escaped(step.state)
                    problem = "the puzzle is failed" if step.terminated and not escapes else ""
                    return Preview(name, tuple(states), tuple(pressed), escapes, problem)
        except EscapeError as error:
            return Preview(name, tuple(states), tuple(pressed), problem=str(error))
        return Preview(name, tuple(states), tuple(pressed), problem=f"no end within {MOST} primitives")


class Stopped(Exception):
    """Raised in the driver's thread to end it."""


class Gate:
    """Gate that lets primitives pass at `pace` per second (None for no limit), one by one, or not at all.

    Attributes:
        is_paused: only primitives released by `step` pass.
        is_stopped: `stop` has closed the gate for good.
    """

    def __init__(self, pace: float | None = 5.0, paused: bool = False) -> None:
        self.pace = pace
        self._turn = threading.Condition()
        self.is_paused, self.is_stopped = paused, False
        self._primitives, self._decisions = 0, 0

    def pause(self, paused: bool = True) -> None:
        """Close or open the gate."""
        with self._turn:
            self.is_paused = paused
            self._primitives = self._decisions = 0
            self._turn.notify_all()

    def step(self, primitives: int = 0, decisions: int = 0) -> None:
        """Let a number of primitives, or of whole decisions, pass, then close."""
        with self._turn:
            self.is_paused = True
            self._primitives, self._decisions = primitives, decisions
            self._turn.notify_all()

    def stop(self) -> None:
        """End the driver, whether it is waiting or not."""
        with self._turn:
            self.is_stopped = True
            self._turn.notify_all()

    def pass_primitive(self) -> None:
        """Wait until a primitive may run. Raises `Stopped`."""
        with self._turn:
            self._turn.wait_for(lambda: self.is_stopped or not self.is_paused or self._primitives or self._decisions)
            if self.is_stopped:
                raise Stopped
            if self.is_paused and self._primitives:
                self._primitives -= 1

    def end_decision(self) -> None:
        """Record the end of a decision."""
        with self._turn:
            if self._decisions:
                self._decisions -= 1


KEPT_DECISIONS, KEPT_EVENTS, KEPT_VALUES = 12, 200, 80
ENDLESS = 10**9
"""Training budget of an agent that learns while it is watched, primitives."""


@dataclasses.dataclass(frozen=True)
class ObservedChoice:
    """One choice of an agent, with the numbers behind it."""

    action: Any  # the chosen action
    mask: NDArray[np.bool_]  # legal actions, bool (actions,)
    values: NDArray[Any] | None  # one number per action, or None if the agent computes none
    meaning: str  # meaning of `values`: `value` (Q, in units of return) or `preference`; empty without values
    state_value: float | None  # V(s) of the critic or the highest legal Q; None without both
    state: RoomState  # state of the room
    notes: Mapping[int, str] = dataclasses.field(default_factory=dict)  # notes of a search baseline, by action


class CompletedDecision(NamedTuple):
    """A decision and its SMDP transition."""

    name: str  # name of the primitive or option
    transition: SMDPTransition
    ended: str  # value of `info["option"]["ended"]`


@dataclasses.dataclass(frozen=True)
class ShownCall:
    """One running call of a hierarchical agent."""

    call: RunningCall  # the call
    began: int  # primitives in the episode at the time of the call
    reward: float  # undiscounted reward since then

    @property
    def name(self) -> str:
        """Task of the call, with its context in brackets."""
        context = "" if self.call.context is None else f"({self.call.context})"
        return f"{self.call.task}{context}"

    @property
    def ending(self) -> str:
        """Termination at the latest choice, in words."""
        return "goes on" if self.call.ends == 0.0 else f"ends with {self.call.ends:.0%}"


class Watch:
    """Record of a driver while it drives. Its primitives pass a gate; its episodes follow from a seed.

    Attributes:
        choice: the last choice.
        plan: predicted course of the running option, from its beginning, or None for primitives.
        calls: running calls behind the last choice, the outermost first; empty for agents without a stack.
        decisions: the last completed decisions, oldest first.
        events: log lines, oldest first; each begins with episode and primitive.
        values: (primitives so far, V) at decisions.
        states: states of the current episode.
        rewards: rewards of the current episode, one per primitive.
        episode: number of the current episode, from 1.
        total: undiscounted return of the current episode so far.
        primitives: number of primitives in all episodes.
        in_decision: number of primitives in the current decision so far.
        on_change: called after every choice (with None) and every primitive; may block.
        on_wait: called before every primitive.
    """

    def __init__(self, driver: Driver, gate: Gate, seed: int = 0) -> None:
        self.driver, self.gate = driver, gate
        self._seed = check_seed(seed)
        self.choice: ObservedChoice | None = None
        self.plan: Preview | None = None
        self.calls: tuple[ShownCall, ...] = ()
        self.decisions: deque[CompletedDecision] = deque(maxlen=KEPT_DECISIONS)
        self.events: deque[str] = deque(maxlen=KEPT_EVENTS)
        self.values: deque[tuple[int, float]] = deque(maxlen=KEPT_VALUES)
        self.states: list[RoomState] = []
        self.rewards: list[float] = []
        self.episode = self.primitives = self.in_decision = 0
        self.total = 0.0
        self.on_change: Callable[[PrimitiveStep | None], None] = lambda step: None
        self.on_wait: Callable[[], None] = lambda: None
        self.previewer = Previewer(driver.room.instance, driver.make_options())
        recorder = driver.recorder
        recorder.on_step, recorder.before_step, recorder.on_reset = self._note_step, self._wait, self._note_reset

    def run(self, episodes: int | None = None) -> None:
        """Drive until `gate.stop()` or for a number of episodes. An agent in training learns."""
        agent, env = _WatchedAgent(self), _WatchedEnv(self)
        try:
            if self.driver.trains:
                train(agent, env, primitives=ENDLESS, seed=self._seed, eval_episodes=0, progress=False)
                return
            number = 0
            while episodes is None or number < episodes:
                seed = compute_episode_seed(self._seed, "evaluation", number) if number else self._seed
                for _ in play_episode(agent, env, seed):
                    pass
                number += 1
        except Stopped:
            pass

    def read(self, observation: Any, action: Any, mask: NDArray[np.bool_]) -> ObservedChoice:
        """Read the agent's numbers at an observation."""
        agent = self.driver.agent
        state_value = agent.compute_state_value(observation)
        shown, meaning = agent.compute_values(observation), "value"
        if shown is not None and state_value is None:
            state_value = float(shown[mask].max())
        if shown is None:
            shown, meaning = agent.compute_preferences(observation), "preference"
        values, meaning = (None, "") if shown is None else (np.array(shown), meaning)
        notes = agent.describe_presses() if isinstance(agent, SearchBaseline) else {}
        return ObservedChoice(to_plain_action(action), mask.copy(), values, "note" if notes else meaning, state_value,
                              self.states[-1], notes)

    def read_graph(self) -> frozenset[tuple[int, int]] | None:
        """Return the edges (parent, child) among targets that the agent believes in, or None if it has no graph."""
        graph, places = self.driver.agent.get_graph(), self.driver.room.observer.light_places
        return find_target_edges(graph, places) if graph is not None and places else None

    def note_choice(self, choice: ObservedChoice) -> None:
        """Record a choice, and predict the course of a chosen option."""
        self.choice, self.in_decision = choice, 0
        self._note_calls()
        if choice.state_value is not None:
            self.values.append((self.primitives, choice.state_value))
        name = name_action(self.driver.names, choice.action)
        is_number = isinstance(choice.action, int) and choice.action >= self.driver.primitives
        is_option = is_number and name in self.previewer.options
        self.plan = self.previewer.preview(name, choice.state) if is_option else None
        self.on_change(None)

    def _note_calls(self) -> None:
        """Record the running calls, and log the finished ones."""
        here = len(self.rewards)
        calls = tuple(
            ShownCall(call, here - call.primitives, sum(self.rewards[here - call.primitives :]))
            for call in self.driver.agent.list_calls()
        )
        running = {(call.name, call.began) for call in calls}
        for call in reversed(self.calls):
            if here and (call.name, call.began) not in running:
                self._log(f"{call.name} is over: {here - call.began} primitives, reward "
                          f"{sum(self.rewards[call.began :]):g}")
        self.calls = calls

    def note_end(self, transition: SMDPTransition, info: Mapping[str, Any]) -> None:
        """Record a completed decision."""
        option = info.get("option") or {"ended": "reached", "reason": ""}
        name = name_action(self.driver.names, transition.action)
        self.decisions.append(CompletedDecision(name, transition, option["ended"]))
        if option["ended"] != "reached":
            self._log(f"{name}: {option['ended']}" + (f", {option['reason']}" if option["reason"] else ""))
        end = EpisodeEnd.of_step(bool(info["is_success"]), transition.terminated, transition.truncated)
        if end.is_over:
            self._log(f"{end.words}, return {self.total:g}")
        self.gate.end_decision()

    def _note_reset(self, state: RoomState) -> None:
        self.states, self.rewards, self.total = [state], [], 0.0
        self.episode += 1
        self._log("a new episode")

    def _wait(self) -> None:
        self.on_wait()
        self.gate.pass_primitive()

    def _note_step(self, step: PrimitiveStep) -> None:
        self.states.append(step.after)
        self.rewards.append(step.reward)
        self.total += step.reward
        self.primitives += 1
        self.in_decision += 1
        for target in step.pressed:
            lit = self.driver.room.instance.puzzle.get_lit(step.after.puzzle)[target]
            name = self.driver.room.instance.targets[target].name
            self._log(f"{name} pressed: {'on' if lit else 'stays off'}")
        self.on_change(step)

    def _log(self, text: str) -> None:
        self.events.append(f"{self.episode}.{len(self.states) - 1}  {text}")


class _WatchedAgent(Agent):
    """The driver's agent with a record of each choice; `train` and `play_episode` accept it like any agent."""

    def __init__(self, watch: Watch) -> None:
        self._watch = watch
        self._agent = watch.driver.agent
        self.settings = self._agent.settings

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> Any:
        return self.record(observation, serve_one(self._agent).act(observation, action_mask), action_mask)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> Any:
        return self.record(observation, self._agent.act_greedy(observation, action_mask, rng), action_mask)

    def make_policy(self) -> Policy:
        return _WatchedPolicy(self, self._agent.make_policy())

    def record(self, observation: Any, action: Any, mask: NDArray[np.bool_]) -> Any:
        self._watch.note_choice(self._watch.read(observation, action, mask))
        return action

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        return serve_one(self._agent).observe(transition)

    def state_dict(self) -> dict[str, Any]:
        return self._agent.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self._agent.load_state_dict(state)


class _WatchedPolicy(Policy):
    """The driver's policy with a record of each choice."""

    def __init__(self, watched: _WatchedAgent, policy: Policy) -> None:
        self._watched, self._policy, self.is_markov = watched, policy, policy.is_markov

    def begin_episode(self, rng: np.random.Generator, num_envs: int = 1) -> None:
        self._policy.begin_episode(rng, num_envs)

    def act(self, batch: Moments) -> Any:
        return np.array((self.choose(batch.observation[0], batch.action_mask[0]),))

    def choose(self, observation: Any, action_mask: NDArray[np.bool_]) -> Any:
        return self._watched.record(observation, self._policy.choose(observation, action_mask), action_mask)

    def note_outcome(self, transition: SMDPTransition) -> None:
        self._policy.note_outcome(transition)


class _WatchedEnv(gymnasium.Wrapper):
    """The driver's environment with a record of each completed decision."""

    def __init__(self, watch: Watch) -> None:
        super().__init__(watch.driver.env)
        set_option_discount(self.env, watch.driver.agent.gamma)
        self._watch = watch

    def step(self, action: Any) -> Any:
        shown = self.env.step(action)
        legal = np.ones(0 if isinstance(action, np.ndarray) else len(self._watch.driver.names), dtype=np.bool_)
        transition = make_transition(None, action, legal, shown, self._watch.driver.agent.gamma)
        self._watch.note_end(transition, shown[4])
        return shown
