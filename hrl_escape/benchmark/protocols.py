"""Protocols of the benchmarks: the grid of a rung under each.

A protocol says which rooms of a rung agents train in and which they are tested in. `standings.py` scores the results.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.agents.text_agent import TEXT_AGENT
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.references.registry import SWEEP_BASELINES
from hrl_escape.errors import ConfigError
from hrl_escape.sets.benchmark import Benchmark
from hrl_escape.sets.grammar import THEN
from hrl_escape.sets.room_sequence import SEQUENCE_HORIZON
from hrl_escape.sets.room_spec import RoomSpec

Protocol: TypeAlias = Literal["per-instance", "generalise", "transfer", "few-shot", "sequence"]
"""Training and test rooms of the agents on a rung.

- `per-instance`: train from scratch in each test room.
- `generalise`: train in training rooms, test in other rooms of the same rung.
- `transfer`: train in training rooms of one rung, test in rooms of another.
- `few-shot`: as `generalise`, with several trials in each room; memories persist across trials, weights are frozen.
- `sequence`: as `generalise`, with a room of every rung in an episode, one after another.
"""

BUDGETS = dict.fromkeys(("doormat", "pair", "chain-3", "chain-4", "chain"), 20_000) | {"house": 500_000}
"""Primitives of a run, by rung."""
BUDGET = 100_000
"""Primitives of a run on any other rung."""
SEQUENCE: Literal["sequence"] = "sequence"
"""Name of the protocol, and of its sequence of rungs in results by rung."""
SEQUENCE_ROOMS = 10
"""Test rooms of each rung of a sequence, by default."""
EVALUATIONS = 5
"""Evaluations in a run after the first."""


def get_budget(rung: str) -> int:
    """Return the default training budget on a rung, in primitives."""
    return BUDGETS.get(rung, BUDGET)


@dataclasses.dataclass(frozen=True)
class LadderSettings:
    """Settings of a protocol; None selects the protocol's default."""

    runs: int = 10
    """Training seeds in each room or set."""
    primitives: int | None = None
    """Training budget of a run; the rung's own by default."""
    rooms: int | None = None
    """Rooms of the test set; by default 10 with per-instance and for each rung of a sequence, otherwise all."""
    train_sizes: tuple[int, ...] = (64,)
    """Numbers of training rooms, each a set of its own; with the protocol sequence, of every rung. Not for
    per-instance."""
    eval_episodes: int | None = None
    """Episodes in an evaluation; by default 20 with per-instance, otherwise one in each test room."""
    observation: str | None = None
    """Observation of all agents; by default of the rung's axis, else features with per-instance if no agent is
    +objects, otherwise objects."""
    source: str | None = None
    """Rung to train on with transfer."""
    trials: int = 8
    """Trials in each room with few-shot."""
    first_seed: int = 0
    """Lowest training seed."""
    repeats: int = 1
    """Rooms in a sequence of one rung; their cues follow one latent code per episode."""


def name_protocol(protocol: Protocol, source: str | None) -> str:
    """Return the folder name of a protocol, such as `generalise` or `transfer-from-chain`."""
    if (protocol == "transfer") != (source is not None):
        raise ConfigError("from", source, "the rung to train on with the protocol transfer, and with no other")
    return protocol if source is None else f"{protocol}-from-{source}"


def make_protocol_grid(bench: Benchmark, rung: str, protocol: Protocol, agents: Sequence[AgentSpec],
                       settings: LadderSettings) -> Grid:
    """Make the grid of a rung under a protocol other than `sequence`.

    Args:
        bench: the benchmark.
        rung: name of the rung to test on.
        protocol: the protocol.
        agents: specs of the agents.
        settings: numbers of rooms and runs.

    Raises:
        UnknownNameError: no such rung.
        ConfigError: more rooms than the rung has, or a rung to train on that does not go with the protocol.
    """
    label = name_protocol(protocol, settings.source)
    if protocol == "few-shot" and settings.trials < 2:
        raise ConfigError("trials", settings.trials, "2 or more; with one it is the protocol generalise")
    record, source = bench[rung].record, settings.source or rung
    if settings.source == rung:
        raise ConfigError("from", rung, f"another rung than {rung}; the protocol generalise trains and tests on one")
    name, test = f"{bench.source}/{rung}", record.test.count
    count = settings.rooms if settings.rooms is not None else min(10, test) if protocol == "per-instance" else test
    if not 1 <= count <= test:
        raise ConfigError("rooms", count, f"from 1 to {test}, the rooms of {name}/test")
    primitives = get_budget(source) if settings.primitives is None else settings.primitives
    is_plain = protocol == "per-instance" and not any(agent.reads_objects for agent in agents)
    given = next((axis.observation for axis in bench.manifest.axes if rung in axis.rungs), "")
    observation = settings.observation or given or ("features" if is_plain else "objects")
    if protocol == "per-instance":
        return _make_grid(
            f"{bench.name}-{rung}-per-instance", f"Each of {count} rooms of {name} from nothing.", agents, settings,
            primitives, 20, observation, rooms=tuple(RoomSpec(f"{name}/test#{index}") for index in range(count)))
    train, most = f"{bench.source}/{source}", bench[source].record.train.count
    for size in settings.train_sizes:
        if not 1 <= size <= most:
            raise ConfigError("train_sizes", size, f"from 1 to {most}, the rooms of {train}/train")
    tested = f"{count} others" if source == rung else f"{count} of {name}, without learning there"
    return _make_grid(
        f"{bench.name}-{rung}-{label}", f"Trained in rooms of {train}, tested in {tested}.", agents, settings,
        primitives, count, observation, train_rooms=tuple(f"{train}/train#0..{size}" for size in settings.train_sizes),
        test_rooms=(f"{name}/test#0..{count}",), trials=settings.trials if protocol == "few-shot" else 1)


def _make_grid(name: str, description: str, agents: Sequence[AgentSpec], settings: LadderSettings, primitives: int,
               episodes: int, observation: str, **rooms: Any) -> Grid:
    return Grid(name, description, tuple(agents), runs=settings.runs, first_seed=settings.first_seed,
                primitives=primitives, eval_every=max(1, primitives // EVALUATIONS),
                eval_episodes=episodes if settings.eval_episodes is None else settings.eval_episodes,
                observation=observation, **rooms)


def choose_sequence(bench: Benchmark) -> tuple[str, ...]:
    """Return the rungs whose robots have the same primitives as the first rung's, in order."""
    first, *_ = bench
    return tuple(rung.name for rung in bench if rung.config.robot.actions == first.config.robot.actions)


def make_sequence_grid(bench: Benchmark, rungs: Sequence[str], agents: Sequence[AgentSpec], settings: LadderSettings
                       ) -> Grid:
    """Make the grid of the protocol `sequence`: an episode has a room of every rung, one after another.

    Args:
        bench: the benchmark.
        rungs: names of the rungs, in order; one with `settings.repeats` above 1.
        agents: specs of the agents.
        settings: numbers of rooms and runs.

    Raises:
        UnknownNameError: no such rung.
        ConfigError: fewer than two rungs without `repeats`, more rooms than a rung has, or an agent that follows the
            numbers of one room's options.
    """
    name_protocol(SEQUENCE, settings.source)
    records = [bench[rung].record for rung in rungs]
    repeats = settings.repeats > 1
    if len(rungs) != 1 if repeats else len(rungs) < 2 or len(set(rungs)) < len(rungs):
        raise ConfigError("rung", " ".join(rungs), "one rung with repeats above 1" if repeats else
                          "two or more with the protocol sequence, each once")
    followers = [agent.label for agent in agents if agent.name in (*SWEEP_BASELINES, TEXT_AGENT)]
    if followers:
        raise ConfigError("agents", followers[0], "an agent that does not follow the numbers of options, because "
                          "the rooms of a sequence have different options")
    most = min(record.test.count for record in records)
    count = settings.rooms if settings.rooms is not None else most if repeats else min(SEQUENCE_ROOMS, most)
    for field, role, number in (("rooms", "test", count), *(("train_sizes", "train", n) for n in settings.train_sizes)):
        most = min(getattr(record, role).count for record in records)
        if not 1 <= number <= most:
            raise ConfigError(field, number, f"from 1 to {most}, the rooms that {role} of every rung has")

    def name_rooms(role: str, number: int) -> str:
        text = THEN.join(f"{bench.source}/{rung}/{role}#0..{number}" for rung in rungs)
        return f"{text} x {settings.repeats}" if repeats else text

    primitives = max(map(get_budget, rungs)) if settings.primitives is None else settings.primitives
    rooms = (f"{settings.repeats} rooms of {bench.name}/{rungs[0]} with one latent code" if repeats else
             f"A room of each of {len(rungs)} rungs of {bench.name}, from {rungs[0]} to {rungs[-1]},")
    return _make_grid(
        f"{bench.name}-{SEQUENCE}", f"{rooms} in an episode of {SEQUENCE_HORIZON:,} primitives; tested in others than "
        "those trained in.", agents, settings, primitives, count, settings.observation or "objects",
        train_rooms=tuple(name_rooms("train", size) for size in settings.train_sizes),
        test_rooms=(name_rooms("test", count),))
