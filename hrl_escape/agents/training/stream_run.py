"""One training run in many streams: segments of steps, their totals, and checkpoints of the running episodes.

Streams that can write their episodes down are saved with the run at any time. All others begin anew after every
evaluation, and the run is saved only there, so that it resumes to the same bits either way.
"""

from __future__ import annotations

import ctypes
import sys
import time
import warnings
from collections.abc import Sequence
from typing import Any, cast

import gymnasium
import torch
from gymnasium.vector import VectorEnv
from torch import Tensor

from hrl_escape.agents.registry import SMDP_PREFIX
from hrl_escape.agents.state import Stateful, StateTree
from hrl_escape.agents.streams import StreamAgent, Streams, StreamTransitions, gather_decisions
from hrl_escape.agents.training.callbacks import Callback
from hrl_escape.agents.training.env_description import describe_many
from hrl_escape.agents.training.evaluation import compute_episode_seed
from hrl_escape.agents.training.progress import Reporter
from hrl_escape.agents.training.results import SegmentRecord, read_row
from hrl_escape.agents.training.run import NO_OPTIONS, Run, RunArguments
from hrl_escape.agents.training.run_folder import RunFolder
from hrl_escape.agents.training.vector_streams import make_streams

__all__ = ["StreamRun", "keep_freed_memory"]

SEGMENT_PRIMITIVES, SEGMENT_STEPS = 16_384, 16
"""Size of a segment, a row of the log: primitives run in all streams together, and least steps."""
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # parameters of glibc's mallopt
_KEPT = 1 << 30  # bytes


class StreamRun(Run):
    """A run whose unit is a segment: a fixed number of steps of all streams.

    Args:
        agent: a new agent.
        env: vector environment or streams to train in.
        eval_env: ordinary environment of the same spaces, to evaluate in.
        arguments: arguments of the run; see `train`.
        callbacks: told of the run, in this order.
    """

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
        """Begin all episodes anew."""
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
        self._is_fresh = False
        sums: dict[str, float] = {}
        counts: dict[str, int] = {}
        for _ in range(self._steps):
            if self.is_spent:
                break
            asking = streams.is_waiting.nonzero().squeeze(1)
            action = torch.zeros(streams.count, dtype=torch.int64, device=streams.device)
            action[asking] = agent.act_streams(streams.observation[asking], streams.action_mask[asking], asking)
            ended = streams.step(action)
            decisions = gather_decisions(ended, streams.gamma, agent.gamma)
            for name, value in agent.observe_streams(decisions).items():
                sums[name], counts[name] = sums.get(name, 0.0) + value, counts.get(name, 0) + 1
            self.primitives += tally.add(decisions, ended.success[decisions.stream])
            self.decisions += len(decisions.stream)
            report(self.primitives, words)
        if self.primitives == self.decisions and before == 0 and self.arguments.name.startswith(SMDP_PREFIX):
            warnings.warn(NO_OPTIONS.format(name=self.arguments.name), stacklevel=2)
        seconds = time.perf_counter() - started
        self.seconds += seconds
        row = {
            "kind": "segment", "primitives": self.primitives, "decisions": self.decisions, **tally.take_row(),
            **{f"train/{name}": total / counts[name] for name, total in sums.items()},
            "time/seconds": self.seconds,
            "time/primitives_per_second": (self.primitives - before) / max(seconds, 1e-9),
        }
        self.segments.append(cast("SegmentRecord", read_row(row)))
        return row

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
            self.streams.load_state_dict(state["streams"])
            self._tally.load_state_dict(state["tally"])


class _StreamTally(Stateful):
    """Returns and lengths of running episodes, and sums over those that ended, on the device.

    The sums are empty between segments, so that the state is that of the running episodes.
    """

    STATE = ("_running",)

    def __init__(self, count: int, device: torch.device) -> None:
        self._running = torch.zeros((2, count), dtype=torch.float64, device=device)  # return and length so far
        self._sums = torch.zeros(4, dtype=torch.float64, device=device)  # returns, lengths, successes, episodes

    def add(self, decisions: StreamTransitions, success: Tensor) -> int:
        """Add decisions, and whether each ended an episode in success, bool (n,); returns the primitives that ran."""
        row = torch.stack((decisions.summed_reward.double(), decisions.duration.double()))
        running = self._running[:, decisions.stream] + row
        over = decisions.terminated | decisions.truncated
        self._running[:, decisions.stream] = torch.where(over, 0.0, running)
        ended = torch.stack((*running, success.double(), torch.ones_like(running[0])))
        self._sums += torch.where(over, ended, 0.0).sum(dim=1)
        return int(decisions.duration.sum())

    def take_row(self) -> dict[str, Any]:
        """Logged numbers of the episodes that ended since the last call."""
        returns, lengths, successes, episodes = self._sums.tolist()
        self._sums.zero_()
        return {"train/episodes": int(episodes), "train/successes": int(successes),
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
