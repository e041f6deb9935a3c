"""Options of commands that make the runs of a grid: a part of them, on other machines, or none at all."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from hrl_escape.commands.room_choice import split_assignment
from hrl_escape.comparison.comparison import Comparison, Shard, count_missing, read_comparison, run_grid
from hrl_escape.comparison.cost import describe_cost
from hrl_escape.comparison.grid import Grid
from hrl_escape.comparison.launching.clusters import RayLauncher, SlurmLauncher
from hrl_escape.comparison.launching.local import Launcher, LocalLauncher
from hrl_escape.errors import ConfigError


@dataclasses.dataclass(frozen=True, kw_only=True)
class LaunchArgs:
    """Options that say where runs are made."""

    workers: int | None = None
    """Runs at a time; one a core by default."""
    ray: bool = False
    """Run on a Ray cluster that shares the folder (extra `ray`), or on a Ray started here."""
    slurm: int | None = None
    """Run as a Slurm array of this many jobs that share the folder (extra `slurm`); as processes here if there is no
    Slurm."""
    resources: tuple[str, ...] = ()
    """Resources that each run asks of Ray (num_cpus=2 num_gpus=0.5 memory=4e9), or each job of Slurm through submitit
    (timeout_min=600 mem_gb=4 cpus_per_task=8 slurm_partition=long)."""
    shard: str = ""
    """Make only a part of the runs, such as 2/8: one part on each of eight machines that share the folder, each
    resumable. Then --report."""
    report: bool = False
    """Run nothing: report what is finished in the folder."""
    dry_run: bool = False
    """Run nothing: print how many runs are to be made and about how long they take."""

    def make_runs(self, grid: Grid, out: Path) -> Comparison:
        """Make the part of a grid's runs that is asked for, or read all that are finished."""
        if self.report:
            return read_comparison(out, grid)
        return run_grid(grid, out, self._make_launcher(), shard=Shard.parse(self.shard or "1/1"))

    def format_options(self, *known: str) -> list[str]:
        """Words of the command line for what is not at its default and decides runs, but for `known` fields."""
        words = []
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value == field.default or field.name in (*known, "shard", "report", "dry_run", "open", "json"):
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
        """Describe how many runs are to be made, and about how long they take."""
        runs, missing, seconds = count_missing(grid, out)
        words = f"{runs:,} runs, {missing:,} to be made in {out}"
        if seconds is None:
            return f"{words}; {describe_cost(grid, grid.make_places())}"
        return (f"{words}; {seconds:.3g} s of training each in the median of {runs - missing:,}, so about "
                f"{missing * seconds / 3600:.2g} core hours")
