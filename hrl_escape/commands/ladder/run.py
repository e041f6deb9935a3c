"""Run agents on the rungs of a benchmark under a protocol, and report each rung.

Protocols:
    per-instance  train from scratch in each test room
    generalise    train in training rooms, test in others
    transfer      train in training rooms of one rung, test in rooms of another, without learning
    few-shot      as generalise, with several trials in each room; memories persist across trials
    sequence      a room of every rung in an episode, one after another, within one horizon

Finished runs are kept; the same command resumes. `hrl-escape ladder report` summarises the rungs.

Examples:
    hrl-escape ladder run smdp-dqn random-options oracle --rung doormat pair --protocol per-instance --runs 3
    hrl-escape ladder run smdp-ppo+objects+memory oracle --rung lattice --protocol generalise --train-sizes 1 16 64
    hrl-escape ladder run smdp-dqn+objects+memory bayes --protocol transfer --from chain --rung lattice-5
    hrl-escape ladder run smdp-dqn+objects+memory random-options oracle --protocol few-shot --trials 4 --rung chain
    hrl-escape ladder run smdp-ppo+objects+memory random-options oracle --protocol sequence
    hrl-escape ladder run smdp-dqn oracle --rung chain lattice --out /shared/ladder --shard 3/8
"""

from __future__ import annotations

import dataclasses
import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from hrl_escape.agents.spec import AgentSpec
from hrl_escape.benchmark.comparison import read_comparison
from hrl_escape.benchmark.protocols import (
    SEQUENCE,
    LadderSettings,
    Protocol,
    choose_sequence,
    make_protocol_grid,
    make_sequence_grid,
    name_protocol,
)
from hrl_escape.benchmark.reporting.figures import AxisScore, draw_radar, list_references, make_profiles
from hrl_escape.benchmark.reporting.report import write_report
from hrl_escape.benchmark.rung_references import load_references
from hrl_escape.benchmark.standings import RungStanding, list_standings, score_standings
from hrl_escape.benchmark.summary import summarise
from hrl_escape.commands.compare import LaunchArgs
from hrl_escape.commands.room_choice import refuse_options
from hrl_escape.errors import FileReadError
from hrl_escape.figures import save_figure
from hrl_escape.names import join_words, make_file_name
from hrl_escape.sets.benchmark import Benchmark, load_benchmark

FROM = {"word": "from"}
"""Command-line name of `source`, because `from` is reserved in Python."""
PROTOCOLS_OF = {"train_sizes": ("generalise", "transfer", "few-shot", "sequence"), "trials": ("few-shot",),
                "repeats": ("sequence",)}
"""Options of some protocols only."""


@dataclasses.dataclass(frozen=True)
class RunArgs(LadderSettings, LaunchArgs):
    """Options of `hrl-escape ladder run`."""

    agents: Annotated[tuple[str, ...], tyro.conf.Positional] = dataclasses.field(kw_only=True)
    """Specs of agents, and references: smdp-dqn, smdp-ppo+objects+memory, search-backtrack, oracle; `hrl-escape list`
    names them."""
    rung: tuple[str, ...] = ()
    """Names of rungs; all by default; with the protocol sequence, those with the same primitives."""
    protocol: Protocol = "per-instance"
    """per-instance, generalise, transfer, few-shot or sequence."""
    source: Annotated[str | None, tyro.conf.arg(name="from")] = dataclasses.field(default=None, metadata=FROM)
    """Rung to train on with transfer."""
    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""
    out: Path | None = None
    """Folder of all rungs and protocols; runs/ and the benchmark's name by default."""

    def format_command(self, rungs: Sequence[str]) -> str:
        """Return the command line that reproduces these rungs."""
        return shlex.join(["hrl-escape", "ladder", "run", *self.agents, "--rung", *rungs,
                           *self.format_options("agents", "rung")])


def find_default_folder(bench: Benchmark) -> Path:
    """Return the default folder of a benchmark's runs."""
    return Path("runs") / make_file_name(bench.name)


def run(args: RunArgs) -> int:
    """Run rung by rung; the exit code is 1 if runs failed."""
    bench = load_benchmark(args.benchmark)
    for name, protocols in PROTOCOLS_OF.items():
        if args.protocol not in protocols:
            refuse_options(args, (name,), f"does nothing with --protocol {args.protocol}; it is for "
                           f"{join_words(protocols, 'or')}")
    agents = tuple(map(AgentSpec.parse, args.agents))
    console, failed = Console(soft_wrap=True, highlight=False), 0
    rungs = args.rung or tuple(rung.name for rung in bench)
    if args.protocol == SEQUENCE:
        chosen = args.rung or choose_sequence(bench)
        if left_out := [rung for rung in rungs if rung not in chosen]:
            console.print("Left out of the sequence, because their robots have other primitives: "
                          f"{', '.join(left_out)}")
        parts = {SEQUENCE: (chosen, make_sequence_grid(bench, chosen, agents, args))}
    else:
        parts = {rung: ((rung,), make_protocol_grid(bench, rung, args.protocol, agents, args)) for rung in rungs}
    folder = (args.out or find_default_folder(bench)) / name_protocol(args.protocol, args.source)
    for name, (chosen, grid) in parts.items():
        if args.dry_run:
            console.print(f"{name}: {args.describe_work(grid, folder / name)}")
            continue
        comparison = args.make_runs(grid, folder / name)
        failed += len(comparison.failures)
        if not args.shard:
            write_report(comparison, args.format_command(chosen))
        console.print(f"{name}: {len(comparison.runs)} runs finished, {len(comparison.failures)} failed; "
                      f"{comparison.out}")
    return 1 if failed else 0


# --- results ---------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class ReportArgs:
    """Options of `hrl-escape ladder report`."""

    folder: Annotated[Path | None, tyro.conf.Positional] = None
    """Folder given to `hrl-escape ladder run --out`; runs/ and the benchmark's name by default."""
    protocol: Protocol = "per-instance"
    """Protocol to summarise."""
    source: Annotated[str | None, tyro.conf.arg(name="from")] = None
    """Training rung, with transfer."""
    benchmark: str = "ladder-1"
    """Benchmark that comes with the package, or a manifest file."""
    json: bool = False
    """Print JSON instead of tables."""


def run_report(args: ReportArgs) -> None:
    """Summarise the finished runs of `hrl-escape ladder run`: efficiency and success rate of every agent on every rung.

    A rung is passed if the lower end of the 95 % interval of the success rate is at least 0.9 and efficiency at least
    0.5. The ladder score is the mean over rungs of the interquartile mean of efficiency, over the rungs that every
    agent was run on. The normalised score is 0 for the best search baseline, such as search-memory, and 1 for the Bayes
    planner. It requires runs of both, and a gap between them that is above 0.10 in unseen rooms. Regret is the share of
    the training primitives lost relative to the oracle.

    A benchmark with axes, such as ladder-2, also gives a profile: a table of efficiency by axis, with its references,
    and a radar chart, profile.svg in the protocol's folder.

    Examples:
        hrl-escape ladder report
        hrl-escape ladder report --protocol generalise --json
        hrl-escape ladder report --protocol transfer --from chain
        hrl-escape ladder report runs/mine --protocol sequence
        hrl-escape ladder report --benchmark ladder-2
    """
    bench = load_benchmark(args.benchmark)
    rungs = [SEQUENCE] if args.protocol == SEQUENCE else [rung.name for rung in bench]
    base = (args.folder or find_default_folder(bench)) / name_protocol(args.protocol, args.source)
    folders = {rung: base / rung for rung in rungs}
    found = {rung: folder for rung, folder in folders.items() if (folder / "grid.json").exists()}
    if not found:
        raise FileReadError(f"{base}: no rung was run here; see hrl-escape ladder run --help")
    standings = [standing for rung, folder in found.items()
                 for standing in list_standings(rung, summarise(read_comparison(folder)))]
    highest = {standing.agent.label: "none" for standing in standings}
    highest |= {standing.agent.label: standing.rung for standing in standings if standing.is_passed}
    common, scores = score_standings(standings)
    profiles = _make_profiles(bench, standings)
    if args.json:
        print(json.dumps({"protocol": args.protocol, "highest": highest, "rungs": list(map(_to_json, standings)),
                          "score_rungs": common, **_profiles_to_json(profiles),
                          "scores": {label: score._asdict() for label, score in scores.items()}}, indent=2))
        return
    console = Console(width=120, highlight=False)
    table = Table("rung", "agent", "runs", "efficiency", "normalised", "regret", "trained in", "success rate", "passed",
                  "core hours",
                  *(("rooms escaped",) if args.protocol == SEQUENCE else ()), box=None, pad_edge=False)
    for standing in standings:
        agent = standing.agent
        table.add_row(
            standing.rung, agent.label, str(agent.runs),
            f"{agent.efficiency:.3f}",
            "" if standing.normalised is None else f"{standing.normalised:.2f}",
            "" if agent.regret is None else f"{agent.regret.value:.2f}",
            "" if agent.seen is None else f"{agent.seen.value:.3f}", f"{standing.success_rate:.0%}",
            "yes" if standing.is_passed else "no", f"{_count_hours(standing):.2g}",
            *([f"{_count_rooms(standing):.2f} of {standing.parts}"] if args.protocol == SEQUENCE else []))
    console.print(table)
    if any(standing.agent.trials for standing in standings):
        console.print(_make_trial_table(standings))
    if profiles:
        _tell_profiles(console, bench, profiles, base / "profile.svg")
    for label, rung in highest.items():
        console.print(f"Highest rung that {label} passed: {rung}", markup=False)
    over = f"over {', '.join(common)}:" if common else "over no rung: none has runs of every agent"
    console.print(f"Ladder score {over}")
    for label, score in scores.items():
        console.print(f"{label}: {score:.3f}", markup=False)


def _make_profiles(bench: Benchmark, standings: Sequence[RungStanding]) -> dict[str, dict[str, AxisScore]]:
    """Make profiles of agents and references; empty for a benchmark without axes."""
    found: dict[str, dict[str, float]] = {}
    for standing in standings:
        found.setdefault(standing.agent.label, {})[standing.rung] = standing.agent.efficiency.value
    known = list_references(load_references(bench.name))
    return make_profiles(bench.manifest.axes, found | known) if bench.manifest.axes else {}


def _tell_profiles(console: Console, bench: Benchmark, profiles: dict[str, dict[str, AxisScore]], path: Path) -> None:
    """Print a row for each axis, and draw the radar chart."""
    axes = bench.manifest.axes
    table = Table("axis", *profiles, box=None, pad_edge=False)
    for axis in axes:
        table.add_row(axis.name, *(str(profile.get(axis.name, "")) for profile in profiles.values()))
    console.print(table)
    save_figure(path, draw_radar(profiles, axes))
    console.print(f"wrote {path}", markup=False)


def _profiles_to_json(profiles: dict[str, dict[str, AxisScore]]) -> dict[str, object]:
    return {"profiles": {agent: {axis: score.levels for axis, score in profile.items()}
                         for agent, profile in profiles.items()}} if profiles else {}


def _count_hours(standing: RungStanding) -> float:
    """Core hours of training of all its runs."""
    return standing.agent.seconds * standing.agent.runs / 3600


def _count_rooms(standing: RungStanding) -> float:
    """Mean number of rooms of a sequence that the agent escaped from."""
    return standing.success_rate.value * standing.parts


def _make_trial_table(standings: Sequence[RungStanding]) -> Table:
    """Make the table of efficiency by trial, a row for each agent and rung."""
    most = max(len(standing.agent.trials) for standing in standings)
    table = Table("rung", "agent", *(f"trial {number}" for number in range(1, most + 1)), box=None, pad_edge=False)
    for standing in standings:
        table.add_row(standing.rung, standing.agent.label, *(f"{trial.value:.3f}" for trial in standing.agent.trials))
    return table


def _to_json(standing: RungStanding) -> dict[str, object]:
    agent = standing.agent
    return {"rung": standing.rung, "agent": agent.label, "runs": agent.runs,
            "efficiency": agent.efficiency._asdict(), "seen": None if agent.seen is None else agent.seen._asdict(),
            "success_rate": standing.success_rate, "passed": standing.is_passed, "normalised": standing.normalised,
            **{name: None if (found := getattr(agent, name)) is None else found._asdict()
               for name in ("regret", "unseen")},
            "core_hours": _count_hours(standing),
            "trials": [trial._asdict() for trial in agent.trials],
            **({"rooms": standing.parts, "rooms_escaped": _count_rooms(standing)} if standing.parts > 1 else {})}
