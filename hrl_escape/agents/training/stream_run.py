"""One training run in many streams: segments of steps, their totals, and checkpoints of the running episodes.

Streams that can write their episodes down are saved with the run at any time. All others begin anew at an evaluation,
and the run is saved only there, so that it resumes to the same bits either way.

Vector environments of Gymnasium become streams here, with each of the three kinds of automatic reset. The state that an
episode ended in is a decision's outcome, never the first observation of the next one. Where the environment cannot give
its episodes, their actions stand for them, which a resumed run makes again; so that this takes little time, all
episodes begin anew at the first evaluation after `REMADE` actions.
"""

from __future__ import annotations

import ctypes
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from torch import Tensor

from hrl_escape.agents.agent import SUCCESS_KEYS, check_observation, count_actions, read_success_value
from hrl_escape.agents.registry import SMDP_PREFIX
from hrl_escape.agents.state import Stateful, StateTree
from hrl_escape.agents.streams import (
    EndedDecisions,
    StreamAgent,
    Streams,
    StreamTransitions,
    gather_decisions,
)
from hrl_escape.agents.training.callbacks import Callback
from hrl_escape.agents.training.env_description import describe_many
from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.agents.training.run import NO_OPTIONS, Means, Reporter, Run, RunArguments
from hrl_escape.agents.training.run_folder import RunFolder
from hrl_escape.errors import CheckpointError, StepContractError

REMADE = 200_000
"""Most actions, of all streams together, that stand for running episodes."""


class VectorStreams:
    """Streams of a vector environment, one decision of each a step.

    `infos` may hold what `make_transition` reads of `info`, as arrays: `action_mask`, and for decisions of several
    primitives `duration` and `discounted_reward`; and `is_success`, else `success`, at the end of an episode.

    Args:
        env: numpy arrays, or tensors, which stay on their device.
        gamma: discount of `discounted_reward`, where the environment gives one.
    """

    def __init__(self, env: VectorEnv, gamma: float) -> None:
        self._env = env
        self.count, self.gamma = env.num_envs, gamma
        self.observation_space, self.action_space = env.single_observation_space, env.single_action_space
        self._actions = count_actions(self.action_space, "train")
        self._mode = AutoresetMode(env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        self.observation = self.action_mask = torch.empty(0)
        self._was_over = torch.zeros(self.count, dtype=torch.bool)
        self._gives_episodes = hasattr(env.unwrapped, "state_dict")
        self._made: list[NDArray[np.integer]] = []  # otherwise, actions of every step since `reset`, (streams,) each

    @property
    def device(self) -> torch.device:
        """Device of the environment's tensors; the CPU for arrays."""
        return self.observation.device

    @property
    def is_waiting(self) -> Tensor:
        """All streams but those that reset in the next step, bool (streams,)."""
        return ~self._was_over

    def reset(self, seeds: int) -> None:
        """Begin all episodes anew."""
        self._made = []
        observation, infos = self._env.reset(seed=seeds)
        self.observation = self._take(observation)
        self.action_mask = self._read_mask(infos)
        self._was_over = torch.zeros(self.count, dtype=torch.bool, device=self.device)

    def step(self, action: Tensor) -> EndedDecisions:
        """Run one decision in every stream, or the reset that takes its place."""
        before, where = self.observation, self.is_waiting
        if not self._gives_episodes and len(self._made) * self.count <= REMADE:
            self._made.append(action.cpu().numpy().astype(np.min_scalar_type(self._actions)))
        given = action if isinstance(before, Tensor) and self._gives_tensors else action.cpu().numpy()
        seen, reward, terminated, truncated, infos = self._env.step(given)
        now, mask = self._take(seen), self._read_mask(infos)
        reward, terminated, truncated = (self._take(part, dtype) for part, dtype in (
            (reward, torch.float32), (terminated, torch.bool), (truncated, torch.bool)))
        over = (terminated | truncated) & where
        reached, reached_mask, final = now, mask, {}
        if self._mode == AutoresetMode.SAME_STEP and "final_obs" in infos:
            final = infos["final_info"]
            reached = self._replace(now, infos["final_obs"], over)
            reached_mask = (self._replace(mask, final["action_mask"], over) if "action_mask" in final else
                            mask | over[:, None])
        elif self._mode == AutoresetMode.DISABLED and bool(over.any()):
            begun, infos_begun = self._env.reset(options={"reset_mask": over if self._gives_tensors else
                                                          over.cpu().numpy()})
            now, mask = self._take(begun), self._read_mask(infos_begun)
        self.observation, self.action_mask = now, mask
        self._was_over = over if self._mode == AutoresetMode.NEXT_STEP else torch.zeros_like(over)
        duration, discounted = self._read_rewards(reward, infos, final, over)
        success = self._read_success(final if self._mode == AutoresetMode.SAME_STEP else infos, over)
        return EndedDecisions(where, before, action, reward, discounted, duration, reached, reached_mask, terminated,
                          truncated, success)

    # --- what comes from the environment ---------------------------------------------------

    def _take(self, value: Any, dtype: torch.dtype | None = None) -> Tensor:
        if isinstance(value, Tensor):
            self._gives_tensors = True
            return value if dtype is None else value.to(dtype)
        self._gives_tensors = False
        tensor = torch.tensor(np.asarray(value), dtype=dtype)
        if dtype is None and tensor.is_floating_point() and not bool(tensor.isfinite().all()):
            check_observation(np.asarray(value), "of a step")
        return tensor

    def _replace(self, batch: Tensor, values: Any, where: Tensor) -> Tensor:
        """Copy of a batch with some rows of another, which may be an array of arrays and None."""
        rows = where.nonzero().squeeze(1)
        new = values[rows] if isinstance(values, Tensor) else torch.from_numpy(
            np.stack([np.asarray(values[row]) for row in rows.tolist()]))
        return batch.index_copy(0, rows, new.to(self.device, batch.dtype))

    def _read_mask(self, infos: Mapping[str, Any]) -> Tensor:
        given = infos.get("action_mask")
        if given is None:
            return torch.ones((self.count, self._actions), dtype=torch.bool, device=self.device)
        mask = (given if isinstance(given, Tensor) else torch.from_numpy(np.stack(list(given)))) != 0
        if mask.shape != (self.count, self._actions):
            raise StepContractError(f"infos['action_mask'] has shape {tuple(mask.shape)}; {self.count} environments "
                                    f"of {self._actions} actions need ({self.count}, {self._actions})")
        if mask.device.type == "cpu" and not bool(mask.any(dim=1).all()):
            raise StepContractError("infos['action_mask'] is all zero for an environment: at least one action must "
                                    "always be legal")
        return mask.to(self.device)

    def _read_rewards(self, reward: Tensor, infos: Mapping[str, Any], final: Mapping[str, Any], over: Tensor
                      ) -> tuple[Tensor, Tensor]:
        """Duration k and R of each stream's decision; `final` holds those of decisions that ended an episode."""
        duration, discounted = torch.ones_like(reward, dtype=torch.int64), reward
        for source, rows in ((infos, ~over if final else torch.ones_like(over)), (final, over)):
            if "duration" not in source or not bool(rows.any()):
                continue
            duration = self._replace(duration, self._take(source["duration"]), rows)
            if "discounted_reward" in source:
                discounted = self._replace(discounted, self._take(source["discounted_reward"]), rows)
            elif bool((duration > 1).any()):
                raise StepContractError("decisions ran several primitives but infos has no 'discounted_reward', so "
                                        "their discounted reward is unknown")
        return duration.clamp(min=1), discounted

    def _read_success(self, infos: Mapping[str, Any], over: Tensor) -> Tensor:
        """Success as `read_success` reads it of each stream whose episode ended, int8 (streams,); -1 where it is None.

        `infos` holds the streams' last steps.
        """
        success = torch.full_like(over, -1, dtype=torch.int8)
        for name in reversed(SUCCESS_KEYS):
            if name not in infos:
                continue
            values, given = infos[name], infos.get(f"_{name}")
            if isinstance(values, Tensor):
                shown = over if given is None else over & torch.as_tensor(given, device=self.device)
                if values.dtype != torch.bool:
                    for value in values[shown].tolist():
                        read_success_value(name, value)
                success = torch.where(shown, values.to(self.device, torch.int8), success)
                continue
            for stream in over.nonzero().squeeze(1).tolist():
                if (given is None or given[stream]) and values[stream] is not None:
                    success[stream] = read_success_value(name, values[stream])
        return success

    # --- checkpoints -----------------------------------------------------------------------

    def state_dict(self) -> StateTree | None:
        """Running episodes, or the actions that they came of; None after too many of these."""
        env: Any = self._env.unwrapped
        if self._gives_episodes:
            return {"env": dict(env.state_dict()), "observation": self.observation, "action_mask": self.action_mask,
                    "was_over": self._was_over}
        if len(self._made) * self.count > REMADE:
            return None
        return {"made": np.array(self._made).reshape(-1, self.count), "observation": self.observation}

    def load_state_dict(self, state: StateTree) -> None:
        """Go on where `state_dict` was taken, after a `reset` with the same seeds, or raise `CheckpointError`."""
        env: Any = self._env.unwrapped
        if self._gives_episodes:
            env.load_state_dict(state["env"])
            self.observation, self.action_mask, self._was_over = (
                torch.from_numpy(np.array(state[name])).to(self.device)
                for name in ("observation", "action_mask", "was_over"))
            return
        for actions in np.asarray(state["made"]):
            self.step(torch.from_numpy(actions.astype(np.int64)).to(self.device))
        if not np.array_equal(self.observation.cpu().numpy(), np.asarray(state["observation"]), equal_nan=True):
            raise CheckpointError("the environments do not do the same again for equal seeds and actions")


def make_streams(env: VectorEnv | Streams, gamma: float) -> Streams:
    """The streams of a vector environment: its own, or one decision of each a step; streams stay as they are."""
    if not isinstance(env, VectorEnv):
        return env
    inner: Any = env.unwrapped
    return inner.get_streams() if hasattr(inner, "get_streams") else VectorStreams(env, gamma)


SEGMENT_PRIMITIVES, SEGMENT_STEPS = 16_384, 16
"""Size of a segment, a row of the log: primitives run in all streams together, and least steps."""
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # parameters of glibc's mallopt
_KEPT = 1 << 30  # bytes


class StreamRun(Run):
    """A run whose unit is a segment: a fixed number of steps of all streams."""

    agent: StreamAgent

    def __init__(self, agent: StreamAgent, env: VectorEnv | Streams, eval_env: gymnasium.Env, arguments: RunArguments,
                 callbacks: Sequence[Callback] = ()) -> None:
        super().__init__(agent, eval_env, eval_env, arguments, callbacks=callbacks)
        keep_freed_memory()
        self._source, self._begun = env, 0
        self.streams = streams = make_streams(env, agent.gamma)
        self._steps = max(SEGMENT_STEPS, SEGMENT_PRIMITIVES // streams.count)
        self._begin()

    @property
    def identity(self) -> dict[str, Any]:
        """Streams beside the environment of evaluations, which stands for them when the run is shown or loaded."""
        return super().identity | {"streams": describe_many(self._source)}

    def _begin(self) -> None:
        self._begun += 1
        self._reset_streams()
        self.agent.begin_streams(self.streams.count, self.streams.device)

    def _reset_streams(self) -> None:
        self.streams.reset(compute_episode_seed(self.arguments.seed, "streams", self._begun))
        self._tally = _StreamTally(self.streams.count, self.streams.device)
        self._is_fresh = True

    @property
    def can_be_saved(self) -> bool:
        """True at any time where streams can be written down, else just after all episodes began anew, or ended."""
        return self._is_fresh or self.is_over or self.streams.state_dict() is not None

    def _evaluate(self, folder: RunFolder | None) -> None:
        super()._evaluate(folder)
        if self.decisions and not self.is_over and self.streams.state_dict() is None:
            self._begin()

    def run_unit(self, report: Reporter) -> dict[str, Any]:
        """Train for one segment; returns its row of the log."""
        started = time.perf_counter()
        streams, agent, tally = self.streams, self.agent, self._tally
        before, words = self.primitives, self.describe_returns()
        self._is_fresh, means = False, Means()
        for _ in range(self._steps):
            if self.is_spent:
                break
            asking = streams.is_waiting.nonzero().squeeze(1)
            action = torch.zeros(streams.count, dtype=torch.int64, device=streams.device)
            action[asking] = agent.act_streams(streams.observation[asking], streams.action_mask[asking], asking)
            ended = streams.step(action)
            decisions = gather_decisions(ended, streams.gamma, agent.gamma)
            means.note(agent.observe_streams(decisions))
            self.primitives += tally.add(decisions, ended.success[decisions.stream])
            self.decisions += len(decisions.stream)
            report(self.primitives, words)
        if self.primitives == self.decisions and before == 0 and self.arguments.name.startswith(SMDP_PREFIX):
            warnings.warn(NO_OPTIONS.format(name=self.arguments.name), stacklevel=2)
        return self.end_segment(tally.take_row(), means, started, before)

    def state_dict(self) -> StateTree:
        """Streams and their sums beside the agent and the totals."""
        return super().state_dict() | {"streams": None if self.is_over else self.streams.state_dict(),
                                       "begun": self._begun, "tally": self._tally.state_dict()}

    def load_state_dict(self, state: StateTree) -> None:
        """Go on where `state_dict` was taken."""
        super().load_state_dict(state)
        self._begun = int(state["begun"])
        self._reset_streams()
        if state["streams"] is not None:
            try:
                self.streams.load_state_dict(state["streams"])
            except CheckpointError as error:
                warnings.warn(f"{error}: all episodes begin anew, so the run does not resume to the same bits",
                              stacklevel=2)
                self._begin()
                return
            self._tally.load_state_dict(state["tally"])


class _StreamTally(Stateful):
    """Returns and lengths of running episodes, and sums over those that ended, on the device.

    The sums are empty between segments, so that the state is that of the running episodes.
    """

    STATE = ("_running",)

    def __init__(self, count: int, device: torch.device) -> None:
        self._running = torch.zeros((2, count), dtype=torch.float64, device=device)  # return and length so far
        self._sums = torch.zeros(5, dtype=torch.float64, device=device)
        """Returns, lengths, successes, episodes, and episodes that report their success."""

    def add(self, decisions: StreamTransitions, success: Tensor) -> int:
        """Add decisions; returns the primitives that ran. `success`, (n,), is as in `EndedDecisions`."""
        row = torch.stack((decisions.summed_reward.double(), decisions.duration.double()))
        running = self._running[:, decisions.stream] + row
        over = decisions.terminated | decisions.truncated
        self._running[:, decisions.stream] = torch.where(over, 0.0, running)
        counts = (success == 1, torch.ones_like(over), success >= 0)
        ended = torch.stack((*running, *(count.double() for count in counts)))
        self._sums += torch.where(over, ended, 0.0).sum(dim=1)
        return int(decisions.duration.sum())

    def take_row(self) -> dict[str, Any]:
        """Logged numbers of the episodes that ended since the last call."""
        returns, lengths, successes, episodes, reported = self._sums.tolist()
        self._sums.zero_()
        return {"train/episodes": int(episodes), "train/successes": int(successes) if reported else None,
                "train/return": returns / episodes if episodes else None,
                "train/length": lengths / episodes if episodes else None}


def keep_freed_memory() -> None:
    """Let this process keep up to 1 GiB of freed memory for the next block of its size.

    glibc gives blocks of some megabytes back to the system as soon as they are freed, so that each minibatch of many
    streams pays for fresh, zeroed pages. What is computed does not depend on it. Other C libraries are left alone.
    """
    if sys.platform != "linux":
        return
    set_option = getattr(ctypes.CDLL(None), "mallopt", None)
    if set_option is not None:
        set_option(_MMAP_THRESHOLD, _KEPT)
        set_option(_TRIM_THRESHOLD, _KEPT)
