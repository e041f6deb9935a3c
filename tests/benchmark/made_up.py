"""Comparisons whose results are written down by hand, so that what they amount to is known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hrl_escape.agents.spec import parse_specs
from hrl_escape.agents.training.evaluation import Evaluation
from hrl_escape.benchmark.comparison import Comparison
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.launching.local import Failure
from hrl_escape.benchmark.runs import RunResult
from hrl_escape.benchmark.score_range import ScoreRange
from hrl_escape.env.presets import get_preset
from hrl_escape.env.sampling.generation import generate
from hrl_escape.sets.places import RunPlace
from hrl_escape.sets.room_spec import RoomSpec

ROOM = generate(get_preset("paper-two-button"), 0)
OTHER_ROOM = generate(get_preset("paper-one-button"), 0)
WORST, BEST = -1000.0, 100.0
START = ((0.0, 0.0, 0, 0.0),)


def make_result(returns: Sequence[float], best: float = BEST, reachable: float | None = None, budget: int = 1000,
                source: str = "planner", start: tuple = START) -> RunResult:
    """A run with these returns of one episode, evaluated at equal distances from 0 to the budget, or at its end.

    An escape at once earns `BEST` and each primitive more costs 1.
    """
    places = [budget * number / (len(returns) - 1) for number in range(len(returns))] if len(returns) > 1 else [budget]
    evaluations = tuple(
        Evaluation(
            primitives=round(place), decisions=number * 10, returns=(value,), lengths=(1 + round(BEST - value),),
            decision_counts=(5,), successes=(value > WORST,), progress=(float(value > WORST),),
        )
        for number, (place, value) in enumerate(zip(places, returns, strict=True))
    )
    reach = best if reachable is None else reachable
    fewest, fewest_reachable = 1 + round(BEST - best), 1 + round(BEST - reach)
    score_range = ScoreRange(WORST, start, (best,), (reach,), (fewest,), (fewest_reachable,), source)
    first = next((round(place) for place, value in zip(places, returns, strict=True) if value > WORST), None)
    seconds = tuple(map(float, range(len(returns))))
    return RunResult(budget, budget, 10 * len(returns), 7, 3, first, evaluations, score_range, None, seconds,
                     0.5, {"torch": "1.0"})


def compare(agents: dict[str, Sequence[Sequence[float] | RunResult | None]], rooms: int = 1, budget: int = 1000,
            runs: int | None = None) -> Comparison:
    """A comparison from each agent's runs, room by room.

    Args:
        agents: spec -> runs, each the returns at its evaluations, a result, or None for a failure.
        rooms: 1 or 2.
        budget: primitives.
        runs: of an agent in a room; as many as the longest list has by default.
    """
    specs = parse_specs(agents)
    instances = (ROOM, OTHER_ROOM)[:rooms]
    runs = runs or max(map(len, agents.values())) // rooms
    grid = Grid("made-up", agents=specs, rooms=tuple(RoomSpec(i.name) for i in instances), runs=runs, primitives=budget)
    places = tuple(RunPlace.of_room(instance) for instance in instances)
    by_place = {(run.number, run.place_id, run.seed): run for run in grid.make_runs(places)}
    found, failures = [], []
    for number, results in enumerate(agents.values()):
        for index, result in enumerate(results):
            room, seed = divmod(index, runs)
            run = by_place[number, instances[room].id, seed]
            if result is None:
                failures.append(Failure(run, "it fell over"))
            else:
                made = result if isinstance(result, RunResult) else make_result(result, budget=budget)
                found.append((run, made))
    return Comparison(grid, places, tuple(found), tuple(failures), Path("nowhere"))
