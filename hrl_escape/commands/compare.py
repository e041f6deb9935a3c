"""Compare agents on the same rooms and write a report: verdict, curves, tables, replays.

    hrl-escape compare                                     # quickstart: do options help, does learning help?
    hrl-escape compare demo                                # the same as hrl-escape demo
    hrl-escape compare --agents smdp-r-max search-backtrack random-options --room clutter
    hrl-escape compare paper --workers 8
    hrl-escape compare ladder --room clutter clutter#1 --runs 5
    hrl-escape compare --agents dqn smdp-dqn smdp-dqn@keras-rl-2019 random-options --room four-button-chain
    hrl-escape compare my-grid.toml --out runs/mine
    hrl-escape compare --env CartPole-v1 --agents dqn ppo --runs 5
    hrl-escape compare --env MiniGrid-DoorKey-8x8-v0 --options my_options.py:make --agents dqn smdp-dqn random-options
    hrl-escape compare --agents smdp-dqn random-options --observation objects \
        --train-rooms ladder-1/pair/train#0..16 --test-rooms ladder-1/pair/test

Finished runs are kept; the same command resumes. An environment from elsewhere has no best known return: agents are
compared by their return, or by success where every episode reports it. In a grid's file, agents are tables or short
texts, and rooms are short texts:

    primitives = 20000
    rooms = ["clutter#3", "larg-2019(size=4)", "my-room.json", "ladder-1/lattice/test#3"]
    agents = ["random-options", { name = "smdp-dqn", label = "far-sighted", settings = { gamma = 0.999 } },
              { name = "smdp-dqn", label = "no primitives", options = { include_primitives = false } }]
"""

from __future__ import annotations

import dataclasses
import json
import math
import shlex
import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table
from rich.text import Text

from hrl_escape.agents.registry import RANDOM_OPTIONS
from hrl_escape.agents.spec import PARTS, AgentSpec
from hrl_escape.benchmark.comparison import Comparison, Shard, count_missing, read_comparison, run_grid
from hrl_escape.benchmark.cost import describe_cost
from hrl_escape.benchmark.grid import Grid, load_grid
from hrl_escape.benchmark.launching.clusters import RayLauncher, SlurmLauncher
from hrl_escape.benchmark.launching.local import Launcher, LocalLauncher
from hrl_escape.benchmark.presets import GRIDS, get_grid
from hrl_escape.benchmark.reporting.report import format_first_escape, list_env_columns, list_env_values, write_report
from hrl_escape.benchmark.summary import Summary
from hrl_escape.benchmark.verdict import SENTENCE_MARKS, write_verdict
from hrl_escape.commands.agent_choice import VectorObservation
from hrl_escape.commands.env_choice import EnvChoice
from hrl_escape.commands.room_choice import refuse_rooms, split_assignment
from hrl_escape.errors import ConfigError, UnknownNameError, UnsupportedError
from hrl_escape.names import join_words, make_console_text, make_file_name, tell_seconds
from hrl_escape.sets.room_spec import RoomSpec

DEFAULT, DEMO = "quickstart", "demo"
AGENTS_HELP = ("Other agents: names from `hrl-escape list agents references`, smdp- in front for those that choose "
               "among options, @ and the name of settings, then parts: "
               f"{join_words('+' + name for name in PARTS)}, see `hrl-escape list parts`.")
PIPED_WIDTH = 110


@dataclasses.dataclass(frozen=True, kw_only=True)
class LaunchArgs:
    """Options of the execution of a grid, shared with `hrl-escape ladder run`."""

    workers: int | None = None
    """Runs at a time; one a core by default."""
    ray: bool = False
    """Run on a Ray cluster that shares the folder (extra `ray`), or on a local Ray."""
    slurm: int | None = None
    """Run as a Slurm array of this many jobs that share the folder (extra `slurm`); as local processes without
    Slurm."""
    resources: tuple[str, ...] = ()
    """Resources of each run with Ray (num_cpus=2 num_gpus=0.5 memory=4e9), or of each Slurm job through submitit
    (timeout_min=600 mem_gb=4 cpus_per_task=8 slurm_partition=long)."""
    shard: str = ""
    """Make one part of the runs, such as 2/8 on the second of eight machines that share the folder; then use
    --report."""
    report: bool = False
    """Report the finished runs in the folder without running."""
    dry_run: bool = False
    """Run nothing: print how many runs are to be made and about how long they take."""
    quiet: bool = False
    """Show no progress line."""

    def make_runs(self, grid: Grid, out: Path) -> Comparison:
        """Make the requested part of a grid's runs, or read all finished ones."""
        if self.report:
            return read_comparison(out, grid)
        return run_grid(grid, out, self._make_launcher(), shard=Shard.parse(self.shard or "1/1"),
                        progress=False if self.quiet else None)

    def format_options(self, *known: str) -> list[str]:
        """Return the words of the command line for changed options that affect runs, without `known` fields."""
        words = []
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value == field.default or field.name in (*known, "shard", "report", "dry_run", "quiet", "open",
                                                        "json"):
                continue
            values = value if isinstance(value, tuple) else () if value is True else (value,)
            words += [f"--{field.metadata.get('word', field.name).replace('_', '-')}", *map(str, values)]
        return words

    def _make_launcher(self) -> Launcher:
        resources = dict(split_assignment(text, "--resources", "num_gpus=1") for text in self.resources)
        if self.slurm is not None and self.ray:
            raise ConfigError("slurm", self.slurm, "without --ray: choose one")
        if resources and not self.ray and self.slurm is None:
            raise ConfigError("resources", " ".join(self.resources), "with --ray or --slurm")
        if self.slurm is not None:
            return SlurmLauncher(self.slurm, resources=resources)
        return RayLauncher(self.workers, resources=resources) if self.ray else LocalLauncher(self.workers)

    def describe_work(self, grid: Grid, out: Path) -> str:
        """Describe the number of missing runs and their estimated time."""
        runs, missing, seconds = count_missing(grid, out)
        words = f"{runs:,} runs, {missing:,} to be made in {out}"
        if seconds is None:
            return f"{words}; {describe_cost(grid, grid.make_places())}"
        return (f"{words}; {tell_seconds(seconds)} of training each in the median of {runs - missing:,}, so about "
                f"{tell_seconds(missing * seconds)} of training on one core")


@dataclasses.dataclass(frozen=True)
class CompareArgs(LaunchArgs, EnvChoice):
    """Options of `hrl-escape compare`."""

    what: Annotated[str, tyro.conf.Positional] = DEFAULT
    """Name of a comparison, see `hrl-escape list comparisons`; or a .toml or .json file with your own grid."""
    agents: Annotated[tuple[str, ...], tyro.conf.arg(help=AGENTS_HELP)] = ()
    room: tuple[str, ...] = ()
    """Other rooms: clutter, clutter#3, ladder-1/lattice/test#3, my-room.json; see `hrl-escape room --help`."""
    train_rooms: tuple[str, ...] = ()
    """Training sets, such as ladder-1/lattice/train#0..64, clutter#0..16 or a .json file of a set."""
    test_rooms: tuple[str, ...] = ()
    """Test sets: one for all --train-rooms, or one for each."""
    reference: float | None = None
    """Return in --env to draw and to name for comparison."""
    runs: int | None = None
    """Runs of each agent in each room; use ten or more for published tables."""
    first_seed: int | None = None
    """Training seed of the first run, 0 by default."""
    primitives: int | None = None
    """Training budget of a run."""
    eval_every: int | None = None
    """Primitives between evaluations; a twentieth of the budget by default."""
    eval_episodes: int | None = None
    """Episodes in an evaluation."""
    observation: VectorObservation | None = None
    """Observation of all agents; by default the comparison's, or objects if one of --agents needs it."""
    out: Path | None = None
    """Folder of runs and report; runs/NAME by default."""
    open: bool = False
    """Open the report in a browser at the end."""
    json: bool = False
    """Print the results as JSON."""

    @classmethod
    def check_words(cls, command: Sequence[str], words: Sequence[str]) -> None:
        """Raise for --rooms, the name of --room in 0.3."""
        refuse_rooms(words)

    def make_grid(self) -> Grid:
        """Make the requested grid.

        Raises:
            EscapeError: it cannot be read, or has an impossible value.
        """
        if Path(self.what).suffix.lower() in (".toml", ".json"):
            grid = load_grid(self.what)
        elif self.what in GRIDS:
            grid = get_grid(self.what)
        else:
            raise UnknownNameError("comparison", self.what, [*GRIDS, "your-grid.toml"])
        changes: dict[str, object] = {
            name: value for name in ("runs", "first_seed", "primitives", "eval_every", "eval_episodes", "observation")
            if (value := getattr(self, name)) is not None
        }
        if self.agents:
            agents = changes["agents"] = tuple(map(AgentSpec.parse, self.agents))
            if any(agent.reads_objects for agent in agents):
                changes.setdefault("observation", "objects")
        if (env := self.make_env_spec(self.reference)) is not None:
            if self.room or self.train_rooms or self.test_rooms or self.observation:
                raise UnsupportedError("--env does not go with --room, --train-rooms, --test-rooms and --observation")
            changes |= {"rooms": (), "env": env}
            if not self.agents:
                over_options = (RANDOM_OPTIONS, "smdp-dqn") if self.options else ()
                changes["agents"] = tuple(map(AgentSpec.parse, ("random", "dqn", *over_options)))
        if self.room:
            changes["rooms"] = tuple(map(RoomSpec.parse, self.room))
        if self.train_rooms:
            changes |= {"rooms": (), "train_rooms": self.train_rooms, "test_rooms": self.test_rooms}
        if self.what == DEFAULT and (self.agents or self.room or self.train_rooms or self.env):
            changes |= {"name": "comparison", "description": ""}
        return dataclasses.replace(grid, **changes)

    def format_command(self) -> str:
        """Return the command line that reproduces this comparison."""
        return shlex.join(["hrl-escape", "compare", self.what, *self.format_options("what")])


def run(args: CompareArgs) -> int:
    """Run and report; the exit code is 1 if runs failed."""
    grid = args.make_grid()
    console = Console(soft_wrap=True, highlight=False, width=None if sys.stdout.isatty() else PIPED_WIDTH)
    out = args.out or Path("runs") / make_file_name(grid.name)
    if args.dry_run:
        console.print(args.describe_work(grid, out))
        return 0
    try:
        comparison = args.make_runs(grid, out)
    except KeyboardInterrupt:
        Console(stderr=True).print("Finished runs are kept; the same command resumes.")
        raise
    if args.shard:
        console.print(f"part {args.shard}: {len(comparison.runs)} runs finished; --report reports all parts")
        return 1 if comparison.failures else 0
    summary = write_report(comparison, args.format_command())
    page = comparison.out / "report.html"
    if args.json:
        print(json.dumps(_to_json(summary, comparison), indent=2))
    else:
        _print(console, summary, comparison)
    if args.open:
        webbrowser.open(page.as_uri())
    return 1 if comparison.failures else 0


@dataclasses.dataclass(frozen=True)
class DemoArgs:
    """Options of `hrl-escape demo`."""

    workers: int | None = None
    """Runs at a time; one a core by default."""
    open: bool = False
    """Open the report in a browser at the end."""
    dry_run: bool = False
    """Run nothing: print how many runs are to be made and about how long they take."""


def run_demo(args: DemoArgs) -> int:
    """Compare six agents in a room with four buttons: the same as `hrl-escape compare demo`.

    Examples:
        hrl-escape demo
        hrl-escape demo --open
    """
    return run(CompareArgs(what=DEMO, **vars(args)))


# --- what is printed -------------------------------------------------------------------


def _print(console: Console, summary: Summary, comparison: Comparison) -> None:
    headline, *others = write_verdict(summary)
    console.print()
    console.print(_mark(headline.text), style="bold")
    for sentence in others:
        console.print(Text(SENTENCE_MARKS[sentence.kind], style="dim").append_text(_mark(sentence.text)))
    table = Table(box=None, pad_edge=False, header_style="dim", padding=(0, 1))
    table.add_column("agent", no_wrap=True)
    in_rooms = summary.grid.env is None
    for heading in (("efficiency", "95 % interval", "progress", "success rate", "primitives", "first escape")
                    if in_rooms else list_env_columns(summary)):
        table.add_column(heading, justify="right", no_wrap=True)
    for agent in summary.agents:
        if not in_rooms:
            table.add_row(make_console_text(agent.label), *list_env_values(summary, agent))
            continue
        table.add_row(make_console_text(agent.label), f"{agent.efficiency.value:.3f}",
                      f"{agent.efficiency.low:.3f} to {agent.efficiency.high:.3f}", f"{agent.progress.value:.2f}",
                      f"{agent.success.value:.0%}", f"{agent.length.value:,.0f}", format_first_escape(agent))
    console.print("", table, "")
    console.print(summary.describe_intervals(), style="dim")
    for failure in comparison.failures:
        console.print(Text(f"failed: {failure.run.name}: {failure.message}", style="red"))
    console.print(f"Report: {(comparison.out / 'report.html').absolute().as_uri()}", markup=False)


def _mark(text: str) -> Text:
    """Print labels between backticks in bold."""
    marked = Text()
    for number, part in enumerate(text.split("`")):
        marked.append(part, style="bold cyan" if number % 2 else "")
    return marked


def _to_json(summary: Summary, comparison: Comparison) -> dict[str, Any]:
    return _clear({
        "measure": summary.measure.name,
        "verdict": [dataclasses.asdict(sentence) for sentence in write_verdict(summary)],
        "agents": [
            {
                "label": agent.label,
                "runs": agent.runs,
                "seen": None if agent.seen is None else agent.seen._asdict(),
                **{name: getattr(agent, name)._asdict() for name in
                   ("primary", "returns", "efficiency", "progress", "success", "first_escape", "length", "score",
                    "area")},
                **{name: None if (found := getattr(agent, name)) is None else found._asdict()
                   for name in ("regret", "unseen")},
                "escaped_runs": agent.escaped_runs,
                "stuck": agent.stuck,
                "gap": agent.gap._asdict(),
            }
            for agent in summary.agents
        ],
        "rooms": [{"name": room.name, "id": room.place.id, "best": room.best, "fewest": room.fewest}
                  for room in summary.rooms],
        "failures": [{"run": failure.run.name, "message": failure.message} for failure in comparison.failures],
        "report": str(comparison.out / "report.html"),
    })


def _clear(value: Any) -> Any:
    """Replace NaN, which JSON lacks, by None."""
    if isinstance(value, dict):
        return {name: _clear(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_clear(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value
