"""Protocols of the ladder: the grid of a rung under each, and which rungs an agent has passed.

Every protocol is a grid for the same comparison; nothing here runs anything.

The ladder score is one number an agent, the mean over rungs of the interquartile mean of efficiency. Rungs are strata
of equal weight, as tasks are in Agarwal et al. (2021). Within a rung whole rooms are drawn, since runs in one room are
much alike: ten seeds in one room say nothing of the next room. Draws are those of `inference.py`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from hrl_escape.agents.spec import BAYES, AgentSpec
from hrl_escape.agents.text_agent import TEXT_AGENT
from hrl_escape.benchmark.grid import Grid
from hrl_escape.benchmark.inference import LEVEL, RESAMPLES, Estimate, compute_wilson_interval, draw_weights
from hrl_escape.benchmark.references.registry import BY_LIGHTS, BY_NUMBER
from hrl_escape.benchmark.statistics import Floats, Scores, compute_iqm
from hrl_escape.benchmark.summary import AgentSummary, Summary
from hrl_escape.errors import ConfigError
from hrl_escape.sets.benchmark import Benchmark
from hrl_escape.sets.grammar import THEN
from hrl_escape.sets.room_sequence import SEQUENCE_HORIZON, list_sets
from hrl_escape.sets.room_spec import RoomSpec

LEAST_HEADROOM = 0.05
"""Least efficiency between search baseline and Bayes planner for which the learned share is given."""


def compute_learned_share(efficiency: float, search: float, bayes: float) -> float | None:
    """Place on the scale from the best search baseline (0) to the Bayes planner, `bayes` (1), in efficiency.

    The Bayes planner is given how rooms are drawn and what marks mean, and discovers the graph; the baseline is not
    given the room configuration. Below 0 for an agent worse than the baseline, above 1 for one better than the Bayes
    planner; None where less than `LEAST_HEADROOM` is between the two.
    """
    return (efficiency - search) / (bayes - search) if bayes - search >= LEAST_HEADROOM else None


def compute_ladder_score(rungs: Sequence[Scores], rng: np.random.Generator, resamples: int = RESAMPLES) -> Estimate:
    """Mean over rungs of the interquartile mean over a rung's runs, with its 95 % interval.

    Each rung has one array (runs,) of efficiencies from 0 to 1 for each unit that is drawn as a whole: a room that was
    learned in, or a run that was tested in unseen rooms.
    """
    value = float(np.mean([compute_iqm(units) for units in rungs]))
    lower, upper = (np.mean(ends, axis=0)
                    for ends in zip(*(_draw_ends(units, rng, resamples) for units in rungs), strict=True))
    return Estimate(value, float(np.quantile(lower, (1 - LEVEL) / 2)), float(np.quantile(upper, (1 + LEVEL) / 2)))


def _draw_ends(units: Scores, rng: np.random.Generator, resamples: int) -> tuple[Floats, Floats]:
    """Draws (resamples,) of a rung's interquartile mean with the lowest efficiency added, and with the highest."""
    drawn = draw_weights(len(units), resamples, rng)
    shares = [np.repeat(drawn[:, [number]] / len(unit), len(unit), axis=-1) for number, unit in enumerate(units)]
    weights = np.concatenate([*shares, drawn[:, -1:]], axis=-1)
    lower, upper = (compute_iqm([np.concatenate([*units, [bound]])], [weights]) for bound in (0.0, 1.0))
    return lower, upper


# --- protocols ---------------------------------------------------------------------------

Protocol: TypeAlias = Literal["per-instance", "generalise", "transfer", "few-shot", "tower"]
"""`per-instance`: learn each test room from nothing. `generalise`: learn in training rooms, be tested in others of the
same rung. `transfer`: learn in training rooms of one rung, be tested in rooms of another. `few-shot`: as `generalise`,
with several trials in each room, through which memories last and weights stay as they are. `tower`: as `generalise`,
with a room of every rung in an episode, one after another."""

BUDGETS = dict.fromkeys(("doormat", "pair", "chain-3", "chain-4", "chain"), 20_000) | {"house": 500_000}
"""Primitives of a run, by rung."""
BUDGET = 100_000
"""Primitives of a run on any other rung."""
TOWER: Literal["tower"] = "tower"
"""Name of the protocol, and of its rungs in sequence where results go by rung."""
FLOOR_ROOMS = 10
"""Rooms of each floor of a tower to be tested in, by default."""
EVALUATIONS = 5
"""Evaluations in a run after the first."""
PASSED_RATE, PASSED_EFFICIENCY = 0.9, 0.5
"""A rung is passed with a success rate above the first, by the lower end of Wilson's interval, and efficiency above the
second."""


def get_budget(rung: str) -> int:
    """Primitives of a run on a rung, unless others are asked for."""
    return BUDGETS.get(rung, BUDGET)


@dataclasses.dataclass(frozen=True)
class LadderSettings:
    """Numbers that may be changed; None for the protocol's own."""

    runs: int = 10
    """Training seeds in each room or set."""
    primitives: int | None = None
    """Training budget of a run; the rung's own by default."""
    rooms: int | None = None
    """Rooms of the test set; by default 10 with per-instance and on each floor of a tower, otherwise all."""
    train_sizes: tuple[int, ...] = (64,)
    """Numbers of training rooms, each a set of its own, with all protocols but per-instance; in a tower those of every
    floor."""
    eval_episodes: int | None = None
    """Episodes in an evaluation; by default 20 with per-instance, otherwise one in each test room."""
    observation: str | None = None
    """Observation of all agents; by default that of the rung's axis, else features with per-instance if no agent is
    +objects, otherwise objects."""
    source: str | None = None
    """Rung to train on with transfer."""
    trials: int = 8
    """Trials in each room with few-shot."""
    first_seed: int = 0
    """Lowest training seed; another one replicates results with fresh seeds."""
    floors: int = 1
    """Floors of a tower of one rung, whose marks follow one motif in an episode, so that the first floor teaches it."""


def name_protocol(protocol: Protocol, source: str | None) -> str:
    """Name of a protocol's folder, such as `generalise` or, with a rung to train on, `transfer-from-chain`."""
    if (protocol == "transfer") != (source is not None):
        raise ConfigError("from", source, "the rung to train on with the protocol transfer, and with no other")
    return protocol if source is None else f"{protocol}-from-{source}"


def make_protocol_grid(bench: Benchmark, rung: str, protocol: Protocol, agents: Sequence[AgentSpec],
                       settings: LadderSettings) -> Grid:
    """Grid of a rung under a protocol.

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


def choose_floors(bench: Benchmark) -> tuple[str, ...]:
    """Rungs, in order, whose robots have the primitives of the first rung's: the floors of the benchmark's tower."""
    first, *_ = bench
    return tuple(rung.name for rung in bench if rung.config.robot.actions == first.config.robot.actions)


def make_tower_grid(bench: Benchmark, rungs: Sequence[str], agents: Sequence[AgentSpec], settings: LadderSettings
                    ) -> Grid:
    """Grid of rungs, by name from the bottom to the top, as the floors of one tower.

    Raises:
        UnknownNameError: no such rung.
        ConfigError: fewer than two floors, one twice but by `floors`, more rooms than a rung has, or an agent that
            follows the numbers of one room's options.
    """
    name_protocol(TOWER, settings.source)
    records = [bench[rung].record for rung in rungs]
    repeats = settings.floors > 1
    if len(rungs) != 1 if repeats else len(rungs) < 2 or len(set(rungs)) < len(rungs):
        raise ConfigError("rung", " ".join(rungs), "one with several floors" if repeats else
                          "two or more with the protocol tower, each once")
    followers = [agent.label for agent in agents if agent.name in (*BY_NUMBER, TEXT_AGENT)]
    if followers:
        raise ConfigError("agents", followers[0], "one that does not follow the options of one room, which the floors "
                          "of a tower have not in common")
    most = min(record.test.count for record in records)
    count = settings.rooms if settings.rooms is not None else most if repeats else min(FLOOR_ROOMS, most)
    for field, role, number in (("rooms", "test", count), *(("train_sizes", "train", n) for n in settings.train_sizes)):
        most = min(getattr(record, role).count for record in records)
        if not 1 <= number <= most:
            raise ConfigError(field, number, f"from 1 to {most}, the rooms that {role} of every floor has")

    def name_rooms(role: str, number: int) -> str:
        text = THEN.join(f"{bench.source}/{rung}/{role}#0..{number}" for rung in rungs)
        return f"{text} x {settings.floors}" if repeats else text

    primitives = max(map(get_budget, rungs)) if settings.primitives is None else settings.primitives
    rooms = (f"{settings.floors} rooms of {bench.name}/{rungs[0]} with one motif" if repeats else
             f"A room of each of {len(rungs)} rungs of {bench.name}, from {rungs[0]} to {rungs[-1]},")
    return _make_grid(
        f"{bench.name}-{TOWER}", f"{rooms} in an episode of {SEQUENCE_HORIZON:,} primitives; tested in others than "
        "those trained in.", agents, settings, primitives, count, settings.observation or "objects",
        train_rooms=tuple(name_rooms("train", size) for size in settings.train_sizes),
        test_rooms=(name_rooms("test", count),))


class RungStanding(NamedTuple):
    """Result of one agent on one rung."""

    rung: str  # name of the rung
    agent: AgentSummary  # its summary
    success_rate: Estimate
    """Share of final test episodes that escaped, with Wilson's interval over all of them."""
    is_passed: bool  # the rung is passed, see `judge`
    units: Scores
    """Efficiencies (runs,) of each room that was learned in, or of each run alone that was tested in others."""
    floors: int = 1  # number of floors of a tower, of which the success rate is the share climbed; 1 on a rung
    learned: float | None = None
    """Share of what could be learned across rooms, see `compute_learned_share`; None where search baselines and `bayes`
    were not run on the rung, or are alike."""


def judge(agent: AgentSummary, episodes: int) -> tuple[Estimate, bool]:
    """Success rate with Wilson's interval over the episodes, and whether the rung is passed.

    It is with the interval's lower end at 0.9 or above and an interquartile mean of efficiency of 0.5 or above.
    """
    rate = Estimate(agent.success.value, *compute_wilson_interval(agent.success.value, episodes))
    return rate, rate.low >= PASSED_RATE and agent.efficiency.value >= PASSED_EFFICIENCY


def list_standings(rung: str, summary: Summary) -> list[RungStanding]:
    """RungStanding of every agent of a comparison on a rung."""
    found, has_sets = [], bool(summary.grid.train_rooms)
    floors = max(1 if room.place.split is None else len(list_sets(room.place.split.test)) for room in summary.rooms)
    for agent in summary.agents:
        rooms = summary.grid.eval_episodes if has_sets else 1  # episodes in one room are much alike
        efficiencies = [room for room in agent.efficiencies if len(room)]
        units = [run for room in efficiencies for run in np.split(room, len(room))] if has_sets else efficiencies
        found.append(RungStanding(rung, agent, *judge(agent, agent.runs * rooms), units, floors))
    searched = [own.agent.efficiency.value for own in found if own.agent.spec.name in BY_LIGHTS]
    known = [own.agent.efficiency.value for own in found if own.agent.spec.name == BAYES]
    if not searched or not known:
        return found
    return [own._replace(learned=compute_learned_share(own.agent.efficiency.value, max(searched), max(known)))
            for own in found]


def score_standings(standings: Iterable[RungStanding]) -> tuple[list[str], dict[str, Estimate]]:
    """Rungs that every agent was run on, in order, and the ladder score of each agent over them, by label."""
    by_rung: dict[str, dict[str, Scores]] = {}
    for standing in standings:
        by_rung.setdefault(standing.rung, {})[standing.agent.label] = standing.units
    labels = list(dict.fromkeys(label for agents in by_rung.values() for label in agents))
    common = [rung for rung, agents in by_rung.items() if len(agents) == len(labels)]
    return common, {label: compute_ladder_score([by_rung[rung][label] for rung in common], np.random.default_rng(0))
                    for label in labels if common}
