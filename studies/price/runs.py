"""Runs of the price of flatness, a line of JSON each: when a learner first escaped, and when it was efficient.

A run ends with two efficient evaluations in a row, or with its budget. Times are processor seconds of the process, so
that other work on the machine does not count.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import torch
from gymnasium.vector import VectorEnv

from hrl_escape.agents.registry import get_recipe
from hrl_escape.agents.training.env_description import compute_digest
from hrl_escape.agents.training.evaluation import Evaluation
from hrl_escape.agents.training.results import TrainResult
from hrl_escape.agents.training.train import train
from hrl_escape.benchmark.statistics import compute_efficiency
from hrl_escape.env.instance import RoomInstance
from hrl_escape.errors import ComparisonError
from hrl_escape.options.options_env import OptionsEnv
from hrl_escape.planning.best_known import find_best_known
from hrl_escape.sets.goals import GoalsEnv
from hrl_escape.settings import replace_settings
from hrl_escape.version import __version__, find_versions
from studies.price.contestants import CONTESTANTS, EFFICIENT, FRESH, Contestant, sample_replicate_room
from studies.store import Store

__all__ = ["PriceRun", "compute_run_key", "list_price_runs", "measure_price_runs", "run_contestant"]


_LEAST_COMPILED = 64
"""Fewest copies of a room whose kernels are compiled, which takes some 10 s."""


@dataclass(frozen=True)
class PriceRun:
    """Result of one contestant in one room.

    Attributes:
        agent: label of the contestant.
        buttons: of the room.
        replicate: number; it is the training seed, and chooses the room.
        fewest: primitives of the best known escape.
        budget: primitives.
        primitives: trained for.
        first_escape: primitives at the end of the first training episode that escaped, in many streams at the end of
            its segment; None if none did.
        efficient_at: primitives at the first of two efficient evaluations in a row; None without such a pair.
        efficiency: in the last evaluation.
        episodes: training episodes that ended.
        escapes: how many of them escaped.
        seconds: of processor time, of training and evaluations; planning included.
        key: hash of everything that decides the numbers.
        curve: (primitives, efficiency) of each evaluation; empty of runs made before curves were kept.
    """

    agent: str
    buttons: int
    replicate: int
    fewest: int
    budget: int
    primitives: int
    first_escape: int | None
    efficient_at: int | None
    efficiency: float
    episodes: int
    escapes: int
    seconds: float
    key: str
    curve: tuple[tuple[int, float], ...] = ()

    @property
    def place(self) -> tuple[str, int, int]:
        """Subject of the line."""
        return self.agent, self.buttons, self.replicate


def list_price_runs(first: int, replicates: int, contestants: Sequence[Contestant] = CONTESTANTS
                    ) -> Iterator[tuple[Contestant, int, int]]:
    """Contestant, buttons and replicate of every run, in the order they are best made.

    Stage by stage, and in each replicate by replicate: whenever it is stopped, what is there is balanced.

    Args:
        first: replicate.
        replicates: number of them; a contestant may have fewer, the first of its series.
        contestants: all by default.
    """
    wanted = [(contestant, buttons, replicate) for replicate in range(first, first + replicates)
              for contestant in contestants for buttons in contestant.sizes
              if replicate % FRESH < contestant.replicates]
    yield from sorted(wanted, key=lambda run: run[0].stage)


def measure_price_runs(store: Store, first: int, replicates: int, minutes: float | None = None,
                       contestants: Sequence[Contestant] = CONTESTANTS) -> Iterator[PriceRun]:
    """Make the runs that a store lacks, or has without their curve, and keep each there at once.

    Args:
        store: of the lines.
        first: replicate.
        replicates: number of them.
        minutes: time limit for beginning a run; None for no limit.
        contestants: all by default.

    Raises:
        FileReadError: the file is damaged.
        FileWriteError: it cannot be written.
        EscapeError: see `train`.
    """
    keys = {line.place: line.key for line in store.load() if line.curve}
    end = None if minutes is None else time.monotonic() + 60 * minutes
    for contestant, buttons, replicate in list_price_runs(first, replicates, contestants):
        room = sample_replicate_room(buttons, replicate)
        if keys.get((contestant.label, buttons, replicate)) == compute_run_key(contestant, room, replicate):
            continue
        if end is not None and time.monotonic() >= end:
            return
        made = run_contestant(contestant, room, replicate)
        store.add([made])
        yield made


def compute_run_key(contestant: Contestant, room: RoomInstance, replicate: int) -> str:
    """Hash of everything that decides a run's numbers; labels and other runs do not.

    Settings at their defaults are left out, so that a setting which agents gain keeps the runs made before.
    """
    defaults = dataclasses.asdict(get_recipe(contestant.agent))
    settings = dataclasses.asdict(replace_settings(get_recipe(contestant.agent), contestant.settings))
    return compute_digest({
        "version": __version__, "versions": find_versions(), "agent": contestant.agent,
        "settings": {name: value for name, value in settings.items() if value != defaults[name]},
        "streams": contestant.streams, "room": room.id, "seed": replicate,
        "budget": contestant.budget, "eval_every": contestant.eval_every, "efficient": EFFICIENT})


def run_contestant(contestant: Contestant, room: RoomInstance, replicate: int) -> PriceRun:
    """Train a contestant in a room until it is efficient, or its budget is spent.

    Raises:
        ComparisonError: no escape is known.
        EscapeError: see `train`.
    """
    single = _make_single(room)
    single.reset(seed=0)
    fewest = find_best_known(room, single.unwrapped.get_state()).primitives
    if fewest is None:
        raise ComparisonError(f"{room.name}#{room.seed}: no escape is known, so efficiency cannot be measured")
    most = fewest / EFFICIENT  # with goals, a primitive costs 1 and the last is free
    least = 1 - most - 1e-9 if contestant.has_goals else room.reward.exit + room.reward.step * most
    env = _make_training_env(contestant, room, single)
    started = time.process_time()
    result = train(contestant.agent, env, settings=contestant.settings,
                   eval_env=single if contestant.streams else None, primitives=contestant.budget, seed=replicate,
                   eval_every=contestant.eval_every, eval_episodes=1, progress=False, until_return=least)
    seconds = time.process_time() - started
    env.close()
    episodes, escapes = _count_episodes(result)
    found = [_measure_efficiency(evaluation, fewest) for evaluation in result.evaluations]
    return PriceRun(
        agent=contestant.label, buttons=len(room.targets), replicate=replicate, fewest=fewest, budget=contestant.budget,
        primitives=result.primitives, first_escape=result.first_escape,
        efficient_at=_find_efficient(result.evaluations, found), efficiency=round(found[-1], 4),
        episodes=episodes, escapes=escapes, seconds=round(seconds, 2), key=compute_run_key(contestant, room, replicate),
        curve=tuple((evaluation.primitives, round(value, 4))
                    for evaluation, value in zip(result.evaluations, found, strict=True)),
    )


def _make_single(room: RoomInstance) -> Any:
    return gymnasium.make("hrl_escape/EscapeRoom-v1", instance=room, observation="features", disable_env_checker=True)


def _make_training_env(contestant: Contestant, room: RoomInstance, single: gymnasium.Env) -> gymnasium.Env | VectorEnv:
    """Training environment of a contestant; kernels of many copies are compiled outside of its time."""
    if contestant.has_options:
        return OptionsEnv(single, include_primitives=False)
    if contestant.has_goals:
        return GoalsEnv(single, exits=1.0)
    if not contestant.streams:
        return single
    many = gymnasium.make_vec("hrl_escape/EscapeRoom-v1", num_envs=contestant.streams, instance=room,
                              observation="features", output="torch", compile=contestant.streams >= _LEAST_COMPILED)
    many.reset(seed=0)
    many.step(torch.zeros(contestant.streams, dtype=torch.int64))
    return many


def _measure_efficiency(evaluation: Evaluation, fewest: int) -> float:
    return float(compute_efficiency(evaluation.escaped, evaluation.lengths, fewest).clip(max=1).mean())


def _count_episodes(result: TrainResult) -> tuple[int, int]:
    """Training episodes that ended before the budget did, and how many of them escaped."""
    ended = [(segment.episodes, segment.successes or 0) for segment in result.segments] or [
        (1, bool(episode.success)) for episode in result.episodes if episode.end != "budget"]
    return sum(number for number, _ in ended), sum(int(escapes) for _, escapes in ended)


def _find_efficient(evaluations: Sequence[Evaluation], efficiencies: Sequence[float]) -> int | None:
    for number in range(len(evaluations) - 1):
        if min(efficiencies[number : number + 2]) >= EFFICIENT - 1e-9:
            return evaluations[number].primitives
    return None
