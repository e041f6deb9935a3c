"""Many training seeds of one algorithm at once: runs side by side, their updates made as one batch.

Each run goes on by itself, its own environment, generators and budget, until its learner has an update due; then all
runs that wait are answered by one batched update. So no run waits for another's longer options or evaluations, and each
makes the decisions that it would make alone. No result depends on which other seeds are trained.
"""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, MutableSequence, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

import gymnasium

from hrl_escape.agents.agent import Agent, StateTree
from hrl_escape.agents.progress import Reporter, show_progress
from hrl_escape.agents.registry import get_agent_class, list_agents
from hrl_escape.agents.results import TrainResult
from hrl_escape.agents.run import Reply, Run
from hrl_escape.errors import AgentSettingsError, DivergenceError, WorkerLostError
from hrl_escape.processes import die_with_parent

__all__ = ["Trials", "check_batched", "find_maker", "list_batched_agents"]

TICK_SECONDS = 0.2
"""Between looks at the progress."""


def list_batched_agents() -> list[str]:
    """Names of the agents that can be trained in trials; each also with the prefix `smdp-`."""
    return [name for name in list_agents() if hasattr(get_agent_class(name), "learn")]


def check_batched(agent: str | Agent, trials: int) -> None:
    """Refuse an agent that has no batched form.

    Raises:
        AgentSettingsError: says which have.
    """
    if not isinstance(agent, str):
        raise AgentSettingsError("agent", agent, "trials make an agent for every seed: give a name, not an agent")
    name = agent
    if not hasattr(get_agent_class(name), "learn"):
        problem = f"{name} has no batched form; these have: {', '.join(list_batched_agents())}. Train its seeds alone"
        raise AgentSettingsError("trials", trials, problem)


def find_maker(name: str, env: gymnasium.Env | Callable[[], gymnasium.Env]) -> Callable[[], gymnasium.Env]:
    """What makes environments like this one, or the function that was given.

    Raises:
        AgentSettingsError: the environment has no spec to make it from.
    """
    if not isinstance(env, gymnasium.Env):
        return env
    spec, hint = env.spec, "give a function that makes one, such as lambda: gymnasium.make(...)"
    if spec is None:
        raise AgentSettingsError(name, env, f"trials need one environment each, and this one has no spec: {hint}")

    def make() -> gymnasium.Env:
        try:
            return gymnasium.make(spec)
        except (gymnasium.error.Error, ValueError) as error:
            problem = f"trials need one environment each, and this one cannot be made anew ({error}): {hint}"
            raise AgentSettingsError(name, env, problem) from error

    return make


@dataclass(frozen=True)
class Trials:
    """Runs of one agent, a seed each.

    Attributes:
        name: the agent's.
        seeds: one a run.
        make_run: makes the run of a seed, with an environment of its own and its folder open.
        revive: makes the agent of a seed as a state says, for what another process has trained.
        primitives: budget of each.
        checkpoint_seconds: between checkpoints of each.
    """

    name: str
    seeds: Sequence[int]
    make_run: Callable[[int], Run]
    revive: Callable[[int, StateTree], Agent]
    primitives: int
    checkpoint_seconds: float

    def train(self, workers: int, progress: bool | None) -> list[TrainResult]:
        """Train all; when one fails, the others go on to their ends before its error is raised.

        Args:
            workers: processes that share the seeds.
            progress: show a line; None on a terminal only.

        Returns:
            Results in the order of the seeds.
        """
        with self._watch(progress) as (counts, report):
            if workers == 1:
                outcomes = dict(enumerate(self._train_group(range(len(self.seeds)), counts, report)))
            else:
                outcomes = self._train_in_processes(min(workers, len(self.seeds)), counts, report)
        for _, outcome in sorted(outcomes.items()):
            if isinstance(outcome, Exception):
                raise outcome
        return [outcome for _, outcome in sorted(outcomes.items()) if isinstance(outcome, TrainResult)]

    @contextmanager
    def _watch(self, progress: bool | None) -> Iterator[tuple[MutableSequence[int], Callable[[], None]]]:
        """Primitives of each run, to be written by whoever trains, and what shows their sum."""
        counts = multiprocessing.get_context().RawArray("q", len(self.seeds))
        label, total = f"{self.name} x {len(self.seeds)}", self.primitives * len(self.seeds)
        with show_progress(label, total, 0, progress) as reporter:
            yield counts, lambda: reporter(sum(counts), self._describe(counts))

    def _describe(self, counts: Sequence[int]) -> str:
        return f"{sum(count >= self.primitives for count in counts)} of {len(counts)} done"

    # --- in this process ---------------------------------------------------------------

    def _train_group(
        self, numbers: Sequence[int], counts: MutableSequence[int], report: Callable[[], None]
    ) -> list[TrainResult | Exception]:
        runs: list[Run] = []
        last = time.monotonic()

        def note(number: int, primitives: int, words: str) -> None:
            nonlocal last
            counts[number] = primitives
            if (now := time.monotonic()) - last >= TICK_SECONDS:
                last = now
                report()

        try:
            for number in numbers:
                runs.append(self.make_run(self.seeds[number]))
                counts[number] = runs[-1].primitives
            return follow_together(runs, self.checkpoint_seconds, [partial(note, number) for number in numbers])
        finally:
            for run in runs:
                run.close()
                run.env.close()
                run.eval_env.close()

    # --- in several --------------------------------------------------------------------

    def _train_in_processes(
        self, workers: int, counts: MutableSequence[int], report: Callable[[], None]
    ) -> dict[int, TrainResult | Exception]:
        context = multiprocessing.get_context("fork")  # environments need not travel: each process makes its own
        outcomes: dict[int, TrainResult | Exception] = {}
        active: dict[Connection, tuple[BaseProcess, Sequence[int]]] = {}
        try:
            for worker in range(workers):
                numbers = range(worker, len(self.seeds), workers)
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(target=self._work, args=(numbers, counts, sender), daemon=True)
                process.start()
                sender.close()
                active[receiver] = process, numbers
            while active:
                for receiver in wait(list(active), TICK_SECONDS):
                    process, numbers = active.pop(receiver)  # pyright: ignore[reportArgumentType]
                    outcomes |= self._receive(receiver, process, numbers)  # pyright: ignore[reportArgumentType]
                report()
        finally:
            for process, _ in active.values():
                process.kill()
                process.join()
        return outcomes

    def _work(self, numbers: Sequence[int], counts: MutableSequence[int], sender: Connection) -> None:
        """What a process does: train its share, and send results with the agents' states."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the parent too, and the parent decides
        die_with_parent()
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(1)  # the processes fill the cores already
        try:
            outcomes = self._train_group(numbers, counts, lambda: None)
        except Exception as error:
            outcomes = [error] * len(numbers)
        sender.send([_pack(outcome) for outcome in outcomes])

    def _receive(
        self, receiver: Connection, process: BaseProcess, numbers: Sequence[int]
    ) -> dict[int, TrainResult | Exception]:
        seeds = [self.seeds[number] for number in numbers]
        try:
            packed = receiver.recv()
        except EOFError:
            process.join()
            return dict.fromkeys(numbers, WorkerLostError(self.name, seeds, process.exitcode))
        process.join()
        return {number: self._unpack(seed, one) for number, seed, one in zip(numbers, seeds, packed, strict=True)}

    def _unpack(self, seed: int, packed: Any) -> TrainResult | Exception:
        if isinstance(packed, Exception):
            return packed
        result, state = packed
        return TrainResult.from_json(result, self.revive(seed, state))


def follow_together(
    runs: Sequence[Run], checkpoint_seconds: float, reports: Sequence[Reporter]
) -> list[TrainResult | Exception]:
    """Follow runs to their ends, answering together those that wait for an update.

    Args:
        runs: of one agent class and the same settings, made to hand out their updates.
        checkpoint_seconds: see `Run.follow`.
        reports: one a run.

    Returns:
        What each came to; an error ends its own run only.
    """
    steps = [run.follow(checkpoint_seconds, report) for run, report in zip(runs, reports, strict=True)]
    outcomes: dict[int, TrainResult | Exception] = {}
    waiting: dict[int, Any] = {}

    def advance(number: int, resume: Callable[[], Any]) -> None:
        try:
            waiting[number] = resume()
        except StopIteration as end:
            outcomes[number] = end.value
        except Exception as error:
            outcomes[number] = error

    make_together: Any = getattr(runs[0].agent, "make_together", None)
    members = tuple(range(len(runs)))
    together: Any = make_together([run.agent for run in runs]) if make_together else None
    try:
        for number in members:
            advance(number, partial(next, steps[number]))
        while waiting:
            if tuple(waiting) != members:
                members = tuple(waiting)
                together = make_together([runs[number].agent for number in members])
            started = time.perf_counter()
            results = together.update(list(waiting.values()))
            share = (time.perf_counter() - started) / len(members)
            waiting.clear()
            for number, result in zip(members, results, strict=True):
                if isinstance(result, DivergenceError):
                    advance(number, partial(steps[number].throw, result))
                else:
                    advance(number, partial(steps[number].send, Reply(result, share)))
    finally:
        for step in steps:
            step.close()
    return [outcomes[number] for number in range(len(runs))]


def _pack(outcome: TrainResult | Exception) -> Any:
    """What can travel to the parent: an error, or a result with its agent's state."""
    if isinstance(outcome, TrainResult):
        assert outcome.agent is not None, "a run that this process finished or loaded has its agent"
        return outcome.to_json(), outcome.agent.state_dict()
    try:
        return pickle.loads(pickle.dumps(outcome))
    except Exception:
        return RuntimeError("".join(traceback.format_exception(outcome)))
