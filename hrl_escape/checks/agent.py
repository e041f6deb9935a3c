"""Check of agents: legal actions, evaluation without side effects, checkpoints that resume to the same bits.

Agents are trained in a small semi-Markov decision process: a corridor with a lamp that must be on before the exit
opens, actions of one to four primitives, masks, terminations and truncations.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from hrl_escape.agents.agent import Agent, SMDPTransition, make_transition, read_action_mask
from hrl_escape.agents.single_env import serve_one
from hrl_escape.agents.training.checkpoint import load_checkpoint, save_checkpoint
from hrl_escape.checks.claims import Claims, dump_state

LENGTH, HORIZON = 6, 60


def check_agent(agent_class: type[Agent], settings: Any = None, decisions: int = 400, seed: int = 0) -> None:
    """Check an agent by training it in a small corridor.

    Args:
        agent_class: constructed as `agent_class(observation_space, action_space, seed, settings)`.
        settings: of the agent; None takes `agent_class.Settings()`.
        decisions: length of training.
        seed: of the agent and of the corridor.

    Raises:
        ContractError: a requirement is violated.
    """
    _AgentCheck(agent_class, settings or agent_class.Settings(), seed).run(decisions)


class _TraceStep(NamedTuple):
    """One primitive inside a decision."""

    observation: NDArray[np.float32]
    action: int
    reward: float
    next_observation: NDArray[np.float32]
    next_action_mask: NDArray[np.bool_]
    consistent: tuple[tuple[int, float], ...]


class _Corridor(gymnasium.Env):
    """Corridor of cells: move one cell or up to four, turn on the lamp in the first cell, leave by the last.

    The observation is (cell / 5, lamp). Moves beyond an end are illegal.
    """

    LEFT, RIGHT, FAR_LEFT, FAR_RIGHT, PRESS = range(5)

    def __init__(self) -> None:
        self.observation_space = spaces.Box(0.0, 1.0, (2,), np.float32)
        self.action_space = spaces.Discrete(5)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed, options=options)
        self._cell, self._lamp, self._spent = int(self.np_random.integers(LENGTH)), False, 0
        return self._observe(), {"action_mask": self._mask().astype(np.int8)}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self._mask()[action], f"illegal action {action}"
        duration = int(self.np_random.integers(2, 5)) if action in (self.FAR_LEFT, self.FAR_RIGHT) else 1
        trace, terminated = [], False
        while len(trace) < duration and self._spent < HORIZON and not terminated:
            before = self._observe()
            terminated = self._move(action)
            self._spent += 1
            reward = 10.0 if terminated else -1.0
            trace.append(_TraceStep(before, action, reward, self._observe(), self._mask(), ((action, 0.0),)))
        rewards = tuple(step.reward for step in trace)
        info = {"duration": len(trace), "rewards": rewards, "trace": tuple(trace),
                "action_mask": self._mask().astype(np.int8)}
        return self._observe(), sum(rewards), terminated, self._spent >= HORIZON and not terminated, info

    def _move(self, action: int) -> bool:
        """Run one primitive; returns whether the robot has left."""
        if action == self.PRESS:
            self._lamp = True
            return False
        step = 1 if action in (self.RIGHT, self.FAR_RIGHT) else -1
        leaves = self._cell + step >= LENGTH and self._lamp
        self._cell = min(max(self._cell + step, 0), LENGTH - 1)
        return leaves

    def _observe(self) -> NDArray[np.float32]:
        return np.array([self._cell / (LENGTH - 1), self._lamp], dtype=np.float32)

    def _mask(self) -> NDArray[np.bool_]:
        at_left, at_right = self._cell == 0, self._cell == LENGTH - 1 and not self._lamp
        return np.array([not at_left, not at_right, not at_left, not at_right, at_left])


class _AgentCheck(Claims):
    """Requirements of agents, checked during a training run."""

    def __init__(self, agent_class: type[Agent], settings: Any, seed: int) -> None:
        super().__init__(f"agent {agent_class.__name__}")
        self._class: Any = agent_class
        self._settings, self._seed = settings, seed

    def run(self, decisions: int) -> None:
        agent = self._make()
        missing = [name for name in ("settings", "gamma", "act", "act_greedy", "observe", "state_dict",
                                     "load_state_dict") if name not in dir(agent)]
        self.require(not missing, "it has every member of the protocol", missing)
        self.require(isinstance(agent.gamma, float) and 0.0 <= agent.gamma <= 1.0, "gamma is a float from 0 to 1",
                     agent.gamma)
        try:
            agent.state_dict()
        except TypeError as error:
            self.require(False, "it declares what a checkpoint keeps of it", str(error))
        elsewhere = _read_global_random_state()
        seen = self._train(agent, _Play(_Corridor(), agent.gamma, self._seed), decisions)
        self.require(_read_global_random_state() == elsewhere, "it draws from generators of its own, never from the "
                     "global random state of numpy or torch", "the global state changed")
        self._check_repeatable(seen, decisions)
        self._check_greedy(agent, seen)
        self._check_resuming(decisions)

    def _make(self) -> Any:
        env = _Corridor()
        return self._class(env.observation_space, env.action_space, self._seed, self._settings)

    def _train(self, agent: Any, play: _Play, decisions: int) -> list[SMDPTransition]:
        """Yield transitions that the agent chose and learned from."""
        made, served = [], serve_one(agent)
        for _ in range(decisions):
            action = served.act(play.observation, play.mask.copy())
            self._require_legal(action, play.mask, "act")
            made.append(play.step(int(action)))
            metrics = served.observe(made[-1])
            finite = isinstance(metrics, Mapping) and all(math.isfinite(value) for value in metrics.values())
            self.require(finite, "observe returns finite numbers by name, or an empty mapping", metrics)
        return made

    def _require_legal(self, action: Any, mask: NDArray[np.bool_], asked: str) -> None:
        is_index = isinstance(action, (int, np.integer)) and not isinstance(action, (bool, np.bool_))
        self.require(is_index and bool(0 <= action < len(mask) and mask[action]),
                     f"{asked} returns the index of a legal action", (action, mask.tolist()))

    def _check_repeatable(self, seen: list[SMDPTransition], decisions: int) -> None:
        again = self._train(agent := self._make(), _Play(_Corridor(), agent.gamma, self._seed), decisions)
        first = next((n for n, (a, b) in enumerate(zip(seen, again, strict=True)) if a.action != b.action), None)
        self.require(first is None, "the same seed makes the same decisions", f"they part at decision {first}")

    def _check_greedy(self, agent: Any, seen: list[SMDPTransition]) -> None:
        """Check that evaluation is legal, repeatable and without side effects."""
        before = dump_state(agent)
        places = seen[-50:]

        def choose() -> list[int]:
            rng = np.random.default_rng(self._seed)
            return [agent.act_greedy(step.observation, step.action_mask.copy(), rng) for step in places]

        first = choose()
        for action, step in zip(first, places, strict=True):
            self._require_legal(action, step.action_mask, "act_greedy")
            only = np.zeros_like(step.action_mask)
            only[step.action] = True
            chosen = agent.act_greedy(step.observation, only.copy(), np.random.default_rng(0))
            self._require_legal(chosen, only, "act_greedy, where one action is legal,")
        self.require(choose() == first, "act_greedy repeats itself with the same generator", first)
        self.require(dump_state(agent) == before, "act_greedy changes nothing in the agent", "state_dict changed")

    def _check_resuming(self, decisions: int) -> None:
        """Check that a checkpoint between episodes resumes to the same bits."""
        agent = self._make()
        play = _Play(_Corridor(), agent.gamma, self._seed)
        self._train(agent, play, decisions // 2)
        while not play.is_new_episode:
            self._train(agent, play, 1)
        fresh = self._make()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "checkpoint.npz"
            try:
                save_checkpoint(path, agent.state_dict())
            except TypeError as error:
                self.require(False, "state_dict is a tree of numbers, text and arrays", str(error))
            try:
                fresh.load_state_dict(load_checkpoint(path))
            except (KeyError, TypeError, ValueError, IndexError, RuntimeError) as error:
                self.require(False, "load_state_dict takes what state_dict gave", repr(error))
        self.require(dump_state(fresh) == dump_state(agent), "load_state_dict restores all of state_dict",
                     "the state differs after loading")
        seed = self._seed + 1
        ways = [self._train(each, _Play(_Corridor(), each.gamma, seed), decisions // 2) for each in (agent, fresh)]
        actions = [[step.action for step in way] for way in ways]
        self.require(actions[0] == actions[1], "a resumed agent makes the decisions of one that was never stopped",
                     next(n for n, (a, b) in enumerate(zip(*actions, strict=True)) if a != b) if
                     actions[0] != actions[1] else None)
        self.require(dump_state(fresh) == dump_state(agent), "a resumed agent learns what one learns that was never "
                     "stopped", "the state differs after more training")


class _Play:
    """State of consecutive episodes before the next decision."""

    def __init__(self, env: _Corridor, gamma: float, seed: int) -> None:
        self._env, self._gamma = env, gamma
        self._begin(seed)

    def _begin(self, seed: int | None) -> None:
        self.observation, info = self._env.reset(seed=seed)
        self.mask = read_action_mask(info, 5)
        self.is_new_episode = True

    def step(self, action: int) -> SMDPTransition:
        transition = make_transition(self.observation, action, self.mask, self._env.step(action), self._gamma)
        self.observation, self.mask = transition.next_observation, transition.next_action_mask
        self.is_new_episode = False
        if transition.terminated or transition.truncated:
            self._begin(None)
        return transition


def _read_global_random_state() -> tuple[Any, ...]:
    """Return the state of the global generators of numpy and torch."""
    import torch  # not for `import hrl_escape.checks`

    kind, keys, place, *_ = np.random.get_state()  # noqa: NPY002  # read only
    return kind, np.asarray(keys).tobytes(), place, torch.get_rng_state().numpy().tobytes()
