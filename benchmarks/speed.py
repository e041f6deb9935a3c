"""Measure the table of speeds, ours against others, in some five minutes, and append it to the history.

    python -m benchmarks.speed                     # every part, appended to benchmarks/speed.jsonl
    python -m benchmarks.speed --parts first-use rooms --dry
    python -m benchmarks.speed --table             # the last run once more, and the plot of the history
    python -m benchmarks.speed --quick --dry       # a minute: shows that everything runs

Each part is a process of its own: `first-use` plans an escape with an empty and a filled cache of kernels, `rooms`
steps single rooms, `batch` steps 8,192 rooms at once, `learning` trains PPO and DQN in many rooms and
Stable-Baselines3's PPO in 8, `options` runs planned options and presses by hand. Peers that are not installed are left
out. Compare ratios within a run. An absolute number belongs to the machine, the instruction set and the load of its
line.
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, TypeAlias

from hrl_escape.cli import run_script
from hrl_escape.errors import FileReadError

Part: TypeAlias = Literal["first-use", "rooms", "batch", "learning", "options"]
HISTORY, FIGURE = Path(__file__).with_name("speed.jsonl"), Path(__file__).parents[1] / "docs/images/speed.svg"
PRESETS = ("paper-two-button", "clutter", "door-key", "key-corridor", "sokoban", "key-chest", "puddle-world")
FIRST_PLAN = "from hrl_escape.cli import main; main(['solve', '--room', 'clutter', '--json'])"


def _run_json(module: str, *arguments: str) -> Any:
    done = subprocess.run([sys.executable, "-m", f"benchmarks.{module}", *arguments, "--json"], check=True,
                          stdout=subprocess.PIPE, text=True)
    return json.loads(done.stdout)


def _make_row(name: str, value: float, unit: str, ratio: float | None = None, to: str = "") -> dict[str, Any]:
    return {"name": name, "value": value, "unit": unit, "ratio": ratio, "to": to}


def measure_first_use(quick: bool) -> list[dict[str, Any]]:
    """Seconds of wall and processor time of a first plan on the command line.

    A cache of one's own begins empty. One of an installation after `hrl-escape warm` begins with its kernels.
    """
    from hrl_escape.kernels import INSTALLED, find_cache_folder

    own = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    rows, cold = [], 0.0
    with tempfile.TemporaryDirectory() as cache, tempfile.TemporaryDirectory() as new:
        caches = {"empty cache": {"NUMBA_CACHE_DIR": cache}, "filled cache": {"NUMBA_CACHE_DIR": cache}}
        if (INSTALLED / find_cache_folder().name).is_dir():
            caches["new cache after `hrl-escape warm`"] = {"XDG_CACHE_HOME": new}
        for name, variables in caches.items():
            before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
            subprocess.run([sys.executable, "-c", FIRST_PLAN], check=True, stdout=subprocess.DEVNULL,
                           stderr=subprocess.DEVNULL, env=own | variables)
            wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
            spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            cold = cold or spent
            rows += [_make_row(f"first plan, {name}", wall, "s"),
                     _make_row(f"first plan, {name}, processor", spent, "s", spent / cold, "empty cache")]
    return rows


def measure_rooms(quick: bool) -> list[dict[str, Any]]:
    """Steps a second of single rooms and of other environments, with CartPole as the unit."""
    found = _run_json("env", "--presets", *PRESETS, "--repeats", "2" if quick else "5",
                      "--seconds", "0.05" if quick else "0.2")
    return [_make_row(f"{row['name']}, one room", row["steps_per_second"], "steps/s", row["ratio"], found["baseline"])
            for row in found["environments"]]


def measure_batch(quick: bool) -> list[dict[str, Any]]:
    """Steps a second of 8,192 rooms at once, with CartPole's own vector environment as the unit."""
    rooms = 512 if quick else 8192
    found = _run_json("batch", "--scenes", "paper-two-button", "--sizes", str(rooms), "--engines", "compiled",
                      "--repeats", "2" if quick else "5", "--threads", str(os.cpu_count() or 1))["contenders"]
    unit = next(row["steps_per_second"] for row in found if row["name"].startswith("CartPole"))
    return [_make_row(f"{row['name']}, {row['rooms']:,} at once", row["steps_per_second"], "steps/s",
                      row["steps_per_second"] / unit, "CartPole's vector environment") for row in found]


def measure_learning(quick: bool) -> list[dict[str, Any]]:
    """Primitives a second that agents learn from, with Stable-Baselines3's PPO in 8 environments as the unit."""
    from benchmarks.many_environments import measure_ours, measure_peer

    threads, (small, large) = os.cpu_count() or 1, (64, 64) if quick else (4_096, 16_384)
    rates = {f"{name}, {count:,} rooms": measure_ours(name, count, 32 * count, threads)["wall"]
             for name, count in (("1 epoch", large), ("10 epochs", small), ("dqn", small))}
    try:
        rates["stable-baselines3's PPO, 8 rooms"] = unit = measure_peer(8, 4_096, threads)["wall"]
    except ImportError:
        unit = 0.0
    return [_make_row(f"ppo, {name}" if "epoch" in name else name, rate, "primitives/s", rate / unit if unit else None,
                      "stable-baselines3's PPO" if unit else "") for name, rate in rates.items()]


def measure_options(quick: bool) -> list[dict[str, Any]]:
    """Planned options a second in 4,096 rooms, by body and by hand, with one environment as the unit."""
    from benchmarks.many_environments import measure_options as measure

    rows = []
    for room, how in (("PaperTwoButton", "body"), ("ArmTwoButton", "hand")):
        unit = measure("single", 1, room, quick)["wall"]
        rate = measure("own pace, compiled", 256 if quick else 4096, room, quick)["wall"]
        rows += [_make_row(f"options by {how}, one room", unit, "options/s", 1.0, "one room"),
                 _make_row(f"options by {how}, batch", rate, "options/s", rate / unit, "one room")]
    return rows


PARTS: dict[str, Callable[[bool], list[dict[str, Any]]]] = {
    "first-use": measure_first_use, "rooms": measure_rooms, "batch": measure_batch, "learning": measure_learning,
    "options": measure_options}


def describe_run() -> dict[str, Any]:
    """Date, versions, processor, instruction set and load of this machine."""
    import torch

    from benchmarks.machine import describe_machine

    cpu = Path("/proc/cpuinfo")
    models = [line.partition(":")[2].strip() for line in (cpu.read_text() if cpu.exists() else "").splitlines()
              if line.startswith("model name")]
    return {"date": datetime.date.today().isoformat(), "machine": describe_machine("torch", "numba"),
            "processor": next(iter(models), "unknown"), "instructions": torch.backends.cpu.get_cpu_capability(),
            "load": round(os.getloadavg()[0], 1)}


def read_history(path: Path = HISTORY) -> list[dict[str, Any]]:
    """Return all runs, oldest first."""
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()] if path.exists() else []


def make_table(run: dict[str, Any]) -> str:
    """Return a run as a table of Markdown, below a line about its machine."""
    machine = run["machine"]
    lines = [f"{run['date']}, version {machine['hrl-escape']}, {machine['cores']} cores of {run['processor']} with "
             f"{run['instructions']}, load {run['load']:.0f} before the run.", "", "| measured | value | ratio |",
             "|---|---|---|"]
    for row in run["rows"]:
        value = f"{row['value']:,.0f}" if row["value"] >= 100 else f"{row['value']:.3g}"
        ratio = "" if row["ratio"] is None else f"{row['ratio']:.2f} of {row['to']}"
        lines.append(f"| {row['name']} | {value} {row['unit']} | {ratio} |")
    return "\n".join(lines)


def draw_history(runs: list[dict[str, Any]], path: Path = FIGURE) -> None:
    """Draw the ratios of each part's first row of ours over the runs."""
    from hrl_escape.figures import LINES, get_figure_class, save_figure

    shown = ("paper-two-button, one room", "paper-two-button, 8,192 at once", "ppo, 10 epochs, 4,096 rooms",
             "options by body, batch")
    figure = get_figure_class()(figsize=(6.4, 3.2), layout="constrained")
    axes = figure.add_subplot()
    for name, colour in zip(shown, LINES, strict=False):
        found = [(number, row["ratio"]) for number, run in enumerate(runs) for row in run["rows"]
                 if row["name"] == name and row["ratio"]]
        if found:
            axes.plot(*zip(*found, strict=True), marker="o", color=colour, label=name)
    axes.set(yscale="log", ylabel="ratio to the peer of the table", xticks=range(len(runs)),
             xticklabels=[f"{run['date']}\n{run['instructions']}" for run in runs])
    axes.yaxis.set_major_formatter("{x:g}")
    axes.legend(frameon=False, fontsize="small")
    path.parent.mkdir(exist_ok=True)
    save_figure(path, figure)


@dataclasses.dataclass
class Args:
    """What to measure."""

    parts: tuple[Part, ...] = tuple(PARTS)
    """Parts of the table."""
    quick: bool = False
    """Small sizes and short measurements."""
    dry: bool = False
    """Print only; the history stays."""
    table: bool = False
    """Print the last run, draw the history, and do no more."""
    part: Part | None = None
    """Measure one part in this process and print its rows as JSON."""


def run(args: Args) -> int:
    """Measure, append and print."""
    if args.part is not None:
        print(json.dumps(PARTS[args.part](args.quick)))
        return 0
    if not args.table:
        measured = {**describe_run(), "rows": []}
        for part in args.parts:
            print(f"measuring {part} ...", file=sys.stderr, flush=True)
            command = [sys.executable, "-m", "benchmarks.speed", "--part", part, *["--quick"] * args.quick]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
            measured["rows"] += json.loads(done.stdout.splitlines()[-1])
        print(make_table(measured))
        if args.dry:
            return 0
        with HISTORY.open("a", encoding="utf-8") as file:
            file.write(json.dumps(measured) + "\n")
    runs = read_history()
    if not runs:
        raise FileReadError(f"{HISTORY} has no run yet: leave out --table to make one")
    draw_history(runs)
    if args.table:
        print(make_table(runs[-1]))
    return 0


if __name__ == "__main__":
    sys.exit(run_script(run))
