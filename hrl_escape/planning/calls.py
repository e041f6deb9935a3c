"""Planning calls that run concurrently: in a thread that can be cancelled, or many at once over processes."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor

from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ConfigError
from hrl_escape.planning.planner import RoomPlanner
from hrl_escape.planning.requests import PlanningRequest, PlanningResult
from hrl_escape.processes import die_with_parent


class PlanningCall:
    """A planning call under way in another thread.

    Made by `start_planning`. Calls of one planner run one after another; those of several planners share the
    interpreter. `plan_many` uses several cores.

    Attributes:
        request: what was asked.
    """

    def __init__(self, planner: RoomPlanner, request: PlanningRequest,
                 on_improvement: Callable[[PlanningResult], None] | None) -> None:
        self.request = request
        self._stop = threading.Event()
        self._future: Future[PlanningResult] = Future()
        self._best: PlanningResult | None = None

        def note(result: PlanningResult) -> None:
            self._best = result
            if on_improvement is not None:
                on_improvement(result)

        def run() -> None:
            try:
                self._future.set_result(planner.answer(request, stop=self._stop, on_improvement=note))
            except BaseException as error:  # raised again in the thread that asks for the result
                self._future.set_exception(error)

        threading.Thread(target=run, name="planning", daemon=True).start()

    @property
    def best(self) -> PlanningResult | None:
        """Best result so far; None before the first plan."""
        return self._best

    def is_done(self) -> bool:
        """Return whether the call has ended."""
        return self._future.done()

    def cancel(self) -> None:
        """Stop the call early; its result is then the best plan so far, or a failure for the reason `cancelled`."""
        self._stop.set()

    def get_result(self, timeout: float | None = None) -> PlanningResult:
        """Wait for the result.

        Args:
            timeout: s; None to wait for ever.

        Raises:
            TimeoutError: no result within the timeout; the call continues.
            EscapeError: what `RoomPlanner.answer` raised.
        """
        return self._future.result(timeout)


def start_planning(planner: RoomPlanner, request: PlanningRequest,
                   on_improvement: Callable[[PlanningResult], None] | None = None) -> PlanningCall:
    """Start a planning call in another thread.

    Args:
        planner: the room's planner.
        request: what to plan.
        on_improvement: called in that thread with the first plan and with every better one.
    """
    return PlanningCall(planner, request, on_improvement)


def plan_many(instance: RoomInstance, requests: Sequence[PlanningRequest], workers: int = 1) -> list[PlanningResult]:
    """Answer requests in one room, over several processes; the results are those of one process.

    Args:
        instance: the room.
        requests: what to plan.
        workers: processes; 1 for this one.

    Returns:
        One result a request, in order.

    Raises:
        ConfigError: the number of workers is below 1.
        EscapeError: what `RoomPlanner.answer` raises.
    """
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ConfigError("workers", workers, "a whole number of processes, at least 1")
    if workers == 1 or len(requests) < 2:
        planner = RoomPlanner(instance)
        return [planner.answer(request) for request in requests]
    context = multiprocessing.get_context("spawn")  # a fork would copy locks that other threads hold
    with ProcessPoolExecutor(min(workers, len(requests)), context, _begin, (instance,)) as pool:
        return list(pool.map(_answer, requests, chunksize=max(1, len(requests) // (4 * workers))))


_planners: list[RoomPlanner] = []


def _begin(instance: RoomInstance) -> None:
    die_with_parent()
    _planners.append(RoomPlanner(instance))


def _answer(request: PlanningRequest) -> PlanningResult:
    return _planners[0].answer(request)
