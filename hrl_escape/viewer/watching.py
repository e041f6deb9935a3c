"""What watch mode knows: a gate that lets primitives through, and what the driver thinks and did.

`Watch` sits around an agent and its environment and notes what passes; it changes no number.
Everything runs in the driver's thread; other threads only turn the gate's knobs and read.
"""

from __future__ import annotations

import dataclasses
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hrl_escape.agents.agent import SMDPTransition, make_transition
from hrl_escape.agents.evaluation import compute_episode_seed, play_episode
from hrl_escape.agents.training import train
from hrl_escape.env.kinematics import RoomState
from hrl_escape.viewer.drivers import Driver
from hrl_escape.viewer.preview import Preview, Previewer
from hrl_escape.viewer.tap import Step

__all__ = ["Done", "Gate", "Stopped", "Thought", "Watch"]

KEPT_DECISIONS, KEPT_EVENTS, KEPT_VALUES = 12, 200, 80
ENDLESS = 10**9
"""Primitives that an agent is trained for while one watches."""


class Stopped(Exception):
    """The one who watched has left."""


class Gate:
    """Lets primitives through at a pace, one at a time, or not at all.

    Attributes:
        pace: primitives a second; None for as fast as it can.
    """

    def __init__(self, pace: float | None = 5.0, paused: bool = False) -> None:
        self.pace = pace
        self._turn = threading.Condition()
        self._paused, self._stopped = paused, False
        self._primitives, self._decisions = 0, 0

    @property
    def is_paused(self) -> bool:
        """Nothing passes but what is let through by a step."""
        return self._paused

    @property
    def is_stopped(self) -> bool:
        """Nothing passes any more."""
        return self._stopped

    def pause(self, paused: bool = True) -> None:
        """Close or open."""
        with self._turn:
            self._paused = paused
            self._primitives = self._decisions = 0
            self._turn.notify_all()

    def step(self, primitives: int = 0, decisions: int = 0) -> None:
        """Let so many primitives, or whole decisions, through and close."""
        with self._turn:
            self._paused = True
            self._primitives, self._decisions = primitives, decisions
            self._turn.notify_all()

    def stop(self) -> None:
        """Make whoever waits give up."""
        with self._turn:
            self._stopped = True
            self._turn.notify_all()

    def pass_primitive(self) -> None:
        """Wait until a primitive may run. Raises `Stopped`."""
        with self._turn:
            self._turn.wait_for(lambda: self._stopped or not self._paused or self._primitives or self._decisions)
            if self._stopped:
                raise Stopped
            if self._paused and self._primitives:
                self._primitives -= 1

    def end_decision(self) -> None:
        """A decision is over."""
        with self._turn:
            if self._decisions:
                self._decisions -= 1


@dataclasses.dataclass(frozen=True)
class Thought:
    """What an agent had in mind at a decision.

    Attributes:
        observation: what it saw.
        action: what it chose.
        mask: bool (actions,), what was legal.
        values: one an action, in the agent's own numbers; None if it has none.
        meaning: of these numbers: `value` (Q, in units of return) or `preference`.
        state_value: V(s): its critic's, or the highest legal Q; None if it has neither.
        state: where it was.
    """

    observation: Any
    action: int
    mask: NDArray[np.bool_]
    values: NDArray[Any] | None
    meaning: str
    state_value: float | None
    state: RoomState


@dataclasses.dataclass(frozen=True)
class Done:
    """What came of a decision: the SMDP transition that the agent learns from.

    Attributes:
        name: of the primitive or option.
        duration: k.
        reward: R = sum gamma^i r_i.
        discount: gamma^k.
        summed: undiscounted sum.
        ended: how it ended.
    """

    name: str
    duration: int
    reward: float
    discount: float
    summed: float
    ended: str


class Watch:
    """An agent being watched.

    Args:
        driver: who is watched.
        gate: lets its primitives through.
        seed: of its episodes.

    Attributes:
        thought: the last decision's.
        plan: what the option that runs meant to do when it began; None for primitives.
        decisions: the last ones, oldest first.
        events: time and text of what happened, oldest first.
        values: (primitives so far, V) at decisions.
        states: of the present episode.
        episode: its number, from 1.
        total: its undiscounted return so far.
        primitives: in all.
        in_decision: primitives of the present decision so far.
        on_change: called after every decision made and every primitive run; may take its time.
        on_wait: called before a primitive, while it may have to wait.
    """

    def __init__(self, driver: Driver, gate: Gate, seed: int = 0) -> None:
        self.driver, self.gate = driver, gate
        self._seed = seed
        self.thought: Thought | None = None
        self.plan: Preview | None = None
        self.decisions: deque[Done] = deque(maxlen=KEPT_DECISIONS)
        self.events: deque[str] = deque(maxlen=KEPT_EVENTS)
        self.values: deque[tuple[int, float]] = deque(maxlen=KEPT_VALUES)
        self.states: list[RoomState] = []
        self.episode = self.primitives = self.in_decision = 0
        self.total = 0.0
        self.on_change: Callable[[Step | None], None] = lambda step: None
        self.on_wait: Callable[[], None] = lambda: None
        instance = driver.room.instance
        self.previewer = Previewer(instance, driver.flavour)
        driver.tap.on_step, driver.tap.before_step, driver.tap.on_reset = self._note_step, self._wait, self._note_reset

    def run(self, episodes: int | None = None) -> None:
        """Let it drive, until `gate.stop()` or so many episodes; a learner learns.

        Raises:
            PlanningFailed: the planner finds no way.
        """
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

    def read(self, observation: Any, action: int, mask: NDArray[np.bool_]) -> Thought:
        """Ask the agent for its own numbers at an observation."""
        agent: Any = self.driver.agent
        values, meaning, state_value = None, "", None
        if hasattr(agent, "compute_values"):
            values, meaning = np.array(agent.compute_values(observation)), "value"
            state_value = float(values[mask].max())
        elif hasattr(agent, "compute_preferences"):
            values, meaning = np.array(agent.compute_preferences(observation)), "preference"
        if hasattr(agent, "compute_state_value"):
            state_value = float(agent.compute_state_value(observation))
        return Thought(observation, int(action), mask.copy(), values, meaning, state_value, self.states[-1])

    def note_thought(self, thought: Thought) -> None:
        """A decision was made."""
        self.thought, self.in_decision = thought, 0
        if thought.state_value is not None:
            self.values.append((self.primitives, thought.state_value))
        name = self.driver.names[thought.action]
        is_option = thought.action >= self.driver.primitives and name in self.previewer.options
        self.plan = self.previewer.preview(name, thought.state) if is_option else None
        self.on_change(None)

    def note_done(self, transition: SMDPTransition, info: Mapping[str, Any]) -> None:
        """A decision is over."""
        option = info.get("option") or {"ended": "reached", "reason": ""}
        name = self.driver.names[transition.action]
        self.decisions.append(Done(name, transition.duration, transition.reward, transition.discount,
                                   transition.summed_reward, option["ended"]))
        if option["ended"] != "reached":
            self._tell(f"{name}: {option['ended']}" + (f", {option['reason']}" if option["reason"] else ""))
        if transition.terminated or transition.truncated:
            self._tell(f"{'escaped' if transition.terminated else 'out of time'}, return {self.total:g}")
        self.gate.end_decision()

    def _note_reset(self, state: RoomState) -> None:
        self.states, self.total = [state], 0.0
        self.episode += 1
        self._tell("a new episode")

    def _wait(self) -> None:
        self.on_wait()
        self.gate.pass_primitive()

    def _note_step(self, step: Step) -> None:
        self.states.append(step.after)
        self.total += step.reward
        self.primitives += 1
        self.in_decision += 1
        for target in step.pressed:
            lit = self.driver.room.instance.puzzle.get_lit(step.after.puzzle)[target]
            name = self.driver.room.instance.targets[target].name
            self._tell(f"{name} pressed: {'on' if lit else 'stays off'}")
        self.on_change(step)

    def _tell(self, text: str) -> None:
        self.events.append(f"{self.episode}.{len(self.states) - 1}  {text}")


class _WatchedAgent:
    """The driver's agent, telling what it thinks whenever it acts; `train` takes it for an agent of its own."""

    Settings: ClassVar[type] = object

    def __init__(self, watch: Watch) -> None:
        self._watch = watch
        self._agent = watch.driver.agent
        self.settings = self._agent.settings

    @property
    def gamma(self) -> float:
        return self._agent.gamma

    def act(self, observation: Any, action_mask: NDArray[np.bool_]) -> int:
        return self._tell(observation, self._agent.act(observation, action_mask), action_mask)

    def act_greedy(self, observation: Any, action_mask: NDArray[np.bool_], rng: np.random.Generator) -> int:
        return self._tell(observation, self._agent.act_greedy(observation, action_mask, rng), action_mask)

    def _tell(self, observation: Any, action: int, mask: NDArray[np.bool_]) -> int:
        self._watch.note_thought(self._watch.read(observation, action, mask))
        return action

    def observe(self, transition: SMDPTransition) -> Mapping[str, float]:
        return self._agent.observe(transition)

    def state_dict(self) -> dict[str, Any]:
        return self._agent.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self._agent.load_state_dict(state)


class _WatchedEnv(gymnasium.Wrapper):
    """The driver's environment, telling what came of each decision."""

    def __init__(self, watch: Watch) -> None:
        super().__init__(watch.driver.env)
        self._watch = watch

    def step(self, action: Any) -> Any:
        shown = self.env.step(action)
        transition = make_transition(None, int(action), np.ones(len(self._watch.driver.names), dtype=np.bool_), shown,
                                     self._watch.driver.agent.gamma)
        self._watch.note_done(transition, shown[4])
        return shown
